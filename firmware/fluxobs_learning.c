/* SPDX-License-Identifier: MIT */
#include "fluxobs_learning.h"

#include "fluxobs_internal.h"
#include "fluxobs_relation.h"

#include <string.h>

/* ---- thresholds: unit, reason, and what determined their value ----------------------------- */

/* Mean of the sixth harmonic over BLOCK, as a share of its amplitude [1]: sinc(3 BLOCK). */
static const fo_real SIXTH = (fo_real)0.3;
/* Std of a row due to model errors [flux bases]: no machine satisfies its relation better. */
static const fo_real MODEL = (fo_real)0.002;
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
/* Least information on the flux [1 / flux bases^2]: the std is a thousand times any flux. */
static const fo_real INFORMATION_MIN = (fo_real)1e-6;
/* Std of the angle above which rows do not update the parameters [rad]: 20 degrees. There the
 * part of the length that is not linear is 6 % of it. */
static const fo_real LEARN_STD = PI / (fo_real)9;
/* Least rotation of a block with a row [rad]. */
static const fo_real TURNED_MIN = (fo_real)1e-6;
/* Speed below which all speeds are the same operating point [rad per memory]. At rest the noise of
 * the speed made a new one of every row: psi_f, which no row tells there, rose by half in 20 s
 * (benchmarks/from_rest.py). */
static const fo_real SPEED_MIN = (fo_real)1;
/* Rows of a round, in which each parameter is forgotten and its prior re-injected once [1]. */
static const uint32_t FORGETTING_ROUND = 16U;
/* A row of a block is used if its weight varies within the block by more than this share [1]: the
 * rows with the weights h differ from the first only if the rotor turns by a quarter of a turn. */
static const fo_real ROW_MIN = (fo_real)0.1;
/* A row of the direction is used if this share of the ripple is not noise [1]: noise has a share of
 * 0 +- 1 / sqrt(samples). */
static const fo_real RIPPLE_MIN = (fo_real)0.5;
/* Squared ripple of 1 / |x| below which it is rounding [1 / flux bases^2]: |x| is near one, and
 * single precision has 1e-7 of it. */
static const fo_real RIPPLE_LEAST = (fo_real)1e-12;
/* The changes du must alternate from sample to sample: their correlation with the ones before is -1
 * for a ripple at half the sampling rate, -1/2 for noise, near 1 for loads, offsets and unequal gains
 * of the sensors. These make the angle ripple, too: with them, a tenth of 128 drives without
 * injection had a row that was sure and wrong [1]. */
static const fo_real ALTERNATING_MIN = (fo_real)0.75;
/* Std of a direction due to a tilt of the axis by cross-saturation, eddy currents or the part of the
 * inverter's loss that no column describes [rad]: 0.3 degrees. It is part of the position's std;
 * without it, two stds hold on 96 % of the rows of a saturated reluctance machine at rest
 * (benchmarks/at_rest.py), and with a degree the std of a linear one is ten times its error. */
static const fo_real TILT = PI / (fo_real)600;
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

fo_real fo_learning_std(const fo_adaptive *a, const fo_learner *s, int n, int count)
{
    fo_real direction[FO_NA] = {0};
    for (int i = n; i < n + count; i++) {
        direction[FO_NF + i] = a->std[i];
    }
    return fo_sqrt(fo_marginal_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction));
}

void fo_learning_values(const fo_adaptive *a, const fo_learner *s, fo_real value[FO_NP])
{
    for (int j = 0; j < (int)FO_NP; j++) {
        value[j] = a->std[j] * s->p[j];
    }
}

/* Updates one of the three reported stds. A block updates only one, because each std costs a
 * substitution. */
static void update_reported_std(const fo_adaptive *a, fo_learner *s, uint32_t n)
{
    static const int first[3] = {FO_PSI, FO_RESISTANCE, FO_INVERTER};
    fo_learning_report *r = &s->report;
    r->reported_std[n] = fo_learning_std(a, s, first[n], n == 2U ? 2 : 1);
    if (n == 2U) {
        const fo_real loss = TWO * a->inverter_mean + a->std[FO_INVERTER] * s->p[FO_INVERTER] +
                             a->std[FO_INVERTER + 1] * s->p[FO_INVERTER + 1];
        r->loss_size = fo_sqrt(loss * loss + r->reported_std[2] * r->reported_std[2]) * a->volt /
                       a->plain.h;
    }
}

static void update_reported_stds(const fo_adaptive *a, fo_learner *s)
{
    for (uint32_t n = 0U; n < 3U; n++) {
        update_reported_std(a, s, n);
    }
}

void fo_learning_reset(const fo_adaptive *a, fo_learner *s)
{
    (void)memset(s->U, 0, sizeof s->U);
    for (int i = 0; i < FO_NA; i++) {
        s->d[i] = ONE;
        s->z[i] = ZERO;
    }
    for (int i = 0; i < FO_NP; i++) {
        s->p[i] = ZERO;
    }
    (void)memset(&s->report, 0, sizeof s->report);
    update_reported_stds(a, s);
    fo_learning_prior_means(a, s->means);
}

void fo_learning_update_voltage_std(const fo_adaptive *a, fo_learner *s, const fo_block_end *end)
{
    fo_real direction[FO_NA] = {0};
    const fo_real *std = a->std;
    direction[FO_NF + FO_RESISTANCE] = std[FO_RESISTANCE] * fo_sqrt(dot(end->mean_current,
                                                                        end->mean_current));
    for (int n = 0; n < 2; n++) {
        direction[FO_NF + FO_INVERTER + n] =
            std[FO_INVERTER + n] * fo_sqrt(dot(end->signs[n], end->signs[n]));
    }
    s->report.voltage_std =
        fo_sqrt(fo_marginal_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction)) * a->volt /
        a->plain.h;
    s->report.voltage_std_square = dot(end->current, end->current);
}

/* ---- prediction: the information factor over a block ----------------------------------------- */

/* Adds process noise of this variance to both components of the flux. The information L on the flux
 * becomes (1 / L + variance)^-1. The information on the other unknowns, with the flux eliminated,
 * does not change. */
static void add_flux_process_noise(fo_learner *s, fo_real variance)
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
static void propagate(const fo_adaptive *a, fo_learner *s, const fo_block *b)
{
    for (int i = 0; i < FO_N; i++) {
        const fo_real by_flux[FO_N] = {i == 0 ? ONE : ZERO, i == 0 ? s->U[0] : ONE};
        fo_real *row = &s->U[FO_AT(FO_NA, i, FO_N)]; /* elements from the drift on */
        for (int j = 0; j < FO_N; j++) {
            row[j] -= b->time * by_flux[j];
        }
        for (int j = 0; j < (int)FO_NS; j++) {
            const int n = (int)FO_RESISTANCE + j;
            row[(int)FO_N + n] -= a->std[n] * dot(by_flux, b->sensitivity[j]);
        }
    }
}

/* Forgets the drift towards its prior. */
static void forget_drift(const fo_adaptive *a, fo_learner *s, fo_real time)
{
    const fo_real share = time / DRIFT_MEMORY,
                  prior = ONE / (a->plain.drift_prior_std * a->plain.drift_prior_std);
    for (int i = FO_N; i < (int)FO_NF; i++) {
        s->d[i] += share * (prior - s->d[i]);
    }
}

/* Time update over the block. The process noise includes effects that no parameter describes. */
static void predict_block(const fo_adaptive *a, fo_learner *s, const fo_block *b)
{
    const fo_real step = a->unmodelled * b->time;
    propagate(a, s, b);
    add_flux_process_noise(s, step * step + b->unmodelled * b->unmodelled);
    if (has_cage_map(&a->plain)) {
        const fo_real q = CAGE_WALK * CAGE_WALK * b->time / (a->std[FO_PSI] * a->std[FO_PSI]);
        s->d[FO_NF + FO_PSI] /= ONE + s->d[FO_NF + FO_PSI] * q;
    }
    forget_drift(a, s, b->time);
}

/* ---- start ---------------------------------------------------------------------------------- */

/* Flux error that a voltage error in proportion to `vector` causes in steady state, at this
 * rotation per sample: the voltage over a sample, divided by j turned. */
static void steady_state_coupling(const fo_real vector[FO_N], fo_real scale, fo_real turned,
                                  fo_real coupling[FO_N])
{
    coupling[0] = scale * vector[1] / turned;
    coupling[1] = -scale * vector[0] / turned;
}

void fo_learning_start(const fo_adaptive *a, fo_learner *s, const fo_candidate *c,
                       const fo_manifold *m, fo_real inflation, const fo_block_end *end)
{
    const fo_real psi = fo_sqrt(c->p[FO_NM - 1]), speed = a->plain.sample_time * end->speed;
    /* at least a radian per memory; at lower speed the drift is unidentifiable */
    const fo_real h = a->plain.h;
    const fo_real turned = fo_abs(speed) > h ? speed : speed < ZERO ? -h : h;
    fo_learning_report *r = &s->report;
    fo_linearisation point;
    fo_real by_flux[FO_N], by_current[FO_N], value[FO_NP];
    fo_learning_values(a, s, value);
    fo_linearise(a, value, c->p, end->current, map_of(end), &point);
    fo_residual_gradients(a, map_of(end), &point, by_flux, by_current);
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
            row[j] = ZERO;
        }
        for (int j = 0; j < 3; j++) { /* resistance and both parts of the inverter's loss */
            const fo_real *vector = j == 0 ? end->mean_current : end->signs[j - 1];
            fo_real coupling[FO_N];
            steady_state_coupling(vector, -a->std[FO_RESISTANCE + j] * a->volt, turned, coupling);
            row[FO_RESISTANCE + j] =
                -(dot(coupling, row_m) + by_psi * dot(coupling, point.direction));
        }
        row[FO_PSI] = by_psi * a->std[FO_PSI];
        row[FO_INDUCTANCE] = by_psi * a->std[FO_INDUCTANCE] * point.armature_flux[0];
        row[FO_INDUCTANCE + 1] = by_psi * a->std[FO_INDUCTANCE + 1] * point.armature_flux[1] *
                                 component_across(point.direction, by_flux);
        s->d[i] = m->d[i] / inflation;
        s->z[i] = ZERO;
    }
    const fo_real square = point.length * point.length;
    add_flux_process_noise(s,
                           START_SHARE_OF_EMF_RATIO * end->emf_ratio * end->emf_ratio * square);
    for (int i = FO_N; i < (int)FO_NF; i++) { /* drift, with its voltage error */
        const fo_real variance = START_SHARE_OF_EMF_RATIO * r->voltage_std * r->voltage_std;
        s->d[i] /= ONE + s->d[i] * variance;
    }
    s->noise_level = ONE;
    s->rows_at_point = ZERO;
    r->rows = ZERO;
    r->innovation_power = ONE;
    r->variance_across = c->variance * square;
    r->growth = r->voltage_std * r->voltage_std;
    const fo_real by_L_q = a->std[FO_INDUCTANCE + 1] * point.armature_flux[1];
    r->variance_by_L_q = by_L_q * by_L_q;
    r->armature_flux_q = point.armature_flux[1];
    r->drift_std = ONE;
}

/* ---- measurement: the rows of a block -------------------------------------------------------- */

/* A block's rows with the weights 1, h_0, h_1: regressors of flux and drift at its end, and of the
 * parameters; innovations; shares of the block's information. */
typedef struct {
    fo_real row[FO_NW][FO_NA], innovation[FO_NW], share[FO_NW];
} block_rows;

/* Weighted sums over the block. */
static void sum_rows(const fo_adaptive *a, const fo_block *b, const fo_sums *sums, block_rows *r)
{
    (void)memset(r, 0, sizeof *r);
    for (int w = 0; w < (int)FO_NW; w++) {
        fo_real *row = r->row[w];
        for (int i = 0; i < FO_N; i++) {
            row[i] = sums_of_h(sums, w)[i];
            row[FO_N + i] = sums_of_th(sums, w)[i] - b->time * row[i];
        }
        row[FO_NF + FO_PSI] = -a->std[FO_PSI] * sum_of_weight(sums, w);
        for (int j = 1; j < (int)FO_NP; j++) {
            row[FO_NF + j] = a->std[j] * sums->by_parameter[j - 1][w];
        }
        for (int j = 0; j < (int)FO_NS; j++) {
            const int n = (int)FO_RESISTANCE + j;
            row[FO_NF + n] -= a->std[n] * dot(row, b->sensitivity[j]);
        }
        r->innovation[w] = -sums->residual[w];
    }
}

/* Subtracts a multiple of row v from row w. */
static void subtract_row(block_rows *r, int w, int v, fo_real factor)
{
    for (int j = 0; j < (int)FO_NA; j++) {
        r->row[w][j] -= factor * r->row[v][j];
    }
    r->innovation[w] -= factor * r->innovation[v];
}

/* Makes the errors of the rows independent: the sums of weights W'W = L D L', and the rows become
 * D^-1 L^-1 times the sums. Row w contains a share D_w of the information. */
static void decorrelate(const fo_sums *sums, block_rows *r)
{
    const fo_real n = (fo_real)sums->samples;
    fo_real D[FO_NW] = {n, ZERO, ZERO};
    for (int w = 1; w < (int)FO_NW; w++) {
        const fo_real factor = sums->h[w - 1] / n;
        D[w] = sums->hh[w == 1 ? 0 : 2] - factor * sums->h[w - 1];
        subtract_row(r, w, 0, factor);
    }
    if (D[1] > ROW_MIN * n) {
        const fo_real factor = (sums->hh[1] - sums->h[0] * sums->h[1] / n) / D[1];
        D[2] -= factor * factor * D[1];
        subtract_row(r, 2, 1, factor);
    }
    for (int w = 0; w < (int)FO_NW; w++) {
        r->share[w] = D[w] > ROW_MIN * n ? D[w] / n : ZERO;
        const fo_real over = D[w] > ZERO ? ONE / D[w] : ZERO;
        for (int j = 0; j < (int)FO_NA; j++) {
            r->row[w][j] *= over;
        }
        r->innovation[w] *= over;
    }
}

/* Compares the innovation of a row, after elimination of flux and drift, with its variance.
 * Averages its power. Returns whether the row is an outlier, as after a jump of the drift. */
static bool test_innovation(fo_learner *s, const fo_real row[FO_NA], fo_real innovation,
                            fo_real information, fo_real share)
{
    fo_real direction[FO_NA];
    (void)memcpy(direction, row, sizeof direction);
    const fo_real square = innovation * innovation;
    const fo_real power = information * square, noise = ONE / information;
    const fo_real by_parameters = fo_marginal_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction);
    const fo_real ratio = square / (noise + by_parameters);
    s->report.rows += share;
    const fo_real gain = share / (s->report.rows + ONE < ROWS ? s->report.rows + ONE : ROWS);
    const fo_real level = s->noise_level > NOISE_LEVEL_MIN ? s->noise_level : NOISE_LEVEL_MIN;
    const bool outlier =
        s->report.rows > LEVEL_ROWS && square > CLIP * (level * noise + by_parameters);
    const fo_real power_max = CLIP * s->noise_level;
    s->noise_level += gain * ((power < power_max ? power : power_max) - s->noise_level);
    const fo_real ratio_max = CLIP * (ONE + s->report.innovation_power);
    s->report.innovation_power +=
        TWO / ROWS * share * ((ratio < ratio_max ? ratio : ratio_max) - s->report.innovation_power);
    return outlier;
}

/* Counts the rows at the present operating point. Returns the number of rows at this point, at
 * least 1. */
static fo_real count_rows_at_point(const fo_adaptive *a, fo_learner *s,
                                   const fo_linearisation *point, fo_real speed, fo_real share)
{
    const fo_real now[3] = {dot(point->direction, point->current),
                            component_across(point->direction, point->current), speed};
    const fo_real speeds = fo_abs(s->operating_point[2]) + fo_abs(speed) + TWO * SPEED_MIN;
    const fo_real scale[3] = {a->over_rated, a->over_rated, ONE / speeds};
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
static void add_resistance_process_noise(fo_learner *s, fo_real variance)
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

void fo_learning_widen_resistance(const fo_adaptive *a, fo_learner *s, fo_real stds)
{
    const fo_real limit = (fo_real)1e3; /* above it, the prior is negligible; also replaces NaN */
    const fo_real std = fo_abs(stds) < limit ? stds : limit;
    add_resistance_process_noise(s, std * std);
    update_reported_stds(a, s);
}

/* Moves the prior mean of a parameter by `shift` stds. Values that the data determine do not
 * change; values that the prior determines move with it. Let A be the information matrix, in which
 * the prior is 1, and A p = b. Then b becomes b - (A - 1) shift: z = U p decreases by `shift` times
 * its column, and b gains the part of the prior. `flux` and `drift` move by what the factor ties
 * them to the parameters. */
static void move_prior_mean(fo_learner *s, int n, fo_real shift, fo_real flux[FO_N],
                            fo_real drift[FO_N])
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
        s->p[j - (int)FO_NF] += after[j];
    }
    after[column] += shift; /* the value changes, not its error */
    fo_solve(FO_NA, s->U, s->z, 0, FO_NF, after);
    for (int i = 0; i < FO_N; i++) {
        flux[i] += after[i];
        drift[i] += after[FO_N + i];
    }
}

void fo_learning_prior_means(const fo_adaptive *a, fo_real means[FO_PRIOR_MEANS])
{
    means[0] = a->psi;
    means[1] = (fo_real)24 * a->plain.hR[0][0] / a->volt;
    means[2] = a->inverter_mean;
}

void fo_learning_shift_values(const fo_real before[FO_PRIOR_MEANS],
                              const fo_real now[FO_PRIOR_MEANS], fo_real value[FO_NP])
{
    value[FO_PSI] += before[0] - now[0];
    value[FO_RESISTANCE] += before[1] - now[1];
    value[FO_INVERTER] += before[2] - now[2];
    value[FO_INVERTER + 1] += before[2] - now[2];
}

void fo_learning_move_prior_means(const fo_adaptive *a, fo_learner *s, fo_real flux[FO_N],
                                  fo_real drift[FO_N])
{
    static const int places[FO_PRIOR_MEANS + 1] = {FO_PSI, FO_RESISTANCE, FO_INVERTER,
                                                   FO_INVERTER + 1};
    fo_real now[FO_PRIOR_MEANS];
    fo_learning_prior_means(a, now);
    for (int i = 0; i < (int)FO_PRIOR_MEANS + 1; i++) {
        const int n = places[i];
        const int mean = i < (int)FO_PRIOR_MEANS ? i : (int)FO_PRIOR_MEANS - 1;
        const fo_real change = now[mean] - s->means[mean];
        if (a->std[n] > ZERO && fo_abs(change) > ZERO) {
            move_prior_mean(s, n, change / a->std[n], flux, drift);
        }
    }
    (void)memcpy(s->means, now, sizeof now);
}

/* Forgets the parameters towards their prior. In a round of rows all information is forgotten once,
 * and the prior of each parameter is re-injected once. */
static void forget_parameters(const fo_adaptive *a, fo_learner *s, fo_real time)
{
    s->forgotten += time * a->slow;
    s->reinject_index = s->reinject_index + 1U < FORGETTING_ROUND ? s->reinject_index + 1U : 0U;
    if (s->reinject_index < (uint32_t)FO_NP) {
        int n = FO_NF + (int)s->reinject_index;
#if FO_ASYMMETRIC
        if (n >= (int)FO_NF + (int)FO_ASYMMETRY) { /* the asymmetry comes last: an observer without it
                                                * re-injects the others in the same rows */
            n += n < (int)FO_NF + (int)FO_INDUCTANCE ? 2 : -2;
        }
#endif
        fo_real row[FO_NA] = {0}, mean = ZERO, information = s->forgotten_before;
        row[n] = ONE;
        fo_add_row_to(FO_NA, s->U, s->d, s->z, n, FO_NF + FO_NP, row, &mean, &information);
    } else if (s->reinject_index == FORGETTING_ROUND - 1U) {
        s->forgotten_before = s->forgotten < ONE / TWO ? s->forgotten : ONE / TWO;
        for (int j = 0; j < (int)FO_NP; j++) {
            s->d[FO_NF + j] *= ONE - s->forgotten_before;
        }
        add_resistance_process_noise(s, HEAT_WALK * HEAT_WALK * s->forgotten_before);
        s->forgotten = ZERO;
    } else {
        /* no work in this row of the round */
    }
}

/* If the solution has a negative inverter loss or a negative resistance, moves it to the most
 * likely parameters at which that value is zero: no inverter adds voltage. */
static void constrain(const fo_adaptive *a, const fo_learner *s, int n, int count, fo_real mean,
                      fo_real x[FO_NA])
{
    fo_real value = mean;
    for (int j = n; j < n + count; j++) {
        value += a->std[j] * x[FO_NF + j];
    }
    if (value < ZERO) {
        fo_real direction[FO_NA] = {0}, y[FO_NA] = {0};
        for (int j = n; j < n + count; j++) {
            direction[FO_NF + j] = a->std[j];
        }
        const fo_real variance = fo_marginal_variance(FO_NA, s->U, s->d, FO_NF, FO_NA, direction);
        for (int j = FO_NF; j < FO_NA; j++) { /* computes y, where U'y = direction */
            y[j] = direction[j] / s->d[j];
        }
        fo_solve(FO_NA, s->U, y, FO_NF, FO_NA, direction);
        const fo_real share = variance > ZERO ? value / variance : ZERO;
        for (int j = FO_NF; j < (int)FO_NA; j++) {
            x[j] -= direction[j] * share;
        }
    }
}

/* Measurement update of the parameters by a row without flux and drift. */
static void update_parameters(const fo_adaptive *a, fo_learner *s, fo_real row[FO_NA],
                              fo_real innovation, fo_real information)
{
    fo_real rhs = innovation, weight = information, x[FO_NA];
    for (int j = 0; j < FO_NP; j++) { /* relative to the prior mean */
        rhs += row[FO_NF + j] * s->p[j];
    }
    fo_add_row_to(FO_NA, s->U, s->d, s->z, FO_NF, FO_NA, row, &rhs, &weight);
    fo_solve(FO_NA, s->U, s->z, FO_NF, FO_NA, x);
    constrain(a, s, FO_RESISTANCE, 1, s->means[1], x);
    constrain(a, s, FO_INVERTER, 2, TWO * a->inverter_mean, x);
    for (int j = 0; j < (int)FO_NP; j++) {
        s->p[j] = x[FO_NF + j];
    }
}

/* Variance of a row due to considered parameters, which no column of the row describes: lags of
 * voltages and currents. All rows at one operating point have the same error. `speed` is in radians
 * per memory. */
static fo_real lag_variance(const fo_adaptive *a, const fo_linearisation *point, fo_real speed)
{
    const fo_real omega = speed * a->plain.h / a->plain.sample_time;
    return dot(point->armature_flux, point->armature_flux) * omega * omega *
           (a->lag_std * a->lag_std + a->delay_std * a->delay_std);
}

/* Variance of a row due to considered parameters whose error oscillates over a turn: harmonics of
 * the magnet flux, unequal gains of the current sensors. The errors of the rows of a turn cancel. */
static fo_real oscillating_variance(const fo_adaptive *a, const fo_linearisation *point)
{
    const fo_real harmonics = SIXTH * a->magnet_error;
    return harmonics * harmonics + dot(point->armature_flux, point->armature_flux) *
                                       a->current_gain_std * a->current_gain_std;
}

/* What all rows of a block have in common. */
typedef struct {
    fo_linearisation point;
    fo_real speed;       /* [rad per memory]                                         */
    fo_real variance;    /* of a row of a whole block                                */
    fo_real curvature;   /* squared error across the position vector / its length    */
    fo_real rows;        /* rows at this operating point                             */
    fo_real lag;         /* variance of a row by lags                                */
    fo_real systematic;  /* variance by other errors that no column describes        */
    bool learn;          /* update the parameters                                    */
} block_context;

/* Measurement update by a row: first of flux and drift, then of the parameters. Adds the changes of
 * flux, drift and parameters to `change`. The row is linear, but the length is not: an error e
 * across the position vector x adds e^2 / (2 |x|). Its mean is subtracted, and its variance is part
 * of the row's. */
static void update_by_row(const fo_adaptive *a, fo_learner *s, const block_context *c,
                          fo_real row[FO_NA], fo_real residual, fo_real share, bool first,
                          fo_real change[FO_NA])
{
    fo_real innovation = residual, before[FO_NP];
    for (int j = 0; j < (int)FO_NA; j++) { /* after the changes by earlier rows */
        innovation -= row[j] * change[j];
    }
    if (first) {
        innovation -= c->curvature / TWO;
    }
    fo_real information = share / c->variance;
    fo_add_row_to(FO_NA, s->U, s->d, s->z, 0, FO_NF, row, &innovation, &information);
    const bool informative = information > ZERO;
    const bool outlier = informative && test_innovation(s, row, innovation, information, share);
    if (outlier) {
        forget_drift(a, s, DRIFT_MEMORY); /* forget the drift completely */
    }
    for (int j = 0; j < (int)FO_NP; j++) {
        before[j] = s->p[j];
    }
    if (informative && !outlier && c->learn) {
        const fo_real level = s->noise_level > ONE ? s->noise_level : ONE;
        const fo_real variance = ONE / information + c->lag;
        const fo_real weight = ONE / ((c->rows * variance + c->systematic) * level);
        if (weight > ZERO) {
            update_parameters(a, s, row, innovation, weight);
        }
    }
    fo_real x[FO_NA];
    for (int j = 0; j < (int)FO_NP; j++) {
        x[FO_NF + j] = s->p[j] - before[j];
    }
    fo_solve(FO_NA, s->U, s->z, 0, FO_NF, x); /* given the change of the parameters */
    for (int i = 0; i < (int)FO_NA; i++) {
        change[i] += x[i];
    }
    for (int i = 0; i < (int)FO_NF; i++) {
        s->z[i] = ZERO;
    }
}

/* The row of the direction: 0 = sum of du r, where du is the change of 1 / |x|. Noise of the current
 * ripples u, too; its share of the squares is no information. */
typedef struct {
    fo_real row[FO_NA], innovation;
    fo_real variance;    /* 0: the row is not used */
    fo_real systematic;  /* variance of the row by model errors */
    fo_real gain;        /* share of the error of the row that it removes */
} direction_row;

static void make_direction_row(const fo_adaptive *a, fo_learner *s, const fo_block *b,
                               const fo_ripple *p, const fo_block_end *end,
                               const fo_linearisation *point, direction_row *r)
{
    const fo_real L_q = a->plain.L_position;
    const fo_real third = (fo_real)(20 * FO_N) * a->plain.over_noise; /* 1 / noise [1/A^2] */
    const fo_real noise = L_q * L_q / third * end->noise_inflation;   /* of x across */
    const fo_real square = point->length * point->length, of_u = noise / (square * square);
    const fo_real true_square = p->square - TWO * (fo_real)p->samples * of_u;
    (void)memset(r, 0, sizeof *r);
    s->report.tilt = ZERO;
    if (p->square > RIPPLE_LEAST && true_square > RIPPLE_MIN * p->square &&
        -p->lagged > ALTERNATING_MIN * p->square) {
        const fo_real share = true_square / p->square;
        for (int i = 0; i < FO_N; i++) {
            const fo_real h = share * p->h[i];
            r->row[i] = h;
            r->row[FO_N + i] = share * p->th[i] - b->time * h;
            r->row[FO_NF + FO_OFFSET + i] = L_q * a->std[FO_OFFSET + i] * h;
        }
        for (int j = 0; j < (int)FO_NS; j++) { /* the sensitivities grow with the time */
            const int n = FO_RESISTANCE + j;
            r->row[FO_NF + n] += a->std[n] * (share / b->time * dot(p->th, b->sensitivity[j]) -
                                              dot(r->row, b->sensitivity[j]));
        }
        for (int n = 0; n < 2; n++) { /* where phase currents ripple through zero, so does the loss */
            const int j = FO_INVERTER + n;
            r->row[FO_NF + j] -= a->std[j] * a->volt * p->signs[n];
        }
        r->row[FO_NF + FO_INDUCTANCE + 1] =
            -a->std[FO_INDUCTANCE + 1] * point->armature_flux[1] * true_square;
        r->innovation = -p->product;
        const fo_real radian = point->length * true_square; /* the residual of a turn by 1 rad */
        const fo_real model = MODEL * radian;
        r->variance = noise / square * TWO * (p->square - p->lagged) + model * model;
        /* the phase currents' signs may be anything between the two soft ones */
        const fo_real knee = s->report.loss_size * a->plain.h * (p->signs[0] - p->signs[1]);
        r->systematic = TILT * TILT * radian * radian + knee * knee;
        s->report.tilt = r->systematic / (radian * radian);
        fo_real direction[FO_NA];
        (void)memcpy(direction, r->row, sizeof direction);
        const fo_real known = fo_marginal_variance(FO_NA, s->U, s->d, 0, FO_NA, direction);
        r->gain = known / (known + r->variance);
    }
}

/* Measurement update by the rows of a block in which the rotor has turned. */
static void update_by_block(const fo_adaptive *a, fo_learner *s, const fo_block *b,
                            const fo_sums *sums, const fo_block_end *end, fo_real change[FO_NA])
{
    block_context c;
    block_rows r;
    fo_real value[FO_NP];
    direction_row d;
    fo_learning_values(a, s, value);
    fo_linearise(a, value, end->flux, end->current, map_of(end), &c.point);
    make_direction_row(a, s, b, &sums->ripple, end, &c.point, &d);
    s->report.direction_gain = d.gain;
    /* a row of the direction limits the flux error like a rotation by its gain */
    const fo_real turned = fo_abs(b->turned) + d.gain, blocks = turned / BLOCK;
    c.speed = fo_abs(b->turned) / b->time;
    c.curvature = (s->report.variance_across + s->report.growth * b->time * b->time) /
                  c.point.length;
    c.variance = MODEL * MODEL + c.curvature * c.curvature / TWO +
                 a->through_L * end->noise_inflation * (blocks > ONE ? blocks : ONE) /
                     (fo_real)sums->samples;
    const fo_real shape = b->unmodelled / turned; /* length by unmodelled voltages */
    c.lag = lag_variance(a, &c.point, c.speed);
    c.systematic = shape * shape + oscillating_variance(a, &c.point);
    c.rows = count_rows_at_point(a, s, &c.point, c.speed, blocks);
    c.learn = !s->frozen && end->emf_ratio < EMF_RATIO_LIMIT &&
              c.curvature < LEARN_STD * LEARN_STD * c.point.length;
    sum_rows(a, b, sums, &r);
    decorrelate(sums, &r);
    for (int w = 0; w < (int)FO_NW; w++) {
        if (r.share[w] > ZERO) {
            update_by_row(a, s, &c, r.row[w], r.innovation[w], r.share[w] * blocks, w == 0, change);
        }
    }
    if (d.variance > ZERO) {
        block_context along = c;
        along.variance = d.variance;
        along.systematic = d.systematic;
        update_by_row(a, s, &along, d.row, d.innovation, ONE, false, change);
    }
    if (c.learn) {
        forget_parameters(a, s, b->time);
    }
}

/* ---- variances of the new estimate ----------------------------------------------------------- */

/* Marginal variance of the flux in direction `across`, `time` after the reference, while the flux
 * has moved by `moved` per prior std of each parameter: one part with L_q known, and what the error
 * of L_q adds, which turns the position vector. */
typedef struct {
    fo_real known, by_L_q;
} marginal_pair;

static marginal_pair marginal_variance(const fo_adaptive *a, const fo_learner *s,
                                       const fo_real across[FO_N], fo_real time,
                                       const fo_real moved[FO_NS], fo_real armature_flux_q)
{
    enum { L_Q = (int)FO_NA - 1 };
    marginal_pair v;
    fo_real direction[FO_NA] = {0};
    for (int i = 0; i < FO_N; i++) {
        direction[i] = across[i];
        direction[FO_N + i] = time * across[i];
    }
    for (int j = 0; j < (int)FO_NS; j++) {
        direction[FO_NF + FO_RESISTANCE + j] = moved[j];
    }
    for (int i = 0; i < FO_N; i++) {
        direction[FO_NF + FO_OFFSET + i] +=
            a->plain.L_position * a->std[FO_OFFSET + i] * across[i];
    }
    const fo_real level = s->noise_level > NOISE_LEVEL_MIN ? s->noise_level : NOISE_LEVEL_MIN;
    v.known = level * fo_marginal_variance(FO_NA, s->U, s->d, 0, FO_NF, direction);
    v.known += fo_marginal_variance(FO_NA, s->U, s->d, FO_NF, L_Q, direction);
    const fo_real y = direction[L_Q];
    const fo_real with = y - a->std[FO_INDUCTANCE + 1] * armature_flux_q;
    v.known += y * y / s->d[L_Q];
    v.by_L_q = (with * with - y * y) / s->d[L_Q];
    return v;
}

/* Computes two variances: at the end of this block, and one block later if the voltages stay the
 * same relative to the rotor. At steady load the rows have correlated the errors of the parameters with the flux,
 * and these errors add almost nothing. */
static void update_report_variances(const fo_adaptive *a, fo_learner *s, const fo_block *b,
                                    const fo_linearisation *point)
{
    fo_learning_report *r = &s->report;
    const fo_real across[FO_N] = {-point->direction[1], point->direction[0]};
    fo_real next[FO_N], moved[FO_NS] = {0};
    const fo_real q = point->armature_flux[1];
    const marginal_pair now = marginal_variance(a, s, across, ZERO, moved, q);
    for (int j = 0; j < (int)FO_NS; j++) { /* relative to the rotor, as in this block */
        moved[j] = a->std[FO_RESISTANCE + j] * dot(across, b->sensitivity[j]);
    }
    turn(across, fo_abs(b->turned) < ONE ? b->turned : ZERO, next);
    const marginal_pair then = marginal_variance(a, s, next, b->time, moved, q);
    r->variance_across = now.known;
    r->variance_by_L_q = now.by_L_q;
    r->armature_flux_q = q;
    r->growth =
        then.known > now.known ? (then.known - now.known) / (b->time * b->time) : ZERO;
}

static void learn_block(const fo_adaptive *a, fo_learner *s, const fo_mail *m, fo_answer *answer)
{
    const fo_block *b = &m->block;
    const fo_block_end *end = &m->end;
    fo_linearisation point;
    fo_real change[FO_NA] = {0};
    predict_block(a, s, b);
    s->report.direction_gain = ZERO;
    if (m->data.sums.samples > 0U &&
        (fo_abs(b->turned) > TURNED_MIN || m->data.sums.ripple.square > ZERO)) {
        update_by_block(a, s, b, &m->data.sums, end, change);
    }
    for (int i = 0; i < FO_N; i++) {
        answer->flux[i] = change[i];
        answer->drift[i] = change[FO_N + i];
    }
    for (int j = 0; j < (int)FO_NP; j++) {
        answer->change[j] = a->std[j] * change[FO_NF + j];
    }
    fo_learning_move_prior_means(a, s, answer->flux, answer->drift);
    const fo_real flux[FO_N] = {end->flux[0] + answer->flux[0], end->flux[1] + answer->flux[1]};
    fo_learning_values(a, s, answer->value);
    fo_linearise(a, answer->value, flux, end->current, map_of(end), &point);
    update_report_variances(a, s, b, &point);
    fo_learning_update_voltage_std(a, s, end);
    s->report_index = s->report_index < 2U ? s->report_index + 1U : 0U;
    update_reported_std(a, s, s->report_index);
    const fo_real gain = fo_sqrt(s->d[FO_N]) * a->plain.drift_prior_std; /* prior std over std */
    s->report.drift_std = gain > ONE ? ONE / gain : ONE;
    answer->wrong = !(s->noise_level - s->noise_level == ZERO && point.length > ZERO);
    answer->kind = FO_ANSWER_CORRECTION;
}

/* Are all numbers of an answer finite? */
static bool is_finite_answer(const fo_answer *c)
{
    const fo_learning_report *r = &c->report;
    fo_real sum = c->length + c->variance + c->other_theta + c->other_weight + r->variance_across +
                  r->growth + r->variance_by_L_q + r->armature_flux_q + r->loss_size +
                  r->voltage_std + r->voltage_std_square + r->drift_std + r->innovation_power +
                  r->rows;
    for (int i = 0; i < FO_N; i++) {
        sum += c->flux[i] + c->drift[i];
    }
    for (int i = 0; i < 3; i++) {
        sum += r->reported_std[i] + c->means[i];
    }
    for (int j = 0; j < (int)FO_NP; j++) {
        sum += c->change[j] + c->value[j];
    }
    return sum - sum == ZERO;
}

bool fo_adaptive_learn(const fo_adaptive *a, fo_adaptive_state *state)
{
    fo_mail *m = &state->mail;
    fo_learner *s = &state->learner;
    const bool work = FO_ACQUIRE(m->owner) == FO_MAIL_WITH_LEARNER;
    if (work) {
        fo_answer answer;
        (void)memset(&answer, 0, sizeof answer);
        if (m->searching) {
            fo_candidates_learn(a, s, &state->now.search, m, &answer);
        } else {
            learn_block(a, s, m, &answer);
        }
        answer.report = s->report;
        (void)memcpy(answer.means, s->means, sizeof answer.means);
        answer.wrong = answer.wrong || !is_finite_answer(&answer);
        m->data.answer = answer;
        FO_RELEASE(m->owner, FO_MAIL_ANSWERED);
    }
    return work;
}
