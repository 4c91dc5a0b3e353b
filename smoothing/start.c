#include "start.h"

#include <stdlib.h>
#include <string.h>

#include "direction.h"

enum { S = 4, DRIFT = 2 };

/* Model errors of two rows are independent if the rotor turned by this angle between them: a
 * twelfth of a turn, half a period of the harmonics 5 and 7 in rotor coordinates [rad]. */
#define CORRELATION_ANGLE 0.5235987755982988
/* An angle of the observer anchors the flux with at least this error [rad]; neighbouring angles
 * share their error: the variance is that of this many rows. */
#define LEAST_ANCHOR 0.02
#define ANCHOR_ROWS 30.0
/* Time constant of the unmodelled inverter loss [s]: about a turn at half speed. */
#define LOSS_TIME 2e-3
/* Fewest changes of the current in a block that measure the direction. */
#define DIRECTION_ROWS 7.0
/* Blocks without an anchor over which the flux correction is interpolated. */
enum { LONGEST_GAP = 8 };
/* Gain of the speed that predicts the next row's angle. */
#define SPEED_GAIN 0.1

double fo_model_variance(const fo_model *m, double rotation)
{
    const double error = m->model_error * m->flux_base;
    return error * error * CORRELATION_ANGLE / rotation;
}

typedef struct {
    vec correction; /* in the middle of the block */
    double xx, xy, yy; /* its covariance */
} direction_state;

typedef struct {
    const vec *volt_seconds, *current;
    const double *psi;
    const vec *anchor; /* correction by the observer's angle */
    double loss;       /* variance rate of the flux [Wb^2/s] */
} start_record;

typedef struct {
    double x[S], p[S][S];
    double angle, speed;
    bool seen;
} filter;

static void filter_predict(filter *f, double step, double loss, double wander)
{
    for (int n = 0; n < DRIFT; n++) f->x[n] += step * f->x[n + DRIFT];
    for (int n = 0; n < DRIFT; n++)
        for (int k = 0; k < S; k++) f->p[n][k] += step * f->p[n + DRIFT][k];
    for (int k = 0; k < S; k++)
        for (int n = 0; n < DRIFT; n++) f->p[k][n] += step * f->p[k][n + DRIFT];
    for (int n = 0; n < DRIFT; n++) {
        f->p[n][n] += loss * fabs(step);
        f->p[n + DRIFT][n + DRIFT] += wander * fabs(step);
    }
}

static void filter_update(filter *f, const double row[S], double innovation, double variance)
{
    double by_row[S], spread = variance;
    for (int n = 0; n < S; n++) {
        by_row[n] = 0.0;
        for (int k = 0; k < S; k++) by_row[n] += f->p[n][k] * row[k];
    }
    for (int n = 0; n < S; n++) spread += row[n] * by_row[n];
    for (int n = 0; n < S; n++) f->x[n] += by_row[n] / spread * innovation;
    for (int n = 0; n < S; n++)
        for (int k = 0; k < S; k++) f->p[n][k] -= by_row[n] * by_row[k] / spread;
}

static double anchor_variance(const fo_model *m, double std)
{
    const double error = (std > LEAST_ANCHOR ? std : LEAST_ANCHOR) * m->flux_base;
    return error * error * ANCHOR_ROWS;
}

/* One block in one direction; `sign` is +1 or -1. */
static void filter_block(const fo_work *w, const double p[FO_P], const start_record *r, size_t b,
                         int sign, filter *f, double *angle)
{
    const fo_model *m = w->model;
    const size_t n = w->per_block, first = b * n;
    const double h = m->sample_time, half = 0.5 * (double)(n - 1);
    double rest = 0.0, row[S] = {0.0, 0.0, 0.0, 0.0}, at_start = f->angle, noise = 0.0;
    size_t measured = 0, anchored = 0;
    vec anchor = {0.0, 0.0}, across = {0.0, 0.0};
    fo_ripple ripple;
    memset(&ripple, 0, sizeof ripple);
    double current = 0.0;
    for (size_t j = 0; j < n; j++) {
        const size_t k = first + (sign > 0 ? j : n - 1 - j);
        const double since = ((double)(k - first) - half) * h;
        const vec flux = plus(r->volt_seconds[k], vec_of(f->x[0] + since * f->x[2],
                                                         f->x[1] + since * f->x[3]));
        vec rotor, i_dq;
        fo_relation at;
        double guess = f->angle + f->speed * h * sign;
        const double old = f->angle;
        const double residual =
            fo_solve_angle(m, p, r->psi[k], r->current[k], flux, &guess, &rotor, &i_dq, &at);
        f->angle = guess;
        f->speed += SPEED_GAIN * ((f->angle - old) / (h * sign) - f->speed);
        angle[k] = f->angle;
        current += length_of(r->current[k]) / (double)n;
        if (w->measurements > FO_DIRECTION) {
            const fo_ripple_row now = {times(residual, at.along), product(flux, conjugate(rotor)),
                                       times(at.size, at.along), f->angle};
            across = plus(across, product(turned(at.along), rotor));
            fo_add_ripple(&ripple, &now, &at, &at, fo_is_measured(&w->record, k), f->speed * h * sign);
        }
        if (fo_is_measured(&w->record, k)) {
            const vec along = product(at.along, rotor);
            const double d = dot(at.by_d, at.along), q = dot(at.by_q, at.along);
            measured++;
            rest += residual;
            noise += d * d + q * q;
            row[0] += along.re;
            row[1] += along.im;
            row[2] += along.re * since;
            row[3] += along.im * since;
        }
        if (isfinite(w->record.angle_std[k])) {
            anchored++;
            anchor = plus(anchor, minus(r->anchor[k], times(since, vec_of(f->x[2], f->x[3]))));
        }
    }
    if (measured == n && f->seen) {
        const double over = 1.0 / (double)n;
        for (int a = 0; a < S; a++) row[a] *= over;
        noise *= m->current_noise * m->current_noise * over * over;
        filter_update(f, row, -rest * over,
                      noise + fo_model_variance(m, fabs(f->angle - at_start) + 1e-9));
    }
    if (f->seen && ripple.rows >= DIRECTION_ROWS && fo_shows_direction(m, &ripple)) {
        /* The drift follows a wrong voltage too slowly: its prior error acts within the block. */
        const double R_error = m->std[FO_P_resistance] * current,
                     loss_error = m->std[FO_P_inverter_hard],
                     step = h * (double)n, gained = step * step * (R_error * R_error +
                                                                   loss_error * loss_error);
        const double size = ripple.size / ripple.rows, tilt = m->std[FO_P_tilt],
                     length = length_of(across);
        const double direction[S] = {across.re / length, across.im / length, 0.0, 0.0};
        f->p[0][0] += gained;
        f->p[1][1] += gained;
        filter_update(f, direction, -size * fo_direction_error(&ripple),
                      size * size * (fo_direction_variance(m, &ripple) *
                                         (1.0 + fo_saliency_variance(m, &ripple)) +
                                     tilt * tilt));
    }
    if (2 * anchored > n) {
        const size_t middle = first + n / 2, edge = sign > 0 ? first + n - 1 : first;
        anchor = times(1.0 / (double)anchored, anchor);
        if (!f->seen) {
            f->seen = true;
            f->x[0] = anchor.re;
            f->x[1] = anchor.im;
            f->angle = w->record.angle[edge];
        }
        if (isfinite(w->record.angle_std[middle])) {
            const double variance = anchor_variance(m, w->record.angle_std[middle]);
            const double alpha[S] = {1.0, 0.0, 0.0, 0.0}, beta[S] = {0.0, 1.0, 0.0, 0.0};
            filter_update(f, alpha, anchor.re - f->x[0], variance);
            filter_update(f, beta, anchor.im - f->x[1], variance);
        }
    }
}

static void run(const fo_work *w, const double p[FO_P], const start_record *r, int sign,
                direction_state *state, double *angle)
{
    const fo_model *m = w->model;
    const double wander = FO_DRIFT_RATE * m->drift_std;
    filter f;
    memset(&f, 0, sizeof f);
    f.p[0][0] = f.p[1][1] = 4.0 * m->flux_base * m->flux_base;
    f.p[2][2] = f.p[3][3] = m->drift_std * m->drift_std;
    for (size_t n = 0; n < w->blocks; n++) {
        const size_t b = sign > 0 ? n : w->blocks - 1 - n;
        if (n > 0)
            filter_predict(&f, sign * (double)w->per_block * m->sample_time, r->loss,
                           wander * wander);
        filter_block(w, p, r, b, sign, &f, angle);
        const direction_state done = {vec_of(f.x[0], f.x[1]), f.p[0][0], f.p[0][1], f.p[1][1]};
        state[b] = done;
    }
}

/* Mean of both directions, weighted by their information. */
static vec joined(const direction_state *a, const direction_state *b)
{
    const double da = 1.0 / (a->xx * a->yy - a->xy * a->xy),
                 db = 1.0 / (b->xx * b->yy - b->xy * b->xy);
    const double axx = a->yy * da, axy = -a->xy * da, ayy = a->xx * da;
    const double bxx = b->yy * db, bxy = -b->xy * db, byy = b->xx * db;
    const double xx = axx + bxx, xy = axy + bxy, yy = ayy + byy, d = 1.0 / (xx * yy - xy * xy);
    const double re = axx * a->correction.re + axy * a->correction.im + bxx * b->correction.re +
                      bxy * b->correction.im;
    const double im = axy * a->correction.re + ayy * a->correction.im + bxy * b->correction.re +
                      byy * b->correction.im;
    return vec_of(d * (yy * re - xy * im), d * (xx * im - xy * re));
}

static void anchors(const fo_work *w, const double p[FO_P], const start_record *r, vec *anchor)
{
    for (size_t k = 0; k < w->record.rows; k++) {
        if (!isfinite(w->record.angle_std[k])) continue;
        const vec rotor = direction_of(w->record.angle[k]);
        fo_relation at;
        fo_relate(w->model, p, r->psi[k], product(r->current[k], conjugate(rotor)), rotor, &at);
        anchor[k] = minus(product(at.flux, rotor), r->volt_seconds[k]);
    }
}

/* Starts from the anchors alone. Returns false if there is a long gap between them. */
static bool start_from_anchors(fo_work *w, const start_record *r)
{
    const size_t n = w->per_block;
    size_t last = 0;
    bool any = false;
    for (size_t b = 0; b < w->blocks; b++) {
        vec sum = {0.0, 0.0};
        size_t count = 0;
        for (size_t k = b * n; k < (b + 1) * n; k++)
            if (isfinite(w->record.angle_std[k])) {
                sum = plus(sum, r->anchor[k]);
                count++;
            }
        if (count == 0) {
            if (b - (any ? last : 0) >= LONGEST_GAP) return false;
            continue;
        }
        w->correction[b] = times(1.0 / (double)count, sum);
        for (size_t a = any ? last + 1 : 0; a < b; a++) {
            const double share = any ? (double)(a - last) / (double)(b - last) : 1.0;
            w->correction[a] = plus(times(1.0 - share, any ? w->correction[last] : sum),
                                    times(share, w->correction[b]));
        }
        last = b;
        any = true;
    }
    if (!any || w->blocks - 1 - last >= LONGEST_GAP) return false;
    for (size_t b = last + 1; b < w->blocks; b++) w->correction[b] = w->correction[last];
    memcpy(w->angle, w->record.angle, w->record.rows * sizeof *w->angle);
    return true;
}

bool fo_start(fo_work *w, const double p[FO_P])
{
    const fo_model *m = w->model;
    const size_t n = w->record.rows;
    vec *room = malloc(3 * n * sizeof *room);
    double *numbers = malloc(3 * n * sizeof *numbers);
    direction_state *states = malloc(2 * w->blocks * sizeof *states);
    const bool good = room != NULL && numbers != NULL && states != NULL;
    if (good) {
        double *forwards = numbers + n, *backwards = numbers + 2 * n;
        const double loss = fo_inverter_error(m, p), source = FO_VOLTAGE_SHARE * m->voltage;
        const start_record r = {room, room + n, numbers, room + 2 * n,
                                (loss * loss + source * source) * LOSS_TIME};
        fo_integrate(w, p, room, room + n, numbers);
        anchors(w, p, &r, room + 2 * n);
        if (start_from_anchors(w, &r)) {
            fo_fit_speed(w);
            free(room);
            free(numbers);
            free(states);
            return true;
        }
        run(w, p, &r, 1, states, forwards);
        run(w, p, &r, -1, states + w->blocks, backwards);
        for (size_t b = 0; b < w->blocks; b++) {
            const direction_state *f = &states[b], *g = &states[w->blocks + b];
            w->correction[b] = joined(f, g);
            const double *known = f->xx + f->yy < g->xx + g->yy ? forwards : backwards;
            memcpy(w->angle + b * w->per_block, known + b * w->per_block,
                   w->per_block * sizeof *known);
        }
        for (size_t k = w->blocks * w->per_block; k < n; k++) w->angle[k] = w->angle[k - 1];
        fo_fit_speed(w);
    }
    free(room);
    free(numbers);
    free(states);
    return good;
}
