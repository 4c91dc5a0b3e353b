/* SPDX-License-Identifier: MIT */
#include "fluxobs_adaptive.h"

#include "fluxobs_candidates.h"
#include "fluxobs_internal.h"

#include <string.h>

/* Order of the filter's state; the resistance error in ohm, the inverter's voltage in volt. */
enum { P_FLUX = 0, P_DRIFT = FO_N, P_PSI = 2 * FO_N, P_R = P_PSI + 1, P_V = P_PSI + 2 };
/* Element (i, j), i < j, of a packed strict upper triangle, column by column. */
#define AT(i, j) ((int)(j) * ((int)(j) - 1) / 2 + (int)(i))
/* The same for the manifold's, row by row. */
#define ROW(i, j) ((int)(i) * (2 * (int)FO_NM - (int)(i) - 3) / 2 + (int)(j) - 1)

/* No real machine satisfies its relation better than this, in flux bases. */
static const fo_real MODEL = (fo_real)0.0015;
/* Lower bound of the residual's power over the assumed. */
static const fo_real LEVEL_LEAST = (fo_real)0.05;
/* Above this the model does not hold: the residual is 30 times what was assumed. */
static const fo_real LEVEL_MOST = (fo_real)1e3;
/* An innovation beyond this many stds is clipped to it. */
static const fo_real CLIP = (fo_real)5;
/* While a phase current is near zero, the inverter's sign is wrong by a good half for a fraction of
 * a millisecond: the square of the first times the second [s]. */
static const fo_real KNEE_TIME = (fo_real)4e-5;
/* This many times the information on the resistance that comes from noise does not count. */
static const fo_real BEYOND = (fo_real)2;
/* Random walk of the drift over that of the flux. */
static const fo_real DRIFT_WALK = (fo_real)0.01;
/* At the start, errors of resistance and inverter are tied to flux and drift as if speed and load
 * had always been the same; this share of their variance is not tied. */
static const fo_real LOOSE = (fo_real)0.1;
/* A parameter that is off its prior by this many of the prior's stds is pulled back to it. */
static const fo_real FAR = (fo_real)3;
/* Memories before a position of the filter is called valid, if resistance and inverter are unknown,
 * and if they are known. */
static const fo_real PROVEN_AFTER = (fo_real)3;
static const fo_real PROVEN_AFTER_KNOWN = (fo_real)0.25;
/* The same if the guard never knows the position, as at low speed. */
static const fo_real PROVEN_ALONE = (fo_real)10;
/* Std of the angle above which linearising makes no sense: 30 degrees. */
static const fo_real STD_LOST = PI / (fo_real)6;
/* Std of the angle above which the filter does not start: 15 degrees. */
static const fo_real STD_START = PI / (fo_real)12;
/* A voltage error of this share of the drift's prior is in no model; a slow turn by it leaves no
 * trace in the residual. */
static const fo_real UNMODELLED = (fo_real)0.05;
/* Bandwidth with which the saliency's part of the derivative is followed, times the memory. */
static const fo_real TILT = (fo_real)10;
/* If a current of this many times its noise turns this many times as fast as the rotor for this
 * many memories, the rotor is not at rest: the filter is wrong. */
static const fo_real LARGE = (fo_real)30;
static const fo_real STANDING_SLOWER = (fo_real)4;
static const fo_real STANDING_MOST = (fo_real)0.2;
/* If filter and guard differ by 20 degrees for three memories, the guard is right. */
static const fo_real DISAGREE = PI / (fo_real)9;
static const fo_real DISAGREE_FOR = (fo_real)3;

/* ---- configuration -------------------------------------------------------------------- */

static bool numbers_in_range(const fo_adaptive *a, const fo_adaptive_config *c)
{
    const fo_real high = (fo_real)1e6;
    bool good = within(a->saliency * a->plain.current_limit, -high, high) &&
                within(a->over_current, (fo_real)1e-9, (fo_real)1e9) &&
                within(a->noise, (fo_real)1e-12, high) && within(c->slow_memory, ZERO, (fo_real)1e9) &&
                within(c->resistance_std, ZERO, (fo_real)1e9) &&
                within(c->inverter_std, ZERO, (fo_real)1e9) &&
                within(c->inverter_voltage, -(fo_real)1e9, (fo_real)1e9);
    for (int i = P_PSI; i < FO_NP; i++) {
        good = good && within(a->walk[i], ZERO, (fo_real)1e18);
    }
    return good && within(a->mean[P_PSI], ZERO, (fo_real)1e3) &&
           within(a->variance[P_PSI], ZERO, (fo_real)1e6);
}

fo_error fo_adaptive_init(fo_adaptive *a, const fo_config *config, const fo_adaptive_config *c)
{
    fo_error found = fo_init(&a->plain, config);
    if (found == FO_OK && !(c->psi_f >= ZERO && c->psi_f_std >= ZERO && c->resistance_std >= ZERO &&
                            c->inverter_std >= ZERO && c->inverter_current > ZERO &&
                            c->slow_memory > ZERO)) {
        found = FO_ERROR_BASE;
    }
    if (found == FO_OK) {
        const fo_observer *o = &a->plain;
        const fo_real psi = config->flux_base, volt_seconds = config->sample_time / psi;
        const fo_real through_L =
            (config->L_position + c->saliency) * config->current_noise / psi;
        const fo_real stds[3] = {c->psi_f_std / psi, c->resistance_std, c->inverter_std};
        a->saliency = c->saliency / psi;
        a->charge = volt_seconds / (fo_real)24;
        a->over_current = ONE / c->inverter_current;
        a->knee = (fo_real)FO_NP * KNEE_TIME * volt_seconds / psi;
        a->projection = c->projection;
        a->noise = through_L * through_L + MODEL * MODEL;
        /* current noise also enters through the resistance */
        fo_real drop = ZERO;
        for (int i = 0; i < FO_N; i++) {
            drop += config->R[i][i] * config->sample_time * config->current_noise / (psi * TWO);
        }
        a->through_R = (fo_real)FO_NP * drop * drop;
        a->decoy = config->sample_time * config->current_noise / psi;
        for (int i = 0; i < FO_NP; i++) {
            a->mean[i] = ZERO;
        }
        a->mean[P_PSI] = c->psi_f / psi;
        a->mean[P_V] = c->inverter_voltage;
        for (int i = 0; i < FO_N; i++) {
            a->variance[P_FLUX + i] = ONE;
            a->variance[P_DRIFT + i] = o->plausible * o->plausible;
            /* follows the flux with the memory, whatever the noise */
            a->walk[P_FLUX + i] = (fo_real)FO_NP * a->noise * o->h * o->h;
            a->walk[P_DRIFT + i] = DRIFT_WALK * a->walk[P_FLUX + i];
        }
        for (int i = 0; i < 3; i++) {
            a->variance[P_PSI + i] = stds[i] * stds[i];
            a->walk[P_PSI + i] =
                (fo_real)FO_NP * a->variance[P_PSI + i] * config->sample_time / c->slow_memory;
        }
        found = numbers_in_range(a, c) ? FO_OK : FO_ERROR_RANGE;
    }
    return found;
}

static void forget(const fo_adaptive *a, fo_adaptive_state *s)
{
    (void)memset(s->U, 0, sizeof s->U);
    for (int i = 0; i < FO_NP; i++) {
        s->p[i] = a->mean[i];
        s->D[i] = a->variance[i];
    }
}

void fo_adaptive_reset(const fo_adaptive *a, fo_adaptive_state *s)
{
    (void)memset(s, 0, sizeof *s);
    fo_reset(&a->plain, &s->plain);
    forget(a, s);
    s->x[0] = ONE;
    s->random = 0x2545F491U;
    fo_candidates_sow(a, s);
}

/* ---- covariance U D U' ---------------------------------------------------------------- */

static void zero(fo_real x[FO_NP])
{
    for (int i = 0; i < FO_NP; i++) {
        x[i] = ZERO;
    }
}

/* Updates the decoy as if it were the column of the resistance. Its parameter does not exist: the
 * information on it is what current noise seems to tell about the resistance. */
static void update_decoy(fo_adaptive_state *s, const fo_real row[FO_NP], const fo_real gain[FO_NP],
                         fo_real alpha)
{
    fo_real f = ZERO;
    for (int i = 0; i < FO_NM; i++) {
        f += row[i] * s->decoy[i];
    }
    const fo_real back = f / alpha;
    for (int i = 0; i < FO_NM; i++) {
        s->decoy[i] -= gain[i] * back;
    }
    s->decoy_told = f * f;
}

/* Bierman's update with row'p, which is `off` from what it should be, and noise of this variance.
 * Returns the variance of the innovation. */
static fo_real update(fo_adaptive_state *s, const fo_real row[FO_NP], fo_real off, fo_real noise)
{
    fo_real gain[FO_NP], alpha = noise;
    fo_real *u = s->U;
    for (int j = 0; j < FO_NP; j++) {
        fo_real f = row[j];
        if (j == (int)P_R) {
            update_decoy(s, row, gain, alpha);
        }
        for (int i = 0; i < j; i++) {
            f += u[i] * row[i];
        }
        if (j == (int)P_R) {
            s->told = f * f;
        }
        const fo_real v = s->D[j] * f, before = alpha;
        alpha += v * f;
        const fo_real back = f / before;
        s->D[j] *= before / alpha;
        for (int i = 0; i < j; i++) {
            const fo_real old = *u;
            *u = old - gain[i] * back;
            u++;
            gain[i] += old * v;
        }
        gain[j] = v;
    }
    const fo_real most = CLIP * fo_sqrt(alpha);
    const fo_real step = (off > most ? most : off < -most ? -most : off) / alpha;
    for (int j = 0; j < FO_NP; j++) {
        s->p[j] += gain[j] * step;
    }
    return alpha;
}

/* Adds variance to one state (Agee and Turner). */
static void widen(fo_adaptive_state *s, int n, fo_real variance)
{
    fo_real column[FO_NP], left = variance;
    zero(column);
    column[n] = ONE;
    for (int j = n; j >= 0; j--) {
        const fo_real pivot = column[j], d_new = s->D[j] + left * pivot * pivot;
        if (pivot != ZERO && d_new > ZERO) {
            fo_real *u = &s->U[AT(0, j)];
            const fo_real over = left * pivot / d_new;
            left *= s->D[j] / d_new;
            s->D[j] = d_new;
            for (int i = 0; i < j; i++) {
                column[i] -= pivot * u[i];
                u[i] += over * column[i];
            }
        }
    }
}

static fo_real variance_of(const fo_adaptive_state *s, int n)
{
    fo_real sum = s->D[n];
    for (int j = n + 1; j < FO_NP; j++) {
        const fo_real u = s->U[AT(n, j)];
        sum += u * u * s->D[j];
    }
    return sum;
}

/* Variance of the flux across a direction. */
static fo_real variance_across(const fo_adaptive_state *s, const fo_real along[FO_N])
{
    fo_real sum = s->D[0] * along[1] * along[1];
    for (int j = 1; j < FO_NP; j++) {
        const fo_real second = j == 1 ? ONE : s->U[AT(1, j)];
        const fo_real y = along[0] * second - along[1] * s->U[AT(0, j)];
        sum += s->D[j] * y * y;
    }
    return sum;
}

/* ---- inverter ------------------------------------------------------------------------- */

/* tanh(x) to within 0.0014: its Pade approximant, clipped where that reaches 1. */
static fo_real soft_sign(fo_real x)
{
    const fo_real square = x * x;
    fo_real sign = x > ZERO ? ONE : -ONE;
    if (square < (fo_real)13.298) {
        sign = x * ((fo_real)945 + square * ((fo_real)105 + square)) /
               ((fo_real)945 + square * ((fo_real)420 + (fo_real)15 * square));
    }
    return sign;
}

/* Amplitude-invariant vector of the signs of the phase currents; returns how unsure they are, 0 to
 * 3. */
static fo_real direction(const fo_adaptive *a, const fo_real current[FO_N], fo_real signs[FO_N])
{
    const fo_real half = current[0] / TWO, root = (fo_real)0.8660254037844386 * current[1];
    const fo_real phases[3] = {
        soft_sign(current[0] * a->over_current), soft_sign((root - half) * a->over_current),
        soft_sign((-root - half) * a->over_current)};
    fo_real unsure = ZERO;
    for (int i = 0; i < 3; i++) {
        const fo_real knee = ONE - phases[i] * phases[i];
        unsure += knee * knee;
    }
    signs[0] = (TWO * phases[0] - phases[1] - phases[2]) / (fo_real)3;
    signs[1] = (phases[1] - phases[2]) * (fo_real)0.5773502691896258;
    return unsure;
}

/* ---- the filter ----------------------------------------------------------------------- */

/* Effects of an interval: its volt-seconds, and those of one ohm and of one inverter volt. */
typedef struct {
    fo_real v[FO_N];
    fo_real charge[FO_N];
    fo_real before[FO_N]; /* charge of the interval before, turned on to this one: this sample's
                             noise is in the residual too; in both it would pass for a resistance */
    fo_real inverter[FO_N];
    fo_real unsure; /* of the inverter's signs, 0 to 3 */
} effects;

/* At least a radian per memory: if slower, nothing can be told from the drift. */
static fo_real turned_in_a_sample(const fo_adaptive *a, const fo_adaptive_state *s)
{
    const fo_real h = a->plain.h, speed = a->plain.sample_time * s->tracker.speed;
    return fo_abs(speed) > h ? speed : speed < ZERO ? -h : h;
}

/* How far from steady state the past may have been: less, the more turns there are in a memory. */
static fo_real looseness(const fo_adaptive *a, fo_real turned)
{
    return LOOSE / (ONE + fo_abs(turned) / (a->plain.h * TWO * PI));
}

/* Variance of a candidate's angle, with unknown errors of resistance and inverter. */
static fo_real tied_variance(const fo_adaptive *a, const fo_adaptive_state *s,
                             const fo_candidate *c)
{
    const fo_real *current = s->plain.current[0];
    const fo_real turned = turned_in_a_sample(a, s), scale = (fo_real)24 * a->charge / turned;
    fo_real x[FO_N], signs[FO_N];
    for (int i = 0; i < FO_N; i++) {
        x[i] = c->p[i] - a->plain.L_position * current[i];
    }
    const fo_real square = dot(x, x);
    (void)direction(a, current, signs);
    const fo_real *causes[2] = {current, signs};
    fo_real variance = c->variance;
    for (int k = 0; k < 2; k++) {
        const fo_real across = scale * dot(causes[k], x); /* what was along x is across it */
        const fo_real all = scale * scale * dot(causes[k], causes[k]);
        const fo_real off = across * across / square + looseness(a, turned) * all;
        variance += s->D[P_R + k] * off / square;
    }
    return variance;
}

/* Ties errors of resistance and inverter to flux, drift and magnet flux, assuming steady state:
 * they shift the flux by -i / (j omega), and lengthen the magnet flux by the part of that along
 * it. */
static void tie(const fo_adaptive *a, fo_adaptive_state *s, const fo_real along[FO_N],
                fo_real length, fo_real psi_before, fo_real psi_variance)
{
    const fo_observer *o = &a->plain;
    const fo_real *current = s->plain.current[0];
    const fo_real turned = turned_in_a_sample(a, s);
    const fo_real i_along = dot(along, current);
    fo_real signs[FO_N], lengthens[FO_N];
    for (int i = 0; i < FO_N; i++) {
        lengthens[i] = along[i] - a->saliency * (current[i] - i_along * along[i]) / length;
    }
    (void)direction(a, current, signs);
    const fo_real *causes[2] = {current, signs};
    for (int k = 0; k < 2; k++) {
        const int n = P_R + k;
        fo_real *u = &s->U[AT(0, n)];
        const fo_real scale = (fo_real)24 * a->charge / turned;
        const fo_real both = k == 1 ? s->U[AT(P_R, P_V)] : ZERO;
        const fo_real *other = &s->U[AT(0, P_R)];
        const fo_real d[FO_N] = {-scale * causes[k][1], scale * causes[k][0]};
        const fo_real loose = looseness(a, turned) * dot(d, d) * s->D[n];
        const fo_real off = s->p[n] - a->mean[n]; /* learnt before; not known to the candidate */
        fo_real longer = ZERO;
        for (int i = 0; i < FO_N; i++) {
            u[P_FLUX + i] = d[i] + both * other[P_FLUX + i];
            u[P_DRIFT + i] = ZERO;
            longer += lengthens[i] * d[i];
            s->p[P_FLUX + i] += d[i] * off;
            s->D[P_FLUX + i] += loose;
            s->D[P_DRIFT + i] += loose * turned * turned / (o->h * o->h);
        }
        u[P_PSI] = ZERO;
        if (s->D[P_PSI] > ZERO) {
            u[P_PSI] = longer + both * other[P_PSI];
            s->p[P_PSI] += longer * off;
            s->D[P_PSI] += loose;
        }
    }
    if (psi_variance > ZERO && s->D[P_R] + s->D[P_V] > ZERO) { /* else the candidate has it */
        fo_real row[FO_NP];
        zero(row);
        row[P_PSI] = ONE;
        (void)update(s, row, psi_before - s->p[P_PSI], psi_variance);
    }
}

/* Starts the filter at a candidate, with the covariance of its projection: U D U' is the inverse of
 * the information U'dU. What was learnt about resistance and inverter before is kept. */
static void start(const fo_adaptive *a, fo_adaptive_state *s, const fo_candidate *c,
                  const fo_manifold *m, fo_real inflation)
{
    const fo_real psi_before = s->p[P_PSI], psi_variance = variance_of(s, P_PSI);
    const fo_real root = psi_variance > ZERO ? fo_sqrt(c->p[P_PSI]) : ZERO;
    const fo_real *current = s->plain.current[0];
    fo_real x[FO_N];
    for (int i = 0; i < FO_N; i++) {
        x[i] = c->p[i] - a->plain.L_position * current[i];
    }
    const fo_real length = fo_sqrt(dot(x, x));
    const fo_real along[FO_N] = {x[0] / length, x[1] / length};

    for (int j = 0; j < FO_NM; j++) {
        /* the manifold has the square of the magnet flux, the filter the magnet flux itself */
        const fo_real scale = j == (int)P_PSI ? TWO * root : ONE;
        fo_real column[FO_NP];
        zero(column);
        column[j] = scale;
        for (int i = j - 1; i >= 0; i--) {
            for (int k = i + 1; k <= j; k++) {
                column[i] -= m->U[ROW(i, k)] * column[k];
            }
            s->U[AT(i, j)] = column[i];
        }
        const fo_real information = m->d[j] * scale * scale;
        s->D[j] = information > ZERO ? inflation / information : ZERO;
        s->p[j] = c->p[j];
    }
    s->p[P_PSI] = psi_variance > ZERO ? root - a->saliency * dot(along, current) : psi_before;
    s->running = true;
    s->power = ONE / a->plain.h;
    s->lag_one = ZERO;
    s->innovation = ZERO;
    s->level = ONE;
    s->disagree = ZERO;
    s->agreed = false;
    s->alpha = ZERO;
    s->tells = ZERO;
    s->pretends = ZERO;
    (void)memset(s->decoy, 0, sizeof s->decoy);
    s->settled = ZERO;
    s->exposed = ZERO;
    s->turning = ZERO;
    s->standing = ZERO;
    s->swept = ZERO;
    s->tracker.settled = ZERO;
    s->x[0] = along[0];
    s->x[1] = along[1];
    s->theta = c->theta;
    s->candidates[0] = *c;
    tie(a, s, along, length, psi_before, psi_variance);
}

/* Moves the decoy over an interval, like the column of the resistance, but driven by numbers of the
 * size of the current's noise with random signs (xorshift), in place of the current. */
static void drive_decoy(const fo_adaptive *a, fo_adaptive_state *s)
{
    const fo_real noise = a->decoy * fo_sqrt(s->plain.roughness), h = a->plain.h;
    uint32_t x = s->random;
    x ^= x << 13U;
    x ^= x >> 17U;
    x ^= x << 5U;
    s->random = x;
    const uint32_t signs[FO_N] = {x & 0x100U, x & 0x10000U};
    for (int i = 0; i < FO_N; i++) {
        s->decoy[i] += h * s->decoy[P_DRIFT + i] + (signs[i] != 0U ? noise : -noise);
    }
}

/* Moves p and its covariance over an interval; one state in turn gains its random walk. */
static void time_update(const fo_adaptive *a, fo_adaptive_state *s, const effects *t)
{
    const fo_real h = a->plain.h;
    for (int k = P_DRIFT; k < FO_NP; k++) { /* column by column, U <- F U */
        fo_real *u = &s->U[AT(0, k)];
        for (int i = 0; i < FO_N; i++) {
            const int drift = P_DRIFT + i;
            u[i] += k == drift ? h : k > drift ? h * u[drift] : ZERO;
        }
    }
    for (int i = 0; i < FO_N; i++) {
        s->U[AT(i, P_R)] -= t->before[i];
        s->U[AT(i, P_V)] -= t->before[i] * s->U[AT(P_R, P_V)] + t->inverter[i];
        s->p[i] += t->v[i] + h * s->p[P_DRIFT + i] - s->p[P_R] * t->charge[i] -
                   (s->p[P_V] - a->mean[P_V]) * t->inverter[i];
    }
    const uint32_t round = s->turn % (uint32_t)FO_NP;
    const int n = (int)round;
    fo_real won = ZERO;
    if (a->variance[n] > ZERO) {
        const fo_real room = ONE - variance_of(s, n) / a->variance[n];
        won = room > ZERO ? a->walk[n] * room * (n < (int)P_PSI ? s->level : ONE) : ZERO;
    }
    if (n < (int)P_DRIFT) {
        won += a->through_R * s->plain.roughness;
        won += a->knee * s->p[P_V] * s->p[P_V] * t->unsure;
    }
    if (won > ZERO) {
        widen(s, n, won);
    }
}

/* Takes in the residual |x| - saliency i_d - psi_f. Its derivative is taken in the direction that
 * the tracker predicts: this sample's noise in it would count as information. */
static void measurement_update(const fo_adaptive *a, fo_adaptive_state *s,
                               const fo_real x[FO_N], fo_real length)
{
    const fo_real *i = s->plain.current[0];
    const fo_real i_along = dot(x, i) / length;
    const fo_real off = length - a->saliency * i_along - s->p[P_PSI];
    fo_real along[FO_N] = {x[0] / length, x[1] / length}, row[FO_NP];
    zero(row);
    if (s->tracker.settled >= TRACKER_SETTLED) {
        const fo_real ahead = wrap(s->tracker.angle - s->theta) +
                              a->plain.sample_time * s->tracker.speed;
        if (fo_abs(ahead) < PI / TWO) {
            turn(s->x, ahead, along);
        }
    }
    /* the saliency's part lies across; its noise would count as information as well */
    const fo_real tilt = a->saliency * (along[0] * i[1] - along[1] * i[0]) / length;
    const fo_real follow = TILT * a->plain.h;
    s->tilt += (s->settled > ZERO && follow < ONE ? follow : ONE) * (tilt - s->tilt);
    row[P_FLUX] = along[0] + s->tilt * along[1];
    row[P_FLUX + 1] = along[1] - s->tilt * along[0];
    row[P_PSI] = -ONE;
    /* second order: uncertainty across lengthens the vector */
    const fo_real across = variance_across(s, along);
    const fo_real curve = across / (TWO * length);
    const fo_real noise = a->noise * s->level + TWO * curve * curve;
    const fo_real resistance = s->p[P_R], variance = s->D[P_R];
    const fo_real alpha = update(s, row, curve - off, noise);
    /* for the resistance, take only what is beyond noise */
    s->tells += a->plain.h * (s->told / alpha - s->tells);
    s->pretends += a->plain.h * (s->decoy_told / alpha - s->pretends);
    const fo_real beyond = s->tells - BEYOND * s->pretends;
    const fo_real share = beyond > ZERO ? beyond / s->tells : ZERO;
    s->p[P_R] = resistance + share * (s->p[P_R] - resistance);
    s->D[P_R] = variance + share * (s->D[P_R] - variance);
    s->alpha = alpha;

    const fo_real most = CLIP * fo_sqrt(s->level);
    const fo_real e = off * fo_sqrt(s->level / alpha);
    const fo_real taken = e > most ? most : e < -most ? -most : e;
    s->power = a->plain.rho * s->power + taken * taken;
    s->lag_one = a->plain.rho * s->lag_one + taken * s->innovation;
    s->innovation = taken;
    const fo_real level = s->power * a->plain.h;
    s->level = level > LEVEL_LEAST ? level : LEVEL_LEAST;
}

/* Pulls a parameter that has gone far from its prior back to it. */
static void remind(const fo_adaptive *a, fo_adaptive_state *s)
{
    const uint32_t round = s->turn % 3U;
    const int n = P_PSI + (int)round;
    const fo_real off = a->mean[n] - s->p[n];
    if (off * off > FAR * FAR * a->variance[n] && a->variance[n] > ZERO) {
        fo_real row[FO_NP];
        zero(row);
        row[n] = ONE;
        (void)update(s, row, off, a->variance[n]);
    }
}

/* Are resistance and inverter known? */
static bool knows_voltage(const fo_adaptive *a)
{
    return !(a->variance[P_R] + a->variance[P_V] > ZERO);
}

/* Has it run for long enough to be believed? */
static bool proven(const fo_adaptive *a, const fo_adaptive_state *s)
{
    const fo_real least = knows_voltage(a) ? PROVEN_AFTER_KNOWN
                          : s->agreed      ? PROVEN_AFTER
                                           : PROVEN_ALONE;
    return fo_abs(s->swept) > SWEEP && s->settled > least;
}

/* Is the estimate finite, and the flux one that a machine can have? */
static bool sound(const fo_adaptive_state *s)
{
    fo_real sum = s->alpha + s->power + s->lag_one + s->tracker.speed + s->tracker.acceleration;
    for (int i = 0; i < FO_NP; i++) {
        sum += s->p[i];
    }
    return sum - sum == ZERO && s->p[0] * s->p[0] + s->p[1] * s->p[1] < RUNAWAY;
}

/* Watches for a current that turns while the rotor is said to stand. If the resistance is large
 * enough, its drop is the whole voltage, and cannot be told from an EMF that turns with the
 * current. */
static void look_at_current(const fo_adaptive *a, fo_adaptive_state *s)
{
    const fo_observer *o = &a->plain;
    const fo_real *now = s->plain.current[0], *before = s->plain.current[1];
    const fo_real square = dot(now, now);
    const fo_real noise = LARGE * LARGE * o->position_noise * s->plain.roughness;
    const bool large = square * o->L_position * o->L_position > noise;
    const fo_real step = large ? (before[0] * now[1] - before[1] * now[0]) / square : ZERO;
    s->turning += (o->h < ONE ? o->h : ONE) * (step - s->turning);
    const fo_real rotor = fo_abs(s->tracker.speed) * o->sample_time * STANDING_SLOWER;
    const fo_real least = rotor > o->h ? rotor : o->h;
    s->standing = fo_abs(s->turning) > least ? s->standing + o->h : ZERO;
}

/* Decides whether the filter has to give way. */
static void watch(const fo_adaptive *a, fo_adaptive_state *s, const fo_real v[FO_N],
                  fo_real plain_theta, bool plain_valid, fo_real variance)
{
    fo_real guard = plain_theta;
    bool known = plain_valid;
    if (a->projection == FO_PROJECT_ALWAYS) {
        fo_manifold information;
        fo_candidate *c = &s->candidates[0];
        for (int i = 0; i < FO_N; i++) {
            c->p[P_FLUX + i] += v[i] + a->plain.h * c->p[P_DRIFT + i];
        }
        fo_project(a, s, c, &information);
        guard = c->theta;
        known = c->variance < STD_LIMIT * STD_LIMIT &&
                s->plain.info.noise[0] * c->variance * c->p[P_PSI] < ONE / TWO;
    }
    const fo_real apart = fo_abs(wrap(s->theta - guard));
    const bool off = known && apart > DISAGREE;
    s->agreed = known ? apart < DISAGREE / TWO : s->agreed;
    s->disagree = off ? s->disagree + a->plain.h : ZERO;
    const bool overruled = s->disagree > DISAGREE_FOR || s->standing > DISAGREE_FOR;
    const bool misfit = s->level > LEVEL_MOST;
    if (overruled || misfit) {
        s->restarts++;
        forget(a, s);
        fo_candidates_sow(a, s);
    } else if (!(variance < STD_LOST * STD_LOST)) {
        if (!proven(a, s)) { /* what was learnt meanwhile is of little worth */
            forget(a, s);
        }
        fo_candidates_sow(a, s);
    } else {
        /* it goes on */
    }
}

/* Writes the estimate of the filter, whose position vector has this length and whose angle this
 * std. Returns false, and keeps the plain observer's position, if a number overflows. States do not
 * show that: an example is the variance of a parameter with a scale of its own. */
static bool report(const fo_adaptive *a, const fo_adaptive_state *s, fo_real length, fo_real std,
                   fo_real coloured, fo_adaptive_estimate *e)
{
    const fo_observer *o = &a->plain;
    fo_estimate *q = &e->position;
    const fo_real psi = length * o->flux_base;
    const fo_real drift[FO_N] = {s->p[P_DRIFT] * o->drift_base, s->p[P_DRIFT + 1] * o->drift_base};
    e->psi_f = s->p[P_PSI] * o->flux_base;
    e->psi_f_std = fo_sqrt(variance_of(s, P_PSI) * coloured) * o->flux_base;
    e->drift_std = fo_sqrt(variance_of(s, P_DRIFT) * coloured) * o->drift_base;
    e->resistance_std = fo_sqrt(variance_of(s, P_R) * coloured);
    e->inverter_std = fo_sqrt(variance_of(s, P_V) * coloured);
    const fo_real sum = psi + drift[0] + drift[1] + s->tracker.speed + e->psi_f + e->psi_f_std +
                        e->drift_std + e->resistance_std + e->inverter_std;
    const bool good = sum - sum == ZERO, known = proven(a, s);
    if (good && (known || !q->valid)) { /* until then the plain observer's, if that is valid */
        for (int i = 0; i < FO_N; i++) {
            q->flux[i] = s->p[P_FLUX + i] * o->flux_base;
            q->drift[i] = drift[i];
        }
        q->psi_f = psi;
        q->theta_e = s->theta;
        q->theta_e_tracked = s->tracker.angle;
        q->speed_e = s->tracker.speed;
        q->theta_e_std = std;
        q->innovation = s->innovation;
        q->noise_share = ZERO;
        q->valid = s->tracker.settled >= TRACKER_SETTLED && std < STD_LIMIT &&
                   s->standing < STANDING_MOST;
    }
    q->valid = q->valid && (known || !good);
    e->theta_other = q->theta_e;
    e->weight_other = ZERO;
    return good;
}

/* Writes what the estimate holds while the filter does not run. */
static void report_prior(const fo_adaptive *a, const fo_adaptive_state *s, fo_adaptive_estimate *e)
{
    e->adapting = false;
    e->theta_other = e->position.theta_e;
    e->weight_other = e->position.valid ? ZERO : ONE / TWO;
    e->psi_f = e->position.psi_f;
    e->psi_f_std = fo_sqrt(variance_of(s, P_PSI)) * a->plain.flux_base;
    e->drift_std = a->plain.plausible * a->plain.drift_base;
    e->resistance_std = fo_sqrt(variance_of(s, P_R));
    e->inverter_std = fo_sqrt(variance_of(s, P_V));
}

/* Numbers have run away: restarts, and keeps the plain observer's estimate. */
static void give_up(const fo_adaptive *a, fo_adaptive_state *s, fo_adaptive_estimate *e)
{
    s->restarts++;
    forget(a, s);
    fo_candidates_sow(a, s);
    report_prior(a, s, e);
}

static fo_real position_square(const fo_adaptive *a, const fo_adaptive_state *s, fo_real x[FO_N])
{
    for (int i = 0; i < FO_N; i++) {
        x[i] = s->p[P_FLUX + i] - a->plain.L_position * s->plain.current[0][i];
    }
    return dot(x, x);
}

/* The rest of a sample, if the filter's numbers are sound. */
static void conclude(const fo_adaptive *a, fo_adaptive_state *s, const fo_real x[FO_N],
                     fo_real square, const fo_real v[FO_N], fo_adaptive_estimate *e)
{
    const fo_observer *o = &a->plain;
    /* Coloured innovations make a variance larger. */
    const fo_real r = correlation(s->lag_one, s->power);
    const fo_real coloured = (ONE + r) / (ONE - r);
    const fo_real length = fo_sqrt(square), theta = fo_atan2(x[1], x[0]);
    fo_real variance = VARIANCE_UNKNOWN, across = ZERO;
    if (square > o->square_min) {
        const fo_real turned = fo_abs(s->tracker.speed) * o->sample_time;
        s->exposed += UNMODELLED * o->h * o->plausible / length -
                      s->exposed * (turned < ONE ? turned : ONE);
        s->x[0] = x[0] / length;
        s->x[1] = x[1] / length;
        across = variance_across(s, s->x) * coloured;
        variance = (across + o->position_noise * s->plain.roughness) / square +
                   s->exposed * s->exposed;
    }
    const fo_real std = fo_sqrt(variance < VARIANCE_UNKNOWN ? variance : VARIANCE_UNKNOWN);
    const fo_real plain_theta = e->position.theta_e;
    const bool plain_valid = e->position.valid;
    s->swept += wrap(theta - s->theta);
    s->theta = theta;
    s->settled += o->h;
    track(o, &s->tracker, theta);
    settle_tracker(o, &s->tracker, theta, std);
    look_at_current(a, s);
    bool good = across - across == ZERO;
    if (good) {
        good = report(a, s, length, std, coloured, e);
    }
    if (good) {
        watch(a, s, v, plain_theta, plain_valid, variance);
    } else {
        give_up(a, s, e);
    }
}

static void run(const fo_adaptive *a, fo_adaptive_state *s, const effects *t, bool measured,
                fo_adaptive_estimate *e)
{
    fo_real x[FO_N];
    drive_decoy(a, s);
    time_update(a, s, t);
    fo_real square = position_square(a, s, x);
    if (measured && square > a->plain.square_min) {
        measurement_update(a, s, x, fo_sqrt(square));
        remind(a, s);
        square = position_square(a, s, x);
    }
    if (sound(s)) {
        conclude(a, s, x, square, t->v, e);
    } else {
        give_up(a, s, e);
    }
}

/* ---- the start ------------------------------------------------------------------------ */

static void begin(const fo_adaptive *a, fo_adaptive_state *s, const effects *t,
                  fo_adaptive_estimate *e)
{
    const fo_observer *o = &a->plain;
    fo_estimate *q = &e->position;
    fo_choice choice;
    if (a->projection != FO_PROJECT_NEVER) {
        fo_candidates_step(a, s, t->v, &choice);
        e->weight_other = choice.weight;
        if (choice.found && choice.weight < ONE / TWO) {
            e->theta_other = choice.other;
        }
        if (s->plain.trusted) { /* it assumes known resistance and inverter */
            const fo_real off = knows_voltage(a) ? ZERO : s->disturbance * s->disturbance;
            const fo_real all = q->theta_e_std * q->theta_e_std + off;
            q->theta_e_std = fo_sqrt(all < VARIANCE_UNKNOWN ? all : VARIANCE_UNKNOWN);
            q->valid = q->valid && q->theta_e_std < STD_LIMIT;
        } else if (choice.found) {
            fo_real variance = choice.best.variance;
            const fo_real apart = wrap(choice.other - choice.best.theta);
            variance += choice.weight * apart * apart;
            q->theta_e = choice.best.theta;
            q->theta_e_tracked = s->tracker.angle;
            q->speed_e = s->tracker.speed;
            q->theta_e_std = fo_sqrt(variance < VARIANCE_UNKNOWN ? variance : VARIANCE_UNKNOWN);
            for (int i = 0; i < FO_N; i++) {
                q->flux[i] = choice.best.p[i] * o->flux_base;
                q->drift[i] = choice.best.p[FO_N + i] * o->drift_base;
            }
            q->psi_f = fo_sqrt(choice.best.p[2 * FO_N]) * o->flux_base;
            q->valid = false;
        } else {
            /* nothing is known */
        }
        if (choice.decided && tied_variance(a, s, &choice.best) < STD_START * STD_START) {
            start(a, s, &choice.best, &choice.information, choice.inflation);
        }
    } else if (s->plain.trusted) {
        fo_manifold information;
        fo_candidate c;
        c = s->candidates[0];
        const fo_real power = s->plain.power * o->h;
        for (int i = 0; i < FO_N; i++) {
            c.p[i] = s->plain.x[FLUX + i];
            c.p[FO_N + i] = s->plain.x[DRIFT + i];
        }
        s->tracker = s->plain.tracker;
        fo_project(a, s, &c, &information);
        if (c.variance < STD_START * STD_START) {
            start(a, s, &c, &information, power > ONE ? power : ONE);
        }
    } else {
        /* it waits */
    }
}

/* ---- samples -------------------------------------------------------------------------- */

/* Effects of the last interval, from the currents. */
static void integrate(const fo_adaptive *a, fo_adaptive_state *s, bool complete, effects *t)
{
    fo_real mean[FO_N], mean_24[FO_N], signs[FO_N];
    for (int i = 0; i < FO_N; i++) {
        mean_24[i] = mean_current_24(s->plain.current[0][i], s->plain.current[1][i],
                                     s->plain.current[2][i], s->plain.current[3][i]);
        mean[i] = mean_24[i] / (fo_real)24;
    }
    t->unsure = direction(a, mean, signs);
    for (int i = 0; i < FO_N; i++) {
        t->v[i] = s->plain.source[i] - (complete ? ZERO : dot(a->plain.hR[i], mean_24));
        t->charge[i] = a->charge * mean_24[i];
        t->inverter[i] = (fo_real)24 * a->charge * signs[i];
    }
    const fo_real step = a->plain.sample_time * s->tracker.speed;
    const fo_real sine = fo_abs(step) < ONE ? step : ZERO, cosine = ONE - sine * sine / TWO;
    t->before[0] = cosine * s->charge[0] - sine * s->charge[1];
    t->before[1] = cosine * s->charge[1] + sine * s->charge[0];
    for (int i = 0; i < FO_N; i++) {
        s->charge[i] = t->charge[i];
    }
}

/* After the plain observer's step: the rest of the sample. */
static void go_on(const fo_adaptive *a, fo_adaptive_state *s, bool complete, bool measured,
                  fo_adaptive_estimate *e)
{
    if (s->plain.have_current && s->plain.have_voltage) {
        effects t;
        integrate(a, s, complete, &t);
        if (s->running) {
            e->adapting = true;
            run(a, s, &t, measured, e);
        } else {
            report_prior(a, s, e);
            begin(a, s, &t, e);
        }
    } else {
        if (!s->plain.have_current) {
            forget(a, s);
            fo_candidates_sow(a, s);
        }
        report_prior(a, s, e);
    }
    s->turn++;
    e->resistance_error = s->p[P_R];
    e->inverter_voltage = s->p[P_V];
}

/* Known voltage loss of the inverter over the interval that ends with this current, in volt. */
static void known_loss(const fo_adaptive *a, const fo_adaptive_state *s,
                       const fo_real current[FO_N], fo_real loss[FO_N])
{
    const fo_state *q = &s->plain;
    loss[0] = ZERO;
    loss[1] = ZERO;
    if (a->mean[P_V] != ZERO) {
        fo_real mean[FO_N], signs[FO_N];
        for (int i = 0; i < FO_N; i++) {
            mean[i] = current[i];
            if (q->have_current) {
                mean[i] = mean_current_24(current[i], q->current[0][i], q->current[1][i],
                                          q->current[2][i]) /
                          (fo_real)24;
            }
        }
        if (dot(mean, mean) <= a->plain.current_limit * a->plain.current_limit) {
            (void)direction(a, mean, signs);
            loss[0] = a->mean[P_V] * signs[0];
            loss[1] = a->mean[P_V] * signs[1];
        }
    }
}

void fo_adaptive_step(const fo_adaptive *a, fo_adaptive_state *s, const fo_real voltage[FO_N],
                      const fo_real current[FO_N], fo_adaptive_estimate *e)
{
    const uint32_t before = s->plain.bad_currents + s->plain.outliers;
    fo_real left[FO_N];
    known_loss(a, s, current, left);
    for (int i = 0; i < FO_N; i++) {
        left[i] = voltage[i] - left[i];
    }
    fo_step(&a->plain, &s->plain, left, current, &e->position);
    go_on(a, s, false, s->plain.bad_currents + s->plain.outliers == before, e);
}

void fo_adaptive_step_volt_seconds(const fo_adaptive *a, fo_adaptive_state *s,
                                   const fo_real volt_seconds[FO_N], const fo_real current[FO_N],
                                   fo_adaptive_estimate *e)
{
    const uint32_t before = s->plain.bad_currents + s->plain.outliers;
    fo_real left[FO_N];
    known_loss(a, s, current, left);
    for (int i = 0; i < FO_N; i++) {
        left[i] = volt_seconds[i] - a->plain.sample_time * left[i];
    }
    fo_step_volt_seconds(&a->plain, &s->plain, left, current, &e->position);
    go_on(a, s, true, s->plain.bad_currents + s->plain.outliers == before, e);
}
