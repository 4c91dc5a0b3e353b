/* Forward differentiation: a number with its derivatives by the parameters of the model.
 *
 * The score of a likelihood must be the exact derivative of the likelihood that the code computes. With
 * these numbers the linearised model is written once. d[0] is the value, d[1 + k] the derivative by
 * parameter k of FO_OF_MODEL. */
#ifndef FLUXOBS_DUAL_H
#define FLUXOBS_DUAL_H

#include <math.h>

#include "parameters.h"

#ifdef FO_VALUES_ONLY
enum { FO_SLOPES = 0, FO_WIDTH = 1 }; /* see values.h */
#else
/* FO_WIDTH: a multiple of what a vector register holds. */
enum { FO_SLOPES = FO_T, FO_WIDTH = (1 + FO_T + 1) / 2 * 2 };
#endif

typedef struct {
    double d[FO_WIDTH];
} fo_dual;

/* f(a) with its derivative f'(a). */
static inline fo_dual fo_chain(fo_dual a, double value, double slope)
{
    fo_dual r;
    for (int k = 0; k < FO_WIDTH; k++) r.d[k] = slope * a.d[k];
    r.d[0] = value;
    return r;
}

static inline fo_dual fo_constant(double value)
{
    fo_dual r = {{value}};
    return r;
}

static inline fo_dual fo_unknown(double value, int index)
{
    fo_dual r = {{value}};
    if (FO_SLOPES > 0) r.d[FO_SLOPES > 0 ? index - FO_FIRST_OF_MODEL + 1 : 0] = 1.0;
    return r;
}

static inline fo_dual fo_add(fo_dual a, fo_dual b)
{
    fo_dual r;
    for (int k = 0; k < FO_WIDTH; k++) r.d[k] = a.d[k] + b.d[k];
    return r;
}

static inline fo_dual fo_sub(fo_dual a, fo_dual b)
{
    fo_dual r;
    for (int k = 0; k < FO_WIDTH; k++) r.d[k] = a.d[k] - b.d[k];
    return r;
}

/* r ← r + b c, in place: without copies of the operands. */
static inline void fo_accumulate(fo_dual *restrict r, const fo_dual *restrict b,
                                 const fo_dual *restrict c)
{
    const double x = b->d[0], y = c->d[0], value = r->d[0] + x * y;
    for (int k = 0; k < FO_WIDTH; k++) r->d[k] += b->d[k] * y + x * c->d[k];
    r->d[0] = value;
}

/* r ← r + s b */
static inline void fo_accumulate_scaled(fo_dual *restrict r, double s, const fo_dual *restrict b)
{
    for (int k = 0; k < FO_WIDTH; k++) r->d[k] += s * b->d[k];
}

/* r ← b c */
static inline void fo_product(fo_dual *restrict r, const fo_dual *restrict b,
                              const fo_dual *restrict c)
{
    const double x = b->d[0], y = c->d[0];
    for (int k = 0; k < FO_WIDTH; k++) r->d[k] = b->d[k] * y + x * c->d[k];
    r->d[0] = x * y;
}

/* r ← r − b c */
static inline void fo_reduce(fo_dual *restrict r, const fo_dual *restrict b,
                             const fo_dual *restrict c)
{
    const double x = b->d[0], y = c->d[0], value = r->d[0] - x * y;
    for (int k = 0; k < FO_WIDTH; k++) r->d[k] -= b->d[k] * y + x * c->d[k];
    r->d[0] = value;
}

static inline fo_dual fo_mul(fo_dual a, fo_dual b)
{
    fo_dual r;
    fo_product(&r, &a, &b);
    return r;
}

/* a + s b */
static inline fo_dual fo_axpy(fo_dual a, double s, fo_dual b)
{
    fo_accumulate_scaled(&a, s, &b);
    return a;
}

/* a + b c */
static inline fo_dual fo_mac(fo_dual a, fo_dual b, fo_dual c)
{
    fo_accumulate(&a, &b, &c);
    return a;
}

/* a − b c */
static inline fo_dual fo_msub(fo_dual a, fo_dual b, fo_dual c)
{
    fo_reduce(&a, &b, &c);
    return a;
}

static inline fo_dual fo_scale(double s, fo_dual a)
{
    for (int k = 0; k < FO_WIDTH; k++) a.d[k] *= s;
    return a;
}

static inline fo_dual fo_shift(double s, fo_dual a)
{
    a.d[0] += s;
    return a;
}

static inline fo_dual fo_inverse(fo_dual a)
{
    return fo_chain(a, 1.0 / a.d[0], -1.0 / (a.d[0] * a.d[0]));
}

static inline fo_dual fo_exp_of(fo_dual a)
{
    const double e = exp(a.d[0]);
    return fo_chain(a, e, e);
}

/* A vector of two components. */
typedef struct {
    fo_dual a, b;
} fo_pair;

static inline fo_pair fo_constant_pair(double a, double b)
{
    const fo_pair r = {fo_constant(a), fo_constant(b)};
    return r;
}

#endif
