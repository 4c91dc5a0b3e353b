/* For an exported folder: impossible seeds only reset the state, whatever they contain. Every
 * estimate of the following record is finite, and the position becomes valid. */
#include <math.h>
#include <stdio.h>

#include "fluxobs_seed.h"
#include "motor_observer.h"
#include "vectors.h"

#ifdef ADAPTIVE
typedef fo_adaptive_state any_state;
typedef fo_adaptive_estimate any_estimate;
#define SEED fo_adaptive_seed_state
#define STEP fo_adaptive_step
#define POSITION .position
#else
typedef fo_state any_state;
typedef fo_estimate any_estimate;
#define SEED fo_seed_state
#define STEP fo_step
#define POSITION
#endif

static any_state state;

static int follows(const fo_seed *seed, const fo_real current[2])
{
    any_estimate e;
    int valid = 0, endless = 0;
    SEED(&motor_observer, &state, seed, current);
    for (int k = 0; k < SAMPLES; k++) {
        STEP(&motor_observer, &state, &samples[k][0], &samples[k][2], &e);
        const fo_real sum = e POSITION.theta_e + e POSITION.theta_e_std + e POSITION.speed_e +
                            e POSITION.flux[0] + e POSITION.flux[1] + e POSITION.drift[0];
        endless += !(sum - sum == (fo_real)0);
        valid += e POSITION.valid ? 1 : 0;
    }
    return endless == 0 && valid > 0;
}

/* An unknown angle is uniform over a turn. */
static const fo_real UNKNOWN = (fo_real)1.8;

/* The angle's standard deviation one sample after a seed. */
static fo_real std_after(const fo_seed *seed)
{
    const fo_real still[2] = {0, 0};
    any_estimate e;
    SEED(&motor_observer, &state, seed, still);
    STEP(&motor_observer, &state, &samples[0][0], &samples[0][2], &e);
    return e POSITION.theta_e_std;
}

int main(void)
{
    const fo_real bad[] = {(fo_real)NAN, (fo_real)INFINITY, (fo_real)-INFINITY, (fo_real)1e30};
    const fo_seed good = {(fo_real)0.7, (fo_real)0.1, (fo_real)0, (fo_real)0, (fo_real)0,
                          (fo_real)0};
    const fo_real still[2] = {0, 0};
    int failures = !follows(&good, still);
    for (int n = 0; n < 4; n++) {
        for (int field = 0; field < 6; field++) {
            fo_seed seed = good;
            fo_real *const fields[6] = {&seed.theta_e, &seed.theta_e_std, &seed.speed_e, &seed.psi_f,
                                        &seed.psi_f_std, &seed.weight_other};
            *fields[field] = bad[n];
            if (!follows(&seed, still)) {
                printf("field %d with %g\n", field, (double)bad[n]);
                failures++;
            }
        }
        const fo_real current[2] = {bad[n], (fo_real)1};
        if (!follows(&good, current)) {
            printf("current %g\n", (double)bad[n]);
            failures++;
        }
    }
    fo_seed unsure = good;
    unsure.theta_e_std = (fo_real)0; /* as in a structure of zeros */
    if (!(std_after(&unsure) > UNKNOWN)) {
        printf("a seed without a standard deviation is believed\n");
        failures++;
    }
    for (int side = -1; side <= 1; side += 2) { /* angles of more than a turn are refused */
        fo_seed turn = good;
        turn.theta_e = (fo_real)side * (fo_real)6.2831;
        const bool inside = std_after(&turn) < (fo_real)0.2;
        turn.theta_e = (fo_real)side * (fo_real)6.2833;
        if (!inside || !(std_after(&turn) > UNKNOWN)) {
            printf("the limit of the angle is not a turn\n");
            failures++;
        }
    }
    return failures > 0;
}
