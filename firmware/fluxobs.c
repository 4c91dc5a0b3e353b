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

/* Element (i, j), i <= j, of a packed upper triangle. */
#define AT(i, j) ((i) * (2 * FO_NX - (i) - 1) / 2 + (j))

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

static fo_real wrap(fo_real angle)
{
    while (angle > PI) {
        angle -= TWO * PI;
    }
    while (angle <= -PI) {
        angle += TWO * PI;
    }
    return angle;
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
    o->root_rho = fo_sqrt(o->rho);
    o->noise_information = q2 / (fo_real)FO_N * c->current_noise * c->current_noise;

    o->prior[S] = ONE;
    o->prior[KAPPA] = ONE / (TWO * drift_prior);
    o->prior[CC] = ONE / (drift_prior * drift_prior);
    for (int i = 0; i < FO_N; i++) {
        o->prior[FLUX + i] = ONE;
        o->prior[DRIFT + i] = ONE / drift_prior;
    }
    /* Each row brings back what forgetting takes until its next turn, 1 - rho^period. */
    fo_real left = ONE;
    for (int i = 0; i < REINJECT_PERIOD; i++) {
        left *= o->rho;
    }
    for (int i = 0; i < FO_NX; i++) {
        o->reinject[i] = fo_sqrt(ONE - left) * o->prior[i];
    }
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

/* How much wider than configured the prior of state i has to be. */
static fo_real prior_scale(const fo_state *s, int i)
{
    return i < KAPPA ? ONE : i < CC ? s->prior_scale : s->prior_scale * s->prior_scale;
}

/* Only the prior is left; the innovations start at their assumed level. */
static void empty_information(const fo_observer *o, fo_state *s)
{
    for (int i = 0; i < FO_TRIANGLE; i++) {
        s->info.R[i] = ZERO;
    }
    for (int i = 0; i < FO_NX; i++) {
        s->info.R[AT(i, i)] = o->prior[i] / prior_scale(s, i);
        s->info.z[i] = ZERO;
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

/* R <- sqrt(rho) R F^-1, z <- sqrt(rho) (z + R F^-1 d): F(h, v)^-1 = F(-h, -v), and d the
 * known input (v'Q1v + E'v, v, 0, 0, 0). docs/theory.md, section 4. */
static void predict(const fo_observer *o, fo_state *s, const fo_real v[FO_N])
{
    const fo_real h = o->h, g = o->root_rho;
    fo_real q[FO_N]; /* 2 Q1 v */
    for (int i = 0; i < FO_N; i++) {
        q[i] = dot(o->Q1x2[i], v);
    }
    const fo_real input = dot(q, v) / TWO + dot(o->E, v);

    { /* the row of s reaches every column */
        fo_real *row = s->info.R;
        const fo_real r_s = row[S], kappa = row[KAPPA], kappa_new = kappa - h * r_s;
        fo_real shift = r_s * input;
        row[CC] = g * (row[CC] - h * (kappa + kappa_new));
        for (int j = 0; j < FO_N; j++) {
            const fo_real flux = row[FLUX + j], flux_new = flux - q[j] * r_s;
            row[DRIFT + j] = g * (row[DRIFT + j] - h * flux - q[j] * kappa_new);
            shift += flux_new * v[j];
            row[FLUX + j] = g * flux_new;
        }
        row[KAPPA] = g * kappa_new;
        row[S] = g * r_s;
        s->info.z[S] = g * (s->info.z[S] + shift);
    }
    for (int i = 0; i < FO_N; i++) { /* the rows of the flux, and ... */
        fo_real *row = &s->info.R[AT(FLUX + i, 0)];
        const fo_real kappa = row[KAPPA];
        fo_real shift = ZERO;
        row[CC] = g * (row[CC] - TWO * h * kappa);
        for (int j = 0; j < i; j++) {
            row[DRIFT + j] = g * (row[DRIFT + j] - q[j] * kappa);
        }
        for (int j = i; j < FO_N; j++) {
            const fo_real flux = row[FLUX + j];
            row[DRIFT + j] = g * (row[DRIFT + j] - h * flux - q[j] * kappa);
            shift += flux * v[j];
            row[FLUX + j] = g * flux;
        }
        row[KAPPA] = g * kappa;
        s->info.z[FLUX + i] = g * (s->info.z[FLUX + i] + shift);
    }
    { /* ... of kappa have nothing left of their diagonals; what is below is only forgotten */
        fo_real *row = &s->info.R[AT(KAPPA, 0)];
        const fo_real kappa = row[KAPPA];
        row[CC] = g * (row[CC] - TWO * h * kappa);
        for (int j = 0; j < FO_N; j++) {
            row[DRIFT + j] = g * (row[DRIFT + j] - q[j] * kappa);
        }
        row[KAPPA] = g * kappa;
        s->info.z[KAPPA] *= g;
    }
    for (int i = AT(DRIFT, DRIFT); i < FO_TRIANGLE; i++) {
        s->info.R[i] *= g;
    }
    for (int i = DRIFT; i < FO_NX; i++) {
        s->info.z[i] *= g;
    }
    /* What noise alone pretends to know is carried and forgotten in the same way; it lives on
     * (flux, drift), in each component alike. */
    s->info.noise[2] = o->rho * (s->info.noise[2] - TWO * h * s->info.noise[1] + h * h * s->info.noise[0]);
    s->info.noise[1] = o->rho * (s->info.noise[1] - h * s->info.noise[0]);
    s->info.noise[0] = o->rho * s->info.noise[0];
}

/* Rotates the row (zero left of `first`) into R x = z; returns the normalised innovation. */
static fo_real rotate_in(fo_state *s, fo_real row[FO_NX], fo_real rhs, int first)
{
    for (int i = first; i < FO_NX; i++) {
        if (row[i] == ZERO) {
            continue;
        }
        fo_real *r = &s->info.R[AT(i, 0)];
        const fo_real square = r[i] * r[i] + row[i] * row[i];
        const fo_real norm = fo_sqrt(square);
        const fo_real inverse = norm * (ONE / square); /* the division need not wait for the root */
        const fo_real cosine = r[i] * inverse, sine = row[i] * inverse;
        r[i] = norm;
        for (int j = i + 1; j < FO_NX; j++) {
            const fo_real old = r[j];
            r[j] = cosine * old + sine * row[j];
            row[j] = cosine * row[j] - sine * old;
        }
        const fo_real old = s->info.z[i];
        s->info.z[i] = cosine * old + sine * rhs;
        rhs = cosine * rhs - sine * old;
    }
    return rhs;
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

/* 0 = s + (Q2 i)'flux + i'Q3 i + C'i, divided by its noise. Returns 0 where that is far from what
 * all samples before say; the information is then spoilt. */
static int measure(const fo_observer *o, fo_state *s, const fo_real current[FO_N])
{
    fo_real row[FO_NX] = {0};
    fo_real rhs = -dot(o->row_C, current);
    row[S] = o->row_s;
    for (int i = 0; i < FO_N; i++) {
        row[FLUX + i] = dot(o->row_Q2[i], current);
        rhs -= current[i] * dot(o->row_Q3[i], current);
    }
    const fo_real e = rotate_in(s, row, rhs, S);
    if (!(e * e < OUTLIER_LIMIT * OUTLIER_LIMIT * o->row_s * o->row_s)) {
        return 0;
    }
    s->power = o->rho * s->power + e * e;
    s->lag_one = o->rho * s->lag_one + e * s->innovation;
    s->weight = o->rho * s->weight + ONE;
    s->innovation = e;
    s->info.noise[0] += o->noise_information * roughness(o, s);
    s->rough += o->h * (third_difference(s) - s->rough);
    return 1;
}

static void solve(const fo_state *s, const fo_real inverse[FO_NX], fo_real x[FO_NX])
{
    for (int i = FO_NX - 1; i >= 0; i--) {
        const fo_real *row = &s->info.R[AT(i, 0)];
        fo_real sum = s->info.z[i];
        for (int j = i + 1; j < FO_NX; j++) {
            sum -= row[j] * x[j];
        }
        x[i] = sum * inverse[i];
    }
}

/* y solves R'y = e_k: the variance of x_k is |y|^2. Entries before k are zero. */
static void whiten(const fo_state *s, const fo_real inverse[FO_NX], int k, fo_real y[FO_NX])
{
    fo_real rest[FO_NX] = {0};
    for (int i = 0; i < k; i++) {
        y[i] = ZERO;
    }
    rest[k] = ONE;
    for (int i = k; i < FO_NX; i++) {
        const fo_real *row = &s->info.R[AT(i, 0)];
        y[i] = rest[i] * inverse[i];
        for (int j = i + 1; j < FO_NX; j++) {
            rest[j] -= row[j] * y[i];
        }
    }
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
    if (!(step <= PI && step >= -PI)) { /* faster than the samples can tell */
        stop_tracker(s, theta);
        return;
    }
    const fo_real error = wrap(theta - wrap(s->angle + step));
    s->angle = wrap(s->angle + step + o->track[0] * error);
    s->speed += h * s->acceleration + o->track[1] * error;
    s->acceleration += o->track[2] * error;
}

/* What R says of the solution, and what of it is only noise. Per-unit. */
typedef struct {
    fo_real inverse[FO_NX]; /* of R's diagonal                                                */
    fo_real x[FO_NX];
    fo_real P[FO_N][FO_N];  /* covariance of the flux, innovations white and of assumed power */
    fo_real inflation;      /* what coloured innovations of another power make of it          */
    fo_real noise_share;
} solution;

static void read_solution(const fo_state *s, solution *a)
{
    fo_real y[FO_N][FO_NX];
    for (int i = 0; i < FO_NX; i++) {
        a->inverse[i] = ONE / s->info.R[AT(i, i)];
    }
    solve(s, a->inverse, a->x);
    fo_real trace = ZERO;
    for (int i = 0; i < FO_N; i++) {
        whiten(s, a->inverse, FLUX + i, y[i]);
        for (int j = 0; j <= i; j++) {
            fo_real sum = ZERO;
            for (int k = FLUX + i; k < FO_NX; k++) {
                sum += y[i][k] * y[j][k];
            }
            a->P[i][j] = sum;
            a->P[j][i] = sum;
        }
        trace += a->P[i][i];
    }
    /* Information that noise pretends to have on the flux when the drift is unknown. */
    fo_real pretended = s->info.noise[0];
    if (s->info.noise[2] > ZERO) {
        pretended -= s->info.noise[1] * s->info.noise[1] / s->info.noise[2];
    }
    a->noise_share = pretended * trace;

    fo_real r1 = s->power > ZERO ? s->lag_one / s->power : ZERO;
    r1 = r1 < ZERO ? ZERO : r1 > CORRELATION_LIMIT ? CORRELATION_LIMIT : r1;
    a->inflation = s->power / s->weight * (ONE + r1) / (ONE - r1);
}

/* Mean variance of a drift component, as uninflated as P. */
static fo_real drift_variance(const fo_state *s, const solution *a)
{
    fo_real sum = ZERO;
    for (int i = 0; i < FO_N; i++) {
        fo_real y[FO_NX];
        whiten(s, a->inverse, DRIFT + i, y);
        for (int k = DRIFT + i; k < FO_NX; k++) {
            sum += y[k] * y[k];
        }
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
static fo_real angle_variance(const fo_observer *o, const fo_state *s, const solution *a,
                              const fo_real *p, fo_real square)
{
    const fo_real across = p[1] * p[1] * a->P[0][0] - TWO * p[0] * p[1] * a->P[0][1] +
                           p[0] * p[0] * a->P[1][1];
    return (a->inflation * across / square + o->position_noise * roughness(o, s)) / square;
}

/* A prior that is wrong is forgotten slowly: widen it, and let what it did count for little. */
static void widen_prior(fo_state *s, fo_real excess)
{
    const fo_real keep = DISTRUST / excess, root = fo_sqrt(keep);
    s->prior_scale *= TWO * fo_sqrt(excess);
    for (int i = 0; i < FO_TRIANGLE; i++) {
        s->info.R[i] *= root;
    }
    for (int i = 0; i < FO_NX; i++) {
        s->info.z[i] *= root;
    }
    for (int i = 0; i < 3; i++) {
        s->info.noise[i] *= keep;
    }
}

/* Does a voltage error of the plausible size turn the flux by little? It adds up until the rotor
 * has turned by about a radian; a slow turn of the flux leaves no trace in the innovations. */
static int voltage_error_small(const fo_observer *o, fo_state *s)
{
    const fo_real speed = s->speed < ZERO ? -s->speed : s->speed;
    const fo_real turned = speed * o->sample_time;
    s->exposed += o->h - s->exposed * (turned < ONE ? turned : ONE);
    if (!s->trusted) {
        s->exposed = ZERO; /* trust comes with half a turn */
    }
    return s->exposed < VOLTAGE_LIMIT * o->prior[DRIFT] * s->length;
}

/* Carries the last trusted flux on by integration; returns the variance of its angle. It grows
 * with what is not known of the drift and with a voltage error as large as the drift's prior; where
 * the length of the position vector, which should stay, says that the error is larger, with that.
 * Once nothing is known of the angle any more, the flux stays where it is. */
static fo_real carry_on(const fo_observer *o, fo_state *s, const fo_real v[FO_N],
                        const solution *a)
{
    fo_real p[FO_N], flux[FO_N];
    if (s->carried == ZERO) {
        position(o, s, s->flux, p);
        const fo_real square = dot(p, p);
        const fo_real plausible = ONE / (o->prior[DRIFT] * o->prior[DRIFT]);
        s->growth = (a->inflation * drift_variance(s, a) + plausible) / square;
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
static void reinject_prior(const fo_observer *o, fo_state *s, const fo_real x[FO_NX])
{
    const int j = (int)s->turn / REINJECT_EVERY;
    if ((int)s->turn % REINJECT_EVERY == 0) {
        const fo_real weight = o->reinject[j] / prior_scale(s, j);
        fo_real row[FO_NX] = {0};
        row[j] = weight;
        (void)rotate_in(s, row, weight * x[j], j);
    }
    s->turn = (s->turn + 1U) % (uint32_t)REINJECT_PERIOD;
}

/* Decides which flux is reported: the least squares' own while it is trusted or nothing better
 * is known, else the last trusted one carried on. See docs/theory.md, section 6. */
static void read_out(const fo_observer *o, fo_state *s, const fo_real v[FO_N], fo_estimate *e)
{
    solution a;
    fo_real p[FO_N];
    read_solution(s, &a);
    const fo_real *flux = &a.x[FLUX], *drift = &a.x[DRIFT];
    position(o, s, flux, p);
    fo_real square = dot(p, p), theta = fo_atan2(p[1], p[0]);

    const int known = a.noise_share < SHARE_LIMIT && square > o->length_min * o->length_min;
    s->swept = known ? s->swept + wrap(theta - s->theta) : ZERO;
    s->theta = theta;
    const fo_real turned = s->swept < ZERO ? -s->swept : s->swept;
    const int trusted = known && (s->trusted || turned > SWEEP);
    s->trusted = trusted ? 1U : 0U;

    /* A covariance with a prior that is too tight in it is too small by as much. */
    const fo_real drift_prior = s->prior_scale / o->prior[DRIFT];
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
        reinject_prior(o, s, a.x);
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

/* 24 times the mean current over the last interval: the cubic through four samples. */
static fo_real mean_current_24(const fo_state *s, int i)
{
    return (fo_real)9 * s->current[0][i] + (fo_real)19 * s->current[1][i] -
           (fo_real)5 * s->current[2][i] + s->current[3][i];
}

/* Per-unit volt-seconds of the last interval; the resistive drop is still to be taken off unless
 * the source's are `complete`. */
static void volt_seconds(const fo_observer *o, const fo_state *s, int complete, fo_real v[FO_N])
{
    for (int i = 0; i < FO_N; i++) {
        v[i] = s->source[i];
        for (int j = 0; j < FO_N && !complete; j++) {
            v[i] -= o->hR[i][j] * mean_current_24(s, j);
        }
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

/* One sample; `source` in per-unit volt-seconds, complete or still without the resistive drop. */
static void advance(const fo_observer *o, fo_state *s, const fo_real source[FO_N], int complete,
                    const fo_real current[FO_N], fo_estimate *e)
{
    fo_real v[FO_N] = {0};
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
        const fo_information before = s->info;
        if (s->have_voltage) {
            volt_seconds(o, s, complete, v);
            predict(o, s, v);
        } else {
            empty_information(o, s); /* the past cannot be connected to this sample */
        }
        const fo_real step = position_step(o, s, v);
        contradicted = current_good && s->trusted &&
                       step > TWO * s->step + STEP_LIMIT * s->length +
                                  STEP_NOISE * fo_sqrt(o->position_noise * roughness(o, s));
        contradicted = contradicted || (current_good && !measure(o, s, current));
        if (contradicted) { /* go over it as if it were missing */
            s->outliers++;
            bad = 1;
            s->info = before;
            for (int i = 0; i < FO_N; i++) {
                s->current[0][i] = s->current[1][i];
            }
            volt_seconds(o, s, complete, v);
            predict(o, s, v);
        } else {
            s->step = step;
        }
    }
    s->consecutive_bad = bad ? s->consecutive_bad + 1U : 0U;
    if (absurd || s->consecutive_bad > FO_MAX_CONSECUTIVE_BAD) {
        s->restarts += absurd || s->consecutive_bad == FO_MAX_CONSECUTIVE_BAD + 1U ? 1U : 0U;
        restart(o, s);
    }
    read_out(o, s, v, e);
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
