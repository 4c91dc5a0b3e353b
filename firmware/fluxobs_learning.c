/* SPDX-License-Identifier: MIT */
#include "fluxobs_learning.h"

#include "fluxobs_internal.h"

#include <string.h>

/* ---- thresholds: unit, reason, and what determined their value ----------------------------- */

/* Rotation over which residuals are averaged to one measurement row [rad]: an eighth of a turn.
 * Model errors are functions of the angle with harmonics up to the sixth. Rows of shorter blocks
 * would repeat the same error and count as new information. */
static const fo_real BLOCK = PI / (fo_real)4;
/* Time after which a block ends if the rotor is slow [memories]. The weight of its row is the share
 * of BLOCK that the rotor has turned. */
static const fo_real BLOCK_MAX = (fo_real)0.3;
/* Mean of the sixth harmonic over BLOCK, as a share of its amplitude [1]: sinc(3 BLOCK). */
static const fo_real SIXTH = (fo_real)0.3;
/* Std of a row due to model errors [flux bases]: no machine satisfies its relation better. */
static const fo_real MODEL = (fo_real)0.002;
/* Share of the inverter's voltage that the model of the loss does not describe [1]. */
static const fo_real INVERTER_UNMODELLED = (fo_real)0.05;
/* Additional share of the difference between the two signs, which is largest within the knee [1]. */
static const fo_real KNEE_UNMODELLED = (fo_real)0.3;
/* Time in which half of the information on a drift is forgotten [memories]. */
static const fo_real DRIFT_MEMORY = (fo_real)100;
/* Rows over which powers of innovations are averaged [1]: two turns. */
static const fo_real ROWS = (fo_real)16;
/* A power above this multiple of its average is clipped, and the drift returns to its prior [1]:
 * five stds. */
static const fo_real CLIP = (fo_real)25;
/* Rows after which the average of the powers is meaningful [1]. */
static const fo_real LEVEL_ROWS = (fo_real)8;
/* Lower bound of that average for the flux [1]: a fiftieth, that is, a seventh of the std. */
static const fo_real NOISE_LEVEL_MIN = (fo_real)0.02;
/* Change of the current as a share of the rated current, or of the speed as a share of itself, that
 * makes a new operating point [1]. Rows at one operating point repeat the same error: the n-th row
 * counts 1/n. */
static const fo_real NEW_POINT = (fo_real)0.3;
/* Least information on the flux [1 / flux bases^2]: the std is a thousand times any flux. */
static const fo_real INFORMATION_MIN = (fo_real)1e-6;
/* Rows of a round, in which each parameter is forgotten and its prior re-injected once [1]. */
static const uint32_t FORGETTING_ROUND = 16U;
/* Between rows the position's variance is computed again if the parameters may have added more than
 * this share [1]. Otherwise the std would be an eighth too small. */
static const fo_real GROWTH_MAX = (fo_real)1e9;
/* Share of the squared parameter-to-EMF ratio that a start adds to the variances of flux and drift
 * [1]. */
static const fo_real START_SHARE_OF_EMF_RATIO = (fo_real)0.3;

/* Process noise of a cage's flux relative to the model of i_d, as a share of the flux in a memory
 * [1]. An offset of 2 % of rated current changes the flux by 4 % within its time constant, three to
 * thirty memories. Without this noise, valid rows were wrong by 10 degrees
 * (tests/observers/test_cage.py). */
static const fo_real CAGE_WALK = (fo_real)0.01;
/* Process noise of the resistance by heat, as a share of its prior std in a slow memory [1]: 5 % of
 * R_s in 100 s by default. With forgetting alone the estimate would not change, and its std would
 * shrink. While copper warmed by 11 % in 40 s, the estimate ended 26 stds off
 * (tests/observers/test_heat.py). */
static const fo_real HEAT_WALK = (fo_real)0.1;

/* ---- parameters --------------------------------------------------------------------------- */

fo_real fo_learning_value(const fo_adaptive *a, const fo_adaptive_state *s, int n)
{
    return a->std[n] * s->p[n];
}

fo_real fo_learning_std(const fo_adaptive *a, const fo_adaptive_state *s, int n, int count,
                              fo_real curve)
{
    fo_real direction[FO_NA] = {0};
    for (int i = n; i < n + count; i++) {
        direction[FO_NF + i] = a->std[i];
    }
    direction[FO_NF + FO_CURVE] += a->std[FO_CURVE] * curve;
    return fo_sqrt(fo_marginal_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction));
}

/* Present estimate of the inverter's voltage loss, both parts together [V]. */
static fo_real inverter_loss(const fo_adaptive *a, const fo_adaptive_state *s)
{
    return TWO * a->inverter_mean + fo_learning_value(a, s, FO_INVERTER) +
           fo_learning_value(a, s, FO_INVERTER + 1);
}

fo_real fo_learning_unmodelled_voltage(const fo_adaptive *a, const fo_adaptive_state *s)
{
    const fo_real share = INVERTER_UNMODELLED + KNEE_UNMODELLED * s->knee;
    const fo_real mean = inverter_loss(a, s), std = s->reported_std[2];
    return share * fo_sqrt(mean * mean + std * std) * a->volt / a->plain.h;
}

/* Linearises the map at the filter's own angle, because the guard's angle may differ. A cage's map
 * does not depend on the angle. */
static void linearise_map_at_filter(const fo_adaptive *a, fo_adaptive_state *s)
{
#if FO_MAPPED
    const fo_observer *o = &a->plain;
    if (has_map(o) && s->running && !has_cage_map(o) && !s->plain.has_external_angle) {
        fo_linearise_map(o, predicted_angle(o, &s->tracker), s->plain.current[0], &s->map_point);
    } else {
        s->map_point = s->plain.map_point;
    }
#else
    (void)a;
    (void)s;
#endif
}

/* Position vector and derivatives at which the relation is linearised. */
typedef struct {
    fo_real current[FO_N];      /* current without offset                                    */
    fo_real x[FO_N], length;    /* position vector                                           */
    fo_real direction[FO_N];    /* direction of the position vector: the d axis              */
    fo_real armature_flux[2];   /* flux of the current along d, q                            */
    fo_real length_by_current;  /* part of the length due to the current: saliency           */
} linearisation_point;

/* Component of v across the unit vector `along`. */
static fo_real component_across(const fo_real along[FO_N], const fo_real v[FO_N])
{
    return along[0] * v[1] - along[1] * v[0];
}

/* Position vector at the present current, with the estimates of the inductances. */
static void linearise(const fo_adaptive *a, const fo_adaptive_state *s, linearisation_point *point)
{
    const fo_observer *o = &a->plain;
    const fo_real L_d = o->L_position + a->saliency, L_q = o->L_position;
    const fo_real wrong_d = fo_learning_value(a, s, FO_INDUCTANCE);
    const fo_real wrong_q = fo_learning_value(a, s, FO_INDUCTANCE + 1);
    for (int i = 0; i < FO_N; i++) {
        const fo_real offset = fo_learning_value(a, s, FO_OFFSET + i);
        point->current[i] = s->plain.current[0][i] - offset;
        point->x[i] = s->flux[i] - (L_q + wrong_q * L_q) * point->current[i];
#if FO_MAPPED
        if (has_map(o)) {
            point->x[i] = s->flux[i] - (s->map_point.armature_flux[i] - L_q * offset);
        }
#endif
    }
#if FO_MAPPED
    const fo_map_point *f = &s->map_point;
    if (has_map(o)) {
        point->length_by_current = f->active_flux - o->map->psi / o->flux_base;
        point->armature_flux[0] = dot(f->direction, f->armature_flux) +
                                  (has_cage_map(o) ? ZERO : point->length_by_current);
        point->armature_flux[1] = component_across(f->direction, f->armature_flux);
        point->x[0] += wrong_q * point->armature_flux[1] * f->direction[1];
        point->x[1] -= wrong_q * point->armature_flux[1] * f->direction[0];
    }
#endif
    point->length = fo_sqrt(dot(point->x, point->x));
    point->direction[0] = point->x[0] / point->length;
    point->direction[1] = point->x[1] / point->length;
#if FO_MAPPED
    if (has_map(o)) { /* convert from the direction of the map's linearisation to the present
                       * direction */
        const fo_real off = component_across(f->direction, point->direction) * point->length;
        point->length_by_current +=
            wrong_d * point->armature_flux[0] - component_across(f->direction, f->by_flux) * off;
    } else
#endif
    {
        const fo_real i_d = dot(point->direction, point->current);
        point->armature_flux[0] = L_d * i_d;
        point->armature_flux[1] = L_q * component_across(point->direction, point->current);
        point->length_by_current = (a->saliency + wrong_d * L_d - wrong_q * L_q) * i_d;
    }
}

/* Gradient of the residual by the flux, and negative gradient by the current. */
static void residual_gradients(const fo_adaptive *a, const fo_adaptive_state *s,
                               const linearisation_point *point, fo_real by_flux[FO_N],
                               fo_real by_current[FO_N]) {
#if FO_MAPPED
    if (has_map(&a->plain)) {
        const fo_map_point *f = &s->map_point;
        for (int i = 0; i < FO_N; i++) {
            by_flux[i] = f->by_flux[i];
            by_current[i] = f->by_current[i];
        }
    } else
#else
    (void)s;
#endif
    {
        const fo_real i_d = dot(point->direction, point->current);
        for (int i = 0; i < FO_N; i++) {
            const fo_real beside = point->current[i] - i_d * point->direction[i];
            by_flux[i] = point->direction[i] - a->saliency / point->length * beside;
            by_current[i] = a->plain.L_position * by_flux[i] + a->saliency * point->direction[i];
        }
    }
}

/* Updates one of the three reported stds. A row updates only one, because each std costs a
 * substitution. */
static void update_reported_std(const fo_adaptive *a, fo_adaptive_state *s, uint32_t n)
{
    if (n == 0U) {
        s->reported_std[0] = fo_learning_std(a, s, FO_PSI, 1, ZERO);
    } else if (n == 1U) {
        s->reported_std[1] = fo_learning_std(a, s, FO_RESISTANCE, 1, ZERO);
    } else {
        s->reported_std[2] = fo_learning_std(a, s, FO_INVERTER, 2, inverter_loss(a, s));
    }
}

void fo_learning_reset(const fo_adaptive *a, fo_adaptive_state *s)
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
        update_reported_std(a, s, n);
    }
    s->voltage_std = ZERO;
    s->emf_ratio = TWO;
}

static fo_real magnitude(const fo_real v[FO_N]) { return fo_sqrt(dot(v, v)); }

/* Std of the voltage at this current due to errors of the parameters. */
static void update_voltage_std(const fo_adaptive *a, fo_adaptive_state *s, const fo_interval *t)
{
    fo_real direction[FO_NA] = {0};
    for (int i = FO_RESISTANCE; i < FO_OFFSET; i++) {
        direction[FO_NF + i] = magnitude(t->sensitivity[i]);
    }
    s->voltage_std =
        fo_sqrt(fo_marginal_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction)) / a->plain.h;
    s->voltage_std_square = dot(s->plain.current[0], s->plain.current[0]);
}

void fo_learning_update_emf_ratio(const fo_adaptive *a, fo_adaptive_state *s, const fo_interval *t,
                       fo_real length, fo_real turned)
{
    if (!s->running && s->sample_index % FORGETTING_ROUND == 0U) {
        update_voltage_std(a, s, t);
    }
    const fo_real square = dot(s->plain.current[0], s->plain.current[0]);
    fo_real flux_std = s->voltage_std * a->plain.h;
    if (square > s->voltage_std_square && s->voltage_std_square > ZERO) { /* larger now */
        flux_std *= fo_sqrt(square / s->voltage_std_square);
    }
    const fo_real decay = turned < ONE ? turned : ONE;
    const fo_real growth = length > ZERO ? flux_std / length : ONE;
    const fo_real ratio = s->emf_ratio + growth - s->emf_ratio * decay;
    s->emf_ratio = ratio < TWO ? ratio : TWO;
    if (!(a->std[FO_RESISTANCE] + a->std[FO_INVERTER] > ZERO)) { /* both are known */
        s->emf_ratio = ZERO;
    }
}

/* ---- prediction: the information factor over a block ----------------------------------------- */

/* Adds process noise of this variance to both components of the flux. The information L on the flux
 * becomes (1 / L + variance)^-1. The information on the other unknowns, with the flux eliminated,
 * does not change. */
static void add_flux_process_noise(fo_adaptive_state *s, fo_real variance)
{
    fo_real *first = &s->U[0], *second = &s->U[FO_ROW(FO_NA, 1)];
    const fo_real u = first[0], d0 = s->d[0], d1 = s->d[1];
    /* the formulas for the two rows avoid a difference of large numbers */
    const fo_real a = ONE + variance * d0, b = ONE + variance * d1, square = d0 * u * u;
    const fo_real det = a * b + variance * square, u_new = u / b;
    const fo_real m0 = d0 * b / det, m1 = d1 * (a + square * variance / b) / det;
    s->d[0] = m0 > INFORMATION_MIN ? m0 : INFORMATION_MIN;
    s->d[1] = m1 > INFORMATION_MIN ? m1 : INFORMATION_MIN;
    first[0] = u_new;
    for (int j = 1; j < FO_NA - 1; j++) {
        first[j] += (u_new - u) * second[j - 1];
    }
}

/* Propagates the factor to the end of the block, where the flux is flux + time drift + sensitivity
 * p. */
static void propagate(fo_adaptive_state *s, const fo_block *b)
{
    for (int i = 0; i < FO_N; i++) {
        const fo_real by_flux[FO_N] = {i == 0 ? ONE : ZERO, i == 0 ? s->U[0] : ONE};
        fo_real *row = &s->U[FO_AT(FO_NA, i, FO_N)]; /* elements from the drift on */
        for (int j = 0; j < FO_N; j++) {
            row[j] -= b->time * by_flux[j];
        }
        for (int j = 0; j < FO_NP; j++) {
            row[FO_N + j] -= dot(by_flux, b->sensitivity[j]);
        }
    }
}

/* Forgets the drift towards its prior. */
static void forget_drift(const fo_adaptive *a, fo_adaptive_state *s, fo_real time)
{
    const fo_real share = time / DRIFT_MEMORY,
                  prior = ONE / (a->plain.drift_prior_std * a->plain.drift_prior_std);
    for (int i = FO_N; i < (int)FO_NF; i++) {
        s->d[i] += share * (prior - s->d[i]);
    }
}

static void reset_block(fo_adaptive_state *s)
{
    (void)memset(&s->now.block, 0, sizeof s->now.block);
    s->now.block.theta = s->theta;
}

/* Flux error that a parameter error causes in steady state: sensitivity / (j turned). */
static void steady_state_coupling(const fo_real sensitivity[FO_N], fo_real turned,
                                  fo_real coupling[FO_N])
{
    coupling[0] = sensitivity[1] / turned;
    coupling[1] = -sensitivity[0] / turned;
}

void fo_learning_start(const fo_adaptive *a, fo_adaptive_state *s, const fo_candidate *c,
                       const fo_manifold *m, fo_real inflation, const fo_interval *t)
{
    const fo_real psi = fo_sqrt(c->p[FO_NM - 1]), speed = a->plain.sample_time * s->tracker.speed;
    /* at least a radian per memory; at lower speed the drift is unidentifiable */
    const fo_real h = a->plain.h;
    const fo_real turned = fo_abs(speed) > h ? speed : speed < ZERO ? -h : h;
    linearisation_point point;
    fo_real by_flux[FO_N], by_current[FO_N];
    linearise_map_at_filter(a, s);
    for (int i = 0; i < FO_N; i++) {
        s->flux[i] = c->p[i];
        s->drift[i] = c->p[FO_N + i];
    }
    linearise(a, s, &point);
    residual_gradients(a, s, &point, by_flux, by_current);
    if (a->std[FO_PSI] > ZERO && !s->frozen && !(fo_abs(s->p[FO_PSI]) > ZERO)) { /* first start */
        s->p[FO_PSI] = (point.length - point.length_by_current - a->psi) / a->std[FO_PSI];
    }
    const fo_real *element = m->U;
    for (int i = 0; i < (int)FO_NF; i++) {
        fo_real row_m[FO_NM] = {0}; /* row i of the manifold's factor */
        row_m[i] = ONE;
        for (int j = i + 1; j < (int)FO_NM; j++) {
            row_m[j] = *element;
            element++;
        }
        for (int j = i + 1; j < (int)FO_NF; j++) {
            s->U[FO_AT(FO_NA, i, j)] = row_m[j];
        }
        fo_real *row = &s->U[FO_AT(FO_NA, i, FO_NF)]; /* the parameters */
        const fo_real by_psi = TWO * psi * row_m[FO_NM - 1]; /* p has the square of psi */
        for (int j = 0; j < (int)FO_NP; j++) {
            fo_real coupling[FO_N] = {0};
            if (j < (int)FO_OFFSET) {
                steady_state_coupling(t->sensitivity[j], turned, coupling);
            }
            row[j] = -(dot(coupling, row_m) + by_psi * dot(coupling, point.direction));
        }
        row[FO_PSI] = by_psi * a->std[FO_PSI];
        row[FO_INDUCTANCE] = by_psi * a->std[FO_INDUCTANCE] * point.armature_flux[0];
        row[FO_INDUCTANCE + 1] = by_psi * a->std[FO_INDUCTANCE + 1] * point.armature_flux[1] *
                                 component_across(point.direction, by_flux);
        s->d[i] = m->d[i] / inflation;
        s->z[i] = ZERO;
    }
    add_flux_process_noise(
        s, START_SHARE_OF_EMF_RATIO * s->emf_ratio * s->emf_ratio * point.length * point.length);
    for (int i = FO_N; i < (int)FO_NF; i++) { /* drift, with its voltage error */
        const fo_real variance = START_SHARE_OF_EMF_RATIO * s->voltage_std * s->voltage_std;
        s->d[i] /= ONE + s->d[i] * variance;
    }
    s->theta = c->theta;
    s->x[0] = point.direction[0];
    s->x[1] = point.direction[1];
    s->running = true;
    s->noise_level = ONE;
    s->rows = ZERO;
    s->innovation_power = ONE;
    s->rows_at_point = ZERO;
    s->variance_across = c->variance * point.length * point.length;
    s->variance_time = ZERO;
    s->growth = s->voltage_std * s->voltage_std;
    const fo_real by_L_q = a->std[FO_INDUCTANCE + 1] * point.armature_flux[1];
    s->variance_by_L_q = by_L_q * by_L_q;
    s->armature_flux_q = point.armature_flux[1];
    s->voltage_turn = ZERO;
    s->disagreement = ZERO;
    reset_block(s);
}

/* ---- measurement
 * ------------------------------------------------------------------------------ */

/* Adds a sample's residual |x| - length_by_current - psi_f and its gradients to the block. */
static void add_sample(const fo_adaptive *a, const fo_adaptive_state *s,
                       const linearisation_point *point, fo_block *b) {
    fo_real by_flux[FO_N], by_current[FO_N];
    residual_gradients(a, s, point, by_flux, by_current);
    for (int i = 0; i < FO_N; i++) {
        b->by_flux[i] += by_flux[i];
        b->by_flux_time[i] += by_flux[i] * b->time;
        b->by_parameter[FO_OFFSET + i] += a->std[FO_OFFSET + i] * by_current[i];
    }
    for (int j = FO_RESISTANCE; j < (int)FO_NP; j++) {
        b->by_parameter[j] += dot(by_flux, b->sensitivity[j]);
    }
    b->by_parameter[FO_PSI] -= a->std[FO_PSI];
    b->by_parameter[FO_INDUCTANCE] -= a->std[FO_INDUCTANCE] * point->armature_flux[0];
    b->by_parameter[FO_INDUCTANCE + 1] -= a->std[FO_INDUCTANCE + 1] * point->armature_flux[1] *
                                          component_across(point->direction, by_flux);
    b->residual +=
        point->length - point->length_by_current - (a->psi + fo_learning_value(a, s, FO_PSI));
    b->samples++;
}

/* Compares the innovation of a row, after elimination of flux and drift, with its variance.
 * Averages its power. Returns whether the row is an outlier, as after a jump of the drift. */
static bool test_innovation(fo_adaptive_state *s, const fo_real row[FO_NA], fo_real innovation,
                            fo_real information, fo_real share)
{
    fo_real direction[FO_NA];
    (void)memcpy(direction, row, sizeof direction);
    const fo_real square = innovation * innovation;
    const fo_real power = information * square, noise = ONE / information;
    const fo_real by_parameters = fo_marginal_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction);
    const fo_real ratio = square / (noise + by_parameters);
    s->rows += share;
    const fo_real gain = share / (s->rows + ONE < ROWS ? s->rows + ONE : ROWS);
    const fo_real level = s->noise_level > NOISE_LEVEL_MIN ? s->noise_level : NOISE_LEVEL_MIN;
    const bool outlier =
        s->rows > LEVEL_ROWS && square > CLIP * (level * noise + by_parameters);
    const fo_real power_max = CLIP * s->noise_level;
    s->noise_level += gain * ((power < power_max ? power : power_max) - s->noise_level);
    const fo_real ratio_max = CLIP * (ONE + s->innovation_power);
    s->innovation_power +=
        TWO / ROWS * share * ((ratio < ratio_max ? ratio : ratio_max) - s->innovation_power);
    return outlier;
}

/* Counts the row at the present operating point. Returns the number of rows at this point, at least
 * 1. */
static fo_real count_rows_at_point(const fo_adaptive *a, fo_adaptive_state *s,
                                   const linearisation_point *point, fo_real speed, fo_real share) {
    const fo_real now[3] = {dot(point->direction, point->current),
                            component_across(point->direction, point->current), speed};
    const fo_real speeds = fo_abs(s->operating_point[2]) + fo_abs(speed);
    const fo_real scale[3] = {a->over_rated, a->over_rated, speeds > ZERO ? ONE / speeds : ZERO};
    fo_real moved = ZERO;
    for (int i = 0; i < 3; i++) {
        const fo_real change = (now[i] - s->operating_point[i]) * scale[i];
        moved += change * change;
    }
    s->rows_at_point =
        s->rows_at_point / (ONE + moved / (NEW_POINT * NEW_POINT) * s->rows_at_point) + share;
    const fo_real gain = s->rows_at_point > ONE ? ONE / s->rows_at_point : ONE;
    for (int i = 0; i < 3; i++) {
        s->operating_point[i] += gain * (now[i] - s->operating_point[i]);
    }
    return s->rows_at_point > ONE ? s->rows_at_point : ONE;
}

/* Adds process noise of this variance to the resistance. The information on the other parameters,
 * with the resistance eliminated, does not change. The random step w of R is an unknown: R - w, the
 * earlier R, replaces R in the rows, and w is eliminated. */
static void add_resistance_process_noise(fo_adaptive_state *s, fo_real variance)
{
    const int psi = FO_NF + (int)FO_PSI, r = FO_NF + (int)FO_RESISTANCE;
    fo_real *row_psi = &s->U[FO_AT(FO_NA, psi, r)];
    const fo_real *row_r = &s->U[FO_AT(FO_NA, r, r + 1)];
    const fo_real share = row_psi[0], step = ONE + variance * s->d[r];
    const fo_real gain = -variance * s->d[r] / step; /* gain of the row of R in the row of w */
    s->d[psi] /= ONE + variance * share * share * s->d[psi] / step;
    s->d[r] /= step;
    s->z[psi] += share * gain * s->z[r];
    row_psi[0] += share * gain;
    for (int j = 0; j < (int)FO_NA - 1 - r; j++) {
        row_psi[1 + j] += share * gain * row_r[j];
    }
}

void fo_learning_widen_resistance(const fo_adaptive *a, fo_adaptive_state *s, fo_real stds)
{
    const fo_real limit = (fo_real)1e3; /* above it, the prior is negligible; also replaces NaN */
    const fo_real std = fo_abs(stds) < limit ? stds : limit;
    add_resistance_process_noise(s, std * std);
    for (uint32_t n = 0U; n < 3U; n++) {
        update_reported_std(a, s, n);
    }
}

/* Moves the prior mean of a parameter by `shift` stds. Values that the data determine do not
 * change; values that the prior determines move with it. Let A be the information matrix, in which
 * the prior is 1, and A p = b. Then b becomes b - (A - 1) shift: z = U p decreases by `shift` times
 * its column, and b gains the part of the prior. */
static void move_prior_mean(fo_adaptive_state *s, int n, fo_real shift)
{
    const int column = FO_NF + n;
    fo_real gained[FO_NA] = {0}, before[FO_NA], after[FO_NA];
    fo_solve(FO_NA, s->U, s->z, FO_NF, FO_NA, before);
    for (int i = FO_NF; i < column; i++) {
        s->z[i] -= s->U[FO_AT(FO_NA, i, column)] * shift;
    }
    s->z[column] -= shift;
    for (int j = column; j < (int)FO_NA && !s->frozen; j++) { /* U'd gained = shift e_n */
        fo_real sum = j == column ? shift : ZERO;
        for (int i = column; i < j; i++) {
            sum -= s->U[FO_AT(FO_NA, i, j)] * s->d[i] * gained[i];
        }
        gained[j] = sum / s->d[j];
        s->z[j] += gained[j];
    }
    fo_solve(FO_NA, s->U, s->z, FO_NF, FO_NA, after);
    for (int j = FO_NF; j < (int)FO_NA; j++) {
        after[j] -= before[j];
        if (j < (int)FO_NF + (int)FO_CURVE) { /* the curve is a considered parameter */
            s->p[j - (int)FO_NF] += after[j];
        }
    }
    after[column] += shift; /* the value changes, not its error */
    if (s->running) {
        fo_solve(FO_NA, s->U, s->z, 0, FO_NF, after);
        for (int i = 0; i < FO_N; i++) {
            s->flux[i] += after[i];
            s->drift[i] += after[FO_N + i];
        }
    }
}

void fo_learning_prior_means(const fo_adaptive *a, fo_real means[FO_PRIOR_MEANS])
{
    means[0] = a->psi;
    means[1] = (fo_real)24 * a->plain.hR[0][0] / a->volt;
    means[2] = a->inverter_mean;
}

void fo_learning_move_prior_means(const fo_adaptive *a, fo_adaptive_state *s,
                                  const fo_real before[FO_PRIOR_MEANS]) {
    static const int places[FO_PRIOR_MEANS + 1] = {FO_PSI, FO_RESISTANCE, FO_INVERTER,
                                                   FO_INVERTER + 1};
    fo_real now[FO_PRIOR_MEANS];
    fo_learning_prior_means(a, now);
    for (int i = 0; i < (int)FO_PRIOR_MEANS + 1; i++) {
        const int n = places[i], mean = i < (int)FO_PRIOR_MEANS ? i : (int)FO_PRIOR_MEANS - 1;
        if (a->std[n] > ZERO) {
            move_prior_mean(s, n, (now[mean] - before[mean]) / a->std[n]);
        }
    }
}

/* Forgets the parameters towards their prior. In a round of rows all information is forgotten once,
 * and the prior of each parameter is re-injected once. */
static void forget_parameters(const fo_adaptive *a, fo_adaptive_state *s, fo_real time)
{
    s->forgotten += time * a->slow;
    s->reinject_index = s->reinject_index + 1U < FORGETTING_ROUND ? s->reinject_index + 1U : 0U;
    if (s->reinject_index < (uint32_t)FO_CURVE) {
        const int n = FO_NF + (int)s->reinject_index;
        fo_real row[FO_NA] = {0}, mean = ZERO, information = s->forgotten_before;
        row[n] = ONE;
        fo_add_row_to(FO_NA, s->U, s->d, s->z, n, FO_NF + FO_CURVE, row, &mean, &information);
    } else if (s->reinject_index == FORGETTING_ROUND - 1U) {
        s->forgotten_before = s->forgotten < ONE / TWO ? s->forgotten : ONE / TWO;
        for (int j = 0; j < (int)FO_CURVE; j++) {
            s->d[FO_NF + j] *= ONE - s->forgotten_before;
        }
        add_resistance_process_noise(s, HEAT_WALK * HEAT_WALK * s->forgotten_before);
        s->forgotten = ZERO;
    } else {
        /* no work in this row of the round */
    }
}

/* If the estimated inverter loss is negative, moves the solution to the most likely parameters with
 * a loss of zero, because no inverter adds voltage. */
static void constrain_inverter_loss(const fo_adaptive *a, const fo_adaptive_state *s,
                                    fo_real x[FO_NA]) {
    const fo_real volts = TWO * a->inverter_mean + a->std[FO_INVERTER] * x[FO_NF + FO_INVERTER] +
                          a->std[FO_INVERTER + 1] * x[FO_NF + FO_INVERTER + 1];
    if (volts < ZERO) {
        fo_real direction[FO_NA] = {0}, y[FO_NA] = {0};
        direction[FO_NF + FO_INVERTER] = a->std[FO_INVERTER];
        direction[FO_NF + FO_INVERTER + 1] = a->std[FO_INVERTER + 1];
        const fo_real variance = fo_marginal_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction);
        for (int j = FO_NF; j < FO_NA; j++) { /* computes y, where U'y = direction */
            y[j] = direction[j] / s->d[j];
        }
        fo_solve(FO_NA, s->U, y, FO_NF, FO_NA, direction);
        for (int j = FO_NF; j < (int)FO_NF + (int)FO_CURVE; j++) {
            x[j] -= direction[j] * volts / variance;
        }
    }
}

/* Measurement update of the parameters by a row without flux and drift. */
static void update_parameters(const fo_adaptive *a, fo_adaptive_state *s, fo_real row[FO_NA],
                              fo_real innovation, fo_real information)
{
    fo_real rhs = innovation, weight = information, x[FO_NA];
    for (int j = 0; j < FO_NP; j++) { /* relative to the prior mean */
        rhs += row[FO_NF + j] * s->p[j];
    }
    fo_add_row_to(FO_NA, s->U, s->d, s->z, FO_NF, FO_NF + FO_CURVE, row, &rhs, &weight);
    fo_solve(FO_NA, s->U, s->z, FO_NF, FO_NA, x);
    constrain_inverter_loss(a, s, x);
    for (int j = 0; j < (int)FO_CURVE; j++) { /* the curve is a considered parameter */
        s->p[j] = x[FO_NF + j];
    }
}

/* Updates flux and drift by the row, given the change of the parameters. Linearises again at the
 * new values. */
static void update_flux(fo_adaptive_state *s, const fo_real before[FO_NP])
{
    fo_real x[FO_NA];
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

fo_real fo_learning_variance_growth(const fo_adaptive *a, const fo_adaptive_state *s)
{
    const fo_real t = s->now.block.time;
    const fo_real square = dot(s->plain.current[0], s->plain.current[0]), before = s->voltage_std_square;
    const fo_real change = (square - before) * a->over_rated * a->over_rated;
    const bool changed = fo_abs(change) > NEW_POINT * NEW_POINT;
    const fo_real raw = s->voltage_std * s->voltage_std * (square > before && before > ZERO ? square / before : ONE);
    return (changed && raw > s->growth ? raw : s->growth) * t * t;
}

/* Marginal variance of the flux across the position vector: one part with L_q known, and the part
 * of L_q. Since the last row the drift has moved the flux in proportion to time, and each parameter
 * in proportion to its sensitivity. At steady load the row has correlated these errors with the
 * flux, and they add almost nothing. After a change of load they add their whole variance. */
static void update_marginal_variance(const fo_adaptive *a, fo_adaptive_state *s,
                                     const linearisation_point *point) {
    enum { L_Q = (int)FO_NF + (int)FO_INDUCTANCE + 1, TAIL = (int)FO_NA - L_Q };
    const fo_block *b = &s->now.block;
    fo_real direction[FO_NA] = {0}, tail[TAIL];
    direction[0] = -point->direction[1];
    direction[1] = point->direction[0];
    for (int i = 0; i < FO_N; i++) {
        const fo_real by_offset = a->plain.L_position * a->std[FO_OFFSET + i];
        direction[FO_N + i] = b->time * direction[i];
        direction[FO_NF + FO_OFFSET + i] = by_offset * direction[i];
    }
    for (int j = FO_RESISTANCE; j < (int)FO_NP; j++) {
        direction[FO_NF + j] += dot(direction, b->sensitivity[j]);
    }
    const fo_real level = s->noise_level > NOISE_LEVEL_MIN ? s->noise_level : NOISE_LEVEL_MIN;
    s->variance_across = level * fo_marginal_variance(FO_NA, s->U, s->d, 0, FO_NF, direction);
    s->variance_across += fo_marginal_variance(FO_NA, s->U, s->d, FO_NF, L_Q, direction);
    (void)memcpy(tail, &direction[L_Q], sizeof tail);
    const fo_real with_L_q_known = fo_marginal_variance(FO_NA, s->U, s->d, L_Q, FO_NA, direction);
    s->variance_across += with_L_q_known;
    (void)memcpy(&direction[L_Q], tail, sizeof tail);
    direction[L_Q] -= a->std[FO_INDUCTANCE + 1] * point->armature_flux[1];
    s->variance_by_L_q =
        fo_marginal_variance(FO_NA, s->U, s->d, L_Q, FO_NA, direction) - with_L_q_known;
    s->armature_flux_q = point->armature_flux[1];
    s->variance_time = b->time;
}

/* Time update over the block. The process noise includes effects that no parameter describes. */
static void predict_block(const fo_adaptive *a, fo_adaptive_state *s, const fo_block *b)
{
    const fo_real step = a->unmodelled * b->time;
    propagate(s, b);
    add_flux_process_noise(s, step * step + b->unmodelled * b->unmodelled);
    if (has_cage_map(&a->plain)) {
        const fo_real q = CAGE_WALK * CAGE_WALK * b->time / (a->std[FO_PSI] * a->std[FO_PSI]);
        s->d[FO_NF + FO_PSI] /= ONE + s->d[FO_NF + FO_PSI] * q;
    }
    forget_drift(a, s, b->time);
}

/* Regressor of the block's averaged residual, for flux and drift at the block's end. Returns the
 * innovation, which is minus that residual. */
static fo_real block_row(const fo_block *b, fo_real row[FO_NA])
{
    const fo_real over = ONE / (fo_real)b->samples;
    for (int i = 0; i < FO_N; i++) {
        row[i] = b->by_flux[i] * over;
        row[FO_N + i] = b->by_flux_time[i] * over - b->time * row[i];
    }
    for (int j = 0; j < FO_NP; j++) {
        row[FO_NF + j] = b->by_parameter[j] * over - dot(row, b->sensitivity[j]);
    }
    return -b->residual * over;
}

/* Variance of a row due to considered parameters, which no column of the row describes: harmonics
 * of the magnet flux, unequal gains of the current sensors, lags of voltages and currents. All rows
 * at one operating point have nearly the same error. `speed` is in radians per memory. */
static fo_real systematic_variance(const fo_adaptive *a, const linearisation_point *point,
                                   fo_real speed)
{
    const fo_observer *o = &a->plain;
    const fo_real omega = speed * o->h / o->sample_time;
    const fo_real late = omega * omega * (a->lag_std * a->lag_std + a->delay_std * a->delay_std);
    return dot(point->armature_flux, point->armature_flux) * late;
}

static fo_real oscillating_variance(const fo_adaptive *a, const linearisation_point *point)
{
    const fo_real harmonics = SIXTH * a->magnet_error;
    return harmonics * harmonics + dot(point->armature_flux, point->armature_flux) *
                                       (a->current_gain_std * a->current_gain_std);
}

/* Measurement update by the block's row: first of flux and drift, then of the parameters. The
 * weight is the row's `share` of a full block. The row is linear, but the length is not: an error e
 * across the position vector x adds e^2 / (2 |x|). Its mean is subtracted, and its variance is part
 * of the row's. */
static void update_by_block(const fo_adaptive *a, fo_adaptive_state *s, fo_real turned,
                               fo_real share)
{
    const fo_block *b = &s->now.block;
    const fo_real over = ONE / (fo_real)b->samples;
    linearisation_point point;
    fo_real row[FO_NA], before[FO_NP];
    fo_real innovation = block_row(b, row);
    linearise(a, s, &point);
    const fo_real curvature = (s->variance_across + fo_learning_variance_growth(a, s)) / point.length;
    innovation -= curvature / TWO; /* mean of the error's square */
    fo_real information = share / (MODEL * MODEL + a->through_L * s->plain.noise_inflation * over +
                                   curvature * curvature / TWO);
    fo_add_row_to(FO_NA, s->U, s->d, s->z, 0, FO_NF, row, &innovation, &information);
    const bool informative = information > ZERO;
    const bool outlier = informative && test_innovation(s, row, innovation, information, share);
    if (outlier) {
        forget_drift(a, s, DRIFT_MEMORY); /* forget the drift completely */
    }
    linearise(a, s, &point);
    const fo_real speed = turned / b->time, unmodelled = b->unmodelled / b->time;
    const fo_real rows = count_rows_at_point(a, s, &point, speed, share);
    const fo_real shape = speed > ZERO ? unmodelled / speed : ZERO;
    const fo_real level = s->noise_level > ONE ? s->noise_level : ONE;
    for (int j = 0; j < FO_NP; j++) {
        before[j] = s->p[j];
    }
    if (informative && !outlier && !s->frozen && s->emf_ratio < EMF_RATIO_LIMIT && speed > ZERO) {
        const fo_real variance = ONE / information + systematic_variance(a, &point, speed);
        const fo_real weight = ONE / ((rows * variance + shape * shape + oscillating_variance(a, &point)) * level);
        if (weight > ZERO) {
            update_parameters(a, s, row, innovation, weight);
            forget_parameters(a, s, b->time);
        }
    }
    update_flux(s, before);
}

/* Ends a block: prediction over the block, measurement update, variances of the new estimate. */
static void finish_block(const fo_adaptive *a, fo_adaptive_state *s, const fo_interval *t,
                         fo_real turned)
{
    const fo_block *b = &s->now.block;
    const fo_real share = turned < BLOCK ? turned / BLOCK : ONE;
    linearisation_point point;
    predict_block(a, s, b);
    if (b->samples > 0U && share > (fo_real)1e-6) {
        update_by_block(a, s, turned, share);
    }
    linearise(a, s, &point);
    s->theta = fo_atan2(point.x[1], point.x[0]);
    {
        const fo_real time = b->time > ZERO ? b->time : a->plain.h;
        fo_real a0[FO_N] = {-point.direction[1], point.direction[0]}, a1[FO_N];
        fo_real side = wrap(s->theta - b->theta) < ZERO ? -turned : turned;
        linearisation_point p1 = point;
        fo_block next = *b;
        turn(a0, side, a1);
        p1.direction[0] = a1[1];
        p1.direction[1] = -a1[0];
        for (int j = 0; j < (int)FO_NP; j++) { turn(b->sensitivity[j], side, next.sensitivity[j]); }
        fo_block keep = *b;
        s->now.block = next;
        update_marginal_variance(a, s, &p1);
        const fo_real v1 = s->variance_across;
        s->now.block = keep;
        reset_block(s);
        update_marginal_variance(a, s, &point);
        s->growth = v1 > s->variance_across ? (v1 - s->variance_across) / (time * time) : ZERO;
    }
    update_voltage_std(a, s, t);
    s->report_index = s->report_index < 2U ? s->report_index + 1U : 0U;
    update_reported_std(a, s, s->report_index);
}

/* Is the estimate finite, and the flux plausible? */
static bool is_plausible(const fo_adaptive_state *s)
{
    fo_real sum = s->noise_level + s->innovation_power + s->variance_across;
    for (int i = 0; i < FO_NP; i++) {
        sum += s->p[i];
    }
    for (int i = 0; i < FO_N; i++) {
        sum += s->drift[i];
    }
    return sum - sum == ZERO && dot(s->flux, s->flux) < RUNAWAY;
}

fo_real fo_learning_step(const fo_adaptive *a, fo_adaptive_state *s, const fo_interval *t,
                           bool measured)
{
    const fo_observer *o = &a->plain;
    fo_block *b = &s->now.block;
    linearisation_point point;
    linearise_map_at_filter(a, s);
    for (int i = 0; i < FO_N; i++) {
        s->flux[i] += t->v[i] + o->h * s->drift[i];
        for (int j = FO_RESISTANCE; j < (int)FO_NP; j++) {
            b->sensitivity[j][i] += t->sensitivity[j][i];
        }
    }
    b->time += o->h;
    b->unmodelled += o->h * fo_learning_unmodelled_voltage(a, s);
    linearise(a, s, &point);
    bool plausible = point.length * point.length > o->square_min / (fo_real)16;
    if (plausible) {
        if (measured) {
            add_sample(a, s, &point, b);
        }
        const fo_real theta = fo_atan2(point.x[1], point.x[0]);
        const fo_real turned = fo_abs(wrap(theta - b->theta));
        s->theta = theta;
        if (turned >= BLOCK || b->time >= BLOCK_MAX) {
            finish_block(a, s, t, turned);
            linearise(a, s, &point);
        } else if (fo_learning_variance_growth(a, s) > GROWTH_MAX * s->variance_across) {
            update_marginal_variance(a, s, &point);
        } else {
            /* the last variance is still valid */
        }
        const fo_real change =
            a->std[FO_INDUCTANCE + 1] * (point.armature_flux[1] - s->armature_flux_q);
        s->variance_by_L_q_now = s->variance_by_L_q + change * change;
        s->x[0] = point.direction[0];
        s->x[1] = point.direction[1];
        plausible = is_plausible(s) && point.length > ZERO;
    }
    return plausible ? point.length : ZERO;
}
