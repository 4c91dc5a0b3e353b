/* Shared by the sources. Not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_INTERNAL_H
#define FLUXOBS_INTERNAL_H

#include "fluxobs.h"

#include <math.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0)
#error "do not use -ffast-math: values that are not finite have to be detected"
#endif

/* Accesses to a flag that two tasks share. A task that reads the flag by FO_ACQUIRE sees everything
 * that the other task wrote before its FO_RELEASE. */
#ifndef FO_RELEASE
#if defined(__GNUC__)
#define FO_RELEASE(flag, value) __atomic_store_n(&(flag), (value), __ATOMIC_RELEASE)
#define FO_ACQUIRE(flag) __atomic_load_n(&(flag), __ATOMIC_ACQUIRE)
#else /* one core: the order of volatile accesses; define both for other compilers and two cores */
#define FO_RELEASE(flag, value) ((flag) = (value))
#define FO_ACQUIRE(flag) (flag)
#endif
#endif

#if FO_SINGLE
#define fo_abs fabsf
#define fo_sqrt sqrtf
#else
#define fo_abs fabs
#define fo_sqrt sqrt
#endif

#define fo_atan2 FO_NAME(fo_atan2)
#define fo_linearise_map FO_NAME(fo_linearise_map)
#define fo_uneven FO_NAME(fo_uneven)
#define fo_add_row FO_NAME(fo_add_row)

#define ZERO ((fo_real)0)
#define ONE ((fo_real)1)
#define TWO ((fo_real)2)
#define PI ((fo_real)3.14159265358979323846)

/* Order of the immersion's state. */
enum { S = 0, FLUX = 1, KAPPA = FO_N + 1, DRIFT = FO_N + 2, CC = FO_NX - 1 };

/* ---- thresholds ------------------------------------------------------------------------
 * Thresholds of the plain observer. Each threshold has its unit, its reason, and the test that
 * fails at half or at twice its value ("not sharp": no test fails). The list at the end names the
 * thresholds for the binding. Tests without a folder are in tests/observers/test_accuracy.py. */

/* Share of noise in the flux information above which the flux is called unknown [1]. Noise in the
 * rows shortens an estimate by this share. A tenth, in one direction only, turns the flux by up to
 * 3 degrees (twice: test_carried_through_a_short_standstill). */
#define SHARE_LIMIT ((fo_real)0.1)
/* Angle by which a voltage error as large as the drift's prior may turn the flux while the position
 * is valid [rad]: 8 degrees (benchmarks/validity.py; half:
 * test_a_ripple_of_the_speed_does_not_keep_a_position_from_being_valid, twice:
 * test_stop_with_a_voltage_error_is_not_wrong_and_sure). */
#define VOLTAGE_LIMIT (PI / (fo_real)22.5)
/* Upper bound of that angle [rad]: ten times VOLTAGE_LIMIT, since a wrong flux may be long. The
 * effect of a larger angle would last for long after a stop (not sharp). */
#define VOLTAGE_TURN_MAX (PI / (fo_real)2.25)
/* Largest change of the flux in one sample; a larger change is an error [flux bases]. It is twice
 * the change that eight samples per period need, if the magnet flux is twice its base (half:
 * tests/observers/test_bad_samples.py,
 * test_a_spike_in_the_voltage_restarts_once_the_currents_contradict). */
#define FLUX_STEP_LIMIT ((fo_real)4)
/* A measurement with a larger innovation is rejected [constraint bases]. The limit is the size of
 * the relation itself; STEP_LIMIT rejects smaller errors (half:
 * test_exact_without_noise_from_volt_seconds, twice: test_drift_jump_is_followed). */
#define OUTLIER_LIMIT ((fo_real)1)
/* A measurement is also rejected if it moves the position vector by more than a sum: twice the
 * vector's last step, this share of its length [1], and this many stds of noise [1]. A current
 * spike may not change the length. A share of 0.15 turns the vector by 9 degrees; six stds occur
 * once in 10^9 samples (twice of either: tests/observers/test_bad_samples.py,
 * test_spikes_of_any_size_and_direction_do_not_mislead). */
#define STEP_LIMIT ((fo_real)0.15)
#define STEP_NOISE ((fo_real)6)
/* If the drift exceeds its prior's std after this rotation, the prior was too tight [rad]. A
 * rotation of one and a half turns shows any flux circle as a whole (not sharp). */
#define SETTLED ((fo_real)3 * PI)
/* The prior's variance then becomes this many times the square of that drift [1]. The new std is
 * twice the drift, so that the drift is ordinary from then on (not sharp). */
#define WIDEN ((fo_real)4)
/* The past information is then multiplied by this factor divided by the squared ratio of the drift
 * to its std [1]. The factor is large enough to keep the matrix regular, and too small to matter
 * (not sharp). With a flux map, the factor reduces the information from before the position was
 * known (at 1, starts are wrong by up to 8 degrees). */
#define DISTRUST ((fo_real)0.01)
/* Rotation at a known flux before the position is trusted [rad]: half a turn. A flux that is wrong
 * due to its drift shows within this rotation (twice:
 * test_never_valid_at_standstill_and_one_period_is_enough_after). */
#define SWEEP PI
/* Largest std of a valid position [rad]: 3 degrees. Five stds are then within 15 degrees (half:
 * test_random_machines). */
#define STD_LIMIT (PI / (fo_real)60)
/* Time for which the tracker's error must be below STD_LIMIT before a position is valid [memories],
 * and share of the time that counts while the error is larger [1]. Under a quick ripple of the
 * speed the tracker's error may stay larger. The share then delays a valid position by at most
 * three memories (not sharp: half and twice delay a valid position by less than a memory). */
#define TRACKER_SETTLED ((fo_real)0.1)
#define TRACKER_OFF ((fo_real)(1.0 / 30.0))
/* Error at which the tracker restarts [rad]: 60 degrees. Beyond 90 degrees the tracker can lock
 * onto a speed that is a quarter of a turn per sample too fast (twice: tests/firmware/pieces.c). */
#define TRACKER_LOST (PI / (fo_real)3)
/* Variance of an unknown angle, uniform over a turn [rad^2]. Not tuned. */
#define VARIANCE_UNKNOWN (PI * PI / (fo_real)3)
/* Square of a position vector above which the numbers have diverged [flux bases]: a hundred times
 * any flux, but far within single precision (not sharp; tests/firmware/fuzz.c). */
#define RUNAWAY ((fo_real)1e4)
/* Limit of the correlation of successive innovations [1]. The correlation r inflates a variance by
 * (1 + r) / (1 - r), at most 99, and a std tenfold. A larger correlation shows a slow change, not
 * noise (not sharp). */
#define CORRELATION_LIMIT ((fo_real)0.98)
/* Bad samples in a row that are bridged before a restart [1]. */
#define MAX_CONSECUTIVE_BAD ((fo_real)FO_MAX_CONSECUTIVE_BAD)
/* Length of a round [samples]. In a round, samples alternate: one re-injects a row of the prior,
 * the next updates the variances. */
#define REINJECT_PERIOD ((fo_real)(2 * FO_NX))

/* Active flux below which the gradient of its length is undefined [flux bases]: a thousandth, far
 * below the shortest usable active flux. Not tuned. */
#define ACTIVE_FLUX_MIN ((fo_real)0.001)

#define FO_THRESHOLDS(X)                                                                     \
    X(SHARE_LIMIT) X(VOLTAGE_LIMIT) X(VOLTAGE_TURN_MAX) X(FLUX_STEP_LIMIT) X(OUTLIER_LIMIT)      \
    X(STEP_LIMIT) X(STEP_NOISE) X(SETTLED) X(WIDEN) X(DISTRUST) X(SWEEP) X(STD_LIMIT)        \
    X(TRACKER_SETTLED) X(TRACKER_OFF) X(TRACKER_LOST) X(VARIANCE_UNKNOWN) X(RUNAWAY)         \
    X(CORRELATION_LIMIT) X(MAX_CONSECUTIVE_BAD) X(REINJECT_PERIOD) X(ACTIVE_FLUX_MIN)

/* Lag-one correlation of innovations with these sums, limited to 0 to CORRELATION_LIMIT. */
static inline fo_real correlation(fo_real lag_one, fo_real power)
{
    const fo_real r = power > ZERO ? lag_one / power : ZERO;
    return !(r > ZERO) ? ZERO : r > CORRELATION_LIMIT ? CORRELATION_LIMIT : r;
}

/* Coefficients of (atan(q) / q - 1) / q^2 by powers of q^2, |q| <= 0.199. Chebyshev: the relative
 * error of atan(q) is below 8.1e-9 in single precision, 3.4e-19 in double. */
#if FO_SINGLE
#define FO_ATAN_SERIES                                                                       \
    {(fo_real)-0.136489613386948304, (fo_real)0.199906407297515527,                          \
     (fo_real)-0.333333127793564512}
#else
#define FO_ATAN_SERIES                                                                       \
    {(fo_real)0.0511512517027116696, (fo_real)-0.0661865256931123838,                        \
     (fo_real)0.0769072045419432437, (fo_real)-0.0909087985243087116,                        \
     (fo_real)0.111111108177434445,  (fo_real)-0.142857142842660927,                         \
     (fo_real)0.199999999999972729,  (fo_real)-0.333333333333333325}
#endif
/* Expansion points of the arc tangent besides 0 and pi/4: an angle, its tangent (exact in any
 * fo_real), and the tangents above which the next point is nearer [1]. */
#define FO_BETWEEN ((fo_real)0.392570135011828595166)
#define FO_TAN_BETWEEN ((fo_real)0.4140625)
#define FO_NEAR_ZERO ((fo_real)0.19884534)
#define FO_NEAR_BETWEEN ((fo_real)0.66808538)

/* Angle of (x, y) in (-pi, pi], to within four units in the last place; NaN if x or y is NaN. The
 * bits are the same with every compiler and processor, unlike those of atan2 in C libraries. */
fo_real fo_atan2(fo_real y, fo_real x);

/* Adds row'x = value with this information to the factor. The row's elements before `first` are
 * zero. Returns the normalised innovation. */
fo_real fo_add_row(fo_information *info, fo_real row[FO_NX], fo_real value, fo_real information,
                     int first);

#if FO_MAPPED
/* Linearises the map at a current and a rotor angle. `f` gives a cage's rotor flux. */
void fo_linearise_map(const fo_observer *o, fo_real angle, const fo_real current[FO_N],
                      fo_map_point *f);
#endif

static inline fo_real dot(const fo_real a[FO_N], const fo_real b[FO_N])
{
    return a[0] * b[0] + a[1] * b[1];
}

/* Component of v across the unit vector `along`. */
static inline fo_real component_across(const fo_real along[FO_N], const fo_real v[FO_N])
{
    return along[0] * v[1] - along[1] * v[0];
}

/* Row i of a matrix times a vector. */
static inline fo_real row_of(const fo_real matrix[FO_N][FO_N], int i, const fo_real v[FO_N])
{
#if FO_ISOTROPIC
    return matrix[0][0] * v[i];
#else
    return dot(matrix[i], v);
#endif
}

/* Adds a linear term of the relation, if the relation has one. */
static inline fo_real add_linear(fo_real sum, fo_real term)
{
#if FO_ISOTROPIC
    (void)term;
    return sum;
#else
    return sum + term;
#endif
}

/* A component of the armature flux. The position vector is flux - armature flux. */
static inline fo_real armature_flux(const fo_observer *o, const fo_state *s, int i)
{
#if FO_MAPPED
    (void)o;
    return s->map_point.armature_flux[i];
#else
    return o->L_position * s->current[0][i];
#endif
}

static inline bool has_map(const fo_observer *o)
{
#if FO_MAPPED
    return o->map != NULL;
#else
    (void)o;
    return false;
#endif
}

/* Does the rotor flux follow the current, as in a cage? */
static inline bool has_cage_map(const fo_observer *o)
{
#if FO_MAPPED
    return o->map != NULL && o->map->kind == FO_MAP_CAGE;
#else
    (void)o;
    return false;
#endif
}

/* Variance of a cage's angle due to a current offset [rad^2]. The offset makes the flux ripple,
 * because the flux is the low-passed current. */
static inline fo_real cage_ripple_variance(const fo_observer *o, fo_real speed)
{
    fo_real variance = ZERO;
#if FO_MAPPED
    if (has_cage_map(o)) {
        const fo_real corner = o->map->decay / o->sample_time;
        variance = o->map->ripple * o->map->ripple / (speed * speed + corner * corner);
    }
#else
    (void)o;
    (void)speed;
#endif
    return variance;
}

static inline bool within(fo_real x, fo_real low, fo_real high) { return x >= low && x <= high; }

/* The first wrong field of a configuration. */
typedef struct {
    fo_error code;
    const char *field;
} field_error;

static inline void demand(field_error *first, bool good, fo_error code, const char *field)
{
    if (first->code == FO_OK && !good) {
        first->code = code;
        first->field = field;
    }
}

/* Is the memory ten to a million samples, except for rounding? */
static inline bool memory_fits(fo_real memory, fo_real sample_time)
{
    return within(memory, (fo_real)9.99 * sample_time, (fo_real)1.001e6 * sample_time);
}

static inline void demand_size(field_error *first, fo_real x, fo_real low, fo_real high,
                               const char *field)
{
    demand(first, within(x, low, high), FO_ERROR_RANGE, field);
}

/* Wraps an angle between -3 pi and 3 pi to (-pi, pi]. */
static inline fo_real wrap(fo_real angle)
{
    return angle > PI ? angle - TWO * PI : angle <= -PI ? angle + TWO * PI : angle;
}

/* Turns a vector by an angle below 1.5 rad, to within 1e-3 of the angle: the tangent of half the
 * angle is approximated. */
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

/* Unit vector in the direction of an angle in [-pi, pi]. */
static inline void direction_of(fo_real angle, fo_real direction[FO_N])
{
    const fo_real axis[FO_N] = {ONE, ZERO};
    fo_real quarter[FO_N], half[FO_N]; /* half of the angle is within a quarter turn */
    turn(axis, angle / (fo_real)4, quarter);
    turn(quarter, angle / (fo_real)4, half);
    direction[0] = half[0] * half[0] - half[1] * half[1];
    direction[1] = TWO * half[0] * half[1];
}

/* 24 times the mean current of the last interval, from the cubic through four samples. The newest
 * sample is first. */
static inline fo_real mean_current_24(fo_real i0, fo_real i1, fo_real i2, fo_real i3)
{
    return (fo_real)9 * i0 + (fo_real)19 * i1 - (fo_real)5 * i2 + i3;
}

/* Is this a state of zeros, on which fo_reset was never called? */
static inline bool is_never_reset(const fo_state *s) { return s->noise_inflation == ZERO; }

/* Must this state be checked now? Each state is checked once in a round; a restart in the last step
 * begins a round. */
static inline bool may_be_damaged(const fo_state *s)
{
    return s->round_index == 1U || is_never_reset(s);
}

/* Is this an invalid state of the observer, that is, zeros or overwritten memory? Call it where
 * may_be_damaged. */
#define fo_damaged FO_NAME(fo_damaged)
bool fo_damaged(const fo_observer *o, const fo_state *s);

static inline void set_reason(fo_estimate *e, fo_reason reason)
{
    e->valid = reason == FO_VALID;
    e->valid_reason = reason;
}

static inline void stop_tracker(fo_tracker *t, fo_real theta)
{
    t->angle = theta;
    t->speed = ZERO;
    t->acceleration = ZERO;
    t->lost = false;
}

/* Rotation per sample that the tracker predicts. */
static inline fo_real predicted_step(const fo_observer *o, const fo_tracker *t)
{
    const fo_real h = o->sample_time;
    return h * (t->speed + h * t->acceleration / TWO);
}

/* Rotor angle that the tracker predicts for this sample. */
static inline fo_real predicted_angle(const fo_observer *o, const fo_tracker *t)
{
    const fo_real step = predicted_step(o, t);
    return fo_abs(step) <= PI ? wrap(t->angle + step) : t->angle;
}

static inline void track(const fo_observer *o, fo_tracker *t, fo_real theta)
{
    const fo_real h = o->sample_time;
    const fo_real step = predicted_step(o, t);
    if (t->lost) { /* the tracker's angle is that of the last sample */
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
        } else { /* do not lock onto a speed at which the errors of four samples cancel */
            stop_tracker(t, theta);
            t->lost = true;
            t->settled = ZERO;
        }
    } else { /* the rotor turned by more than half a turn in a sample */
        stop_tracker(t, theta);
    }
}

/* Is the tracker's error small for an angle with this std? */
static inline bool follows(const fo_tracker *t, fo_real theta, fo_real std)
{
    return fo_abs(wrap(theta - t->angle)) < STD_LIMIT + (fo_real)3 * std;
}

/* Adds to the time for which the tracker's error was small. The tracker starts from rest, whatever
 * the speed. */
static inline void settle_tracker(const fo_observer *o, fo_tracker *t, fo_real theta, fo_real std)
{
    if (t->settled < TRACKER_SETTLED) { /* a settled tracker stays settled */
        t->settled += follows(t, theta, std) ? o->h : TRACKER_OFF * o->h;
    }
}

/* Returns the observer for another sample time [s], which must be plausible. */
#define fo_scale_to_duration FO_NAME(fo_scale_to_duration)
void fo_scale_to_duration(const fo_observer *o, fo_real duration, fo_observer *scaled);

/* A step that may merge two intervals: one that `begins` a merged interval has no row, and writes
 * no estimate if the interval is then pending. `rows` is the observer with the time of a row: o, or that of two samples if an interval
 * is pending. `input` is a voltage or, if `complete`, volt-seconds. */
#define fo_step_merged FO_NAME(fo_step_merged)
void fo_step_merged(const fo_observer *o, const fo_observer *rows, fo_state *s, fo_merged *merged,
                    bool begins, const fo_real input[FO_N], bool complete,
                    const fo_real current[FO_N], fo_estimate *e);

/* Returns, for an interval of this duration [s]: the observer, the interval's volt-seconds, and the
 * current at its end. An implausible duration gives an absurd current. */
void fo_uneven(const fo_observer *o, const fo_state *s, fo_real duration,
               const fo_real voltage[FO_N], const fo_real current[FO_N], fo_observer *now,
               fo_gathered *g);

#endif
