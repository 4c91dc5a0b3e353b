/* SPDX-License-Identifier: MIT */
#include "fluxobs.h"

#include <math.h>

#ifdef FO_SINGLE
#define fo_sqrt sqrtf
#define fo_atan2 atan2f
#else
#define fo_sqrt sqrt
#define fo_atan2 atan2
#endif

#define ZERO ((fo_real)0)
#define ONE ((fo_real)1)
#define TWO ((fo_real)2)
#define PI ((fo_real)3.14159265358979323846)

/* Order of the immersion's state. */
enum { S = 0, FLUX = 1, KAPPA = FO_N + 1, DRIFT = FO_N + 2, CC = FO_NX - 1 };

/* Element (i, j), i < j, of a packed strict upper triangle. */
#define AT(i, j) ((i) * (2 * FO_NX - (i) - 3) / 2 + (j) - 1)

/* Share of noise in the flux information above which the flux is called unknown. */
static const fo_real SHARE_LIMIT = (fo_real)0.1;
/* Rotation since the flux is known before the position is trusted: half a turn. */
static const fo_real SWEEP = PI;
/* Position std above which a trusted position is not called valid: 3 degrees, five to 15. */
static const fo_real STD_LIMIT = PI / (fo_real)60;
/* The same for what a voltage error as large as the drift's prior can do: 8 degrees. */
static const fo_real VOLTAGE_LIMIT = PI / (fo_real)22.5;
/* Std of an angle of which nothing is known: uniform over a turn, pi / sqrt(3). */
static const fo_real STD_UNKNOWN = (fo_real)1.8137993642342178;
static const fo_real VARIANCE_UNKNOWN = PI * PI / (fo_real)3;
/* The largest flux change in one sample that is no error, in flux bases: twice what eight samples
 * a period ask for, with a magnet flux twice as large as its base. */
static const fo_real FLUX_STEP_LIMIT = (fo_real)4;
/* A measurement further than this off what is known, in constraint bases, is not taken. */
static const fo_real OUTLIER_LIMIT = (fo_real)1;
/* So is one in which the position vector x moves by more than twice its last step, this share of
 * itself and six stds of noise: a spike of the current can leave |x| as it is. */
static const fo_real STEP_LIMIT = (fo_real)0.15;
static const fo_real STEP_NOISE = (fo_real)6;
/* Largest lag-one correlation of the innovations that is believed. */
static const fo_real CORRELATION_LIMIT = (fo_real)0.98;
/* A prior row is re-injected every so many samples: rotations are what a sample costs. */
enum { REINJECT_EVERY = 2, REINJECT_PERIOD = REINJECT_EVERY * FO_NX };
/* Rotation after which a drift beyond its prior std says that the prior was too tight, ... */
static const fo_real SETTLED = (fo_real)3 * PI;
/* ... and what the past then still counts, over the square of that excess. */
static const fo_real DISTRUST = (fo_real)0.01;

static int finite_real(fo_real x) { return x - x == ZERO; }

static int finite_vector(const fo_real *x)
{
    int finite = 1;
    for (int i = 0; i < FO_N; i++) {
        finite = finite && finite_real(x[i]);
    }
    return finite;
}

static fo_real dot(const fo_real *a, const fo_real *b)
{
    fo_real sum = a[0] * b[0];
    for (int i = 1; i < FO_N; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}

static fo_real magnitude(fo_real x) { return x < ZERO ? -x : x; }

/* Of an angle within a turn and a half. */
static fo_real wrap(fo_real angle)
{
    return angle > PI ? angle - TWO * PI : angle <= -PI ? angle + TWO * PI : angle;
}

/* ---- configuration ------------------------------------------------------------------- */

static int config_finite(const fo_config *c)
{
    fo_real sum = c->L_position + c->sample_time + c->memory + c->flux_base + c->constraint_base +
                  c->constraint_noise + c->current_noise + c->current_limit + c->drift_prior +
                  c->tracker_bandwidth + c->length_min;
    for (int i = 0; i < FO_N; i++) {
        for (int j = 0; j < FO_N; j++) {
            sum += c->Q1[i][j] + c->Q2[i][j] + c->Q3[i][j] + c->R[i][j] + c->B[i][j];
        }
        sum += c->E[i] + c->C[i];
    }
    return finite_real(sum);
}

fo_error fo_init(fo_observer *o, const fo_config *c)
{
    if (!config_finite(c)) {
        return FO_ERROR_NOT_FINITE;
    }
    if (!(c->sample_time > ZERO) || !(c->memory >= (fo_real)10 * c->sample_time)) {
        return FO_ERROR_SAMPLE_TIME;
    }
    if (!(c->flux_base > ZERO && c->constraint_base > ZERO && c->constraint_noise > ZERO &&
          c->current_noise > ZERO && c->current_limit > ZERO && c->drift_prior > ZERO &&
          c->tracker_bandwidth > ZERO)) {
        return FO_ERROR_BASE;
    }
    const fo_real psi = c->flux_base;
    const fo_real noise = c->constraint_noise / c->constraint_base;
    const fo_real drift_base = psi / c->memory; /* time base: the memory */
    const fo_real drift_prior = c->drift_prior / drift_base;
    fo_real q2 = ZERO;

    for (int i = 0; i < FO_N; i++) {
        for (int j = 0; j < FO_N; j++) {
            const fo_real q1 = (c->Q1[i][j] + c->Q1[j][i]) / TWO;
            const fo_real q3 = (c->Q3[i][j] + c->Q3[j][i]) / TWO;
            o->Q1x2[i][j] = TWO * q1 * psi * psi / c->constraint_base;
            o->row_Q2[i][j] = c->Q2[i][j] * psi / c->constraint_noise;
            o->row_Q3[i][j] = q3 / c->constraint_noise;
            o->hR[i][j] = c->sample_time * c->R[i][j] / (psi * (fo_real)24);
            o->hB[i][j] = c->sample_time * c->B[i][j] / psi;
            q2 += o->row_Q2[i][j] * o->row_Q2[i][j];
        }
        o->E[i] = c->E[i] * psi / c->constraint_base;
        o->row_C[i] = c->C[i] / c->constraint_noise;
    }
    o->row_s = ONE / noise;
    o->sample_time = c->sample_time;
    o->h = c->sample_time / c->memory;
    o->rho = ONE - o->h;
    o->noise_information = q2 / (fo_real)FO_N * c->current_noise * c->current_noise;

    const fo_real square = drift_prior * drift_prior;
    o->plausible = drift_prior;
    o->prior[S] = ONE;
    o->prior[KAPPA] = ONE / ((fo_real)4 * square);
    o->prior[CC] = ONE / (square * square);
    for (int i = 0; i < FO_N; i++) {
        o->prior[FLUX + i] = ONE;
        o->prior[DRIFT + i] = ONE / square;
    }
    /* Each row brings back what forgetting takes until its next turn, 1 - rho^period. */
    fo_real left = ONE;
    for (int i = 0; i < REINJECT_PERIOD; i++) {
        left *= o->rho;
    }
    o->reinject = ONE - left;
    o->flux_base = psi;
    o->drift_base = drift_base;
    o->current_limit = c->current_limit;
    o->over_noise = ONE / (c->current_noise * c->current_noise);
    o->length_min = c->length_min / psi;
    o->L_position = c->L_position / psi;
    /* Noise of the current in x: directly through L, and through R as a random walk of the flux
     * that is followed with about a quarter of the memory. */
    fo_real walk = ZERO;
    for (int i = 0; i < FO_N; i++) {
        walk += c->R[i][i] / (fo_real)FO_N;
    }
    walk *= walk * c->sample_time * c->memory / (fo_real)4;
    o->position_noise = (c->L_position * c->L_position + walk) * c->current_noise *
                        c->current_noise / (psi * psi);

    /* Fading-memory filter of second order, triple pole z: no lag at constant acceleration.
     * 1 / (1 + x + x^2/2) stands for exp(-x), so that the core needs no exp. */
    const fo_real x = c->tracker_bandwidth * c->sample_time;
    const fo_real pole = ONE / (ONE + x + x * x / TWO);
    const fo_real gap = ONE - pole;
    o->track[0] = ONE - pole * pole * pole;
    o->track[1] = (fo_real)1.5 * gap * gap * (ONE + pole) / c->sample_time;
    o->track[2] = gap * gap * gap / (c->sample_time * c->sample_time);
    return FO_OK;
}

/* ---- square-root information filter -------------------------------------------------- */

/* Information of the prior on state i; wider than configured where it has proved too tight. */
static fo_real prior(const fo_observer *o, const fo_state *s, int i)
{
    const fo_real square = s->prior_scale * s->prior_scale;
    return o->prior[i] / (i < KAPPA ? ONE : i < CC ? square : square * square);
}

/* Only the prior is left; the innovations start at their assumed level. */
static void empty_information(const fo_observer *o, fo_state *s)
{
    for (int i = 0; i < FO_TRIANGLE; i++) {
        s->info.U[i] = ZERO;
    }
    for (int i = 0; i < FO_NX; i++) {
        s->info.d[i] = prior(o, s, i);
        s->info.z[i] = ZERO;
        s->x[i] = ZERO;
    }
    s->innovation = ZERO;
    s->weight = ONE / o->h;
    s->power = s->weight;
    s->lag_one = ZERO;
    s->info.noise[0] = ZERO;
    s->info.noise[1] = ZERO;
    s->info.noise[2] = ZERO;
    s->swept = ZERO;
    s->trusted = 0;
    s->turn = 0;
}

static void restart(const fo_observer *o, fo_state *s)
{
    empty_information(o, s);
    s->have_current = 0;
    s->have_voltage = 0;
    s->exposed = ZERO;
    s->variance = VARIANCE_UNKNOWN; /* what is carried is lost */
}

void fo_reset(const fo_observer *o, fo_state *s)
{
    static const fo_state zero = {0};
    *s = zero;
    s->prior_scale = ONE;
    restart(o, s);
}

/* ---- one interval -------------------------------------------------------------------- */

/* 24 times the mean current over the last interval: the cubic through four samples. */
static fo_real mean_current_24(const fo_state *s, int i)
{
    return (fo_real)9 * s->current[0][i] + (fo_real)19 * s->current[1][i] -
           (fo_real)5 * s->current[2][i] + s->current[3][i];
}

/* The immersion's step over the last interval, x <- F x + b: F depends on q, b is (input, v, 0, 0, 0).
 * docs/theory.md, section 4. Per-unit. */
typedef struct {
    fo_real v[FO_N]; /* volt-seconds */
    fo_real q[FO_N]; /* 2 Q1 v */
    fo_real input;   /* v'Q1v + E'v */
} interval;

/* The resistive drop is still to be taken off unless the source's volt-seconds are `complete`. */
static void last_interval(const fo_observer *o, const fo_state *s, int complete, interval *t)
{
    for (int i = 0; i < FO_N; i++) {
        t->v[i] = s->source[i];
        for (int j = 0; j < FO_N && !complete; j++) {
            t->v[i] -= o->hR[i][j] * mean_current_24(s, j);
        }
    }
    for (int i = 0; i < FO_N; i++) {
        t->q[i] = dot(o->Q1x2[i], t->v);
    }
    t->input = dot(t->q, t->v) / TWO + dot(o->E, t->v);
}

/* U <- U F^-1, d <- rho d, z <- z + U F^-1 b: F(h, v)^-1 = F(-h, -v). */
static void predict(const fo_observer *o, fo_state *s, const interval *t)
{
    const fo_real h = o->h, *v = t->v, *q = t->q;
    fo_real *z = s->info.z;
    fo_real *row = s->info.U;
    { /* the row of s reaches every column */
        fo_real *flux = row, *kappa = flux + FO_N, *drift = kappa + 1, *c = drift + FO_N;
        const fo_real kappa_new = *kappa - h;
        fo_real shift = t->input;
        *c -= h * (*kappa + kappa_new);
        *kappa = kappa_new;
        for (int j = 0; j < FO_N; j++) {
            drift[j] -= h * flux[j] + q[j] * kappa_new;
            flux[j] -= q[j];
            shift += flux[j] * v[j];
        }
        z[S] += shift;
        row = c + 1;
    }
    for (int i = 0; i < FO_N; i++) { /* the rows of the flux, and ... */
        fo_real *flux = row, *kappa = flux + (FO_N - 1 - i), *drift = kappa + 1, *c = drift + FO_N;
        fo_real shift = v[i];
        *c -= TWO * h * *kappa;
        drift[i] -= h;
        for (int j = 0; j < FO_N; j++) {
            drift[j] -= q[j] * *kappa;
        }
        for (int j = i + 1; j < FO_N; j++) {
            drift[j] -= h * flux[j - i - 1];
            shift += flux[j - i - 1] * v[j];
        }
        z[FLUX + i] += shift;
        row = c + 1;
    }
    for (int j = 0; j < FO_N; j++) { /* ... of kappa; what is below is only forgotten */
        row[j] -= q[j];
    }
    row[FO_N] -= TWO * h;

    for (int i = 0; i < FO_NX; i++) {
        s->info.d[i] *= o->rho;
    }
    /* What noise alone pretends to know is carried and forgotten in the same way; it lives on
     * (flux, drift), in each component alike. */
    fo_real *noise = s->info.noise;
    noise[2] = o->rho * (noise[2] - h * (TWO * noise[1] - h * noise[0]));
    noise[1] = o->rho * (noise[1] - h * noise[0]);
    noise[0] = o->rho * noise[0];
}

/* Takes in the row (zero left of `first`) with this weight: Gentleman's rotations without roots.
 * Returns the normalised innovation. The row is used up. */
static fo_real rotate_in(fo_state *s, fo_real row[FO_NX], fo_real rhs, fo_real weight, int first)
{
    fo_real *u = &s->info.U[AT(first, first + 1)];
    for (int i = first; i < FO_NX; i++) {
        const fo_real pivot = row[i], weighted = weight * pivot, d = s->info.d[i];
        const fo_real d_new = d + weighted * pivot, inverse = ONE / d_new;
        const fo_real gain = weighted * inverse;
        weight *= d * inverse;
        s->info.d[i] = d_new;
        for (int j = i + 1; j < FO_NX; j++) {
            row[j] -= pivot * *u;
            *u += gain * row[j];
            u++;
        }
        rhs -= pivot * s->info.z[i];
        s->info.z[i] += gain * rhs;
    }
    return fo_sqrt(weight) * rhs;
}

/* Variance of row'x: |y|^2 / d with U'y = row. The row is used up. */
static fo_real variance_of(const fo_state *s, fo_real row[FO_NX], int first)
{
    const fo_real *u = &s->info.U[AT(first, first + 1)];
    fo_real sum = ZERO;
    for (int i = first; i < FO_NX; i++) {
        sum += row[i] * row[i] / s->info.d[i];
        for (int j = i + 1; j < FO_NX; j++) {
            row[j] -= row[i] * *u++;
        }
    }
    return sum;
}

/* Noise variance of a current component from the last four samples: third differences remove what
 * is smooth and have 20 times the variance. */
static fo_real third_difference(const fo_state *s)
{
    fo_real sum = ZERO;
    for (int i = 0; i < FO_N; i++) {
        const fo_real d = s->current[0][i] - s->current[3][i] +
                          (fo_real)3 * (s->current[2][i] - s->current[1][i]);
        sum += d * d;
    }
    return sum / (fo_real)(20 * FO_N);
}

/* Variance of the current's noise over the assumed one, where it is larger. */
static fo_real roughness(const fo_observer *o, const fo_state *s)
{
    const fo_real ratio = s->rough * o->over_noise;
    return ratio > ONE ? ratio : ONE;
}

/* The measurement 0 = s + (Q2 i)'flux + i'Q3 i + C'i, divided by its noise: row'x = rhs. */
typedef struct {
    fo_real row[FO_NX];
    fo_real rhs;
} measurement;

static void relation(const fo_observer *o, const fo_real current[FO_N], measurement *m)
{
    m->rhs = -dot(o->row_C, current);
    m->row[S] = o->row_s;
    for (int i = 0; i < FO_N; i++) {
        m->row[FLUX + i] = dot(o->row_Q2[i], current);
        m->rhs -= current[i] * dot(o->row_Q3[i], current);
    }
    for (int i = KAPPA; i < FO_NX; i++) {
        m->row[i] = ZERO;
    }
}

/* Is the measurement far from what all samples before say? Seen from before the interval, F'row. */
static int contradicts(const fo_observer *o, const fo_state *s, const interval *t,
                       const measurement *m)
{
    fo_real row[FO_NX];
    const fo_real *flux = &m->row[FLUX];
    const fo_real h = o->h, free = m->row[S], limit = OUTLIER_LIMIT * o->row_s;
    fo_real off = m->rhs - free * t->input - dot(flux, t->v);
    row[S] = free;
    row[KAPPA] = h * free;
    row[CC] = h * row[KAPPA];
    for (int i = 0; i < FO_N; i++) {
        row[FLUX + i] = flux[i] + free * t->q[i];
        row[DRIFT + i] = h * row[FLUX + i];
    }
    for (int i = 0; i < FO_NX; i++) {
        off -= row[i] * s->x[i];
    }
    const fo_real excess = off * off / (limit * limit);
    return !(excess < ONE) && !(excess < ONE + variance_of(s, row, S) / o->rho);
}

static void measure(const fo_observer *o, fo_state *s, measurement *m)
{
    const fo_real e = rotate_in(s, m->row, m->rhs, ONE, S);
    s->power = o->rho * s->power + e * e;
    s->lag_one = o->rho * s->lag_one + e * s->innovation;
    s->weight = o->rho * s->weight + ONE;
    s->innovation = e;
    s->info.noise[0] += o->noise_information * roughness(o, s);
    s->rough += o->h * (third_difference(s) - s->rough);
}

/* ---- read-out ------------------------------------------------------------------------- */

static void stop_tracker(fo_state *s, fo_real theta)
{
    s->angle = theta;
    s->speed = ZERO;
    s->acceleration = ZERO;
}

static void track(const fo_observer *o, fo_state *s, fo_real theta)
{
    const fo_real h = o->sample_time;
    const fo_real step = h * (s->speed + h * s->acceleration / TWO);
    if (!(magnitude(step) <= PI)) { /* faster than the samples can tell */
        stop_tracker(s, theta);
        return;
    }
    const fo_real predicted = wrap(s->angle + step), error = wrap(theta - predicted);
    s->angle = wrap(predicted + o->track[0] * error);
    s->speed += h * s->acceleration + o->track[1] * error;
    s->acceleration += o->track[2] * error;
}

/* U x = z */
static void solve(fo_state *s)
{
    const fo_real *u = &s->info.U[FO_TRIANGLE];
    for (int i = FO_NX - 1; i >= 0; i--) {
        fo_real sum = s->info.z[i];
        for (int j = FO_NX - 1; j > i; j--) {
            sum -= *--u * s->x[j];
        }
        s->x[i] = sum;
    }
}

/* What the information says of the flux, and what of it is only noise. Per-unit. */
typedef struct {
    fo_real P[3];        /* its covariance (11, 12, 22), innovations white and of assumed power */
    fo_real inflation;   /* what coloured innovations of another power make of it               */
    fo_real noise_share;
} certainty;

/* U'y = e_k; the entries of y before k are not written. */
static void row_of_inverse(const fo_state *s, int k, fo_real y[FO_NX])
{
    const fo_real *u = &s->info.U[AT(k, k + 1)];
    for (int j = k; j < FO_NX; j++) {
        y[j] = j == k ? ONE : ZERO;
    }
    for (int i = k; i < FO_NX; i++) {
        for (int j = i + 1; j < FO_NX; j++) {
            y[j] -= y[i] * *u++;
        }
    }
}

static void judge(const fo_state *s, certainty *a)
{
    fo_real y0[FO_NX], y1[FO_NX];
    row_of_inverse(s, FLUX, y0);
    row_of_inverse(s, FLUX + 1, y1);
    a->P[0] = ONE / s->info.d[FLUX];
    a->P[1] = ZERO;
    a->P[2] = ZERO;
    for (int k = FLUX + 1; k < FO_NX; k++) {
        const fo_real inverse = ONE / s->info.d[k], y = y1[k] * inverse;
        a->P[0] += y0[k] * y0[k] * inverse;
        a->P[1] += y0[k] * y;
        a->P[2] += y1[k] * y;
    }
    /* Information that noise pretends to have on the flux when the drift is unknown. */
    const fo_real *noise = s->info.noise;
    fo_real pretended = noise[0];
    if (noise[2] > ZERO) {
        pretended -= noise[1] * noise[1] / noise[2];
    }
    a->noise_share = pretended * (a->P[0] + a->P[2]);

    fo_real r1 = s->power > ZERO ? s->lag_one / s->power : ZERO;
    r1 = r1 < ZERO ? ZERO : r1 > CORRELATION_LIMIT ? CORRELATION_LIMIT : r1;
    a->inflation = s->power / s->weight * (ONE + r1) / (ONE - r1);
}

/* Mean variance of a drift component, as uninflated as P. */
static fo_real drift_variance(const fo_state *s)
{
    fo_real sum = ZERO;
    for (int i = 0; i < FO_N; i++) {
        fo_real row[FO_NX] = {0};
        row[DRIFT + i] = ONE;
        sum += variance_of(s, row, DRIFT + i);
    }
    return sum / (fo_real)FO_N;
}

/* Position vector x = flux - L i. */
static void position(const fo_observer *o, const fo_state *s, const fo_real *flux, fo_real *p)
{
    for (int i = 0; i < FO_N; i++) {
        p[i] = flux[i] - o->L_position * s->current[0][i];
    }
}

/* Variance of the angle of p: covariance across p, and the noise of the current in it. */
static fo_real angle_variance(const fo_observer *o, const fo_state *s, const certainty *a,
                              const fo_real *p, fo_real square)
{
    const fo_real across =
        p[1] * p[1] * a->P[0] - TWO * p[0] * p[1] * a->P[1] + p[0] * p[0] * a->P[2];
    return (a->inflation * across / square + o->position_noise * roughness(o, s)) / square;
}

/* A prior that is wrong is forgotten slowly: widen it, and let what it did count for little. */
static void widen_prior(fo_state *s, fo_real excess)
{
    const fo_real keep = DISTRUST / excess;
    s->prior_scale *= TWO * fo_sqrt(excess);
    for (int i = 0; i < FO_NX; i++) {
        s->info.d[i] *= keep;
    }
    for (int i = 0; i < 3; i++) {
        s->info.noise[i] *= keep;
    }
}

/* Does a voltage error of the plausible size turn the flux by little? It adds up until the rotor
 * has turned by about a radian; a slow turn of the flux leaves no trace in the innovations. */
static int voltage_error_small(const fo_observer *o, fo_state *s)
{
    const fo_real turned = magnitude(s->speed) * o->sample_time;
    s->exposed += o->h - s->exposed * (turned < ONE ? turned : ONE);
    if (!s->trusted) {
        s->exposed = ZERO; /* trust comes with half a turn */
    }
    return s->exposed * o->plausible < VOLTAGE_LIMIT * s->length;
}

/* Carries the last trusted flux on by integration; returns the variance of its angle. It grows
 * with what is not known of the drift and with a voltage error as large as the drift's prior; where
 * the length of the position vector, which should stay, says that the error is larger, with that.
 * Once nothing is known of the angle any more, the flux stays where it is. */
static fo_real carry_on(const fo_observer *o, fo_state *s, const fo_real v[FO_N],
                        const certainty *a)
{
    fo_real p[FO_N], flux[FO_N];
    if (s->carried == ZERO) {
        position(o, s, s->flux, p);
        const fo_real square = dot(p, p);
        s->growth = (a->inflation * drift_variance(s) + o->plausible * o->plausible) / square;
        s->carried_length = fo_sqrt(square);
        s->carried_off = ZERO;
    }
    s->carried += o->h;
    for (int i = 0; i < FO_N; i++) {
        flux[i] = s->flux[i] + v[i] + o->h * s->drift[i];
    }
    position(o, s, flux, p);
    const fo_real off = fo_sqrt(dot(p, p)) / s->carried_length - ONE;
    s->carried_off = off * off > s->carried_off ? off * off : s->carried_off;
    const fo_real variance =
        s->variance + s->growth * s->carried * s->carried + s->carried_off;
    if (!(variance < VARIANCE_UNKNOWN)) {
        return VARIANCE_UNKNOWN;
    }
    for (int i = 0; i < FO_N; i++) {
        s->flux[i] = flux[i];
    }
    return variance;
}

/* One prior row in turn, aimed at the estimate: bounds the standard deviations, moves nothing. */
static void reinject_prior(const fo_observer *o, fo_state *s)
{
    const int j = (int)s->turn / REINJECT_EVERY;
    if ((int)s->turn % REINJECT_EVERY == 0) {
        fo_real row[FO_NX] = {0};
        row[j] = ONE;
        (void)rotate_in(s, row, s->x[j], o->reinject * prior(o, s, j), j);
    }
    s->turn = (s->turn + 1U) % (uint32_t)REINJECT_PERIOD;
}

/* Decides which flux is reported: the least squares' own while it is trusted or nothing better
 * is known, else the last trusted one carried on. See docs/theory.md, section 6. */
static void read_out(const fo_observer *o, fo_state *s, const fo_real v[FO_N], fo_estimate *e)
{
    certainty a;
    fo_real p[FO_N];
    solve(s);
    judge(s, &a);
    const fo_real *flux = &s->x[FLUX], *drift = &s->x[DRIFT];
    position(o, s, flux, p);
    fo_real square = dot(p, p), theta = fo_atan2(p[1], p[0]);

    const int known = a.noise_share < SHARE_LIMIT && square > o->length_min * o->length_min;
    s->swept = known ? s->swept + wrap(theta - s->theta) : ZERO;
    s->theta = theta;
    const fo_real turned = magnitude(s->swept);
    const int trusted = known && (s->trusted || turned > SWEEP);
    s->trusted = trusted ? 1U : 0U;

    /* A covariance with a prior that is too tight in it is too small by as much. */
    const fo_real drift_prior = s->prior_scale * o->plausible;
    const fo_real excess = dot(drift, drift) / (drift_prior * drift_prior);
    a.inflation *= excess > ONE ? excess : ONE;

    fo_real variance = VARIANCE_UNKNOWN;
    if (trusted) {
        variance = angle_variance(o, s, &a, p, square);
        s->variance = variance;
        s->carried = ZERO;
        s->have_carried = 1;
        for (int i = 0; i < FO_N; i++) {
            s->flux[i] = flux[i];
            s->drift[i] = drift[i];
        }
    } else if (s->have_carried) {
        variance = carry_on(o, s, v, &a);
        if (!known || variance < VARIANCE_UNKNOWN) {
            flux = s->flux;
            drift = s->drift;
            position(o, s, flux, p);
            square = dot(p, p);
            theta = fo_atan2(p[1], p[0]);
        }
    }
    s->length = fo_sqrt(square);
    const int lost = !(variance < VARIANCE_UNKNOWN);
    if (lost && !known) {
        stop_tracker(s, theta);
    } else {
        track(o, s, theta);
    }

    for (int i = 0; i < FO_N; i++) {
        e->flux[i] = flux[i] * o->flux_base;
        e->drift[i] = drift[i] * o->drift_base;
    }
    e->psi_f = s->length * o->flux_base;
    e->theta_e = theta;
    e->theta_e_tracked = s->angle;
    e->speed_e = s->speed;
    e->theta_e_std = lost ? STD_UNKNOWN : fo_sqrt(variance);
    e->innovation = s->innovation;
    e->noise_share = a.noise_share;
    const int steady = voltage_error_small(o, s);
    e->valid = trusted && e->theta_e_std < STD_LIMIT && steady;

    if (trusted && excess > ONE && turned > SETTLED) {
        widen_prior(s, excess);
    } else {
        reinject_prior(o, s);
    }
}

/* ---- samples -------------------------------------------------------------------------- */

static void push_current(fo_state *s, const fo_real current[FO_N])
{
    for (int i = 0; i < FO_N; i++) {
        const fo_real newest = current[i];
        for (int k = FO_HISTORY - 1; k > 0; k--) {
            s->current[k][i] = s->have_current ? s->current[k - 1][i] : newest;
        }
        s->current[0][i] = newest;
    }
}

/* Step of the position vector over the last interval, without the drift. */
static fo_real position_step(const fo_observer *o, const fo_state *s, const fo_real v[FO_N])
{
    fo_real step[FO_N];
    for (int i = 0; i < FO_N; i++) {
        step[i] = v[i] - o->L_position * (s->current[0][i] - s->current[1][i]);
    }
    return fo_sqrt(dot(step, step));
}

/* Does the position vector leap? */
static int leaps(const fo_observer *o, const fo_state *s, fo_real step)
{
    return s->trusted && step > TWO * s->step + STEP_LIMIT * s->length +
                                    STEP_NOISE * fo_sqrt(o->position_noise * roughness(o, s));
}

/* One sample; `source` in per-unit volt-seconds, complete or still without the resistive drop. */
static void advance(const fo_observer *o, fo_state *s, const fo_real source[FO_N], int complete,
                    const fo_real current[FO_N], fo_estimate *e)
{
    interval t = {{0}, {0}, 0};
    const int source_finite = finite_vector(source), current_finite = finite_vector(current);
    const fo_real limit = o->current_limit;
    const int absurd =
        (current_finite && !(dot(current, current) <= limit * limit)) ||
        (source_finite && !(dot(source, source) <= FLUX_STEP_LIMIT * FLUX_STEP_LIMIT));
    const int current_good = current_finite && !absurd;
    const int source_missing = !source_finite && s->have_voltage; /* none yet is no fault */
    int bad = !current_finite || source_missing, contradicted = 0;

    s->bad_currents += current_finite ? 0U : 1U;
    s->bad_voltages += source_missing || (!source_finite && s->restarts > 0U) ? 1U : 0U;
    s->absurd += absurd ? 1U : 0U;

    if (!absurd && (current_good || s->have_current)) {
        const int first = !s->have_current;
        push_current(s, current_good ? current : s->current[0]);
        s->have_current = 1;
        if (source_finite && !first) {
            s->have_voltage = 1;
            for (int i = 0; i < FO_N; i++) {
                s->source[i] = source[i];
            }
        }
        if (s->have_voltage) {
            last_interval(o, s, complete, &t);
        } else {
            empty_information(o, s); /* the past cannot be connected to this sample */
        }
        measurement m;
        relation(o, current, &m);
        const fo_real step = position_step(o, s, t.v);
        contradicted = current_good && (leaps(o, s, step) || contradicts(o, s, &t, &m));
        if (contradicted) { /* go over it as if it were missing */
            s->outliers++;
            bad = 1;
            for (int i = 0; i < FO_N; i++) {
                s->current[0][i] = s->current[1][i];
            }
            if (s->have_voltage) {
                last_interval(o, s, complete, &t);
            }
        } else {
            s->step = step;
        }
        if (s->have_voltage) {
            predict(o, s, &t);
        }
        if (current_good && !contradicted) {
            measure(o, s, &m);
        }
    }
    s->consecutive_bad = bad ? s->consecutive_bad + 1U : 0U;
    if (absurd || s->consecutive_bad > FO_MAX_CONSECUTIVE_BAD) {
        s->restarts += absurd || s->consecutive_bad == FO_MAX_CONSECUTIVE_BAD + 1U ? 1U : 0U;
        restart(o, s);
    }
    read_out(o, s, t.v, e);
    e->valid = e->valid && !contradicted;
}

void fo_step(const fo_observer *o, fo_state *s, const fo_real voltage[FO_N],
             const fo_real current[FO_N], fo_estimate *e)
{
    fo_real source[FO_N];
    for (int i = 0; i < FO_N; i++) {
        source[i] = dot(o->hB[i], voltage);
    }
    advance(o, s, source, 0, current, e);
}

void fo_step_volt_seconds(const fo_observer *o, fo_state *s, const fo_real volt_seconds[FO_N],
                          const fo_real current[FO_N], fo_estimate *e)
{
    fo_real source[FO_N];
    for (int i = 0; i < FO_N; i++) {
        source[i] = volt_seconds[i] / o->flux_base;
    }
    advance(o, s, source, 1, current, e);
}
