/* The algebra of a sample, without branches: transition, rotations, solution and variances of the
 * information factor. The source fluxobs.c uses it for one record. The library's binding uses it
 * for several records at once, with vectors in place of numbers (binding/lanes.cpp). Not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_ALGEBRA_H
#define FLUXOBS_ALGEBRA_H

#include "fluxobs_internal.h"

/* FO_VALUE is a number or a vector of numbers. The other macros are its zero, and a struct with U,
 * d, z and noise of this type. */
#ifndef FO_VALUE
#define FO_VALUE fo_real
#define FO_ZERO ZERO
#define FO_FACTOR fo_information
#endif

/* Short loops are unrolled in code compiled for speed, so that a row stays in registers. They are
 * not unrolled where code size counts or a library emulates floating point. -DFO_WRITTEN_OUT
 * overrides the choice. The numbers are the same. */
#ifndef FO_WRITTEN_OUT
#if defined(__GNUC__) && !defined(__OPTIMIZE_SIZE__) && !defined(__SOFTFP__) && !defined(__AVR__)
#define FO_WRITTEN_OUT 1
#else
#define FO_WRITTEN_OUT 0
#endif
#endif
#if FO_WRITTEN_OUT
#define FO_UNROLL _Pragma("GCC unroll 8")
#else
#define FO_UNROLL
#endif

/* Element (i, j), i < j, of a packed strict upper triangle. */
#define AT(i, j) ((int)(i) * (2 * (int)FO_NX - (int)(i) - 3) / 2 + (int)(j) - 1)

/* The immersion's step over one interval is x <- F x + b. F depends on q, and b is (input, v, 0, 0,
 * 0); see docs/theory.md, section 4. Per-unit. */
typedef struct {
    FO_VALUE v[FO_N]; /* volt-seconds */
    FO_VALUE q[FO_N]; /* 2 Q1 v */
    FO_VALUE input;   /* v'Q1v + E'v */
} interval;

/* U <- U F^-1, d <- rho d, z <- z + U F^-1 b: F(h, v)^-1 = F(-h, -v). */
static inline void predict(const fo_observer *o, FO_FACTOR *info, const interval *t)
{
    const fo_real h = o->h, rho = o->rho, h2 = TWO * h;
    const FO_VALUE v0 = t->v[0], v1 = t->v[1], q0 = t->q[0], q1 = t->q[1];
    FO_VALUE *u = info->U, *z = info->z;
    { /* the row of s changes all later columns: flux, kappa, drift, c */
        const FO_VALUE flux0 = u[0] - q0, flux1 = u[1] - q1, kappa = u[2] - h;
        u[3] -= h * u[0] + q0 * kappa;
        u[4] -= h * u[1] + q1 * kappa;
        u[5] -= h * (u[2] + kappa);
        u[0] = flux0;
        u[1] = flux1;
        u[2] = kappa;
        z[S] += t->input + flux0 * v0 + flux1 * v1;
    }
    { /* the row of the first flux changes the second flux, kappa, drift, c */
        const FO_VALUE flux1 = u[6], kappa = u[7];
        u[8] -= h + q0 * kappa;
        u[9] -= h * flux1 + q1 * kappa;
        u[10] -= h2 * kappa;
        z[FLUX] += v0 + flux1 * v1;
    }
    { /* the row of the second flux changes kappa, drift, c */
        const FO_VALUE kappa = u[11];
        u[12] -= q0 * kappa;
        u[13] -= h + q1 * kappa;
        u[14] -= h2 * kappa;
        z[FLUX + 1] += v1;
    }
    u[15] -= q0; /* the row of kappa changes drift, c */
    u[16] -= q1;
    u[17] -= h2;
    for (int i = 0; i < FO_NX; i++) {
        info->d[i] *= rho;
    }
    /* The information from noise alone is propagated and forgotten in the same way. This
     * information is equal for both components of (flux, drift). */
    FO_VALUE *noise = info->noise;
    noise[2] = rho * (noise[2] - h * (TWO * noise[1] - h * noise[0]));
    noise[1] = rho * (noise[1] - h * noise[0]);
    noise[0] = rho * noise[0];
}

/* Right-hand side and weight of row'x = rhs after the rotations so far. */
typedef struct {
    FO_VALUE rhs, weight;
} measurement;

/* Gentleman's square-root-free rotation of row'x = rhs with row i of the factor. It makes row[i]
 * zero. */
static inline void rotate_row(FO_FACTOR *info, int i, FO_VALUE row[FO_NX], measurement *m)
{
    FO_VALUE *u = &info->U[AT(i, i + 1)];
    const FO_VALUE pivot = row[i], weighted = m->weight * pivot, d = info->d[i];
    const FO_VALUE d_new = d + weighted * pivot, inverse = ONE / d_new;
    const FO_VALUE gain = weighted * inverse;
    m->weight *= d * inverse;
    info->d[i] = d_new;
    FO_UNROLL
    for (int j = i + 1; j < FO_NX; j++) {
        row[j] -= pivot * u[j - i - 1];
        u[j - i - 1] += gain * row[j];
    }
    m->rhs -= pivot * info->z[i];
    info->z[i] += gain * m->rhs;
}

typedef struct {
    FO_VALUE along, across;
} variances;

/* Variances of the flux along p and across p, times |p|^2: |y|^2 / d with U'y = (0, p, 0 ..). */
static inline variances flux_variances(const FO_FACTOR *info, const FO_VALUE p[FO_N])
{
    const FO_VALUE *u = &info->U[AT(FLUX, FLUX + 1)];
    variances sum = {FO_ZERO, FO_ZERO};
    FO_VALUE along[FO_NX], across[FO_NX];
    for (int i = 0; i < FO_NX; i++) {
        along[i] = FO_ZERO;
        across[i] = FO_ZERO;
    }
    along[FLUX] = p[0];
    along[FLUX + 1] = p[1];
    across[FLUX] = -p[1];
    across[FLUX + 1] = p[0];
    FO_UNROLL
    for (int i = FLUX; i < FO_NX; i++) {
        const FO_VALUE inverse = ONE / info->d[i], a = along[i], b = across[i];
        sum.along += a * a * inverse;
        sum.across += b * b * inverse;
        FO_UNROLL
        for (int j = i + 1; j < FO_NX; j++) {
            along[j] -= a * *u;
            across[j] -= b * *u;
            u++;
        }
    }
    return sum;
}

/* Variance of the drift across p, times |p|^2. */
static inline FO_VALUE drift_variance_across(const FO_FACTOR *info, const FO_VALUE p[FO_N])
{
    const FO_VALUE *u = info->U, *d = info->d;
    const FO_VALUE a = p[0] + p[1] * u[AT(DRIFT, DRIFT + 1)];
    const FO_VALUE c = p[1] * u[AT(DRIFT, CC)] - a * u[AT(DRIFT + 1, CC)];
    return p[1] * p[1] / d[DRIFT] + a * a / d[DRIFT + 1] + c * c / d[CC];
}

/* U x = z */
static inline void solve(const FO_FACTOR *info, FO_VALUE x[FO_NX])
{
    const FO_VALUE *u = &info->U[FO_TRIANGLE];
    FO_UNROLL
    for (int i = FO_NX - 1; i >= 0; i--) {
        FO_VALUE sum = info->z[i];
        FO_UNROLL
        for (int j = FO_NX - 1; j > i; j--) {
            u--;
            sum -= *u * x[j];
        }
        x[i] = sum;
    }
}

/* Third difference of four currents, newest first. It removes the smooth part of the currents and
 * has 20 times the noise variance. */
static inline FO_VALUE third_difference(FO_VALUE i0, FO_VALUE i1, FO_VALUE i2, FO_VALUE i3)
{
    return i0 - i3 + (fo_real)3 * (i2 - i1);
}

/* A second difference of sums of two samples: noise contributes a fifth of its power to a third
 * difference, a ripple at half the sampling rate nothing. */
static inline FO_VALUE difference_of_sums(FO_VALUE i0, FO_VALUE i1, FO_VALUE i2, FO_VALUE i3)
{
    return i0 - i1 - i2 + i3;
}

#endif
