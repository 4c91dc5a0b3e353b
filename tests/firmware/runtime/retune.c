/* For an exported folder: a configuration changes while the record runs. A plain observer continues
 * like an observer whose numbers were changed by hand. The learnt values of an adaptive observer
 * stay true. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "fluxobs_config.h"
#include "motor_config.h"
#include "motor_observer.h"
#include "fluxobs_retune.h"
#include "vectors.h"

static int failures = 0;

static void demand_that(bool good, const char *what)
{
    if (!good) {
        printf("%s\n", what);
        failures++;
    }
}

enum { CHANGE = 240 };

static void check_plain(const fo_config *config)
{
    static fo_state a, b;
    static fo_observer one, other;
    static fo_retunable r;
    fo_estimate ea, eb;
    fo_config hot = *config, longer = *config;
    hot.R[0][0] = hot.R[1][1] = (fo_real)1.3 * config->R[0][0];
    longer.memory = (fo_real)2 * config->memory;
    fo_init(&one, config);
    fo_init(&other, &hot);
    fo_retunable_init(&r, &one);
    fo_reset(&one, &a);
    fo_reset(&one, &b);
    for (int k = 0; k < SAMPLES; k++) {
        if (k == CHANGE) {
            demand_that(fo_retune(&r, &longer) == FO_ERROR_OTHER, "another memory is taken");
            demand_that(fo_retune(&r, &hot) == FO_OK, "a resistance is refused");
            demand_that(fo_retune(&r, &hot) == FO_ERROR_BUSY, "the second was not refused");
        }
        fo_step(fo_take(&r), &a, &samples[k][0], &samples[k][2], &ea);
        fo_step(k < CHANGE ? &one : &other, &b, &samples[k][0], &samples[k][2], &eb);
        demand_that(memcmp(&ea.flux, &eb.flux, sizeof ea.flux) == 0, "another flux");
    }
    demand_that(fo_retune(&r, config) == FO_OK, "it cannot be changed back");
}

#if FO_ADAPTIVE
static void check_adaptive(const fo_config *config, const fo_adaptive_config *adaptive)
{
    static fo_adaptive_state a, b;
    static fo_adaptive one;
    static fo_adaptive_retunable r;
    fo_adaptive_estimate ea, eb;
    fo_learnt before, after;
    fo_config hot = *config;
    fo_adaptive_config changed = *adaptive;
    fo_real off = 0;
    const fo_real R = config->R[0][0], more = (fo_real)0.05 * R;
    hot.R[0][0] = hot.R[1][1] = R + more;
    changed.psi_f *= (fo_real)1.01;
    changed.inverter_voltage += (fo_real)0.05;
    demand_that(fo_adaptive_init(&one, config, adaptive) == FO_OK, "a good one is refused");
    fo_adaptive_retunable_init(&r, &one);
    fo_adaptive_reset(&one, &a);
    fo_adaptive_reset(&one, &b);
    for (int k = 0; k < SAMPLES; k++) {
        if (k == SAMPLES / 2) {
            fo_adaptive_learnt(&one, &a, &before);
            demand_that(fo_adaptive_retune(&r, &hot, &changed) == FO_OK, "a change is refused");
        }
        const fo_adaptive *now = fo_adaptive_take(&r, &a);
        if (k == SAMPLES / 2) {
            fo_adaptive_learnt(now, &a, &after);
            /* the prior changes too: a value moves by the share that the prior determines */
            const fo_real tiny = (fo_real)1e-5, std_R = before.resistance_std / one.std[FO_RESISTANCE];
            const fo_real std_psi = before.psi_f_std / (one.std[FO_PSI] * one.plain.flux_base);
            const fo_real std_V = before.inverter_std / (one.std[FO_INVERTER] * (fo_real)1.5);
            demand_that(fabs((double)(before.resistance_error - more - after.resistance_error)) <
                            (double)(tiny * R + more * std_R * std_R * 2), "the resistance has changed");
            demand_that(fabs((double)(before.psi_f - after.psi_f)) < (double)((tiny + (fo_real)0.02 * std_psi * std_psi) * before.psi_f),
                        "the magnet flux has changed");
            demand_that(fabs((double)(before.inverter_voltage - after.inverter_voltage)) <
                            (double)(tiny + (fo_real)0.1 * std_V * std_V),
                        "the inverter's loss has changed");
            demand_that(before.resistance_std == after.resistance_std, "another std");
        }
        fo_adaptive_step(now, &a, &samples[k][0], &samples[k][2], &ea);
        fo_adaptive_step(&one, &b, &samples[k][0], &samples[k][2], &eb);
        if (ea.position.valid && eb.position.valid) {
            const fo_real d = (fo_real)fabs(remainder((double)(ea.position.theta_e - eb.position.theta_e),
                                                      6.283185307179586));
            off = d > off ? d : off;
        }
    }
    printf("angles differ by %.2g degrees at most\n", (double)off * 57.3);
    demand_that(off < (fo_real)0.01, "the position has changed");

    /* before anything is learnt, the new values are the estimates */
    fo_adaptive_retunable_init(&r, &one);
    fo_adaptive_reset(&one, &a);
    fo_adaptive_retune(&r, &hot, &changed);
    const fo_adaptive *fresh = fo_adaptive_take(&r, &a);
    for (int k = 0; k < 4; k++) { /* the learner takes the new values with its next mail */
        fo_adaptive_step(fresh, &a, &samples[k][0], &samples[k][2], &ea);
    }
    fo_adaptive_learnt(fresh, &a, &after);
    demand_that(fabs((double)after.resistance_error) < 1e-6 && after.psi_f > (fo_real)1.0099 * adaptive->psi_f,
                "the new values do not hold");
    hot.L_position *= (fo_real)1.1;
    demand_that(fo_adaptive_retune(&r, &hot, &changed) == FO_ERROR_OTHER, "another L is taken");
}
#endif

int main(void)
{
    const fo_machine m = fo_pmsm((fo_real)MOTOR_R, (fo_real)MOTOR_L, (fo_real)MOTOR_PSI, (fo_real)MOTOR_I);
    fo_config config;
    (void)fo_configure(&config, &m, (fo_real)1e-4);
    check_plain(&config);
    check_plain(&motor_config);
#if FO_ADAPTIVE
    fo_adaptive made;
    demand_that(fo_adaptive_init(&made, &motor_config, &motor_adaptive_config) == FO_OK &&
                    made.std[FO_RESISTANCE] == motor_observer.std[FO_RESISTANCE] &&
                    made.plain.hR[0][0] == motor_observer.plain.hR[0][0] &&
                    made.plain.row_Q2[1][1] == motor_observer.plain.row_Q2[1][1],
                "the exported configuration makes another observer");
    check_adaptive(&motor_config, &motor_adaptive_config);
#else
    fo_observer made;
    demand_that(fo_init(&made, &motor_config) == FO_OK &&
                    memcmp(&made, &motor_observer, sizeof made) == 0,
                "the exported configuration makes another observer");
#endif
    return failures > 0 ? 1 : 0;
}
