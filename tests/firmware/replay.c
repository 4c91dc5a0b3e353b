/* Runs an exported observer on any record. Standard input: rows of doubles (u_alpha, u_beta,
 * i_alpha, i_beta). Standard output: rows of estimates as doubles. */
#include <stdio.h>

#include "motor_observer.h"

int main(void)
{
    static fo_state state;
    double row[4];
    fo_reset(&motor_observer, &state);
    while (fread(row, sizeof row, 1, stdin) == 1) {
        const fo_real u[FO_N] = {(fo_real)row[0], (fo_real)row[1]};
        const fo_real i[FO_N] = {(fo_real)row[2], (fo_real)row[3]};
        fo_estimate e;
        fo_step(&motor_observer, &state, u, i, &e);
        const double out[] = {
            (double)e.flux[0],     (double)e.flux[1],         (double)e.psi_f,
            (double)e.theta_e,     (double)e.theta_e_tracked, (double)e.speed_e,
            (double)e.drift[0],    (double)e.drift[1],        (double)e.theta_e_std,
            (double)e.innovation,  (double)e.noise_share,     e.valid ? 1.0 : 0.0,
        };
        if (fwrite(out, sizeof out, 1, stdout) != 1) {
            return 1;
        }
    }
    return 0;
}
