/* Runs an exported observer on samples at uneven times. Standard input: rows of doubles (duration,
 * u_alpha, u_beta, i_alpha, i_beta). Standard output: rows of doubles (theta_e, theta_e_std,
 * speed_e, valid). */
#include <stdio.h>

#include "motor_observer.h"

int main(void)
{
    double row[5];
#ifdef ADAPTIVE
    static fo_adaptive_state state;
    fo_adaptive_reset(&motor_observer, &state);
#else
    static fo_state state;
    fo_reset(&motor_observer, &state);
#endif
    while (fread(row, sizeof row, 1, stdin) == 1) {
        const fo_real u[FO_N] = {(fo_real)row[1], (fo_real)row[2]};
        const fo_real i[FO_N] = {(fo_real)row[3], (fo_real)row[4]};
#ifdef ADAPTIVE
        fo_adaptive_estimate all;
        fo_adaptive_step_for(&motor_observer, &state, (fo_real)row[0], u, i, &all);
        const fo_estimate e = all.position;
#else
        fo_estimate e;
        fo_step_for(&motor_observer, &state, (fo_real)row[0], u, i, &e);
#endif
        const double out[] = {(double)e.theta_e, (double)e.theta_e_std, (double)e.speed_e,
                              e.valid ? 1.0 : 0.0};
        if (fwrite(out, sizeof out, 1, stdout) != 1) {
            return 1;
        }
    }
    return 0;
}
