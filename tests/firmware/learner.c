/* The learner alone: starts where the input says, and processes the samples of the input. See
 * test_learning.py.
 *
 * SPDX-License-Identifier: MIT
 */
#include "fluxobs_learning.h"

#include "fluxobs_internal.h"

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
    a.unmodelled = next();
    a.slow = next();
    a.plain.drift_prior_std = next();
    a.plain.square_min = 0.0;
    for (int i = 0; i < FO_NP; i++) {
        a.std[i] = next();
    }
    fo_learning_reset(&a, &s);
    for (int i = 0; i < FO_N; i++) {
        s.flux[i] = next();
    }
    for (int i = 0; i < FO_N; i++) {
        s.drift[i] = next();
    }
    for (int i = 0; i < (int)FO_NF; i++) {
        const double std = next();
        s.d[i] = 1.0 / (std * std);
    }
    s.theta = next();
    s.now.block.theta = s.theta;
    s.running = true;
    s.emf_ratio = 0.0;
    s.noise_level = 1.0;
    s.innovation_power = 1.0;
    const int rows = (int)next();
    for (int k = 0; k < rows; k++) {
        fo_interval t;
        for (int i = 0; i < FO_N; i++) {
            t.v[i] = next();
        }
        for (int j = 0; j < FO_NP; j++) {
            for (int i = 0; i < FO_N; i++) {
                t.sensitivity[j][i] = next();
            }
        }
        for (int i = 0; i < FO_N; i++) { /* the learnt parameters correct the volt-seconds */
            for (int j = FO_RESISTANCE; j < (int)FO_CURVE; j++) {
                t.v[i] += s.p[j] * t.sensitivity[j][i];
            }
            s.plain.current[0][i] = next();
        }
        s.plain.noise_inflation = next();
        s.knee = next();
        if (!(fo_learning_step(&a, &s, &t, true) > 0.0)) {
            return 1;
        }
        double out[2 * FO_N + FO_CURVE + 4];
        for (int i = 0; i < FO_N; i++) {
            out[i] = s.flux[i];
            out[FO_N + i] = s.drift[i];
        }
        for (int j = 0; j < FO_CURVE; j++) {
            out[2 * FO_N + j] = s.p[j];
        }
        out[2 * FO_N + FO_CURVE] = s.noise_level;
        out[2 * FO_N + FO_CURVE + 1] = s.innovation_power;
        out[2 * FO_N + FO_CURVE + 2] = s.variance_across;
        out[2 * FO_N + FO_CURVE + 3] = s.variance_by_L_q;
        (void)fwrite(out, sizeof out, 1, stdout);
    }
    return 0;
}
