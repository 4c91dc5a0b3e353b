/* The learner alone: starts where the input says, and processes the samples of the input. See
 * test_learning.py.
 *
 * SPDX-License-Identifier: MIT
 */
#include "fluxobs_fast.c"

#include <stdio.h>
#include <string.h>

static double next(void)
{
    double value = 0.0;
    if (fread(&value, sizeof value, 1, stdin) != 1) {
        value = NAN;
    }
    return value;
}

int main(void)
{
    static fo_adaptive a;
    static fo_adaptive_state s;
    (void)memset(&a, 0, sizeof a);
    (void)memset(&s, 0, sizeof s);
    a.plain.h = next();
    a.plain.L_position = next();
    a.saliency = next();
    a.psi = next();
    a.inverter_mean = next();
    a.volt = next();
    a.over_rated = next();
    a.through_L = next();
    const fo_real of_current = a.plain.L_position + a.saliency; /* L_d */
    a.plain.over_noise = of_current * of_current / ((fo_real)(20 * FO_N) * a.through_L);
    a.unmodelled = next();
    a.slow = next();
    a.plain.drift_prior_std = next();
    a.plain.sample_time = next();
    a.plain.hR[0][0] = next() * a.volt / 24.0;
    a.lag_std = next();
    a.delay_std = next();
    a.current_gain_std = next();
    a.magnet_error = next();
    a.plain.square_min = 0.0;
    for (int i = 0; i < FO_NP; i++) {
        a.std[i] = next();
    }
    fo_learning_reset(&a, &s.learner);
    s.report = s.learner.report;
    for (int i = 0; i < FO_N; i++) {
        s.flux[i] = next();
    }
    for (int i = 0; i < FO_N; i++) {
        s.drift[i] = next();
    }
    for (int i = 0; i < (int)FO_NF; i++) {
        const double std = next();
        s.learner.d[i] = 1.0 / (std * std);
    }
    s.theta = next();
    s.running = true;
    s.learner.noise_level = 1.0;
    s.learner.report.innovation_power = 1.0;
    const int rows = (int)next();
    for (int k = 0; k < rows; k++) {
        double effect[FO_NP][FO_N];
        const double none[FO_N] = {0.0, 0.0};
        fo_linearisation point;
        for (int i = 0; i < FO_N; i++) {
            s.plain.volt_seconds[i] = next();
        }
        for (int j = 0; j < FO_NP; j++) {
            for (int i = 0; i < FO_N; i++) {
                effect[j][i] = next();
            }
        }
        for (int i = 0; i < FO_N; i++) { /* the learnt parameters correct the volt-seconds */
            for (int j = 0; j < (int)FO_NS; j++) {
                const int n = (int)FO_RESISTANCE + j;
                s.plain.volt_seconds[i] += s.learner.p[n] * effect[n][i];
                s.block.sensitivity[j][i] += effect[n][i] / a.std[n];
            }
            s.plain.current[0][i] = next();
            for (int n = 0; n < 2; n++) {
                const int j = (int)FO_INVERTER + n;
                s.signs[n][i] = -effect[j][i] / (a.std[j] * a.volt);
            }
        }
        s.plain.noise_inflation = next();
        const double knee = next();
        s.block.time += a.plain.h;
        s.block.unmodelled +=
            (INVERTER_UNMODELLED + KNEE_UNMODELLED * knee) * s.report.loss_size * a.plain.h;
        if (!step_filter(&a, &s, true, true, &point)) {
            return 1;
        }
        if (fabs(s.block.turned) >= BLOCK || s.block.time >= BLOCK_MAX) {
            post(&a, &s, none);
            (void)fo_adaptive_learn(&a, &s);
            if (receive(&a, &s)) {
                return 1;
            }
        }
        double out[2 * FO_N + FO_NP + 4];
        for (int i = 0; i < FO_N; i++) {
            out[i] = s.flux[i];
            out[FO_N + i] = s.drift[i];
        }
        for (int j = 0; j < FO_NP; j++) {
            out[2 * FO_N + j] = s.learner.p[j];
        }
        out[2 * FO_N + FO_NP] = s.learner.noise_level;
        out[2 * FO_N + FO_NP + 1] = s.learner.report.innovation_power;
        out[2 * FO_N + FO_NP + 2] = s.learner.report.variance_across;
        out[2 * FO_N + FO_NP + 3] = s.learner.report.variance_by_L_q;
        (void)fwrite(out, sizeof out, 1, stdout);
    }
    return 0;
}
