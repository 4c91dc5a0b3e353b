/* Compares a state of zeros with a state that was reset: the estimates are the same, and zeros
 * count as one more restart. */
#include "motor_observer.h"
#include "vectors.h"

#ifdef ADAPTIVE
#define RESET fo_adaptive_reset
#define STEP fo_adaptive_step
#define PLAIN .plain
#define POSITION .position
static fo_adaptive_state zeros, reset;
static fo_adaptive_estimate of_zeros, of_reset;
#else
#define RESET fo_reset
#define STEP fo_step
#define PLAIN
#define POSITION
static fo_state zeros, reset;
static fo_estimate of_zeros, of_reset;
#endif

int main(void)
{
    int valid = 0;
    RESET(&motor_observer, &reset);
    for (int k = 0; k < SAMPLES; k++) {
        STEP(&motor_observer, &zeros, &samples[k][0], &samples[k][2], &of_zeros);
        STEP(&motor_observer, &reset, &samples[k][0], &samples[k][2], &of_reset);
        if (of_zeros POSITION.theta_e != of_reset POSITION.theta_e ||
            of_zeros POSITION.theta_e_std != of_reset POSITION.theta_e_std ||
            of_zeros POSITION.valid != of_reset POSITION.valid) {
            return 1;
        }
        valid += of_zeros POSITION.valid ? 1 : 0;
    }
    return valid > 0 && zeros PLAIN.restarts == reset PLAIN.restarts + 1U ? 0 : 2;
}
