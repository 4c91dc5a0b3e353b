/* A number with its derivatives by all parameters: forward differentiation.
 *
 * The score of a likelihood must be the exact derivative of the likelihood that the code computes,
 * covariances included. With these numbers the recursion is written once. */
#ifndef FLUXOBS_DUAL_H
#define FLUXOBS_DUAL_H

#include <math.h>

#include "parameters.h"

typedef struct {
    double v;
    double d[FO_L];
} fo_dual;

/* f(a) with its derivative f'(a). */
static inline fo_dual fo_chain(fo_dual a, double value, double slope)
{
    fo_dual r;
    r.v = value;
    for (int k = 0; k < FO_L; k++) r.d[k] = slope * a.d[k];
    return r;
}

static inline fo_dual fo_constant(double value)
{
    fo_dual r = {value, {0.0}};
    return r;
}

static inline fo_dual fo_unknown(double value, int index)
{
    fo_dual r = {value, {0.0}};
    r.d[index] = 1.0;
    return r;
}

static inline fo_dual fo_add(fo_dual a, fo_dual b)
{
    fo_dual r;
    r.v = a.v + b.v;
    for (int k = 0; k < FO_L; k++) r.d[k] = a.d[k] + b.d[k];
    return r;
}

static inline fo_dual fo_sub(fo_dual a, fo_dual b)
{
    fo_dual r;
    r.v = a.v - b.v;
    for (int k = 0; k < FO_L; k++) r.d[k] = a.d[k] - b.d[k];
    return r;
}

static inline fo_dual fo_mul(fo_dual a, fo_dual b)
{
    fo_dual r;
    r.v = a.v * b.v;
    for (int k = 0; k < FO_L; k++) r.d[k] = a.d[k] * b.v + a.v * b.d[k];
    return r;
}

/* a + s b */
static inline fo_dual fo_axpy(fo_dual a, double s, fo_dual b)
{
    fo_dual r;
    r.v = a.v + s * b.v;
    for (int k = 0; k < FO_L; k++) r.d[k] = a.d[k] + s * b.d[k];
    return r;
}

/* a + b c */
static inline fo_dual fo_mac(fo_dual a, fo_dual b, fo_dual c)
{
    fo_dual r;
    r.v = a.v + b.v * c.v;
    for (int k = 0; k < FO_L; k++) r.d[k] = a.d[k] + (b.d[k] * c.v + b.v * c.d[k]);
    return r;
}

/* a − b c */
static inline fo_dual fo_msub(fo_dual a, fo_dual b, fo_dual c)
{
    fo_dual r;
    r.v = a.v - b.v * c.v;
    for (int k = 0; k < FO_L; k++) r.d[k] = a.d[k] - (b.d[k] * c.v + b.v * c.d[k]);
    return r;
}

static inline fo_dual fo_scale(double s, fo_dual a) { return fo_chain(a, s * a.v, s); }

static inline fo_dual fo_shift(double s, fo_dual a)
{
    a.v += s;
    return a;
}

static inline fo_dual fo_inverse(fo_dual a) { return fo_chain(a, 1.0 / a.v, -1.0 / (a.v * a.v)); }

static inline fo_dual fo_exp_of(fo_dual a)
{
    const double e = exp(a.v);
    return fo_chain(a, e, e);
}

static inline fo_dual fo_tanh_of(fo_dual a)
{
    const double t = tanh(a.v);
    return fo_chain(a, t, 1.0 - t * t);
}

/* A vector of two components. */
typedef struct {
    fo_dual a, b;
} fo_pair;

static inline fo_pair fo_unit(fo_dual angle)
{
    const double c = cos(angle.v), s = sin(angle.v);
    const fo_pair r = {fo_chain(angle, c, -s), fo_chain(angle, s, c)};
    return r;
}

/* Turned by the angle of the unit vector. */
static inline fo_pair fo_turned(fo_pair x, fo_pair unit)
{
    const fo_pair r = {fo_msub(fo_mul(x.a, unit.a), x.b, unit.b),
                       fo_mac(fo_mul(x.a, unit.b), x.b, unit.a)};
    return r;
}

/* Turned back. */
static inline fo_pair fo_turned_back(fo_pair x, fo_pair unit)
{
    const fo_pair r = {fo_mac(fo_mul(x.a, unit.a), x.b, unit.b),
                       fo_msub(fo_mul(x.b, unit.a), x.a, unit.b)};
    return r;
}

static inline fo_pair fo_added(fo_pair x, double s, fo_pair y)
{
    const fo_pair r = {fo_axpy(x.a, s, y.a), fo_axpy(x.b, s, y.b)};
    return r;
}

static inline fo_pair fo_constant_pair(double a, double b)
{
    const fo_pair r = {fo_constant(a), fo_constant(b)};
    return r;
}

#endif
