/* Runs the core under the sanitizers: ordinary motion with every kind of bad sample. Exits with 0
 * if all outputs were finite and the position became known again each time. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>

#include "fluxobs.h"
#include "surface_pmsm.h"

static uint32_t seed = 1;

static uint32_t draw(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 17;
    seed ^= seed << 5;
    return seed;
}

static fo_real garbage(void)
{
    static const double values[] = {0.0, -0.0, 1e-300, 1e3, -1e6, 1e30, -1e38, 1e300};
    const uint32_t n = draw() % 11u;
    if (n < 8u) {
        return (fo_real)values[n];
    }
    return (fo_real)(n == 8u ? NAN : n == 9u ? INFINITY : -INFINITY);
}

static int is_finite(fo_real x) { return x - x == (fo_real)0; }

int main(void)
{
    const double R = 0.36, L = 0.6e-3, psi = 0.0125, h = 1e-4, omega = 500.0, load = 6.0;
    fo_config c;
    surface_pmsm(&c, R, L);
    c.sample_time = (fo_real)h;
    c.memory = (fo_real)0.03;
    c.flux_base = (fo_real)psi;
    c.constraint_base = (fo_real)(psi * psi);
    c.constraint_noise = (fo_real)(0.005 * psi * psi);
    c.current_noise = (fo_real)0.02;
    c.current_limit = (fo_real)240;
    c.drift_prior = (fo_real)0.13;
    c.length_min = (fo_real)(0.25 * psi);
    c.tracker_bandwidth = (fo_real)667;

    fo_observer observer;
    fo_state state;
    fo_estimate e;
    if (fo_init(&observer, &c) != FO_OK) {
        return 1;
    }
    c.memory = (fo_real)(5 * h);
    fo_observer refused;
    if (fo_init(&refused, &c) != FO_ERROR_SAMPLE_TIME) {
        return 1;
    }
    fo_reset(&observer, &state);
    long valid = 0, rows = 0;
    for (long k = 0; k < 400000; k++) {
        const double t = (double)k * h, a = omega * t, b = a - omega * h / 2;
        fo_real i[FO_N] = {(fo_real)(-load * sin(a) + 0.1), (fo_real)(load * cos(a))};
        fo_real u[FO_N];
        u[0] = (fo_real)(-(omega * psi + R * load) * sin(b) - omega * L * load * cos(b));
        u[1] = (fo_real)((omega * psi + R * load) * cos(b) - omega * L * load * sin(b));
        const int dirty = k % 4000 > 2000 && k % 4000 < 2400; /* leave time to recover afterwards */
        if (dirty && draw() % 3u == 0u) {
            u[draw() % 2u] = garbage();
        }
        if (dirty && draw() % 3u == 0u) {
            i[draw() % 2u] = garbage();
        }
        if (k % 5 == 4) {
            fo_real v[FO_N];
            for (int n = 0; n < FO_N; n++) {
                v[n] = c.sample_time * (u[n] - c.R[0][0] * i[n]);
            }
            fo_step_volt_seconds(&observer, &state, v, i, &e);
        } else {
            fo_step(&observer, &state, u, i, &e);
        }
        if (!is_finite(e.theta_e) || !is_finite(e.theta_e_tracked) || !is_finite(e.speed_e) ||
            !is_finite(e.psi_f) || !is_finite(e.theta_e_std) || !is_finite(e.flux[0]) ||
            !is_finite(e.flux[1]) || !is_finite(e.drift[0]) || !is_finite(e.drift[1])) {
            printf("sample %ld: an output is not finite\n", k);
            return 1;
        }
        if (k % 4000 > 3500) {
            rows++;
            valid += e.valid;
            const double error = remainder((double)e.theta_e - a, 2 * 3.14159265358979323846);
            if (e.valid && fabs(error) > 0.26) {
                printf("sample %ld: valid, yet %.1f degrees off\n", k, error * 57.2957795);
                return 1;
            }
        }
    }
    printf("%ld of %ld recovered rows valid; %u voltages and %u currents bad, %u absurd, "
           "%u restarts\n",
           valid, rows, (unsigned)state.bad_voltages, (unsigned)state.bad_currents,
           (unsigned)state.absurd, (unsigned)state.restarts);
    return valid == rows ? 0 : 1;
}
