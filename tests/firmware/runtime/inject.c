/* The injector with any input: finite voltages, no start from samples that are not finite. */
#include "fluxobs_inject.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static const fo_injector_config good = {
    (fo_real)1e-4, (fo_real)36e-3, (fo_real)54e-3, (fo_real)0.545, (fo_real)0.35, (fo_real)250,
    (fo_real)2, (fo_real)0.014, (fo_real)0.03, (fo_real)47};

static int refuses(void)
{
    const fo_real bad[] = {(fo_real)NAN, (fo_real)INFINITY, (fo_real)-1};
    int failures = 0;
    for (int n = 0; n < 3; n++) {
        for (size_t field = 0; field < sizeof good / sizeof(fo_real); field++) {
            fo_injector_config config = good;
            fo_injector injector;
            ((fo_real *)&config)[field] = bad[n];
            failures += fo_injector_init(&injector, &config) ? 1 : 0;
        }
    }
    return failures;
}

int main(void)
{
    static fo_injector injector;
    static fo_injector_state state;
    fo_injection out;
    fo_adaptive_estimate e;
    int failures = refuses() + (fo_injector_init(&injector, &good) ? 0 : 1);
    fo_injector_reset(&state);
    (void)memset(&e, 0, sizeof e);
    (void)memset(&out, 0, sizeof out);
    unsigned random = 1U;
    for (long k = 0; k < 400000; k++) {
        fo_real x[4];
        for (int n = 0; n < 4; n++) {
            random = random * 1664525U + 1013904223U;
            x[n] = (fo_real)(random >> 8) / (fo_real)8388608 - 1;
        }
        e.adapting = random % 97U < 60U;
        e.position.valid = random % 5U == 0U;
        e.position.theta_e = x[0] * (fo_real)3;
        e.position.theta_e_std = x[1] * x[1];
        e.position.speed_e = x[2] * (fo_real)100;
        const fo_real voltage[FO_N] = {out.voltage[0] + x[0], out.voltage[1]};
        fo_real current[FO_N] = {x[2], x[3]};
        if (random % 211U == 0U) {
            current[k % 2] = k % 3 == 0 ? (fo_real)NAN : k % 3 == 1 ? (fo_real)1e30 : (fo_real)-INFINITY;
        }
        fo_inject(&injector, &state, &e, voltage, current, &out);
        const fo_real all = out.voltage[0] + out.voltage[1] + out.bias[0] + out.bias[1];
        failures += all - all == 0 ? 0 : 1;
    }
    /* still able to start: pure answers of a rotor at 0.4 rad, polarity ahead */
    fo_injector_reset(&state);
    fo_real u[2][FO_N] = {{0, 0}, {0, 0}}, i[FO_N] = {0, 0};
    const fo_real c = (fo_real)0.921061, s = (fo_real)0.389418;
    int starts = 0;
    (void)memset(&out, 0, sizeof out);
    for (long k = 0; k < 4000 && starts == 0; k++) {
        const fo_real along = c * u[0][0] + s * u[0][1], across = c * u[0][1] - s * u[0][0];
        const fo_real bias = c * out.bias[0] + s * out.bias[1];
        const fo_real L_d = (fo_real)36e-3 - (fo_real)1e-3 * bias;
        const fo_real d = along * (fo_real)1e-4 / L_d, q = across * (fo_real)1e-4 / (fo_real)54e-3;
        i[0] += c * d - s * q;
        i[1] += s * d + c * q;
        for (int n = 0; n < FO_N; n++) { /* the controller follows the bias */
            i[n] += (out.bias[n] - out.current[n]) / (fo_real)20;
        }
        fo_inject(&injector, &state, &e, u[0], i, &out);
        for (int n = 0; n < FO_N; n++) {
            u[0][n] = out.voltage[n];
        }
        if (out.start) {
            starts++;
            failures += fabs((double)out.seed.theta_e - 0.4) < 0.2 ? 0 : 1;
            failures += out.seed.weight_other > 0 ? 1 : 0;
        }
    }
    if (starts != 1 || failures > 0) {
        printf("%d starts, %d failures\n", starts, failures);
    }
    return starts == 1 && failures == 0 ? 0 : 1;
}
