/* Vectors of the plane as complex numbers. */
#ifndef FLUXOBS_VECTOR_H
#define FLUXOBS_VECTOR_H

#include <math.h>

typedef struct {
    double re, im;
} vec;

static inline vec vec_of(double re, double im)
{
    const vec a = {re, im};
    return a;
}
static inline vec plus(vec a, vec b) { return vec_of(a.re + b.re, a.im + b.im); }
static inline vec minus(vec a, vec b) { return vec_of(a.re - b.re, a.im - b.im); }
static inline vec times(double f, vec a) { return vec_of(f * a.re, f * a.im); }
static inline vec product(vec a, vec b)
{
    return vec_of(a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re);
}
static inline vec conjugate(vec a) { return vec_of(a.re, -a.im); }
static inline vec turned(vec a) { return vec_of(-a.im, a.re); } /* j a */
static inline double dot(vec a, vec b) { return a.re * b.re + a.im * b.im; }
static inline double length_of(vec a) { return sqrt(a.re * a.re + a.im * a.im); }
static inline vec direction_of(double angle) { return vec_of(cos(angle), sin(angle)); }
static inline double clamp(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}
static inline double wrapped(double angle)
{
    return angle - 6.283185307179586 * floor(angle / 6.283185307179586 + 0.5);
}

#endif
