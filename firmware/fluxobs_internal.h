/* What the sources share; not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_INTERNAL_H
#define FLUXOBS_INTERNAL_H

#include "fluxobs.h"

#include <math.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0)
#error "not with -ffast-math: values that are not finite have to be told from others"
#endif

#ifdef FO_SINGLE
#define fo_abs fabsf
#define fo_sqrt sqrtf
#define fo_atan2 atan2f
#else
#define fo_abs fabs
#define fo_sqrt sqrt
#define fo_atan2 atan2
#endif

#define ZERO ((fo_real)0)
#define ONE ((fo_real)1)
#define TWO ((fo_real)2)
#define PI ((fo_real)3.14159265358979323846)

/* Order of the immersion's state. */
enum { S = 0, FLUX = 1, KAPPA = FO_N + 1, DRIFT = FO_N + 2, CC = FO_NX - 1 };

/* Rotation since the flux is known before the position is trusted: half a turn. */
#define SWEEP PI
/* Position std above which a trusted position is not called valid: 3 degrees, five to 15. */
#define STD_LIMIT (PI / (fo_real)60)
/* For so long, in memories, the tracker has to be as near as that before a position is valid; time
 * in which it is not counts for little, so that one which never comes near, under a quick ripple of
 * the speed, does not keep the position from being valid for more than three memories. */
#define TRACKER_SETTLED ((fo_real)0.1)
#define TRACKER_OFF ((fo_real)(1.0 / 30.0))
/* Off by more than this the tracker starts anew: 60 degrees. */
#define TRACKER_LOST (PI / (fo_real)3)
/* Variance of an angle of which nothing is known: uniform over a turn. */
#define VARIANCE_UNKNOWN (PI * PI / (fo_real)3)
/* A position vector longer than this, squared, in flux bases, is numbers that have run away. */
#define RUNAWAY ((fo_real)1e4)
/* Largest lag-one correlation of the innovations that is believed. */
#define CORRELATION_LIMIT ((fo_real)0.98)

/* Lag-one correlation of innovations with these sums, as far as it is believed. */
static inline fo_real correlation(fo_real lag_one, fo_real power)
{
    const fo_real r = power > ZERO ? lag_one / power : ZERO;
    return !(r > ZERO) ? ZERO : r > CORRELATION_LIMIT ? CORRELATION_LIMIT : r;
}

static inline fo_real dot(const fo_real a[FO_N], const fo_real b[FO_N])
{
    return a[0] * b[0] + a[1] * b[1];
}

static inline bool within(fo_real x, fo_real low, fo_real high) { return x >= low && x <= high; }

/* Of an angle within a turn and a half. */
static inline fo_real wrap(fo_real angle)
{
    return angle > PI ? angle - TWO * PI : angle <= -PI ? angle + TWO * PI : angle;
}

/* Turns a vector by an angle below 1.5 rad, to within 1e-3 of it: by the angle whose half has this
 * tangent. */
static inline void turn(const fo_real v[FO_N], fo_real angle, fo_real turned[FO_N])
{
    const fo_real half = angle / TWO, square = half * half;
    const fo_real tangent = half * ((fo_real)15 - square) / ((fo_real)15 - (fo_real)6 * square);
    const fo_real over = ONE / (ONE + tangent * tangent);
    const fo_real cosine = (ONE - tangent * tangent) * over, sine = TWO * tangent * over;
    const fo_real v0 = v[0], v1 = v[1];
    turned[0] = cosine * v0 - sine * v1;
    turned[1] = sine * v0 + cosine * v1;
}

/* 24 times the mean current over the last interval: the cubic through four samples, newest first. */
static inline fo_real mean_current_24(fo_real i0, fo_real i1, fo_real i2, fo_real i3)
{
    return (fo_real)9 * i0 + (fo_real)19 * i1 - (fo_real)5 * i2 + i3;
}

static inline void stop_tracker(fo_tracker *t, fo_real theta)
{
    t->angle = theta;
    t->speed = ZERO;
    t->acceleration = ZERO;
    t->lost = false;
}

static inline void track(const fo_observer *o, fo_tracker *t, fo_real theta)
{
    const fo_real h = o->sample_time;
    const fo_real step = h * (t->speed + h * t->acceleration / TWO);
    if (t->lost) { /* it was at the angle a sample ago */
        const fo_real turned = wrap(theta - t->angle);
        stop_tracker(t, theta);
        t->speed = turned / h;
    } else if (fo_abs(step) <= PI) {
        const fo_real predicted = wrap(t->angle + step);
        const fo_real error = wrap(theta - predicted);
        if (fo_abs(error) <= TRACKER_LOST) {
            t->angle = wrap(predicted + o->track[0] * error);
            t->speed += h * t->acceleration + o->track[1] * error;
            t->acceleration += o->track[2] * error;
        } else { /* left alone it could lock on a speed at which errors of four samples cancel */
            stop_tracker(t, theta);
            t->lost = true;
            t->settled = ZERO;
        }
    } else { /* faster than the samples can tell */
        stop_tracker(t, theta);
    }
}

/* The tracker starts from rest, at whatever speed it is met: is it near by now? */
static inline void settle_tracker(const fo_observer *o, fo_tracker *t, fo_real theta, fo_real std)
{
    if (t->settled < TRACKER_SETTLED) { /* else it stays settled */
        const bool follows = fo_abs(wrap(theta - t->angle)) < STD_LIMIT + (fo_real)3 * std;
        t->settled += follows ? o->h : TRACKER_OFF * o->h;
    }
}

#endif
