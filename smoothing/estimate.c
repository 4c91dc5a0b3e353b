#include "estimate.h"

#include <stdlib.h>
#include <string.h>

#include "matrix.h"
#include "start.h"

enum { N = FO_SMOOTH, DRIFT = 2, PSI = 4, RESISTANCE = 5 };

/* A row is known if its auxiliary flux has this share of the usual flux. */
#define KNOWN_SHARE 0.1
#define QUARTER_TURN 1.5707963267948966

size_t fo_rows_per_block(const fo_model *m)
{
    const double speed = clamp(m->speed, 1e-3, 1.5 / m->sample_time);
    const double rows = floor(FO_BLOCK_ANGLE / (speed * m->sample_time) + 0.5);
    return (size_t)clamp(rows, 1.0, FO_LONGEST_BLOCK);
}

/* Variances and sensitivities of a block. */
typedef struct {
    double angle;        /* variance but for the row's noise [rad^2] */
    double noise;        /* [rad^2] */
    double speed;        /* [(rad/s)^2] */
    double flux[2];      /* [Wb^2] */
    double torque;       /* [(W s)^2] */
    double psi, drift, resistance;
    double innovation, misfit;
} spread;

static bool allocate(fo_work *w, fo_smoothed *s)
{
    const size_t n = w->record.rows, blocks = w->blocks, sides = s->sides;
    w->angle = malloc(n * sizeof *w->angle);
    w->speed = calloc(n, sizeof *w->speed);
    w->unwrapped = malloc(n * sizeof *w->unwrapped);
    w->correction = calloc(blocks, sizeof *w->correction);
    w->psi = calloc(blocks, sizeof *w->psi);
    w->block = calloc(blocks, sizeof *w->block);
    w->about = calloc(blocks, sizeof *w->about);
    const size_t measured = blocks * w->measurements;
    w->measured = malloc(measured * sides * sizeof *w->measured);
    w->across = malloc((blocks * w->columns + 1) * sizeof *w->across);
    w->noise = malloc(measured * w->measurements * sizeof *w->noise);
    w->hard = malloc(n * sizeof *w->hard);
    w->soft = malloc(n * sizeof *w->soft);
    w->doubtful = calloc(blocks, sizeof *w->doubtful);
    w->floating = calloc(3 * blocks, sizeof *w->floating);
    w->total = malloc((blocks * w->columns + 1) * sizeof *w->total);
    s->room.state = malloc(blocks * N * sides * sizeof(double));
    s->room.covariance = malloc(blocks * N * N * sizeof(double));
    s->room.innovation = malloc(measured * sides * sizeof(double));
    s->room.spread = malloc(measured * sizeof(double));
    s->room.gain = malloc(measured * N * sizeof(double));
    s->room.work = malloc(2 * N * sides * sizeof(double));
    return w->angle && w->speed && w->unwrapped && w->correction && w->psi && w->block &&
           w->about && w->measured && w->across && w->total && w->noise && w->hard && w->soft &&
           w->doubtful && w->floating && s->room.state &&
           s->room.covariance && s->room.innovation && s->room.spread && s->room.gain &&
           s->room.work;
}

static void release(fo_work *w, fo_smoothed *s)
{
    free(w->angle);
    free(w->speed);
    free(w->unwrapped);
    free(w->correction);
    free(w->psi);
    free(w->block);
    free(w->about);
    free(w->measured);
    free(w->across);
    free(w->total);
    free(w->noise);
    free(w->doubtful);
    free(w->floating);
    free(w->hard);
    free(w->soft);
    free(s->room.state);
    free(s->room.covariance);
    free(s->room.innovation);
    free(s->room.spread);
    free(s->room.gain);
    free(s->room.work);
}

/* Turns the derivatives of the relation by the assumptions into those of the angle. */
static void complete_angle_columns(fo_work *w, const fo_smoothed *s)
{
    for (size_t b = 0; b < w->blocks; b++) {
        const double *x = s->room.state + b * N * s->sides;
        const fo_block_facts *about = &w->about[b];
        for (size_t j = 0; j < w->columns; j++)
            w->across[b * w->columns + j] += about->across.re * x[1 + j] +
                                             about->across.im * x[s->sides + 1 + j] +
                                             about->across_psi * x[PSI * s->sides + 1 + j];
    }
}

/* Derivatives of the angle at this many rows from the middle of a block. */
static void angle_columns_at(const fo_work *w, size_t b, double rows, double *column)
{
    const double place = clamp((double)b + rows / (double)w->per_block, 0.0,
                               (double)(w->blocks - 1));
    const size_t low = (size_t)place, high = low + 1 < w->blocks ? low + 1 : low;
    const double share = place - (double)low;
    for (size_t j = 0; j < w->columns; j++)
        column[j] = (1.0 - share) * w->across[low * w->columns + j] +
                    share * w->across[high * w->columns + j];
}

static void set_innovations(const fo_work *w, const fo_smoothed *s, spread *all, double *misfit)
{
    fo_misfits(w, s, misfit);
    for (size_t b = 0; b < w->blocks; b++) {
        const size_t k = b * w->measurements + FO_LENGTH;
        const double v = s->room.spread[k];
        all[b].innovation = isfinite(v) ? s->room.innovation[k * s->sides] / sqrt(v) : 0.0;
        all[b].misfit = misfit[b];
    }
}

/* Variance of a quantity with these derivatives; adds `weight` times the shares. */
static double assumed_variance(const fo_work *w, const fo_assumed *l, const double *column,
                               double weight, double *shares)
{
    const size_t P = w->columns;
    double sum = 0.0;
    for (size_t i = 0; i < P; i++) {
        double row = 0.0;
        for (size_t j = 0; j < P; j++) row += l->covariance[i * P + j] * column[j];
        sum += column[i] * row;
        if (shares != NULL) shares[w->active[i]] += weight * column[i] * row;
    }
    return sum;
}

static void add_rest(double *shares, double smoother, double noise)
{
    if (shares == NULL) return;
    shares[FO_BUDGET_SMOOTHER] += smoother;
    shares[FO_BUDGET_NOISE] += noise;
}

static void spread_of(const fo_work *w, const fo_assumed *l, const fo_smoothed *s, size_t b,
                      spread *out, double *budget)
{
    const fo_model *m = w->model;
    const fo_block_facts *about = &w->about[b];
    const size_t P = w->columns, sides = s->sides;
    const double *x = s->room.state + b * N * sides, *c = s->room.covariance + b * N * N;
    double column[FO_P], other[FO_P];
    const double h[3] = {about->across.re, about->across.im, about->across_psi};
    static const int state[3] = {0, 1, PSI};
    double filter = 0.0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) filter += h[i] * h[k] * c[state[i] * N + state[k]];
    filter *= l->filter_scale;
    double *of[FO_QUANTITIES];
    for (int n = 0; n < FO_QUANTITIES; n++)
        of[n] = budget == NULL ? NULL : budget + (size_t)n * FO_BUDGET;
    if (budget != NULL) memset(budget, 0, FO_QUANTITIES * FO_BUDGET * sizeof *budget);
    const double *angle = w->across + b * P;
    out->angle = filter + assumed_variance(w, l, angle, 1.0, of[FO_OF_ANGLE]);
    out->noise = about->across_noise;
    add_rest(of[FO_OF_ANGLE], filter, out->noise);
    /* The speed is the difference of the angles FO_SPEED_ROWS before and behind. */
    const double window = 2.0 * FO_SPEED_ROWS * m->sample_time;
    angle_columns_at(w, b, -(double)FO_SPEED_ROWS, column);
    angle_columns_at(w, b, FO_SPEED_ROWS, other);
    for (size_t j = 0; j < P; j++) column[j] = (other[j] - column[j]) / window;
    out->speed = assumed_variance(w, l, column, 1.0, of[FO_OF_SPEED]);
    const double speed_noise = 2.0 * out->noise / (window * window),
                 speed_walk = l->filter_scale * dot(about->across, about->across) *
                              fo_flux_walk(w, l->p, b) / window;
    out->speed += speed_noise + speed_walk;
    add_rest(of[FO_OF_SPEED], speed_walk, speed_noise);
    /* Flux and torque. The torque is λ × i, without the current of the iron loss. */
    const vec i = about->current_still;
    for (int n = 0; n < 2; n++) {
        for (size_t j = 0; j < P; j++) {
            const vec total = w->total[b * P + j];
            column[j] = (n == 0 ? total.re : total.im) + x[(size_t)n * sides + 1 + j];
        }
        const double walk = l->filter_scale * c[n * N + n];
        out->flux[n] = walk + assumed_variance(w, l, column, 0.5, of[FO_OF_FLUX]);
        add_rest(of[FO_OF_FLUX], 0.5 * walk, 0.0);
    }
    for (size_t j = 0; j < P; j++) {
        const vec total = w->total[b * P + j];
        const vec flux = plus(total, vec_of(x[1 + j], x[sides + 1 + j]));
        vec current = {0.0, 0.0};
        switch (w->active[j]) {
        case FO_P_offset_alpha: current = vec_of(-1.0, 0.0); break;
        case FO_P_offset_beta: current = vec_of(0.0, -1.0); break;
        case FO_P_current_gain_re: current = times(-1.0, conjugate(i)); break;
        case FO_P_current_gain_im: current = times(-1.0, turned(conjugate(i))); break;
        case FO_P_iron_loss: current = times(-about->speed, turned(about->flux)); break;
        default: break;
        }
        column[j] = flux.re * i.im - flux.im * i.re + about->flux.re * current.im -
                    about->flux.im * current.re;
    }
    const double torque_walk =
        l->filter_scale *
        (c[0] * i.im * i.im - 2.0 * c[1] * i.re * i.im + c[N + 1] * i.re * i.re);
    out->torque = torque_walk + assumed_variance(w, l, column, 1.0, of[FO_OF_TORQUE]);
    add_rest(of[FO_OF_TORQUE], torque_walk, 0.0);
    /* Slow states and what they share with the assumptions. */
    const int slow[3] = {PSI, RESISTANCE, DRIFT}, with[3] = {FO_P_psi_f, FO_P_resistance, -1};
    double *const to[3] = {&out->psi, &out->resistance, &out->drift};
    for (int n = 0; n < 3; n++) {
        for (size_t j = 0; j < P; j++)
            column[j] = x[(size_t)slow[n] * sides + 1 + j] + (w->active[j] == with[n] ? 1.0 : 0.0);
        *to[n] = l->filter_scale * c[slow[n] * N + slow[n]] +
                 assumed_variance(w, l, column, 0.0, NULL);
    }
}

/* Without magnets, only the sign of i_d tells both ends of the rotor apart. Where i_d is small, the
 * neighbour does: the row before, and up to the first row with a current the row behind. */
static void choose_ends(const fo_work *w, const fo_assumed *l, fo_row *rows)
{
    const size_t n = w->record.rows;
    const double sure = KNOWN_SHARE * w->model->current;
    size_t first = n;
    for (size_t k = 0; k < n; k++) {
        const double i_d = dot(fo_corrected(l->p, w->record.current[k]), direction_of(rows[k].angle));
        const bool decided = fabs(i_d) > sure;
        if (decided && first == n) first = k;
        if (first == n) continue;
        const bool flip = decided
                              ? i_d < 0.0
                              : fabs(wrapped(rows[k].angle - rows[k - 1].angle)) > QUARTER_TURN;
        if (flip) rows[k].angle += 2.0 * QUARTER_TURN;
    }
    for (size_t k = first == n ? 0 : first; k-- > 0;)
        if (fabs(wrapped(rows[k].angle - rows[k + 1].angle)) > QUARTER_TURN)
            rows[k].angle += 2.0 * QUARTER_TURN;
}

#define MIX(field) ((1.0 - at.share) * a->field + at.share * z->field)

static void write_rows(const fo_work *w, const fo_assumed *l, const fo_smoothed *s, const fo_row *rows,
                       const spread *all, const fo_estimates *out)
{
    const fo_model *m = w->model;
    const size_t n = w->record.rows, sides = s->sides;
    for (size_t k = 0; k < n; k++) {
        const fo_place at = fo_place_of(w, k);
        const size_t next = at.block + 1 < w->blocks ? at.block + 1 : at.block;
        const spread *a = &all[at.block], *z = &all[next];
        const double *x = s->room.state + at.block * N * sides, *y = s->room.state + next * N * sides;
        double *to = out->columns + k;
#define SET(name, value) to[FO_S_##name * n] = (value)
#define STATE(row) ((1.0 - at.share) * x[(row) * sides] + at.share * y[(row) * sides])
        const vec i = fo_corrected(l->p, w->record.current[k]);
        const double angle = rows[k].angle;
        SET(flux_alpha, rows[k].flux.re);
        SET(flux_beta, rows[k].flux.im);
        SET(flux_alpha_std, sqrt(fmax(MIX(flux[0]), 0.0)));
        SET(flux_beta_std, sqrt(fmax(MIX(flux[1]), 0.0)));
        const bool magnets = m->psi > 0.0 && m->L_M == 0.0;
        SET(psi_f, magnets ? m->psi + l->p[FO_P_psi_f] + STATE(PSI) : rows[k].size);
        SET(psi_f_std, sqrt(fmax(MIX(psi), 0.0)));
        SET(theta_e, wrapped(angle));
        SET(theta_e_std, sqrt(fmax(MIX(angle) + MIX(noise), 0.0)));
        SET(speed_e, rows[k].speed);
        SET(speed_e_std, sqrt(fmax(MIX(speed), 0.0)));
        SET(torque, rows[k].flux.re * i.im - rows[k].flux.im * i.re -
                        rows[k].speed * l->p[FO_P_iron_loss] * dot(rows[k].flux, rows[k].flux));
        SET(torque_std, sqrt(fmax(MIX(torque), 0.0)));
        SET(drift_alpha, STATE(DRIFT));
        SET(drift_beta, STATE(DRIFT + 1));
        SET(drift_std, sqrt(fmax(MIX(drift), 0.0)));
        SET(resistance, m->resistance + l->p[FO_P_resistance] + STATE(RESISTANCE));
        SET(resistance_std, sqrt(fmax(MIX(resistance), 0.0)));
        SET(innovation, at.share < 0.5 ? a->innovation : z->innovation);
        SET(misfit, MIX(misfit));
        const bool doubtful =
            w->doubtful[at.block] || w->doubtful[next] || MIX(misfit) > FO_KNOWN_MISFIT;
        SET(doubtful, doubtful ? 1.0 : 0.0);
        out->known[k] = (uint8_t)(fo_is_measured(&w->record, k) && !doubtful &&
                                  rows[k].size > KNOWN_SHARE * m->flux_base);
#undef SET
#undef STATE
    }
}

size_t fo_blocks_of(const fo_model *m, size_t rows) { return rows / fo_rows_per_block(m); }

bool fo_estimate_rows(const fo_model *m, const fo_record *r, bool learning, fo_assumed *learnt,
                 const fo_estimates *out)
{
    fo_work w;
    fo_smoothed s;
    memset(&w, 0, sizeof w);
    memset(&s, 0, sizeof s);
    w.model = m;
    w.record = *r;
    w.per_block = fo_rows_per_block(m);
    w.blocks = fo_blocks_of(m, r->rows);
    w.measurements = m->injection > 0.0 ? FO_MEASUREMENTS : 1;
    for (int j = 0; j < FO_P; j++)
        if (m->std[j] > 0.0) w.active[w.columns++] = j;
    s.sides = 1 + w.columns;
    bool good = allocate(&w, &s);
    fo_row *rows = malloc(r->rows * sizeof *rows);
    spread *all = malloc(w.blocks * sizeof *all);
    good = good && rows != NULL && all != NULL;
    if (good) {
        memcpy(w.angle, r->angle, r->rows * sizeof *w.angle);
        for (size_t k = 1; k < w.blocks * w.per_block; k++)
            if (isnan(r->voltage[k].re) || isnan(r->voltage[k].im)) w.doubtful[k / w.per_block] = 1;
        for (size_t k = 0; k < w.blocks * w.per_block; k++) {
            const int phase = fo_floating_phase(r, k);
            if (phase > 0)
                w.floating[3 * (k / w.per_block) + (size_t)(phase - 1)] += 1.0 / (double)w.per_block;
        }
        double current = 0.0;
        for (size_t k = 0; k < r->rows; k++) {
            const double i_d = dot(r->current[k], direction_of(r->angle[k]));
            current += i_d > 0.0 ? i_d : 0.0;
        }
        w.start_rotor_flux = m->rotor_flux_start * m->L_M * current / (double)r->rows;
        good = fo_start(&w, learnt->p) && fo_learn(&w, learning, learnt, &s);
    }
    if (good) {
        const size_t columns = w.columns;
        w.columns = 0; /* the derivatives of the last pass stay */
        fo_linearise(&w, learnt->p, rows);
        w.columns = columns;
        complete_angle_columns(&w, &s);
        set_innovations(&w, &s, all, w.noise);
        for (size_t b = 0; b < w.blocks; b++)
            spread_of(&w, learnt, &s, b, &all[b],
                      out->budget == NULL ? NULL : out->budget + b * FO_QUANTITIES * FO_BUDGET);
        if (!(m->psi > 0.0 || m->L_M > 0.0)) choose_ends(&w, learnt, rows);
        write_rows(&w, learnt, &s, rows, all, out);
    }
    free(rows);
    free(all);
    release(&w, &s);
    return good;
}
