/* Overwrites memory of the observer while it runs. Afterwards every valid row must have a finite
 * standard deviation, and the observer must find the rotor again. Kinds of damage: a number with
 * the wrong sign, NaN, infinite, zero; random bytes in the whole state. Prints the worst result of
 * each kind. */
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "motor_observer.h"
#include "vectors.h"

#define PI 3.14159265358979323846
#define H 1e-4
#define OMEGA 400.0
#define PSI 0.0125
#define CURRENT 4.0
#define AT 3000 /* sample at which memory is damaged */
#define END 9000

/* A steady run in closed form, in the rotor frame: the current is along q. */
static void sample(int k, double L, double R, fo_real voltage[2], fo_real current[2], double *theta)
{
    const double t0 = H * (k - 1), t1 = H * k, a0 = OMEGA * t0, a1 = OMEGA * t1;
    for (int i = 0; i < 2; i++) {
        const double shift = i == 0 ? 0.0 : -PI / 2;
        const double flux = PSI * (cos(a1 + shift) - cos(a0 + shift)) -
                            L * CURRENT * (sin(a1 + shift) - sin(a0 + shift));
        const double charge = CURRENT * (cos(a1 + shift) - cos(a0 + shift)) / OMEGA;
        voltage[i] = (fo_real)((flux + R * charge) / H);
        current[i] = (fo_real)(-CURRENT * sin(a1 + shift));
    }
    *theta = a1;
}

typedef struct {
    int valid, not_finite, wrong, late; /* numbers of rows; samples until all rows are valid */
    unsigned restarts;
} outcome;

static outcome run(const fo_state *damaged, int first)
{
    outcome o = {0, 0, 0, 0, 0};
    fo_state s = *damaged;
    fo_estimate e;
    const unsigned before = s.restarts;
    for (int k = first; k < END; k++) {
        fo_real voltage[2], current[2];
        double theta;
        sample(k, L_S, R_S, voltage, current, &theta);
        fo_step(&motor_observer, &s, voltage, current, &e);
        const double off = fabs(remainder((double)e.theta_e - theta, 2 * PI));
        o.valid += e.valid;
        if (e.valid && !(isfinite(e.theta_e_std) && isfinite(e.theta_e) && isfinite(e.speed_e)))
            o.not_finite++;
        if (e.valid && !(off < 0.3)) o.wrong++;
        if (!e.valid || !(off < 0.3)) o.late = k - first + 1;
    }
    o.restarts = s.restarts - before;
    return o;
}

static int report(const char *kind, outcome worst)
{
    printf("%s: valid without a number %d, wrong %d, late %d\n", kind, worst.not_finite,
           worst.wrong, worst.late);
    return worst.not_finite > 0 || worst.wrong > MOST_WRONG || worst.late > MOST_LATE;
}

static void worse(outcome *worst, outcome one)
{
    if (one.not_finite > worst->not_finite) worst->not_finite = one.not_finite;
    if (one.wrong > worst->wrong) worst->wrong = one.wrong;
    if (one.late > worst->late) worst->late = one.late;
}

int main(void)
{
    static fo_state good, bad;
    fo_estimate e;
    int failures = 0;
    fo_reset(&motor_observer, &good);
    for (int k = 1; k < AT; k++) {
        fo_real voltage[2], current[2];
        double theta;
        sample(k, L_S, R_S, voltage, current, &theta);
        fo_step(&motor_observer, &good, voltage, current, &e);
    }
    if (!e.valid) return 2;
    const size_t from = offsetof(fo_state, info), to = offsetof(fo_state, tracker) + sizeof(fo_tracker);
    const char *const kinds[] = {"sign", "not a number", "infinite", "zero", "random bytes"};
    for (int kind = 0; kind < 4; kind++) {
        outcome worst = {0, 0, 0, 0, 0};
        for (size_t at = from; at + sizeof(fo_real) <= to; at += sizeof(fo_real)) {
            fo_real x;
            bad = good;
            (void)memcpy(&x, (const char *)&bad + at, sizeof x);
            x = kind == 0 ? -x : kind == 1 ? (fo_real)NAN : kind == 2 ? (fo_real)INFINITY : (fo_real)0;
            (void)memcpy((char *)&bad + at, &x, sizeof x);
            const outcome one = run(&bad, AT);
            if (one.late > MOST_LATE || one.wrong > MOST_WRONG || one.not_finite)
                printf("  %s at number %zu: %d %d %d\n", kinds[kind], (at - from) / sizeof x,
                       one.not_finite, one.wrong, one.late);
            worse(&worst, one);
        }
        failures += report(kinds[kind], worst);
    }
    outcome worst = {0, 0, 0, 0, 0};
    srand(1);
    for (int trial = 0; trial < 300; trial++) {
        bad = good;
        for (size_t at = 4; at < sizeof bad; at++) ((unsigned char *)&bad)[at] = (unsigned char)rand();
        worse(&worst, run(&bad, AT));
    }
    failures += report(kinds[4], worst);
    return failures;
}
