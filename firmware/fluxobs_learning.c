/* SPDX-License-Identifier: MIT */
#include "fluxobs_learning.h"

#include "fluxobs_internal.h"

#include <string.h>

/* ---- thresholds: unit, reason, and what fixed them --------------------------------------- */

/* Rotation for which residuals are averaged to one row: an eighth of a turn [rad]. What a model
 * leaves is a function of the angle, with harmonics up to the sixth: rows of less than that repeat
 * the same error, and must not count as new information. */
static const fo_real BLOCK = PI / (fo_real)4;
/* A slower rotor ends a block after this time; its row weighs by its share of BLOCK [memories]. */
static const fo_real BLOCK_MOST = (fo_real)0.3;
/* Std of a row that no noise explains: no machine satisfies its relation better [flux bases]. */
static const fo_real MODEL = (fo_real)0.002;
/* Of the inverter's voltage, this share is in no model: the curve of its loss. */
static const fo_real INVERTER_UNMODELLED = (fo_real)0.05;
/* Where a current is within the harder sign's knee, so much more is. */
static const fo_real KNEE_UNMODELLED = (fo_real)0.3;
/* Time in which a drift that was known is half forgotten [memories]. */
static const fo_real DRIFT_MEMORY = (fo_real)100;
/* Rows over which powers are averaged: two turns. */
static const fo_real ROWS = (fo_real)16;
/* A power beyond this many times the average before is clipped to it, and the drift is opened anew:
 * five stds. */
static const fo_real CLIP = (fo_real)25;
/* Rows after which that average means something. */
static const fo_real PROVEN = (fo_real)8;
/* Lower bound of that power for the flux: a fiftieth, a seventh of the std. */
static const fo_real LEVEL_LEAST = (fo_real)0.02;
/* Rows at one operating point repeat the same error: the n-th counts 1/n. Current, of rated, or
 * speed, of itself, that differ by this share make a new one. */
static const fo_real NEW_POINT = (fo_real)0.3;
/* Least information on the flux [1 / flux bases^2]: a thousand times any flux. */
static const fo_real LEAST = (fo_real)1e-6;
/* Rows in which each parameter is forgotten once, and its prior comes back. */
static const uint32_t ROUND = 16U;
/* The position's variance is found anew between rows where what the parameters may have done since is
 * more than this share of it: the std would be an eighth too large. */
static const fo_real SINCE_MATTERS = (fo_real)0.25;
/* Share of doubt's square that a start leaves to flux and drift. */
static const fo_real LOOSE = (fo_real)0.3;

/* Share of its flux by which a cage may walk off what i_d says, in a memory: an offset of 2 % of
 * rated current moves it by 4 % within its time constant, three to thirty memories. Without it
 * valid rows were 10 degrees off (tests/observers/test_cage.py). */
static const fo_real CAGE_WALK = (fo_real)0.01;
/* Share of its prior std by which heat may walk the resistance in the slow memory: 5 % of R_s in
 * 100 s by default. Forgetting alone leaves it where it was learnt, ever surer: while copper warmed
 * by 11 % in 40 s the estimate ended 26 of its stds off (tests/observers/test_heat.py). */
static const fo_real HEAT_WALK = (fo_real)0.1;

/* ---- parameters --------------------------------------------------------------------------- */

fo_real fo_learning_value(const fo_adaptive *a, const fo_adaptive_state *s, int n)
{
    return a->std[n] * s->p[n];
}

fo_real fo_learning_deviation(const fo_adaptive *a, const fo_adaptive_state *s, int n, int count,
                              fo_real curve)
{
    fo_real direction[FO_NA] = {0};
    for (int i = n; i < n + count; i++) {
        direction[FO_NF + i] = a->std[i];
    }
    direction[FO_NF + FO_CURVE] += a->std[FO_CURVE] * curve;
    return fo_sqrt(fo_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction));
}

/* Present loss of both parts of the inverter [V]. */
static fo_real loss(const fo_adaptive *a, const fo_adaptive_state *s)
{
    return TWO * a->inverter_mean + fo_learning_value(a, s, FO_INVERTER) +
           fo_learning_value(a, s, FO_INVERTER + 1);
}

fo_real fo_learning_unmodelled(const fo_adaptive *a, const fo_adaptive_state *s)
{
    const fo_real share = INVERTER_UNMODELLED + KNEE_UNMODELLED * s->knee;
    const fo_real mean = loss(a, s), std = s->deviations[2];
    return share * fo_sqrt(mean * mean + std * std) * a->volt / a->plain.h;
}

/* Asks the map at the filter's own angle: that of the guard may be another. A cage's says the same
 * at any. */
static void ask_map(const fo_adaptive *a, fo_adaptive_state *s)
{
#if FO_MAPPED
    const fo_observer *o = &a->plain;
    if (mapped(o) && s->running && !cage(o) && !s->plain.guided) {
        fo_ask_map(o, expected_angle(o, &s->tracker), s->plain.current[0], &s->shape);
    } else {
        s->shape = s->plain.shape;
    }
#else
    (void)a;
    (void)s;
#endif
}

/* The rotor as the filter sees it: its position vector, and what the current makes there. */
typedef struct {
    fo_real current[FO_N];    /* without offset                                              */
    fo_real x[FO_N], length;  /* position vector                                             */
    fo_real along[FO_N];      /* its direction                                               */
    fo_real made[2];          /* flux of the current along and across it, with the L assumed */
    fo_real grown;            /* what the current adds to its length                         */
} sight;

/* The part of v across `along`, a unit vector. */
static fo_real across(const fo_real along[FO_N], const fo_real v[FO_N])
{
    return along[0] * v[1] - along[1] * v[0];
}

/* Finds the rotor, with what is learnt of the inductances. */
static void look(const fo_adaptive *a, const fo_adaptive_state *s, sight *at)
{
    const fo_observer *o = &a->plain;
    const fo_real L_d = o->L_position + a->saliency, L_q = o->L_position;
    const fo_real wrong_d = fo_learning_value(a, s, FO_INDUCTANCE);
    const fo_real wrong_q = fo_learning_value(a, s, FO_INDUCTANCE + 1);
    for (int i = 0; i < FO_N; i++) {
        const fo_real offset = fo_learning_value(a, s, FO_OFFSET + i);
        at->current[i] = s->plain.current[0][i] - offset;
        at->x[i] = s->flux[i] - (L_q + wrong_q * L_q) * at->current[i];
#if FO_MAPPED
        if (mapped(o)) {
            at->x[i] = s->flux[i] - (s->shape.away[i] - L_q * offset);
        }
#endif
    }
#if FO_MAPPED
    const fo_shape *f = &s->shape;
    if (mapped(o)) {
        at->grown = f->active - o->map->psi / o->flux_base;
        at->made[0] = dot(f->expected, f->away) + (cage(o) ? ZERO : at->grown);
        at->made[1] = across(f->expected, f->away);
        at->x[0] += wrong_q * at->made[1] * f->expected[1];
        at->x[1] -= wrong_q * at->made[1] * f->expected[0];
    }
#endif
    at->length = fo_sqrt(dot(at->x, at->x));
    at->along[0] = at->x[0] / at->length;
    at->along[1] = at->x[1] / at->length;
#if FO_MAPPED
    if (mapped(o)) { /* what the map says where it was asked is carried to this direction */
        const fo_real off = across(f->expected, at->along) * at->length;
        at->grown += wrong_d * at->made[0] - across(f->expected, f->slope) * off;
    } else
#endif
    {
        const fo_real i_d = dot(at->along, at->current);
        at->made[0] = L_d * i_d;
        at->made[1] = L_q * across(at->along, at->current);
        at->grown = (a->saliency + wrong_d * L_d - wrong_q * L_q) * i_d;
    }
}

/* How the residual answers to the flux, and, negative, to the current. */
static void slopes(const fo_adaptive *a, const fo_adaptive_state *s, const sight *at,
                   fo_real slope[FO_N], fo_real by_current[FO_N])
{
#if FO_MAPPED
    if (mapped(&a->plain)) {
        const fo_shape *f = &s->shape;
        for (int i = 0; i < FO_N; i++) {
            slope[i] = f->slope[i];
            by_current[i] = f->by_current[i];
        }
    } else
#else
    (void)s;
#endif
    {
        const fo_real i_d = dot(at->along, at->current);
        for (int i = 0; i < FO_N; i++) {
            const fo_real beside = at->current[i] - i_d * at->along[i];
            slope[i] = at->along[i] - a->saliency / at->length * beside;
            by_current[i] = a->plain.L_position * slope[i] + a->saliency * at->along[i];
        }
    }
}

/* Keeps one of the stds that are reported. */
static void keep_deviation(const fo_adaptive *a, fo_adaptive_state *s, uint32_t n)
{
    if (n == 0U) {
        s->deviations[0] = fo_learning_deviation(a, s, FO_PSI, 1, ZERO);
    } else if (n == 1U) {
        s->deviations[1] = fo_learning_deviation(a, s, FO_RESISTANCE, 1, ZERO);
    } else {
        s->deviations[2] = fo_learning_deviation(a, s, FO_INVERTER, 2, loss(a, s));
    }
}

void fo_learning_forget(const fo_adaptive *a, fo_adaptive_state *s)
{
    (void)memset(s->U, 0, sizeof s->U);
    for (int i = 0; i < FO_NA; i++) {
        s->d[i] = ONE;
        s->z[i] = ZERO;
    }
    for (int i = 0; i < FO_NP; i++) {
        s->p[i] = ZERO;
    }
    for (uint32_t n = 0U; n < 3U; n++) {
        keep_deviation(a, s, n);
    }
    s->unsure = ZERO;
    s->doubt = TWO;
}

static fo_real magnitude(const fo_real v[FO_N]) { return fo_sqrt(dot(v, v)); }

/* Finds the voltage by which the parameters may be off at this current. */
static void weigh_parameters(const fo_adaptive *a, fo_adaptive_state *s, const fo_effects *t)
{
    fo_real direction[FO_NA] = {0};
    for (int i = FO_RESISTANCE; i < FO_OFFSET; i++) {
        direction[FO_NF + i] = magnitude(t->effect[i]);
    }
    s->unsure = fo_sqrt(fo_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction)) / a->plain.h;
    s->unsure_at = dot(s->plain.current[0], s->plain.current[0]);
}

void fo_learning_doubt(const fo_adaptive *a, fo_adaptive_state *s, const fo_effects *t,
                       fo_real length, fo_real turned)
{
    if (!s->running && s->turn % ROUND == 0U) {
        weigh_parameters(a, s, t);
    }
    const fo_real square = dot(s->plain.current[0], s->plain.current[0]);
    fo_real unsure = s->unsure * a->plain.h;
    if (square > s->unsure_at && s->unsure_at > ZERO) { /* it has grown since */
        unsure *= fo_sqrt(square / s->unsure_at);
    }
    const fo_real gone = turned < ONE ? turned : ONE;
    const fo_real doubt = s->doubt + (length > ZERO ? unsure / length : ONE) - s->doubt * gone;
    s->doubt = doubt < TWO ? doubt : TWO;
    if (!(a->std[FO_RESISTANCE] + a->std[FO_INVERTER] > ZERO)) { /* all of it is known */
        s->doubt = ZERO;
    }
}

/* ---- the triangle: rows of flux and drift above those of the parameters ---------------------- */

/* Lets the flux take a random step of this variance: the information L on it, given the rest,
 * becomes (1 / L + variance)^-1, and what it says about the rest stays. */
static void step_flux(fo_adaptive_state *s, fo_real variance)
{
    fo_real *first = &s->U[0], *second = &s->U[FO_ROW(FO_NA, 1)];
    const fo_real u = first[0], d0 = s->d[0], d1 = s->d[1];
    /* written out for U'dU, so that nothing cancels */
    const fo_real a = ONE + variance * d0, b = ONE + variance * d1, square = d0 * u * u;
    const fo_real det = a * b + variance * square, u_new = u / b;
    const fo_real m0 = d0 * b / det, m1 = d1 * (a + square * variance / b) / det;
    s->d[0] = m0 > LEAST ? m0 : LEAST;
    s->d[1] = m1 > LEAST ? m1 : LEAST;
    first[0] = u_new;
    for (int j = 1; j < FO_NA - 1; j++) {
        first[j] += (u_new - u) * second[j - 1];
    }
}

/* Carries the triangle to the end of the block: flux there = flux + time drift + effect p. */
static void carry(fo_adaptive_state *s, const fo_block *b)
{
    for (int i = 0; i < FO_N; i++) {
        const fo_real on[FO_N] = {i == 0 ? ONE : ZERO, i == 0 ? s->U[0] : ONE};
        fo_real *row = &s->U[FO_AT(FO_NA, i, FO_N)]; /* from the drift on */
        for (int j = 0; j < FO_N; j++) {
            row[j] -= b->time * on[j];
        }
        for (int j = 0; j < FO_NP; j++) {
            row[FO_N + j] -= dot(on, b->effect[j]);
        }
    }
}

/* The drift is forgotten towards its prior. */
static void forget_drift(const fo_adaptive *a, fo_adaptive_state *s, fo_real time)
{
    const fo_real share = time / DRIFT_MEMORY, prior = ONE / (a->plain.plausible * a->plain.plausible);
    for (int i = FO_N; i < (int)FO_NF; i++) {
        s->d[i] += share * (prior - s->d[i]);
    }
}

static void clear_block(fo_adaptive_state *s)
{
    (void)memset(&s->now.block, 0, sizeof s->now.block);
    s->now.block.theta = s->theta;
}

/* How steady states tie an error of a parameter to the flux: effect / (j turned). */
static void tied(const fo_real effect[FO_N], fo_real turned, fo_real tie[FO_N])
{
    tie[0] = effect[1] / turned;
    tie[1] = -effect[0] / turned;
}

void fo_learning_start(const fo_adaptive *a, fo_adaptive_state *s, const fo_candidate *c,
                       const fo_manifold *m, fo_real inflation, const fo_effects *t)
{
    const fo_real psi = fo_sqrt(c->p[FO_NM - 1]), speed = a->plain.sample_time * s->tracker.speed;
    const fo_real h = a->plain.h; /* at least a radian a memory: slower, nothing tells the drift */
    const fo_real turned = fo_abs(speed) > h ? speed : speed < ZERO ? -h : h;
    sight at;
    fo_real slope[FO_N], by_current[FO_N];
    ask_map(a, s);
    for (int i = 0; i < FO_N; i++) {
        s->flux[i] = c->p[i];
        s->drift[i] = c->p[FO_N + i];
    }
    look(a, s, &at);
    slopes(a, s, &at, slope, by_current);
    if (a->std[FO_PSI] > ZERO && !s->frozen && !(fo_abs(s->p[FO_PSI]) > ZERO)) { /* new */
        s->p[FO_PSI] = (at.length - at.grown - a->psi) / a->std[FO_PSI];
    }
    const fo_real *known = m->U;
    for (int i = 0; i < (int)FO_NF; i++) {
        fo_real on[FO_NM] = {0}; /* the row of the manifold */
        on[i] = ONE;
        for (int j = i + 1; j < (int)FO_NM; j++) {
            on[j] = *known;
            known++;
        }
        for (int j = i + 1; j < (int)FO_NF; j++) {
            s->U[FO_AT(FO_NA, i, j)] = on[j];
        }
        fo_real *row = &s->U[FO_AT(FO_NA, i, FO_NF)]; /* the parameters */
        const fo_real by_psi = TWO * psi * on[FO_NM - 1]; /* the manifold has its square */
        for (int j = 0; j < (int)FO_NP; j++) {
            fo_real tie[FO_N] = {0};
            if (j < (int)FO_OFFSET) {
                tied(t->effect[j], turned, tie);
            }
            row[j] = -(dot(tie, on) + by_psi * dot(tie, at.along));
        }
        row[FO_PSI] = by_psi * a->std[FO_PSI];
        row[FO_INDUCTANCE] = by_psi * a->std[FO_INDUCTANCE] * at.made[0];
        row[FO_INDUCTANCE + 1] =
            by_psi * a->std[FO_INDUCTANCE + 1] * at.made[1] * across(at.along, slope);
        s->d[i] = m->d[i] / inflation;
        s->z[i] = ZERO;
    }
    step_flux(s, LOOSE * s->doubt * s->doubt * at.length * at.length);
    for (int i = FO_N; i < (int)FO_NF; i++) { /* as much, turning, for the drift */
        const fo_real loose = LOOSE * s->unsure * s->unsure;
        s->d[i] /= ONE + s->d[i] * loose;
    }
    s->theta = c->theta;
    s->x[0] = at.along[0];
    s->x[1] = at.along[1];
    s->running = true;
    s->level = ONE;
    s->rows = ZERO;
    s->contradiction = ONE;
    s->known_point = ZERO;
    s->across = c->variance * at.length * at.length;
    s->across_at = ZERO;
    const fo_real by_L_q = a->std[FO_INDUCTANCE + 1] * at.made[1];
    s->turning = by_L_q * by_L_q;
    s->made_q = at.made[1];
    s->exposed = ZERO;
    s->disagree = ZERO;
    clear_block(s);
}

/* ---- a sample --------------------------------------------------------------------------------- */

/* Adds the residual |x| - grown - psi_f of a sample to the block. */
static void add(const fo_adaptive *a, const fo_adaptive_state *s, const sight *at, fo_block *b)
{
    fo_real slope[FO_N], by_current[FO_N];
    slopes(a, s, at, slope, by_current);
    for (int i = 0; i < FO_N; i++) {
        b->slope[i] += slope[i];
        b->slope_time[i] += slope[i] * b->time;
        b->along[FO_OFFSET + i] += a->std[FO_OFFSET + i] * by_current[i];
    }
    for (int j = FO_RESISTANCE; j < (int)FO_NP; j++) {
        b->along[j] += dot(slope, b->effect[j]);
    }
    b->along[FO_PSI] -= a->std[FO_PSI];
    b->along[FO_INDUCTANCE] -= a->std[FO_INDUCTANCE] * at->made[0];
    b->along[FO_INDUCTANCE + 1] -=
        a->std[FO_INDUCTANCE + 1] * at->made[1] * across(at->along, slope);
    b->residual += at->length - at->grown - (a->psi + fo_learning_value(a, s, FO_PSI));
    b->samples++;
}

/* What is left of a row for the parameters: follows its power, and how far that contradicts what
 * has been learnt. Returns whether it is a surprise, as after a jump of the drift. */
static bool follow(fo_adaptive_state *s, const fo_real row[FO_NA], fo_real value,
                   fo_real information, fo_real share)
{
    fo_real direction[FO_NA];
    (void)memcpy(direction, row, sizeof direction);
    const fo_real square = value * value;
    const fo_real power = information * square, noise = ONE / information;
    const fo_real known = fo_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction);
    const fo_real odd = square / (noise + known);
    s->rows += share;
    const fo_real gain = share / (s->rows + ONE < ROWS ? s->rows + ONE : ROWS);
    const fo_real usual = s->level > LEVEL_LEAST ? s->level : LEVEL_LEAST;
    const bool surprise = s->rows > PROVEN && square > CLIP * (usual * noise + known);
    s->level += gain * ((power < CLIP * s->level ? power : CLIP * s->level) - s->level);
    const fo_real most = CLIP * (ONE + s->contradiction);
    s->contradiction += TWO / ROWS * share * ((odd < most ? odd : most) - s->contradiction);
    return surprise;
}

/* Counts the rows at the present operating point; returns their number. */
static fo_real rows_here(const fo_adaptive *a, fo_adaptive_state *s, const sight *at,
                         fo_real speed, fo_real share)
{
    const fo_real now[3] = {dot(at->along, at->current), across(at->along, at->current), speed};
    const fo_real before = fo_abs(s->point[2]) + fo_abs(speed);
    const fo_real scale[3] = {a->over_rated, a->over_rated, before > ZERO ? ONE / before : ZERO};
    fo_real moved = ZERO;
    for (int i = 0; i < 3; i++) {
        const fo_real off = (now[i] - s->point[i]) * scale[i];
        moved += off * off;
    }
    s->known_point = s->known_point / (ONE + moved / (NEW_POINT * NEW_POINT) * s->known_point) + share;
    const fo_real gain = s->known_point > ONE ? ONE / s->known_point : ONE;
    for (int i = 0; i < 3; i++) {
        s->point[i] += gain * (now[i] - s->point[i]);
    }
    return s->known_point > ONE ? s->known_point : ONE;
}

/* The resistance takes a random step of this variance; what is known of the others stays. The step w
 * joins the unknowns (R was x - w) and is eliminated again, with the rows that have R in them. */
static void walk_resistance(fo_adaptive_state *s, fo_real variance)
{
    const int psi = FO_NF + (int)FO_PSI, r = FO_NF + (int)FO_RESISTANCE;
    fo_real *over = &s->U[FO_AT(FO_NA, psi, r)];
    const fo_real *own = &s->U[FO_AT(FO_NA, r, r + 1)];
    const fo_real share = over[0], step = ONE + variance * s->d[r];
    const fo_real gain = -variance * s->d[r] / step; /* of R's row in w's */
    s->d[psi] /= ONE + variance * share * share * s->d[psi] / step;
    s->d[r] /= step;
    s->z[psi] += share * gain * s->z[r];
    over[0] += share * gain;
    for (int j = 0; j < (int)FO_NA - 1 - r; j++) {
        over[1 + j] += share * gain * own[j];
    }
}

void fo_learning_warm(const fo_adaptive *a, fo_adaptive_state *s, fo_real stds)
{
    const fo_real most = (fo_real)1e3; /* far more than the prior: nothing is left, or not a number */
    const fo_real walk = fo_abs(stds) < most ? stds : most;
    walk_resistance(s, walk * walk);
    for (uint32_t n = 0U; n < 3U; n++) {
        keep_deviation(a, s, n);
    }
}

/* A parameter's assumed value grows by `more` stds. What the data say of it stays where it is; the
 * prior goes along. With A the information, of which the prior is 1, and A p = b this is
 * b <- b - (A - 1) more: z = U p loses `more` times its column, and b gains the prior's part. */
static void move_mean(fo_adaptive_state *s, int n, fo_real more)
{
    const int at = FO_NF + n;
    fo_real gained[FO_NA] = {0}, before[FO_NA], after[FO_NA];
    fo_solve(FO_NA, s->U, s->z, FO_NF, FO_NA, before);
    for (int i = FO_NF; i < at; i++) {
        s->z[i] -= s->U[FO_AT(FO_NA, i, at)] * more;
    }
    s->z[at] -= more;
    for (int j = at; j < (int)FO_NA && !s->frozen; j++) { /* U'd gained = more, in its place */
        fo_real sum = j == at ? more : ZERO;
        for (int i = at; i < j; i++) {
            sum -= s->U[FO_AT(FO_NA, i, j)] * s->d[i] * gained[i];
        }
        gained[j] = sum / s->d[j];
        s->z[j] += gained[j];
    }
    fo_solve(FO_NA, s->U, s->z, FO_NF, FO_NA, after);
    for (int j = FO_NF; j < (int)FO_NA; j++) {
        after[j] -= before[j];
        if (j < (int)FO_NF + (int)FO_CURVE) { /* the curve is only considered */
            s->p[j - (int)FO_NF] += after[j];
        }
    }
    after[at] += more; /* what has changed of the values, not of the errors */
    if (s->running) {
        fo_solve(FO_NA, s->U, s->z, 0, FO_NF, after);
        for (int i = 0; i < FO_N; i++) {
            s->flux[i] += after[i];
            s->drift[i] += after[FO_N + i];
        }
    }
}

void fo_learning_means(const fo_adaptive *a, fo_real means[FO_MEANS])
{
    means[0] = a->psi;
    means[1] = (fo_real)24 * a->plain.hR[0][0] / a->volt;
    means[2] = a->inverter_mean;
}

void fo_learning_rebase(const fo_adaptive *a, fo_adaptive_state *s, const fo_real before[FO_MEANS])
{
    static const int places[FO_MEANS + 1] = {FO_PSI, FO_RESISTANCE, FO_INVERTER, FO_INVERTER + 1};
    fo_real now[FO_MEANS];
    fo_learning_means(a, now);
    for (int i = 0; i < (int)FO_MEANS + 1; i++) {
        const int n = places[i], mean = i < (int)FO_MEANS ? i : (int)FO_MEANS - 1;
        if (a->std[n] > ZERO) {
            move_mean(s, n, (now[mean] - before[mean]) / a->std[n]);
        }
    }
}

/* The parameters are forgotten towards their prior, one after the other, each every ROUND rows. */
static void forget_parameters(const fo_adaptive *a, fo_adaptive_state *s, fo_real time)
{
    s->since += time * a->slow;
    s->pulled = s->pulled + 1U < ROUND ? s->pulled + 1U : 0U;
    if (s->pulled < (uint32_t)FO_CURVE) {
        const int n = FO_NF + (int)s->pulled;
        fo_real unit[FO_NA] = {0}, mean = ZERO, prior = s->passed;
        unit[n] = ONE;
        fo_rotate(FO_NA, s->U, s->d, s->z, n, FO_NF + FO_CURVE, unit, &mean, &prior);
    } else if (s->pulled == ROUND - 1U) {
        s->passed = s->since < ONE / TWO ? s->since : ONE / TWO;
        for (int j = 0; j < (int)FO_CURVE; j++) {
            s->d[FO_NF + j] *= ONE - s->passed;
        }
        walk_resistance(s, HEAT_WALK * HEAT_WALK * s->passed);
        s->since = ZERO;
    } else {
        /* it rests */
    }
}

/* The parameters learn from what is left of a row; then all is solved. */
static void learn(const fo_adaptive *a, fo_adaptive_state *s, fo_real row[FO_NA], fo_real value,
                  fo_real information, fo_real time)
{
    fo_real before[FO_NP], x[FO_NA];
    for (int j = 0; j < FO_NP; j++) {
        before[j] = s->p[j];
    }
    if (information > ZERO) {
        fo_real rhs = value, weight = information;
        for (int j = 0; j < FO_NP; j++) { /* from the prior mean */
            rhs += row[FO_NF + j] * s->p[j];
        }
        fo_rotate(FO_NA, s->U, s->d, s->z, FO_NF, FO_NF + FO_CURVE, row, &rhs, &weight);
        fo_solve(FO_NA, s->U, s->z, FO_NF, FO_NA, x);
        const fo_real volts = TWO * a->inverter_mean + a->std[FO_INVERTER] * x[FO_NF + FO_INVERTER] +
                              a->std[FO_INVERTER + 1] * x[FO_NF + FO_INVERTER + 1];
        if (volts < ZERO) { /* no inverter adds voltage: the likeliest without */
            fo_real direction[FO_NA] = {0}, y[FO_NA] = {0};
            direction[FO_NF + FO_INVERTER] = a->std[FO_INVERTER];
            direction[FO_NF + FO_INVERTER + 1] = a->std[FO_INVERTER + 1];
            const fo_real variance = fo_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction);
            for (int j = FO_NF; j < FO_NA; j++) { /* the direction is now y, U'y = direction */
                y[j] = direction[j] / s->d[j];
            }
            fo_solve(FO_NA, s->U, y, FO_NF, FO_NA, direction);
            for (int j = FO_NF; j < (int)FO_NF + (int)FO_CURVE; j++) {
                x[j] -= direction[j] * volts / variance;
            }
        }
        for (int j = 0; j < (int)FO_CURVE; j++) { /* the curve is only considered */
            s->p[j] = x[FO_NF + j];
        }
        forget_parameters(a, s, time);
    }
    for (int j = 0; j < FO_NP; j++) {
        x[FO_NF + j] = s->p[j] - before[j];
    }
    fo_solve(FO_NA, s->U, s->z, 0, FO_NF, x);
    for (int i = 0; i < FO_N; i++) {
        s->flux[i] += x[i];
        s->drift[i] += x[FO_N + i];
        s->z[i] = ZERO;
        s->z[FO_N + i] = ZERO;
    }
}

fo_real fo_learning_since(const fo_adaptive_state *s)
{
    const fo_real off = s->unsure * (s->now.block.time - s->across_at);
    return off * off;
}

/* Finds the variance across the position vector: with L_q known, and what L_q adds. Since the last row
 * a drift has moved the flux for a while, and each parameter by its effect. At steady load the row has
 * tied these to the flux, and they add next to nothing; what they may add after a change is all there. */
static void judge_across(const fo_adaptive *a, fo_adaptive_state *s, const sight *at)
{
    enum { L_Q = (int)FO_NF + (int)FO_INDUCTANCE + 1, REST = (int)FO_NA - L_Q };
    const fo_block *b = &s->now.block;
    fo_real direction[FO_NA] = {0}, rest[REST];
    direction[0] = -at->along[1];
    direction[1] = at->along[0];
    for (int i = 0; i < FO_N; i++) {
        const fo_real by_offset = a->plain.L_position * a->std[FO_OFFSET + i];
        direction[FO_N + i] = b->time * direction[i];
        direction[FO_NF + FO_OFFSET + i] = by_offset * direction[i];
    }
    for (int j = FO_RESISTANCE; j < (int)FO_NP; j++) {
        direction[FO_NF + j] += dot(direction, b->effect[j]);
    }
    const fo_real level = s->level > LEVEL_LEAST ? s->level : LEVEL_LEAST;
    s->across = level * fo_variance(FO_NA, s->U, s->d, 0, FO_NF, direction);
    s->across += fo_variance(FO_NA, s->U, s->d, FO_NF, L_Q, direction);
    (void)memcpy(rest, &direction[L_Q], sizeof rest);
    const fo_real known = fo_variance(FO_NA, s->U, s->d, L_Q, FO_NA, direction);
    s->across += known;
    (void)memcpy(&direction[L_Q], rest, sizeof rest);
    direction[L_Q] -= a->std[FO_INDUCTANCE + 1] * at->made[1];
    s->turning = fo_variance(FO_NA, s->U, s->d, L_Q, FO_NA, direction) - known;
    s->made_q = at->made[1];
    s->across_at = b->time;
}

/* Ends a block: takes in its row. */
static void end(const fo_adaptive *a, fo_adaptive_state *s, const fo_effects *t, fo_real turned)
{
    fo_block *b = &s->now.block;
    const fo_real share = turned < BLOCK ? turned / BLOCK : ONE;
    const fo_real step = a->unmodelled * b->time, inverter = b->unmodelled / b->time;
    const fo_real walk = step * step + b->unmodelled * b->unmodelled;
    carry(s, b);
    step_flux(s, walk);
    if (cage(&a->plain)) {
        const fo_real q = CAGE_WALK * CAGE_WALK * b->time / (a->std[FO_PSI] * a->std[FO_PSI]);
        s->d[FO_NF + FO_PSI] /= ONE + s->d[FO_NF + FO_PSI] * q;
    }
    forget_drift(a, s, b->time);
    sight at;
    if (b->samples > 0U && share > (fo_real)1e-6) {
        const fo_real over = ONE / (fo_real)b->samples;
        fo_real row[FO_NA], value = -b->residual * over;
        for (int i = 0; i < FO_N; i++) {
            row[i] = b->slope[i] * over;
            row[FO_N + i] = b->slope_time[i] * over - b->time * row[i];
        }
        for (int j = 0; j < FO_NP; j++) {
            row[FO_NF + j] = b->along[j] * over - dot(row, b->effect[j]);
        }
        fo_real information =
            share / (MODEL * MODEL + a->through_L * s->plain.roughness * over);
        fo_rotate(FO_NA, s->U, s->d, s->z, 0, FO_NF, row, &value, &information);
        const bool known = information > ZERO;
        const bool surprise = known && follow(s, row, value, information, share);
        if (surprise) {
            forget_drift(a, s, DRIFT_MEMORY); /* all of it */
        }
        look(a, s, &at);
        const fo_real speed = turned / b->time;
        const fo_real rows = rows_here(a, s, &at, speed, share);
        const fo_real shape = speed > ZERO ? inverter / speed : ZERO;
        const bool ready =
            known && !surprise && !s->frozen && s->doubt < DOUBT_LIMIT && speed > ZERO;
        const fo_real level = s->level > ONE ? s->level : ONE;
        fo_real weight = ZERO;
        if (ready) {
            weight = ONE / ((rows / information + shape * shape) * level);
        }
        learn(a, s, row, value, weight, b->time);
    }
    look(a, s, &at);
    s->theta = fo_atan2(at.x[1], at.x[0]);
    clear_block(s);
    judge_across(a, s, &at);
    weigh_parameters(a, s, t);
    s->judged = s->judged < 2U ? s->judged + 1U : 0U;
    keep_deviation(a, s, s->judged);
}

/* Is the estimate finite, and the flux one that a machine can have? */
static bool sound(const fo_adaptive_state *s)
{
    fo_real sum = s->level + s->contradiction + s->across;
    for (int i = 0; i < FO_NP; i++) {
        sum += s->p[i];
    }
    for (int i = 0; i < FO_N; i++) {
        sum += s->drift[i];
    }
    return sum - sum == ZERO && dot(s->flux, s->flux) < RUNAWAY;
}

fo_real fo_learning_sample(const fo_adaptive *a, fo_adaptive_state *s, const fo_effects *t,
                           bool measured)
{
    const fo_observer *o = &a->plain;
    fo_block *b = &s->now.block;
    sight at;
    ask_map(a, s);
    for (int i = 0; i < FO_N; i++) {
        s->flux[i] += t->v[i] + o->h * s->drift[i];
        for (int j = FO_RESISTANCE; j < (int)FO_NP; j++) {
            b->effect[j][i] += t->effect[j][i];
        }
    }
    b->time += o->h;
    b->unmodelled += o->h * fo_learning_unmodelled(a, s);
    look(a, s, &at);
    bool good = at.length * at.length > o->square_min / (fo_real)16;
    if (good) {
        if (measured) {
            add(a, s, &at, b);
        }
        const fo_real theta = fo_atan2(at.x[1], at.x[0]);
        const fo_real turned = fo_abs(wrap(theta - b->theta));
        s->theta = theta;
        if (turned >= BLOCK || b->time >= BLOCK_MOST) {
            end(a, s, t, turned);
            look(a, s, &at);
        } else if (fo_learning_since(s) > SINCE_MATTERS * s->across) {
            judge_across(a, s, &at);
        } else {
            /* the variance found last is good enough */
        }
        const fo_real loaded = a->std[FO_INDUCTANCE + 1] * (at.made[1] - s->made_q);
        s->turned = s->turning + loaded * loaded;
        s->x[0] = at.along[0];
        s->x[1] = at.along[1];
        good = sound(s) && at.length > ZERO;
    }
    return good ? at.length : ZERO;
}
