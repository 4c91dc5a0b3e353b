#include "learn.h"

#include <stdlib.h>
#include <string.h>

#include "cells.h"
#include "matrix.h"
#include "start.h"

enum { N = FO_SMOOTH, PSI = 4 };

/* Most iterations; the first ones move only the flux, not the assumptions. */
enum { ITERATIONS = 16, FLUX_FIRST = 3, POLISHING = 2 };
/* Largest step of an assumption that bends the relation. */
#define LARGEST_SHAPE_STEP 0.3
#define LARGEST_HARMONIC_STEP 0.02
/* An iteration ends if no assumption moves by more than this share of its std. */
#define SETTLED 0.05
/* A worse step is repeated with this share of its length, until it is shorter than the least. */
#define SHORTER 0.3
#define SHORTEST 0.02
/* Steps reverse if the cosine between them is below this. */
#define REVERSED (-0.5)
/* Rise of the cost, per block and in all, that counts as worse. */
#define WORSE_PER_BLOCK 0.02
#define WORSE 5.0
/* Voltage error of every inverter besides, as a share of the usual voltage. */
#define USUAL_VOLTAGE_SHARE 0.001
/* Below this share of the rated current, an offset decides which phases lose voltage: the error of
 * the inverter's loss is larger by this factor at zero current. */
#define IDLE_CURRENT 0.05
#define IDLE_ERROR 3.0
/* The voltage error is constant at most this long [s]. */
#define LONGEST_ERROR 1.5
/* A cage's flux differs from that of its model by this share of the rated flux. */
#define ROTOR_FLUX_ERROR 0.05
/* The innovations tell how well the log keeps to the model's error, which is that of a poor drive:
 * the smoother's covariance is scaled by this multiple of their mean square, within a limit. On
 * drives with every error at once the multiples 2, 3 and 5 leave 96.1, 96.3 and 96.6 % of the rows
 * within two standard deviations (benchmarks/whole_log.py). */
#define MISFIT_MARGIN 3.0
#define LEAST_FILTER_SCALE 0.05
/* Error of the direction that is constant at an operating point and angle [rad]: the tilt of the
 * axis differs from its mean by as much as the mean differs from zero, 0.3 degrees. */
#define DIRECTION_ERROR 0.005
/* Blocks on each side over which the innovations are averaged, at least. */
enum { MISFIT_BLOCKS = 3 };
/* If a larger share of the blocks does not fit, the model is wrong, not a stretch of the log. */
#define MOST_DOUBTFUL 0.1
/* What happens in a stretch that does not fit: the flux may jump in each of its blocks, and this
 * share of the magnet flux at its start. */
#define PSI_JUMP 0.3
/* Rounds in which stretches are found and left out. */
enum { DOUBTFUL_ROUNDS = 2 };
/* Error of the back-EMF of a floating phase as a share of the usual back-EMF. A sixth of a turn is
 * three blocks, which share their error: 0.15 for each is 0.09 for the sum. */
#define FLOATING_ERROR 0.15
/* Share of the noise in the regressors that is taken from the information. */
#define REGRESSOR_NOISE 0.999

void fo_misfits(const fo_work *w, const fo_smoothed *s, double *misfit)
{
    const size_t blocks = w->blocks;
    const double span = FO_MISFIT_TIME / (w->model->sample_time * (double)w->per_block);
    const size_t side = span > MISFIT_BLOCKS ? (size_t)span : MISFIT_BLOCKS;
    double sum = 0.0, count = 0.0;
    size_t low = 0, high = 0; /* measurements low .. high - 1 are in the sum */
    const size_t each = w->measurements;
    for (size_t b = 0; b < blocks; b++) {
        const size_t to = b + side + 1 < blocks ? b + side + 1 : blocks,
                     from = b > side ? b - side : 0;
        for (; high < each * to; high++)
            if (isfinite(s->room.spread[high])) {
                const double e = s->room.innovation[high * s->sides];
                sum += e * e / s->room.spread[high];
                count += 1.0;
            }
        for (; low < each * from; low++)
            if (isfinite(s->room.spread[low])) {
                const double e = s->room.innovation[low * s->sides];
                sum -= e * e / s->room.spread[low];
                count -= 1.0;
            }
        misfit[b] = count > 0.0 ? fmax(sum, 0.0) / count : 0.0;
    }
}

/* Marks the blocks that do not fit if most others do; returns the number of new ones. */
static size_t mark_doubtful(fo_work *w, const fo_smoothed *s, double *misfit)
{
    size_t doubtful = 0, added = 0;
    fo_misfits(w, s, misfit);
    for (size_t b = 0; b < w->blocks; b++)
        doubtful += w->doubtful[b] || misfit[b] > FO_KNOWN_MISFIT;
    if ((double)doubtful > MOST_DOUBTFUL * (double)w->blocks) return 0;
    for (size_t b = 0; b < w->blocks; b++)
        if (!w->doubtful[b] && misfit[b] > FO_KNOWN_MISFIT) {
            w->doubtful[b] = 1;
            added++;
        }
    return added;
}

double fo_flux_walk(const fo_work *w, const double p[FO_P], size_t block)
{
    const fo_model *m = w->model;
    const fo_block_facts *b = &w->about[block];
    const double current = hypot(b->current.re, b->current.im) / (IDLE_CURRENT * m->current),
                 idle = 1.0 / (1.0 + current * current * current * current),
                 inverter = fo_inverter_error(m, p) * (1.0 + IDLE_ERROR * idle), source = FO_VOLTAGE_SHARE * b->voltage, usual = USUAL_VOLTAGE_SHARE * m->voltage;
    const double rate = b->rotation / (m->sample_time * (double)w->per_block);
    return 2.0 * (inverter * inverter + source * source + usual * usual) /
           fmax(rate, 1.0 / LONGEST_ERROR);
}

/* Error of the linear relation [Wb^2]: the flux's covariance across the auxiliary flux. */
static double curvature_variance(const fo_block_facts *about, const fo_smooth_block *block,
                                 const double *covariance)
{
    const double *row = block->row[FO_LENGTH], size = fmax(hypot(row[0], row[1]), 1e-9);
    const double x = -row[1] / size, y = row[0] / size;
    const double across = covariance[0] * x * x + 2.0 * covariance[1] * x * y +
                          covariance[N + 1] * y * y;
    const double bend = across / about->size;
    return 0.5 * bend * bend;
}

/* Variance of the flux along the axes of the floating phases. */
static void set_floating(const fo_work *w, size_t b)
{
    static const double cosine[3] = {1.0, -0.5, -0.5},
                        sine[3] = {0.0, 0.8660254037844386, -0.8660254037844386};
    double *sum = w->block[b].floating;
    memset(sum, 0, 3 * sizeof *sum);
    for (size_t n = 0; n < 3; n++) {
        const double share = w->floating[3 * b + n];
        if (share == 0.0) continue;
        const double turned = w->about[b].rotation * share;
        const double error = FLOATING_ERROR * w->model->flux_base * turned;
        sum[0] += error * error * cosine[n] * cosine[n];
        sum[1] += error * error * cosine[n] * sine[n];
        sum[2] += error * error * sine[n] * sine[n];
    }
}

static void set_variances(fo_work *w, const double p[FO_P], const double *covariance)
{
    const fo_model *m = w->model;
    const bool cage = m->L_M > 0.0;
    const double decay_rate = cage ? m->R_R / m->L_M : 0.0;
    const double wander = FO_DRIFT_RATE * m->drift_std, resistance = m->resistance_rate * m->resistance,
                 psi = m->psi_rate * m->flux_base, rotor = ROTOR_FLUX_ERROR * m->flux_base;
    for (size_t b = 0; b < w->blocks; b++) {
        fo_smooth_block *block = &w->block[b];
        const fo_block_facts *about = &w->about[b];
        const double T = block->duration;
        const bool measures = about->usable && !w->doubtful[b];
        block->decay = exp(-decay_rate * T);
        block->walk[0] = fo_flux_walk(w, p, b) * T;
        double *variance = block->variance;
        double direction = about->noise[FO_DIRECTION] * (1.0 + about->saliency_variance);
        if (direction > 0.0) direction += m->model_error * m->model_error * about->size * about->size;
        direction /= LEAST_FILTER_SCALE;
        variance[FO_DIRECTION] = measures && direction > 0.0 ? direction : INFINITY;
        /* The direction limits an error of the flux as a rotation by its gain does. */
        const double gain = sqrt(block->walk[0] / (block->walk[0] + variance[FO_DIRECTION]));
        variance[FO_LENGTH] = about->noise[FO_LENGTH] + fo_model_variance(m, about->rotation + gain);
        if (covariance != NULL)
            variance[FO_LENGTH] += curvature_variance(about, block, covariance + b * N * N);
        if (!measures) variance[FO_LENGTH] = INFINITY;
        block->walk[1] = wander * wander * T;
        block->walk[2] = cage ? rotor * rotor * (1.0 - block->decay * block->decay) : psi * psi * T;
        block->walk[3] = resistance * resistance * T;
        set_floating(w, b);
        if (w->doubtful[b]) {
            const double jump = PSI_JUMP * m->flux_base;
            block->walk[0] += m->flux_base * m->flux_base;
            if (b == 0 || !w->doubtful[b - 1]) block->walk[2] += jump * jump;
        }
    }
}

static void smooth_blocks(fo_work *w, const double p[FO_P], const double *covariance,
                          fo_smoothed *s)
{
    const fo_model *m = w->model;
    const double flux = 4.0 * m->flux_base * m->flux_base, drift = m->drift_std * m->drift_std;
    const double start[N] = {flux,  flux,
                             drift, drift,
                             m->L_M > 0.0 ? m->flux_base * m->flux_base : 0.0, 0.0};
    set_variances(w, p, covariance);
    const size_t each = w->measurements;
    fo_smooth(w->block, w->blocks, each, w->measured, s->sides, start, &s->room);
    for (size_t kind = 0; kind < each; kind++) {
        double *noise = w->noise + kind * each * w->blocks;
        memset(noise, 0, each * w->blocks * sizeof *noise);
        for (size_t b = 0; b < w->blocks; b++) noise[each * b + kind] = w->about[b].noise[kind];
        fo_smooth_noise(w->block, w->blocks, each, &s->room, noise, noise);
    }
}

/* What a step needs to know of the innovations. */
typedef struct {
    double *information, *gradient; /* columns^2, columns */
    double regressor[FO_P];         /* information on L_d and L_q that is only noise */
    double cost, chi, correlation;
    double noise; /* part of the cost that is expected from the noise of the currents */
} normal;

/* Adds the cells' share: -K (B'W E)' (B'W E). */
static bool less_cells(const fo_work *w, const fo_smoothed *s, double usual_speed, normal *n)
{
    const fo_model *m = w->model;
    const size_t P = w->columns, width = P + 2;
    const double share[FO_MEASUREMENTS] = {m->cell_error, DIRECTION_ERROR};
    fo_cells cells;
    if (!(m->cell_error > 0.0)) return true;
    double *sum = NULL;
    bool good = fo_find_cells(w, s->room.spread, usual_speed, &cells);
    if (good) {
        /* Weight, W e, W E of each cell and kind of measurement. */
        sum = calloc(cells.count * w->measurements * width + 1, sizeof *sum);
        good = sum != NULL;
    }
    if (good) {
        for (size_t k = 0; k < w->measurements * w->blocks; k++) {
            const size_t b = k / w->measurements, kind = k % w->measurements;
            if (cells.of[b] < 0 || !isfinite(s->room.spread[k])) continue;
            double *cell = sum + ((size_t)cells.of[b] * w->measurements + kind) * width;
            const double weight = 1.0 / s->room.spread[k];
            const double *e = s->room.innovation + k * s->sides;
            cell[0] += weight;
            for (size_t j = 0; j <= P; j++) cell[1 + j] += weight * e[j];
        }
        for (size_t c = 0; c < cells.count * w->measurements; c++) {
            const double prior = share[c % w->measurements] * m->flux_base, variance = prior * prior,
                         *cell = sum + c * width, k = variance / (1.0 + variance * cell[0]);
            n->cost -= 0.5 * k * cell[1] * cell[1];
            for (size_t i = 0; i < P; i++) {
                n->gradient[i] -= k * cell[2 + i] * cell[1];
                for (size_t j = 0; j < P; j++)
                    n->information[i * P + j] -= k * cell[2 + i] * cell[2 + j];
            }
        }
    }
    free(sum);
    fo_free_cells(&cells);
    return good;
}

static bool normal_equations(const fo_work *w, const double p[FO_P], const fo_smoothed *s,
                             double usual_speed, normal *n)
{
    const size_t P = w->columns;
    double square = 0.0, product = 0.0, last = 0.0, regressor_d = 0.0, regressor_q = 0.0,
           feedback = 0.0;
    size_t count = 0;
    memset(n->information, 0, P * P * sizeof *n->information);
    memset(n->gradient, 0, P * sizeof *n->gradient);
    n->cost = n->noise = 0.0;
    for (size_t b = 0; b < w->blocks; b++)
        if (w->doubtful[b]) n->cost += 0.5 * FO_KNOWN_MISFIT;
    for (size_t k = 0; k < w->measurements * w->blocks; k++) {
        const double spread = s->room.spread[k];
        if (!isfinite(spread)) continue;
        const double weight = 1.0 / spread, *e = s->room.innovation + k * s->sides,
                     z = e[0] / sqrt(spread);
        const fo_block_facts *about = &w->about[k / w->measurements];
        n->cost += 0.5 * e[0] * e[0] * weight;
        for (size_t kind = 0; kind < w->measurements; kind++) {
            const double noise = w->noise[kind * w->measurements * w->blocks + k] * weight;
            n->noise += 0.5 * noise;
            regressor_d += about->share_d[kind] * noise;
            regressor_q += about->share_q[kind] * noise;
            if (kind == FO_LENGTH) feedback += about->share_lag * noise;
        }
        if (k % w->measurements == FO_LENGTH) {
            square += z * z;
            product += z * last;
            last = z;
            count++;
        }
        for (size_t i = 0; i < P; i++) {
            const double scaled = weight * e[1 + i];
            n->gradient[i] += scaled * e[0];
            for (size_t j = 0; j <= i; j++) n->information[i * P + j] += scaled * e[1 + j];
        }
    }
    for (size_t i = 0; i < P; i++)
        for (size_t j = 0; j < i; j++) n->information[j * P + i] = n->information[i * P + j];
    n->cost -= n->noise;
    if (!less_cells(w, s, usual_speed, n)) return false;
    for (size_t i = 0; i < P; i++) {
        const int j = w->active[i];
        const double std = w->model->std[j], regressor = j == FO_P_L_d   ? regressor_d
                                                         : j == FO_P_L_q ? regressor_q
                                                                         : 0.0;
        n->cost += 0.5 * (p[j] / std) * (p[j] / std);
        n->gradient[i] -= regressor;
        if (j == FO_P_lag || j == FO_P_delay) {
            n->cost -= feedback * p[j];
            n->gradient[i] -= feedback;
        }
        n->regressor[i] = REGRESSOR_NOISE * regressor;
    }
    n->chi = count > 0 ? square / (double)count : 0.0;
    n->correlation = square > 0.0 ? product / square : 0.0;
    return true;
}

static double largest_step(int assumption)
{
    switch (assumption) {
    case FO_P_lag:
    case FO_P_delay:
    case FO_P_L_d:
    case FO_P_L_q:
    case FO_P_saturation_d:
    case FO_P_saturation_q: return LARGEST_SHAPE_STEP;
    case FO_P_fifth:
    case FO_P_seventh: return LARGEST_HARMONIC_STEP;
    default: return INFINITY;
    }
}

/* Covariance of the assumptions, (information / scale + prior)⁻¹. `factor` has room for P^2. */
static void posterior(const fo_work *w, const normal *n, double scale, double *covariance,
                      double *factor)
{
    const size_t P = w->columns;
    /* If noise outweighs a little information, it stays in: the sum is then positive. */
    for (int attempt = 0; attempt < 2; attempt++) {
        for (size_t i = 0; i < P; i++)
            for (size_t j = 0; j <= i; j++) {
                const double std_i = w->model->std[w->active[i]],
                             std_j = w->model->std[w->active[j]];
                double share = n->information[i * P + j];
                if (i == j && attempt == 0) share -= n->regressor[i];
                factor[i * P + j] = share / scale * std_i * std_j + (i == j ? 1.0 : 0.0);
            }
        if (fo_factorise(factor, (int)P)) break;
    }
    for (size_t i = 0; i < P; i++) {
        double *row = covariance + i * P;
        memset(row, 0, P * sizeof *row);
        row[i] = 1.0;
        fo_substitute(factor, (int)P, row);
        for (size_t j = 0; j < P; j++)
            row[j] *= w->model->std[w->active[i]] * w->model->std[w->active[j]];
    }
}

/* Step of the assumptions; returns the largest share of its std. */
static double step_of(const fo_work *w, const double p[FO_P], const normal *n, double scale,
                      const double *covariance, double *step)
{
    const size_t P = w->columns;
    double most = 1.0, moved = 0.0;
    for (size_t i = 0; i < P; i++) {
        step[i] = 0.0;
        for (size_t j = 0; j < P; j++) {
            const int a = w->active[j];
            const double std = w->model->std[a];
            step[i] -= covariance[i * P + j] * (n->gradient[j] / scale + p[a] / (std * std));
        }
        most = fmax(most, fabs(step[i]) / largest_step(w->active[i]));
    }
    for (size_t i = 0; i < P; i++) {
        step[i] /= most;
        moved = fmax(moved, fabs(step[i]) / sqrt(covariance[i * P + i]));
    }
    return moved;
}

/* Reference from the smoothed state and its sensitivities. */
static void move_reference(fo_work *w, const fo_smoothed *s, const double *step, vec *correction,
                           double *psi)
{
    for (size_t b = 0; b < w->blocks; b++) {
        const double *x = s->room.state + b * N * s->sides;
        double moved[3] = {x[0], x[s->sides], x[PSI * s->sides]};
        for (size_t j = 0; step != NULL && j < w->columns; j++) {
            moved[0] += x[1 + j] * step[j];
            moved[1] += x[s->sides + 1 + j] * step[j];
            moved[2] += x[PSI * s->sides + 1 + j] * step[j];
        }
        correction[b] = vec_of(moved[0], moved[1]);
        psi[b] = moved[2];
    }
}

/* The last accepted iteration, to go back to. */
typedef struct {
    double p[FO_P], *step, cost, share;
    double *angle, *speed;
    vec *from, *to;
    double *psi_from, *psi_to;
    bool set;
} accepted;

/* Moves to a share of the step from the last accepted iteration. */
static void move_to(fo_work *w, double p[FO_P], const accepted *a)
{
    memcpy(p, a->p, FO_P * sizeof *p);
    for (size_t j = 0; j < w->columns; j++) p[w->active[j]] += a->share * a->step[j];
    for (size_t b = 0; b < w->blocks; b++) {
        w->correction[b] = plus(times(1.0 - a->share, a->from[b]), times(a->share, a->to[b]));
        w->psi[b] = (1.0 - a->share) * a->psi_from[b] + a->share * a->psi_to[b];
    }
    memcpy(w->angle, a->angle, w->record.rows * sizeof *w->angle);
    memcpy(w->speed, a->speed, w->record.rows * sizeof *w->speed);
}

/* Share of the next step. If steps reverse, the iteration alternates between two points: Aitken's
 * relaxation for vector sequences finds the point between them (Irons and Tuck, 1969,
 * doi:10.1002/nme.1620010306). Components are in standard deviations. */
static double relaxation(const fo_work *w, const accepted *a, const double *step,
                         const double *covariance)
{
    double last = 0.0, next = 0.0, product = 0.0;
    for (size_t i = 0; i < w->columns; i++) {
        const double weight = 1.0 / covariance[i * w->columns + i];
        last += weight * a->step[i] * a->step[i];
        next += weight * step[i] * step[i];
        product += weight * a->step[i] * step[i];
    }
    if (!(product < REVERSED * sqrt(last * next))) return 1.0;
    return a->share * (last - product) / (last - 2.0 * product + next);
}

static double usual_speed(const fo_work *w)
{
    const double limit = 1.5 / w->model->sample_time;
    return clamp(w->model->speed, 1e-3, limit);
}

static bool iterate(fo_work *w, fo_assumed *out, fo_smoothed *s, normal *n, accepted *a,
                    double *factor)
{
    const size_t blocks = w->blocks, rows = w->record.rows;
    const double worse = fmax(WORSE, WORSE_PER_BLOCK * (double)blocks);
    const double *covariance = NULL;
    double step[FO_P];
    out->settled = false;
    for (int it = 0; it < ITERATIONS; it++) {
        fo_linearise(w, out->p, NULL);
        if (fo_stopped) return false;
        smooth_blocks(w, out->p, covariance, s);
        covariance = s->room.covariance;
        if (!normal_equations(w, out->p, s, usual_speed(w), n)) return false;
        if (it >= FLUX_FIRST && a->set && n->cost > a->cost + worse) {
            a->share *= SHORTER;
            if (a->share < SHORTEST) a->share = 0.0;
            move_to(w, out->p, a);
            if (a->share == 0.0) break;
            continue;
        }
        const double scale = fmax(1.0, n->chi);
        posterior(w, n, scale, out->covariance, factor);
        double moved = step_of(w, out->p, n, scale, out->covariance, step);
        if (it + 1 < FLUX_FIRST) {
            memset(step, 0, w->columns * sizeof *step);
            moved = INFINITY;
        }
        a->share = a->set ? relaxation(w, a, step, out->covariance) : 1.0;
        memcpy(a->step, step, w->columns * sizeof *a->step);
        memcpy(a->p, out->p, sizeof a->p);
        memcpy(a->from, w->correction, blocks * sizeof *a->from);
        memcpy(a->psi_from, w->psi, blocks * sizeof *a->psi_from);
        memcpy(a->angle, w->angle, rows * sizeof *a->angle);
        memcpy(a->speed, w->speed, rows * sizeof *a->speed);
        move_reference(w, s, a->step, a->to, a->psi_to);
        a->cost = n->cost;
        a->set = true;
        out->cost = n->cost;
        out->noise = n->noise;
        move_to(w, out->p, a);
        if (it >= FLUX_FIRST && moved < SETTLED) {
            out->settled = true;
            break;
        }
    }
    return true;
}

/* Coloured innovations: sandwich of the assumptions' covariance. */
static void colour(const fo_work *w, const normal *n, fo_assumed *out, double *work)
{
    const size_t P = w->columns;
    const double r = clamp(n->correlation, 0.0, 0.95);
    out->filter_scale =
        fmax(LEAST_FILTER_SCALE, MISFIT_MARGIN * n->chi * (1.0 + r) / (1.0 - r));
    if (!(out->filter_scale > 1.0)) return;
    double *half = work; /* C I */
    for (size_t i = 0; i < P; i++)
        for (size_t j = 0; j < P; j++) {
            half[i * P + j] = 0.0;
            for (size_t k = 0; k < P; k++)
                half[i * P + j] += out->covariance[i * P + k] * n->information[k * P + j];
        }
    double row[FO_P];
    for (size_t i = 0; i < P; i++) {
        memcpy(row, out->covariance + i * P, P * sizeof *row);
        for (size_t j = 0; j < P; j++) {
            double sum = 0.0;
            for (size_t k = 0; k < P; k++) sum += half[i * P + k] * work[P * P + k * P + j];
            row[j] += (out->filter_scale - 1.0) * sum;
        }
        memcpy(out->covariance + i * P, row, P * sizeof *row);
    }
}

bool fo_learn(fo_work *w, bool learning, fo_assumed *out, fo_smoothed *s)
{
    const size_t P = w->columns, blocks = w->blocks, rows = w->record.rows;
    double *small = malloc((4 * P * P + 3 * P + 1) * sizeof *small);
    double *long_room = malloc(2 * rows * sizeof *long_room);
    vec *pairs = malloc(2 * blocks * sizeof *pairs);
    double *psis = malloc(2 * blocks * sizeof *psis);
    out->left_out = false;
    bool good = small != NULL && long_room != NULL && pairs != NULL && psis != NULL;
    if (good) {
        normal n = {small, small + P * P, {0.0}, 0.0, 0.0, 0.0, 0.0};
        double *factor = small + P * P + P;
        accepted a = {{0.0},         factor + P * P, 0.0,
                      1.0,           long_room,      long_room + rows,
                      pairs,         pairs + blocks, psis,
                      psis + blocks, false};
        double *work = factor + P * P + P;
        for (int round = 0; good; round++) {
            a.set = false;
            if (learning) good = iterate(w, out, s, &n, &a, factor);
            for (int k = 0; good && k < POLISHING; k++) {
                /* Only the last pass needs derivatives. */
                w->columns = k + 1 < POLISHING ? 0 : P;
                s->sides = 1 + w->columns;
                fo_linearise(w, out->p, NULL);
                if (fo_stopped) break;
                smooth_blocks(w, out->p, k > 0 || learning ? s->room.covariance : NULL, s);
                move_reference(w, s, NULL, w->correction, w->psi);
            }
            good = good && !fo_stopped;
            if (!good) break;
            const size_t added = round == DOUBTFUL_ROUNDS ? 0 : mark_doubtful(w, s, psis);
            out->left_out = out->left_out || added > 0;
            if (added == 0) break;
        }
        if (good) {
            good = normal_equations(w, out->p, s, usual_speed(w), &n);
            out->chi = n.chi;
            out->correlation = n.correlation;
            if (good && learning) {
                memcpy(work + P * P, out->covariance, P * P * sizeof *work);
                colour(w, &n, out, work);
            }
        }
    }
    free(small);
    free(long_room);
    free(pairs);
    free(psis);
    return good;
}
