/* A drive without position sensor that starts from rest: motor, switching inverter with dead time,
 * current and speed control in the loop of the adaptive observer and its injector.
 *
 *     at_rest < parameters        lines "name value"; see `struct drive`
 *
 * Course: search and start; at rest until `hold`; ramp to `speed` of the rated speed, and through
 * zero to minus that speed. The brake opens when the injector is ready. Prints a line of numbers for
 * each quantity. See support/from_rest.py.
 *
 * SPDX-License-Identifier: MIT
 */
#include "fluxobs_inject.h"
#include "motor_observer.h"

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

static struct drive {
    double R, L_d, L_q, psi, pole_pairs, saturation; /* saturation: see currents()                 */
    double J, load, passive;                         /* [kg m^2, N m]; passive: friction, no load */
    double link, dead_time, drop, sample_time, rated_current, rated_speed;
    double offset_alpha, offset_beta, noise, bits;   /* [A], [A], [A], of +-5 rated currents      */
    double theta, seed, hold, duration, speed;       /* speed: share of the rated speed           */
    double given_L_d, given_L_q;                     /* inductances that the injector assumes     */
    double current, voltage, bias, std, inject;      /* inject 0: no injection                    */
    double trace;                                    /* samples between two lines on stderr       */
} p;

static const struct {
    const char *name;
    double *value;
} names[] = {
#define NAME(x) {#x, &p.x}
    NAME(R), NAME(L_d), NAME(L_q), NAME(psi), NAME(pole_pairs), NAME(saturation), NAME(J),
    NAME(load), NAME(passive), NAME(link), NAME(dead_time), NAME(drop), NAME(sample_time),
    NAME(rated_current), NAME(rated_speed), NAME(offset_alpha), NAME(offset_beta), NAME(noise),
    NAME(bits), NAME(theta), NAME(seed), NAME(hold), NAME(duration), NAME(speed),
    NAME(given_L_d), NAME(given_L_q), NAME(current), NAME(voltage), NAME(bias), NAME(std),
    NAME(inject), NAME(trace),
};

/* ---- motor and inverter ------------------------------------------------------------------- */

typedef struct {
    double flux[2], theta, speed; /* electrical */
} motor;

static void rotate(const double v[2], double angle, double out[2])
{
    const double c = cos(angle), s = sin(angle), a = v[0], b = v[1];
    out[0] = c * a - s * b;
    out[1] = s * a + c * b;
}

/* The inverse of L_d is (1 + saturation tanh(i_d / rated current)) / L_d, about. */
static void currents(const motor *m, double i[2])
{
    double dq[2];
    rotate(m->flux, -m->theta, dq);
    const double x = (dq[0] - p.psi) / p.L_d, rated = p.rated_current;
    dq[0] = x + p.saturation * rated * log(cosh(x / rated));
    dq[1] /= p.L_q;
    rotate(dq, m->theta, i);
}

static bool braked = true;
/* Time in which the torque builds up against the brake [s]. */
static const double BUILD_UP = 0.05;
/* Time after which a rotation backwards is no longer part of the start [s]. */
static const double START = 0.5;

static void advance(motor *m, const double leg[3], double time)
{
    const double mean = (leg[0] + leg[1] + leg[2]) / 3;
    const double u[2] = {leg[0] - mean, (leg[1] - leg[2]) / sqrt(3.0)};
    double i[2], middle[2];
    currents(m, i);
    motor half = *m;
    for (int n = 0; n < 2; n++) {
        half.flux[n] += time / 2 * (u[n] - p.R * i[n]);
    }
    half.theta += time / 2 * m->speed;
    currents(&half, middle);
    for (int n = 0; n < 2; n++) {
        m->flux[n] += time * (u[n] - p.R * middle[n]);
    }
    const double torque =
        1.5 * p.pole_pairs * (half.flux[0] * middle[1] - half.flux[1] * middle[0]);
    double load = p.load;
    if (p.passive > 0) { /* friction holds the rotor up to the load */
        const bool holds = fabs(m->speed) < 1e-3 && fabs(torque) < p.load;
        load = holds ? torque : p.load * (fabs(m->speed) < 1e-3 ? torque / fabs(torque)
                                                                : m->speed / fabs(m->speed));
        if (holds) {
            m->speed = 0;
        }
    }
    if (!braked) {
        const double before = m->speed;
        m->speed += time * p.pole_pairs * (torque - load) / p.J;
        if (p.passive > 0 && before * m->speed < 0) {
            m->speed = 0;
        }
    }
    m->theta += time * m->speed;
}

/* A switching period with centred pulses. Dead time delays the upper switch if the current flows out,
 * else the lower one. */
static void switch_period(motor *m, const double u[2])
{
    const double h = p.sample_time, share = p.dead_time / h;
    const double phase[3] = {u[0], -u[0] / 2 + sqrt(0.75) * u[1], -u[0] / 2 - sqrt(0.75) * u[1]};
    double least = phase[0], most = phase[0], edge[8] = {0, 1}, on[3], off[3], i[2];
    for (int n = 1; n < 3; n++) {
        least = fmin(least, phase[n]);
        most = fmax(most, phase[n]);
    }
    currents(m, i);
    const double flows[3] = {i[0], -i[0] / 2 + sqrt(0.75) * i[1], -i[0] / 2 - sqrt(0.75) * i[1]};
    for (int n = 0; n < 3; n++) {
        double duty = 0.5 + (phase[n] - (most + least) / 2) / p.link;
        duty = fmin(fmax(duty, 0), 1);
        on[n] = (1 - duty) / 2 + (flows[n] > 0 ? share : 0);
        off[n] = (1 + duty) / 2 + (flows[n] > 0 ? 0 : share);
        edge[2 + 2 * n] = fmin(on[n], 1);
        edge[3 + 2 * n] = fmin(off[n], 1);
    }
    for (int a = 1; a < 8; a++) { /* sort */
        for (int b = a; b > 0 && edge[b] < edge[b - 1]; b--) {
            const double swap = edge[b];
            edge[b] = edge[b - 1];
            edge[b - 1] = swap;
        }
    }
    for (int k = 0; k < 7; k++) {
        const double middle = (edge[k] + edge[k + 1]) / 2, time = (edge[k + 1] - edge[k]) * h;
        double leg[3];
        for (int n = 0; n < 3; n++) {
            leg[n] = middle > on[n] && middle < off[n] ? p.link : 0;
            leg[n] -= p.drop * (flows[n] > 0 ? 1 : -1);
        }
        if (time > 0) {
            advance(m, leg, time);
        }
    }
}

/* ---- measurement and control -------------------------------------------------------------- */

static unsigned long long random_state;

static double uniform(void)
{
    random_state = random_state * 6364136223846793005ULL + 1442695040888963407ULL;
    return ((double)(random_state >> 11) + 0.5) / 9007199254740992.0;
}

static double normal(void) { return sqrt(-2 * log(uniform())) * cos(6.283185307179586 * uniform()); }

static double quantized(double x)
{
    const double step = 10 * p.rated_current / pow(2, p.bits);
    return step * floor(x / step + 0.5);
}

static double wrapped(double x) { return remainder(x, 6.283185307179586); }

int main(void)
{
    char name[64];
    double value;
    while (scanf("%63s %lf", name, &value) == 2) {
        bool known = false;
        for (size_t n = 0; n < sizeof names / sizeof *names; n++) {
            if (strcmp(name, names[n].name) == 0) {
                *names[n].value = value;
                known = true;
            }
        }
        if (!known) {
            (void)fprintf(stderr, "unknown: %s\n", name);
            return 2;
        }
    }
    random_state = (unsigned long long)p.seed * 7919ULL + 12345ULL;
    const fo_injector_config config = {
        (fo_real)p.sample_time, (fo_real)p.given_L_d, (fo_real)p.given_L_q, (fo_real)p.psi,
        (fo_real)p.current, (fo_real)p.voltage, (fo_real)p.bias, (fo_real)p.noise, (fo_real)p.std,
        (fo_real)(0.1 * p.rated_speed)};
    static fo_injector injector;
    static fo_injector_state injecting;
    static fo_adaptive_state state;
    if (!fo_injector_init(&injector, &config)) {
        (void)printf("unable 1\n");
        return 0;
    }
    fo_injector_reset(&injecting);
    fo_adaptive_reset(&motor_observer, &state);
    motor m = {{p.psi * cos(p.theta), p.psi * sin(p.theta)}, p.theta, 0};
    const double h = p.sample_time, bandwidth = 6.283 * 150, pull = 6.283 * 5;
    const bool magnets = p.psi > 0;
    const double active = magnets ? p.psi : (p.L_d - p.L_q) * p.bias;
    const double k_torque = 1.5 * p.pole_pairs * active;
    fo_real acted[2] = {0, 0};
    double command[2] = {0, 0}, integral[2] = {0, 0}, speed_integral = 0, back = 0, most_back = 0;
    double ready_at = -1, seed_error = 0, open = 0, first_valid = -1, starts = 0, amplitude = 0;
    double torque_at = -1, reasons[16] = {0};
    double rows = 0, valid = 0, square = 0, worst = 0, within = 0, variance = 0;
    const long count = lround(p.duration / h);
    for (long k = 0; k < count; k++) {
        double i[2];
        currents(&m, i);
        const fo_real current[2] = {
            (fo_real)quantized(i[0] + p.offset_alpha + p.noise * normal()),
            (fo_real)quantized(i[1] + p.offset_beta + p.noise * normal())};
        fo_adaptive_estimate e;
        fo_injection injection;
        fo_adaptive_step(&motor_observer, &state, acted, current, &e);
        fo_inject(&injector, &injecting, &e, acted, current, &injection);
        if (!(p.inject > 0)) {
            injection.voltage[0] = injection.voltage[1] = 0;
        }
        if (ready_at < 0 && injection.ready) {
            ready_at = (double)k * h;
        }
        const double apart = (double)e.position.theta_e - m.theta;
        const double error = (magnets ? wrapped(apart) : wrapped(2 * apart) / 2) * 57.29578;
        if (injection.start) {
            fo_adaptive_seed_state(&motor_observer, &state, &injection.seed, current);
            starts++;
            const double from = (double)injection.seed.theta_e - m.theta;
            seed_error = (magnets ? wrapped(from) : wrapped(2 * from) / 2) * 57.29578;
            open = (double)injection.seed.weight_other;
        }
        if (e.position.valid) {
            const double std = (double)e.position.theta_e_std * 57.29578;
            first_valid = first_valid < 0 ? (double)k * h : first_valid;
            valid++;
            square += error * error;
            worst = fmax(worst, fabs(error));
            within += fabs(error) < 2 * std;
            variance += std * std;
        }
        if (ready_at >= 0) {
            reasons[e.position.valid_reason]++;
            rows++;
            amplitude += hypot((double)injection.voltage[0], (double)injection.voltage[1]);
        }

        /* speed control: torque is built up before the brake opens */
        const double t = (double)k * h, since = ready_at < 0 ? 0 : t - ready_at;
        double reference = 0, torque_current = 0;
        if (t > p.hold) { /* ramp up, then to minus that speed */
            const double part = (t - p.hold) / (p.duration - p.hold);
            const double shape = part < 0.2 ? part / 0.2 : part < 0.4 ? 1
                                 : part < 0.8 ? 1 - 2 * (part - 0.4) / 0.4 : -1;
            reference = shape * p.speed * p.rated_speed;
        }
        const double angle = (double)e.position.theta_e;
        if (injection.ready) { /* torque, then the brake opens, then speed control */
            const double gain = p.J * pull / (k_torque * p.pole_pairs), most = 1.6 * p.rated_current;
            const double behind = braked ? 0 : reference - (double)e.position.speed_e;
            if (braked) {
                speed_integral = p.load / k_torque * fmin(since / BUILD_UP, 1);
            }
            speed_integral += gain * behind * pull / 4 * h;
            torque_current = fmin(fmax(gain * behind + speed_integral, -most), most);
        }
        braked = braked && !(since > 2 * BUILD_UP);
        if (torque_at < 0 && injection.ready && fabs(torque_current) > 0.9 * p.load / k_torque) {
            torque_at = t;
        }
        if (since < START) {
            back += m.speed * h;
            most_back = fmin(most_back, back);
        }

        /* current control in rotor coordinates */
        double want[2] = {0, torque_current}, behind[2], u[2];
        rotate(want, angle, want);
        for (int n = 0; n < 2; n++) {
            behind[n] = want[n] + (double)injection.bias[n] - (double)injection.current[n];
        }
        rotate(behind, -angle, behind);
        const double L[2] = {p.L_d, p.L_q};
        for (int n = 0; n < 2; n++) {
            integral[n] += bandwidth * p.R * behind[n] * h;
            u[n] = bandwidth * L[n] * behind[n] + integral[n];
        }
        rotate(u, angle, u);
        acted[0] = (fo_real)command[0];
        acted[1] = (fo_real)command[1];
        switch_period(&m, command); /* the command of the last sample acts now */
        for (int n = 0; n < 2; n++) {
            command[n] = u[n] + (double)injection.voltage[n];
        }
        if (p.trace > 0 && k % (long)p.trace == 0) {
            (void)fprintf(stderr, "%.4f %.2f %.2f %d %d %.2f %.2f %.2f %.2f %.3f\n", t, error,
                          (double)e.position.theta_e_std * 57.29578, (int)e.position.valid_reason,
                          (int)injecting.phase, m.speed, (double)e.position.speed_e, want[0],
                          torque_current, (double)e.psi_f);
        }
    }
    (void)printf("ready %g\nopen %g\nseed_error %g\nfirst_valid %g\nstarts %g\n", ready_at, open,
                 seed_error, first_valid, starts);
    (void)printf("torque_at %g\nback %g\nvalid %g\nrms %g\nworst %g\nwithin %g\nstd %g\n", torque_at,
                 most_back * 57.29578, valid / fmax(rows, 1), sqrt(square / fmax(valid, 1)), worst,
                 within / fmax(valid, 1), sqrt(variance / fmax(valid, 1)));
    (void)printf("volts %g\nspeed %g\nphase %d\n", amplitude / fmax(rows, 1), m.speed,
                 (int)injecting.phase);
    for (int n = 1; n < 16; n++) { /* share of the rows that are not valid for this reason */
        (void)printf("reason_%d %g\n", n, reasons[n] / fmax(rows, 1));
    }
    return 0;
}
