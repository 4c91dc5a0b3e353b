/* Both observers under libFuzzer: arbitrary parameters, arbitrary samples, real motion in between.
 * Nothing may crash or be undefined, every estimate must be finite, and a valid estimate must be
 * right. Ends by itself after FUZZ_STEPS samples. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fluxobs_adaptive.h"
#include "surface_pmsm.h"

#ifndef FUZZ_STEPS
#define FUZZ_STEPS 10000000L
#endif

static const double PI = 3.14159265358979323846;
static long steps, valid, prepared, adapting;

typedef struct {
    const uint8_t *next;
    size_t left;
} bytes;

static unsigned byte(bytes *b)
{
    unsigned value = 0;
    if (b->left > 0) {
        value = *b->next;
        b->next++;
        b->left--;
    }
    return value;
}

/* A number with arbitrary bits. */
static fo_real any(bytes *b)
{
    unsigned char raw[sizeof(fo_real)];
    fo_real value;
    for (size_t i = 0; i < sizeof raw; i++) {
        raw[i] = (unsigned char)byte(b);
    }
    memcpy(&value, raw, sizeof value);
    return value;
}

/* A number within ten decades of `usual`, or any number. */
static fo_real about(bytes *b, double usual)
{
    const int kind = (int)byte(b) - 128;
    if (kind == 127) {
        return any(b);
    }
    return (fo_real)(usual * pow(10.0, kind / (kind % 4 == 0 ? 64.0 : 8.0)));
}

static void fail(const char *what)
{
    fprintf(stderr, "%s, at step %ld\n", what, steps);
    abort();
}

static int finite_real(fo_real x) { return x - x == (fo_real)0; }

static void judge(const fo_estimate *e, double most)
{
    const fo_real out[] = {
        e->flux[0],    e->flux[1],  e->psi_f,    e->theta_e,    e->theta_e_tracked, e->speed_e,
        e->drift[0],   e->drift[1], e->theta_e_std, e->innovation, e->noise_share,
    };
    for (size_t i = 0; i < sizeof out / sizeof out[0]; i++) {
        if (!finite_real(out[i])) {
            fail("an estimate is not finite");
        }
    }
    if (fabs((double)e->theta_e) > PI * 1.000001 || fabs((double)e->theta_e_tracked) > PI * 1.000001) {
        fail("an angle is beyond half a turn");
    }
    if (e->theta_e_std < (fo_real)0 || (e->valid && (double)e->theta_e_std > most)) {
        fail("a standard deviation is impossible");
    }
    steps++;
    valid += e->valid ? 1 : 0;
}

static void judge_adaptive(const fo_adaptive_estimate *e)
{
    const fo_real out[] = {
        e->drift_std,      e->psi_f,            e->psi_f_std,    e->resistance_error,
        e->resistance_std, e->inverter_voltage, e->inverter_std, e->theta_other,
        e->weight_other,
    };
    for (size_t i = 0; i < sizeof out / sizeof out[0]; i++) {
        if (!finite_real(out[i])) {
            fail("an estimate of the adaptive observer is not finite");
        }
    }
    if (e->weight_other < (fo_real)0 || (double)e->weight_other > 0.5000001 ||
        fabs((double)e->theta_other) > PI * 1.000001) {
        fail("another angle is impossible");
    }
    adapting += e->adapting ? 1 : 0;
    judge(&e->position, PI / 17.9); /* errors of inductance and lag may turn the angle */
    steps--; /* the plain observer counts the same sample */
}

typedef struct {
    fo_observer plain;
    fo_adaptive adaptive;
    bool both; /* the adaptive observer can be prepared */
    fo_state state;
    fo_adaptive_state adaptive_state;
} observers;

static void step(observers *o, const fo_real u[FO_N], const fo_real i[FO_N], bool volt_seconds)
{
    fo_estimate e;
    fo_adaptive_estimate a;
    if (volt_seconds) {
        fo_step_volt_seconds(&o->plain, &o->state, u, i, &e);
    } else {
        fo_step(&o->plain, &o->state, u, i, &e);
    }
    judge(&e, PI / 59);
    if (o->both) {
        if (volt_seconds) {
            fo_adaptive_step_volt_seconds(&o->adaptive, &o->adaptive_state, u, i, &a);
        } else {
            fo_adaptive_step(&o->adaptive, &o->adaptive_state, u, i, &a);
        }
        judge_adaptive(&a);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    bytes b = {data, size};
    const double R = (double)about(&b, 0.36), L = (double)about(&b, 0.6e-3);
    const double psi = (double)about(&b, 0.0125), h = (double)about(&b, 1e-4);
    fo_config c;
    surface_pmsm(&c, R, L);
    const unsigned odd = byte(&b);
    if (odd & 1U) {
        c.Q1[0][1] = any(&b);
        c.Q2[1][0] = any(&b);
        c.E[0] = any(&b);
        c.C[1] = any(&b);
    }
    c.sample_time = (fo_real)h;
    c.memory = about(&b, 300 * h);
    c.flux_base = (odd & 2U) ? about(&b, psi) : (fo_real)psi;
    c.constraint_base = (odd & 4U) ? about(&b, psi * psi) : (fo_real)(psi * psi);
    c.constraint_noise = about(&b, 0.005 * psi * psi);
    c.current_noise = about(&b, 0.02);
    c.current_limit = about(&b, 240.0);
    c.drift_prior = about(&b, 0.13);
    c.length_min = (odd & 8U) ? any(&b) : (fo_real)(0.25 * psi);
    c.tracker_bandwidth = about(&b, 667.0);

    static observers o;
    if (fo_init(&o.plain, &c) != FO_OK) {
        return 0;
    }
    prepared++;
    fo_reset(&o.plain, &o.state);
    const unsigned more = byte(&b);
    fo_adaptive_config more_config;
    more_config.saliency = (more & 1U) ? about(&b, 0.3e-3) : (fo_real)0;
    more_config.psi_f = (fo_real)psi;
    more_config.psi_f_std = (more & 2U) ? about(&b, 0.25 * psi) : (fo_real)(0.25 * psi);
    more_config.resistance_std = (more & 4U) ? about(&b, 0.1) : (fo_real)(0.25 * R);
    more_config.inverter_voltage = (more & 8U) ? about(&b, 0.1) : (fo_real)0;
    more_config.inverter_std = (more & 16U) ? about(&b, 0.5) : (fo_real)0;
    more_config.inverter_current = (more & 32U) ? about(&b, 0.5) : (fo_real)0.5;
    const unsigned most = byte(&b);
    more_config.offset_std = (most & 1U) ? about(&b, 0.24) : (fo_real)0.24;
    more_config.asymmetry_std = (most & 2U) ? about(&b, 0.01) : (fo_real)0;
    more_config.L_d_std = (most & 4U) ? about(&b, 0.1) : (fo_real)0;
    more_config.L_q_std = (most & 4U) ? about(&b, 0.1) : (fo_real)0;
    more_config.lag_std = (most & 8U) ? about(&b, 1e-5) : (fo_real)0;
    more_config.delay_std = more_config.lag_std;
    more_config.current_gain_std = (most & 8U) ? (fo_real)0.01 : (fo_real)0;
    more_config.iron_current_std = (most & 8U) ? about(&b, 0.1) : (fo_real)0;
    more_config.harmonic_std = more_config.current_gain_std;
    more_config.slow_memory = (more & 64U) ? about(&b, 100.0) : (fo_real)100;
    more_config.projection = (fo_projection)(more % 2U);
    o.both = fo_adaptive_init(&o.adaptive, &c, &more_config) == FO_OK;
    if (o.both) {
        fo_adaptive_reset(&o.adaptive, &o.adaptive_state);
    }
    double angle = byte(&b) * 0.1, omega = 0.0;
    while (b.left > 0) {
        const unsigned kind = byte(&b);
        if ((kind & 3U) == 0U) { /* arbitrary voltage and current */
            const fo_real u[FO_N] = {any(&b), any(&b)}, i[FO_N] = {any(&b), any(&b)};
            step(&o, u, i, (kind & 4U) != 0U);
            continue;
        }
        /* Motion for some samples: a speed, a load, errors. */
        const double aim = ((double)byte(&b) - 128.0) / 128.0 * PI / (5 * h);
        const double share = ((double)byte(&b) - 128.0) * 0.05 / 12.0;
        const double load = L > 0.0 ? share * psi / L : 0.0;
        const double bias = (kind & 4U) ? ((double)byte(&b) - 128.0) * 0.01 * psi / (300 * h) : 0.0;
        const int count = 1 + (int)byte(&b);
        for (int k = 0; k < count; k++) {
            const double before = angle;
            fo_real u[FO_N], i[FO_N];
            omega += (aim - omega) * 0.05;
            angle = remainder(angle + omega * h, 2 * PI);
            const double middle = before + omega * h / 2;
            i[0] = (fo_real)(-load * sin(angle));
            i[1] = (fo_real)(load * cos(angle));
            u[0] = (fo_real)(-(omega * psi + R * load) * sin(middle) -
                             omega * L * load * cos(middle) + bias);
            u[1] = (fo_real)((omega * psi + R * load) * cos(middle) - omega * L * load * sin(middle));
            if ((kind & 8U) && k % 17 == 16) {
                u[k & 1] = any(&b);
            }
            if ((kind & 16U) && k % 13 == 12) {
                i[k & 1] = any(&b);
            }
            step(&o, u, i, false);
        }
    }
    if (steps >= FUZZ_STEPS) {
        printf("%ld steps, %ld estimates valid, %ld adapting, with %ld settings: nothing found\n",
               steps, valid, adapting, prepared);
        fflush(stdout);
        _Exit(0);
    }
    return 0;
}
