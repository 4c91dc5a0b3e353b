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

/* ---- thresholds ------------------------------------------------------------------------
 * Of the plain observer: what each is, its unit, why it is so large, and what fixed it. The last list
 * names them for the library's binding, from which the twin and the readable observer read them. */

/* Share of the flux information that may be noise before the flux is called unknown [1]. A share of
 * 0.1 makes the flux 5 % too short, 3 degrees in the worst direction (tests/observers/test_accuracy,
 * current noise at standstill). */
#define SHARE_LIMIT ((fo_real)0.1)
/* What a voltage error as large as the drift's prior may turn the flux by while the position is
 * valid: 8 degrees [rad] (benchmarks/validity.py; tests/observers/test_accuracy, locked rotor). */
#define VOLTAGE_LIMIT (PI / (fo_real)22.5)
/* That turn adds up to this at most [rad]: ten times VOLTAGE_LIMIT, since a flux that is wrong may be
 * long; more would be remembered for long after a stop (benchmarks/validity.py). */
#define EXPOSED_MOST (PI / (fo_real)2.25)
/* Largest change of the flux in a sample that is no error [flux bases]: twice what eight samples a
 * period ask for, with a magnet flux twice as large as its base (tests/observers/test_bad_samples). */
#define FLUX_STEP_LIMIT ((fo_real)4)
/* A measurement further than this off what is known is not taken [constraint bases]: the relation's
 * own size. Smaller ones are left to STEP_LIMIT (tests/observers/test_bad_samples). */
#define OUTLIER_LIMIT ((fo_real)1)
/* Nor is one in which the position vector moves by more than twice its last step, this share of
 * itself [1] and so many stds of noise [1]: a spike of the current can leave its length as it is. 0.15
 * is 9 degrees, half of what a spike needs to harm (tests/observers/test_bad_samples); six stds occur
 * once in 10^9 samples. */
#define STEP_LIMIT ((fo_real)0.15)
#define STEP_NOISE ((fo_real)6)
/* Rotation after which a drift beyond its prior's std says that the prior was too tight: one and a
 * half turns [rad], in which any flux circle is seen whole (tests/observers/test_accuracy, a drift of
 * several priors). */
#define SETTLED ((fo_real)3 * PI)
/* The prior's variance then becomes so many times the square of that drift [1]: twice the drift, so
 * that it is ordinary from now on (the same tests). */
#define WIDEN ((fo_real)4)
/* What the past then still counts, over the square of that excess [1]: enough to keep the matrix
 * regular, too little to be believed (the same tests). */
#define DISTRUST ((fo_real)0.01)
/* Rotation since the flux is known before the position is trusted: half a turn [rad]. A flux that is
 * wrong by its drift shows within that (benchmarks/validity.py). */
#define SWEEP PI
/* Std of the position above which it is not valid: 3 degrees [rad], five to 15
 * (benchmarks/validity.py). */
#define STD_LIMIT (PI / (fo_real)60)
/* For so long the tracker has to be as near as that before a position is valid [memories]; and the
 * share of the time that counts while it is not near [1], so that a tracker that never comes near,
 * under a quick ripple of the speed, does not keep the position from being valid for more than three
 * memories (tests/observers/test_accuracy, restart at speed and ripple). */
#define TRACKER_SETTLED ((fo_real)0.1)
#define TRACKER_OFF ((fo_real)(1.0 / 30.0))
/* Off by more than this the tracker starts anew: 60 degrees [rad]. Beyond 90 it can lock on a speed a
 * quarter of a turn a sample too fast (tests/observers/test_tracker). */
#define TRACKER_LOST (PI / (fo_real)3)
/* Variance of an angle of which nothing is known: uniform over a turn [rad^2]. */
#define VARIANCE_UNKNOWN (PI * PI / (fo_real)3)
/* Square of a position vector [flux bases] beyond which its numbers have run away: a hundred times any
 * flux, and far within single precision (tests/firmware/fuzz.c). */
#define RUNAWAY ((fo_real)1e4)
/* Largest correlation of successive innovations that is believed [1]: it inflates a variance by
 * (1 + r) / (1 - r) = 99, to a tenth of the angle's; more is slow change, not noise
 * (benchmarks/validity.py). */
#define CORRELATION_LIMIT ((fo_real)0.98)
/* Bad samples in a row that are bridged before a restart [1]. */
#define MAX_CONSECUTIVE_BAD ((fo_real)FO_MAX_CONSECUTIVE_BAD)
/* Samples take turns: in one a row of the prior is re-injected, in the next the certainty is judged.
 * A round [samples]. */
#define REINJECT_PERIOD ((fo_real)(2 * FO_NX))

#define FO_THRESHOLDS(X)                                                                     \
    X(SHARE_LIMIT) X(VOLTAGE_LIMIT) X(EXPOSED_MOST) X(FLUX_STEP_LIMIT) X(OUTLIER_LIMIT)      \
    X(STEP_LIMIT) X(STEP_NOISE) X(SETTLED) X(WIDEN) X(DISTRUST) X(SWEEP) X(STD_LIMIT)        \
    X(TRACKER_SETTLED) X(TRACKER_OFF) X(TRACKER_LOST) X(VARIANCE_UNKNOWN) X(RUNAWAY)         \
    X(CORRELATION_LIMIT) X(MAX_CONSECUTIVE_BAD) X(REINJECT_PERIOD)

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
