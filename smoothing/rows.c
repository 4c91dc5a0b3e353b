#include "rows.h"

#include <string.h>

#include "direction.h"

/* Knees of the hard and of the soft sign of the inverter's loss, as shares of the rated current.
 * With 0.01 and 0.06 the loss of a measured drive looks like a resistance: its angle is 3 degrees
 * off, against 1 (benchmarks/measured.py). */
#define HARD_KNEE 0.03
#define SOFT_KNEE 0.2
/* Bend of the loss: share of it at half of the rated current. */
#define BEND 0.15
/* The bend has a slope even without a loss: this share of the loss's prior. */
#define LEAST_BEND 0.3
/* A cage's flux below this share of its rated flux does not tell the angle. */
#define LEAST_ROTOR_FLUX 0.3

fo_place fo_place_of(const fo_work *w, size_t row)
{
    const double at = ((double)row - 0.5 * (double)(w->per_block - 1)) / (double)w->per_block;
    fo_place place = {0, 0.0};
    if (w->blocks > 1) {
        const double inside = clamp(at, 0.0, (double)(w->blocks - 1));
        place.block = (size_t)inside;
        if (place.block + 2 > w->blocks) place.block = w->blocks - 2;
        place.share = inside - (double)place.block;
    }
    return place;
}

static double interpolate(const double *values, fo_place at)
{
    return at.share == 0.0 ? values[at.block]
                           : (1.0 - at.share) * values[at.block] + at.share * values[at.block + 1];
}

static vec interpolate_vector(const vec *values, fo_place at)
{
    if (at.share == 0.0) return values[at.block];
    return plus(times(1.0 - at.share, values[at.block]), times(at.share, values[at.block + 1]));
}

/* The parts of a row that do not depend on the angle. */
typedef struct {
    vec current, conjugate_current; /* corrected [A]; and as logged, conjugate */
    vec by_duty, mean_by_duty;      /* error of current and mean at duty_gain = 1 [A] */
    vec mean;                       /* of the current over the interval that ends here [A] */
    vec middle;                     /* between the currents at both ends [A] */
    vec voltage, around;            /* of the interval; mean of it and the next [V] */
    vec bend;                       /* of the inverter's loss at inverter_curve = 1 [V] */
    fo_sign hard, soft;
    vec volt_seconds;               /* gained in the interval [V s] */
} interval;

static double sample_of(const double *x, ptrdiff_t k, ptrdiff_t n)
{
    /* Beyond the ends: continued linearly. */
    if (k < 0) return 2.0 * x[0] - x[2];
    if (k >= n) return 2.0 * x[2 * (n - 1)] - x[2 * (n - 2)];
    return x[2 * k];
}

static vec sample(const vec *x, ptrdiff_t k, ptrdiff_t n)
{
    return vec_of(sample_of(&x->re, k, n), sample_of(&x->im, k, n));
}

/* An unknown voltage counts as zero; its block lets the flux jump. */
static vec voltage_at(const fo_record *r, size_t row)
{
    const vec v = r->voltage[row];
    return isnan(v.re) || isnan(v.im) ? vec_of(0.0, 0.0) : v;
}

static void interval_at(const fo_work *w, const double p[FO_P], size_t row, interval *at)
{
    const fo_model *m = w->model;
    const fo_record *r = &w->record;
    const ptrdiff_t k = (ptrdiff_t)row, n = (ptrdiff_t)r->rows;
    const vec here = sample(r->current, k, n), before = sample(r->current, k - 1, n);
    /* Mean of the cubic through four samples over the interval between the middle two. */
    const vec outer = plus(sample(r->current, k - 2, n), sample(r->current, k + 1, n));
    const vec mean = times(1.0 / 24.0, minus(times(13.0, plus(here, before)), outer));
    at->voltage = voltage_at(r, row == 0 ? 1 : row);
    at->around = times(0.5, plus(at->voltage, voltage_at(r, row + 1 < r->rows ? row + 1 : row)));
    at->conjugate_current = conjugate(here);
    /* The products of the phases' currents and voltages, as a vector. */
    at->by_duty = times(1.0 / m->voltage, conjugate(product(here, at->around)));
    at->mean_by_duty = times(1.0 / m->voltage, conjugate(product(mean, at->voltage)));
    at->current = minus(fo_corrected(p, here), times(p[FO_P_duty_gain], at->by_duty));
    at->mean = minus(fo_corrected(p, mean), times(p[FO_P_duty_gain], at->mean_by_duty));
    at->middle = fo_corrected(p, row == 0 ? here : times(0.5, plus(here, before)));
    const double share = length_of(at->mean) / m->current;
    at->bend = times(-BEND * (1.0 - share) / m->current, at->mean);
    if (!w->signs_known) {
        fo_phase_signs(at->middle, HARD_KNEE * m->current, &w->hard[row]);
        fo_phase_signs(at->middle, SOFT_KNEE * m->current, &w->soft[row]);
    }
    at->hard = w->hard[row];
    at->soft = w->soft[row];
    const vec gain = vec_of(p[FO_P_voltage_gain_re], p[FO_P_voltage_gain_im]);
    vec v = plus(at->voltage, product(gain, conjugate(at->voltage)));
    v = minus(v, times(p[FO_P_link_sag] * share, at->voltage));
    v = minus(v, times(m->resistance + p[FO_P_resistance], at->mean));
    v = minus(v, times(p[FO_P_inverter_hard], at->hard.sign));
    v = minus(v, times(p[FO_P_inverter_soft], at->soft.sign));
    v = plus(v, times(p[FO_P_inverter_curve] * fo_inverter_loss(m, p), at->bend));
    at->volt_seconds = row == 0 ? vec_of(0.0, 0.0) : times(m->sample_time, v);
}

/* Derivative of a row's volt-seconds by a change of the measured current. */
static vec by_current(const fo_work *w, const double p[FO_P], const interval *at, vec change)
{
    const fo_model *m = w->model;
    const double hard = p[FO_P_inverter_hard], soft = p[FO_P_inverter_soft],
                 R = m->resistance + p[FO_P_resistance],
                 dd = R + hard * at->hard.dd + soft * at->soft.dd,
                 dq = hard * at->hard.dq + soft * at->soft.dq,
                 qq = R + hard * at->hard.qq + soft * at->soft.qq;
    return times(-m->sample_time,
                 vec_of(dd * change.re + dq * change.im, dq * change.re + qq * change.im));
}

/* Flux of a cage behind its leakage, from i_d; with its derivatives by R_R and L_M (as shares). */
typedef struct {
    double decay, by_share; /* over a sample; derivative of the decay by ln(R_R / L_M) */
    double L_M;
    double flux, by_R_R, by_L_M;
    double last; /* i_d [A] */
} rotor;

static rotor rotor_at_start(const fo_model *m, const double p[FO_P], double flux)
{
    rotor c = {0.0, 0.0, m->L_M * (1.0 + p[FO_P_L_M]), flux, 0.0, 0.0, NAN};
    if (m->L_M > 0.0) {
        const double share = m->R_R * (1.0 + p[FO_P_R_R]) / c.L_M * m->sample_time;
        c.decay = exp(-share);
        c.by_share = -share * c.decay;
        c.by_L_M = flux / (1.0 + p[FO_P_L_M]);
    }
    return c;
}

static void rotor_step(rotor *c, const double p[FO_P], double i_d)
{
    const double mean = isnan(c->last) ? i_d : 0.5 * (i_d + c->last);
    const double towards = c->L_M * mean, away = c->flux - towards;
    const double R_R = 1.0 + p[FO_P_R_R], L_M = 1.0 + p[FO_P_L_M];
    c->by_R_R = c->decay * c->by_R_R + c->by_share / R_R * away;
    c->by_L_M =
        c->decay * c->by_L_M - c->by_share / L_M * away + (1.0 - c->decay) * towards / L_M;
    c->flux = c->decay * c->flux + (1.0 - c->decay) * towards;
    c->last = i_d;
}

static double steady_psi(const fo_model *m, const double p[FO_P])
{
    return m->psi + p[FO_P_psi_f];
}

/* Change of the flux in rotor coordinates by a change of the current there. */
static vec by_rotor_current(const fo_relation *at, vec change)
{
    return plus(times(change.re, at->by_d), times(change.im, at->by_q));
}

/* The signs of a pass serve the next passes as long as the currents stay the same. */
static void begin_pass(fo_work *w, const double p[FO_P])
{
    const double now[4] = {p[FO_P_offset_alpha], p[FO_P_offset_beta], p[FO_P_current_gain_re],
                           p[FO_P_current_gain_im]};
    bool same = w->signs_filled;
    for (int n = 0; n < 4; n++) {
        same = same && now[n] == w->signs_of[n];
        w->signs_of[n] = now[n];
    }
    w->signs_known = same;
    w->signs_filled = true;
}

void fo_integrate(fo_work *w, const double p[FO_P], vec *volt_seconds, vec *current,
                  double *psi)
{
    const fo_model *m = w->model;
    const bool cage = m->L_M > 0.0;
    rotor c = rotor_at_start(m, p, w->start_rotor_flux);
    begin_pass(w, p);
    vec sum = vec_of(0.0, 0.0);
    for (size_t k = 0; k < w->record.rows; k++) {
        interval at;
        interval_at(w, p, k, &at);
        sum = plus(sum, at.volt_seconds);
        volt_seconds[k] = minus(
            sum, times(m->sample_time * (p[FO_P_lag] + p[FO_P_delay]), at.around));
        current[k] = at.current;
        if (cage) {
            rotor_step(&c, p, dot(at.current, direction_of(w->angle[k])));
            psi[k] = fmax(c.flux, FO_SHORTEST_SHARE * m->flux_base);
        } else {
            psi[k] = steady_psi(m, p);
        }
    }
}

/* Derivatives at a row by every assumption: of the volt-seconds gained, and of the relation. */
static void volt_second_columns(const fo_work *w, const double p[FO_P], const interval *at,
                                vec column[FO_P])
{
    const fo_model *m = w->model;
    const double h = m->sample_time, loss = fo_inverter_loss(m, p),
                 least = LEAST_BEND * m->std[FO_P_inverter_hard];
    const vec u = conjugate(at->voltage), i = at->conjugate_current;
    column[FO_P_resistance] = times(-h, at->mean);
    column[FO_P_inverter_hard] = times(-h, at->hard.sign);
    column[FO_P_inverter_soft] = times(-h, at->soft.sign);
    column[FO_P_inverter_curve] = times(h * (loss > least ? loss : least), at->bend);
    column[FO_P_offset_alpha] = by_current(w, p, at, vec_of(-1.0, 0.0));
    column[FO_P_offset_beta] = by_current(w, p, at, vec_of(0.0, -1.0));
    column[FO_P_current_gain_re] = by_current(w, p, at, times(-1.0, i));
    column[FO_P_current_gain_im] = by_current(w, p, at, times(-1.0, turned(i)));
    column[FO_P_duty_gain] = by_current(w, p, at, times(-1.0, at->mean_by_duty));
    column[FO_P_voltage_gain_re] = times(h, u);
    column[FO_P_voltage_gain_im] = times(h, turned(u));
    column[FO_P_link_sag] = times(-h * length_of(at->mean) / m->current, at->voltage);
}

/* Assumptions that change the volt-seconds; they are summed over the rows. */
static const int summed[] = {
    FO_P_resistance,      FO_P_inverter_hard,   FO_P_inverter_soft,   FO_P_inverter_curve,
    FO_P_offset_alpha,    FO_P_offset_beta,     FO_P_current_gain_re, FO_P_current_gain_im,
    FO_P_duty_gain,       FO_P_voltage_gain_re, FO_P_voltage_gain_im, FO_P_link_sag};
enum { SUMMED = sizeof summed / sizeof *summed };

static void flux_columns(const fo_model *m, const double p[FO_P], const interval *at, const fo_relation *f,
                         vec direction, vec i, vec flux, double speed, const rotor *c,
                         vec column[FO_P])
{
    const vec back = conjugate(direction), logged = product(at->conjugate_current, back);
    const double over = 1.0 / m->current;
    column[FO_P_offset_alpha] = by_rotor_current(f, times(-1.0, back));
    column[FO_P_offset_beta] = by_rotor_current(f, times(-1.0, turned(back)));
    column[FO_P_current_gain_re] = by_rotor_current(f, times(-1.0, logged));
    column[FO_P_current_gain_im] = by_rotor_current(f, times(-1.0, turned(logged)));
    column[FO_P_duty_gain] = by_rotor_current(f, times(-1.0, product(at->by_duty, back)));
    column[FO_P_iron_loss] =
        by_rotor_current(f, times(-speed, turned(product(flux, back))));
    const double left_d = fo_unsaturated(m, p[FO_P_saturation_d], i.re),
                 left_q = fo_unsaturated(m, p[FO_P_saturation_q], i.im);
    const double q = 1.0 + p[m->one_inductance > 0.0 ? FO_P_L_d : FO_P_L_q];
    column[FO_P_L_d] =
        vec_of(f->map.re * left_d, m->one_inductance > 0.0 ? f->map.im * left_q : 0.0);
    column[FO_P_L_q] = vec_of(0.0, f->map.im * left_q);
    column[FO_P_saturation_d] =
        vec_of(-f->map.re * (1.0 + p[FO_P_L_d]) * left_d * left_d * fabs(i.re) * over, 0.0);
    column[FO_P_saturation_q] =
        vec_of(0.0, -f->map.im * q * left_q * left_q * fabs(i.im) * over);
    column[FO_P_psi_f] = vec_of(1.0, 0.0);
    column[FO_P_fifth] = times(m->flux_base, conjugate(f->sixth));
    column[FO_P_seventh] = times(m->flux_base, f->sixth);
    column[FO_P_R_R] = vec_of(c->by_R_R, 0.0);
    column[FO_P_L_M] = vec_of(c->by_L_M, 0.0);
}

/* Sums over the rows of a block. */
typedef struct {
    vec along, along_by_time, mean, current, current_still, flux, flux_across, phase;
    double psi_row, measured, noise, squares, feedback, square_d, square_q, voltage, size, across_noise,
        across_psi, rotation, speed, rotor_flux;
    double column[FO_P], across[FO_P];
    bool usable;
} sums;

/* Covariance of the noise in the measurement and in the derivative by the lag, over the variance of
 * the current's noise, times the rows of a block and the squares: a current controller returns the
 * noise of a row in the voltage of an interval that ends some rows later. The derivative has the
 * mean of two intervals; count: the pairs of rows of a block with the same noise. */
static double feedback_share(const fo_model *m, const sums *s, double rows)
{
    const double after = m->feedback_rows;
    if (!(after > 0.0)) return 0.0;
    const double count = fmax(rows - after, 0.0) + fmax(rows - after + 1.0, 0.0);
    return -0.5 * m->sample_time * s->feedback * count / rows;
}

static void finish(fo_work *w, size_t b, const sums *s, const vec total[FO_P])
{
    const fo_model *m = w->model;
    const double n = (double)w->per_block, over = 1.0 / n, h = m->sample_time;
    fo_block_facts *about = &w->about[b];
    fo_smooth_block *block = &w->block[b];
    block->duration = n * h;
    block->coupling[0] = -h * s->mean.re;
    block->coupling[1] = -h * s->mean.im;
    double *row = block->row[FO_LENGTH];
    row[0] = over * s->along.re;
    row[1] = over * s->along.im;
    row[2] = over * s->along_by_time.re;
    row[3] = over * s->along_by_time.im;
    row[4] = -over * s->psi_row;
    row[5] = 0.0;
    about->noise[FO_LENGTH] = (s->noise * over) * (s->noise * over) * over;
    const double noise = fmax(s->squares, 1e-300);
    about->share_d[FO_LENGTH] = s->square_d / noise;
    about->share_q[FO_LENGTH] = s->square_q / noise;
    about->share_lag = feedback_share(m, s, n) / noise;
    about->rotation = fabs(s->speed * h) + 1e-9;
    about->speed = over * s->speed;
    about->angle = atan2(s->phase.im, s->phase.re);
    about->current = times(over, s->current);
    about->current_still = times(over, s->current_still);
    about->flux = times(over, s->flux);
    about->voltage = over * s->voltage;
    about->size = fmax(over * s->size, FO_SHORTEST_SHARE * m->flux_base);
    about->across_noise = over * s->across_noise;
    about->across = times(over, s->flux_across);
    about->across_psi = over * s->across_psi;
    about->usable = s->usable && !(m->L_M > 0.0 &&
                                   over * s->rotor_flux < LEAST_ROTOR_FLUX * m->flux_base);
    double *measured = w->measured + b * w->measurements * (1 + w->columns);
    measured[0] = over * s->measured;
    for (size_t j = 0; j < w->columns; j++) {
        measured[1 + j] = -over * s->column[w->active[j]];
        w->across[b * w->columns + j] = over * s->across[w->active[j]];
        w->total[b * w->columns + j] = total[w->active[j]];
    }
}

/* ---- measurement of the direction ------------------------------------------------------------ */

/* Fewest rows of a measurement of the direction. */
enum { DIRECTION_ROWS = 16 };

/* What the angle of a row depends on, and derivatives by the assumptions of the flux in stator
 * coordinates and of the relation in rotor coordinates. */
typedef struct {
    vec direction;          /* of the rotor */
    vec across;             /* derivatives of the angle by the flux [rad/Wb], */
    double across_psi;      /* by the magnet flux [rad/Wb], */
    double column[FO_P];    /* by the assumptions */
    double reference;       /* part of the angle that the reference's corrections cause [rad] */
    double time;            /* from the middle of the block [s] */
    const vec *total, *change;
} angle_facts;

/* Sums over the rows of a measurement. */
typedef struct {
    fo_ripple ripple;
    vec total[FO_P], change[FO_P]; /* of the last row */
    vec across, across_by_time;
    double across_psi, reference;
    double of_angle[FO_P], direct[FO_P]; /* derivatives of the angle, and of the ripple's product */
} direction_sums;

static void add_direction(const fo_work *w, direction_sums *s, const fo_ripple_row *now,
                          const fo_relation *f, const fo_relation *given, const angle_facts *facts,
                          bool measured, double rotation)
{
    if (fo_add_ripple(&s->ripple, now, f, given, measured, rotation)) {
        const vec beside = turned(s->ripple.response);
        s->reference += facts->reference;
        s->across = plus(s->across, facts->across);
        s->across_by_time = plus(s->across_by_time, times(facts->time, facts->across));
        s->across_psi += facts->across_psi;
        for (size_t n = 0; n < w->columns; n++) {
            const int j = w->active[n];
            const vec gained =
                product(minus(facts->total[j], s->total[j]), conjugate(facts->direction));
            const vec changed = minus(facts->change[j], s->change[j]);
            s->of_angle[j] += facts->column[n];
            s->direct[j] -= dot(minus(gained, changed), beside);
        }
    }
    memcpy(s->total, facts->total, sizeof s->total);
    memcpy(s->change, facts->change, sizeof s->change);
}

static void finish_direction(fo_work *w, const double p[FO_P], size_t b, direction_sums *s)
{
    const fo_model *m = w->model;
    const fo_ripple *r = &s->ripple;
    fo_block_facts *about = &w->about[b];
    about->noise[FO_DIRECTION] = 0.0;
    if (r->rows < DIRECTION_ROWS) return;
    if (fo_shows_direction(m, r)) {
        const double over = 1.0 / r->rows, size = over * r->size, scale = over * size;
        double *row = w->block[b].row[FO_DIRECTION],
               *measured = w->measured + (b * w->measurements + FO_DIRECTION) * (1 + w->columns);
        row[0] = scale * s->across.re;
        row[1] = scale * s->across.im;
        row[2] = scale * s->across_by_time.re;
        row[3] = scale * s->across_by_time.im;
        row[4] = scale * s->across_psi;
        row[5] = 0.0;
        measured[0] = scale * s->reference - size * (fo_direction_error(r) + p[FO_P_tilt]);
        for (size_t n = 0; n < w->columns; n++) {
            const int j = w->active[n];
            const double by_angle = over * s->of_angle[j], direct = s->direct[j] / r->square;
            measured[1 + n] = -size * (j == FO_P_tilt ? 1.0 : by_angle + direct);
        }
        about->noise[FO_DIRECTION] = size * size * fo_direction_variance(m, r);
        about->saliency_variance = fo_saliency_variance(m, r);
        about->share_d[FO_DIRECTION] = r->noise_d / r->noise / (1.0 + p[FO_P_L_d]);
        about->share_q[FO_DIRECTION] = r->noise_q / r->noise / (1.0 + p[FO_P_L_q]);
    }
    fo_next_ripple(&s->ripple);
    s->across = s->across_by_time = vec_of(0.0, 0.0);
    s->across_psi = s->reference = 0.0;
    memset(s->of_angle, 0, sizeof s->of_angle);
    memset(s->direct, 0, sizeof s->direct);
}

void fo_fit_speed(fo_work *w)
{
    const size_t n = w->record.rows;
    double *turn = w->unwrapped;
    turn[0] = w->angle[0];
    for (size_t k = 1; k < n; k++)
        turn[k] = turn[k - 1] + wrapped(w->angle[k] - w->angle[k - 1]);
    for (size_t k = 0; k < n; k++) {
        const size_t low = k > FO_SPEED_ROWS ? k - FO_SPEED_ROWS : 0,
                     high = k + FO_SPEED_ROWS < n ? k + FO_SPEED_ROWS : n - 1;
        w->speed[k] =
            (turn[high] - turn[low]) / ((double)(high - low) * w->model->sample_time);
    }
}

volatile int fo_stopped = 0;

void fo_linearise(fo_work *w, const double p[FO_P], fo_row *rows)
{
    const fo_model *m = w->model;
    const double h = m->sample_time, half = 0.5 * (double)(w->per_block - 1);
    const bool cage = m->L_M > 0.0, one_inductance = m->one_inductance > 0.0;
    const double noise2 = m->current_noise * m->current_noise;
    const double lag = p[FO_P_lag] + p[FO_P_delay];
    rotor c = rotor_at_start(m, p, w->start_rotor_flux);
    begin_pass(w, p);
    vec flux = vec_of(0.0, 0.0), total[FO_P], volts[FO_P], change[FO_P];
    double i_d = 0.0;
    memset(total, 0, sizeof total);
    memset(volts, 0, sizeof volts);
    memset(change, 0, sizeof change);
    sums s;
    memset(&s, 0, sizeof s);
    direction_sums changes;
    memset(&changes, 0, sizeof changes);
    const bool injection = w->measurements > FO_DIRECTION;
    static const double as_given[FO_P] = {0.0};
    for (size_t k = 0; k < w->record.rows; k++) {
        const size_t b = k / w->per_block, inside = k % w->per_block;
        const bool counts = b < w->blocks;
        const double since = ((double)inside - half) * h;
        const fo_place place = fo_place_of(w, k);
        interval at;
        interval_at(w, p, k, &at);
        if (inside == 0) {
            if (fo_stopped) return;
            memset(&s, 0, sizeof s);
            s.usable = true;
        }
        flux = plus(flux, at.volt_seconds);
        const vec correction = interpolate_vector(w->correction, place);
        const vec lambda = plus(minus(flux, times(h * lag, at.around)), correction);
        const double speed = w->speed[k];
        const vec i = minus(at.current, times(speed * p[FO_P_iron_loss], turned(lambda)));
        double psi = steady_psi(m, p);
        if (cage) {
            rotor_step(&c, p, dot(i, direction_of(w->angle[k])));
            psi = c.flux;
        }
        const double reference = psi, offset = interpolate(w->psi, place);
        psi += offset;
        if (cage) psi = fmax(psi, FO_SHORTEST_SHARE * m->flux_base);
        vec direction, i_dq;
        fo_relation f;
        const double residual =
            fo_solve_angle(m, p, psi, i, lambda, &w->angle[k], &direction, &i_dq, &f);
        if (w->columns > 0) {
            volt_second_columns(w, p, &at, volts);
            flux_columns(m, p, &at, &f, direction, i_dq, lambda, speed, &c, change);
        }
        if (k > 0 && w->columns > 0)
            for (int n = 0; n < SUMMED; n++)
                total[summed[n]] = plus(total[summed[n]], volts[summed[n]]);
        total[FO_P_lag] = total[FO_P_delay] = times(-h, at.around);
        const vec along = product(f.along, direction); /* in stator coordinates */
        const vec athwart = turned(f.along), beside = turned(along);
        const double over = 1.0 / f.size, d = dot(f.by_d, f.along), q = dot(f.by_q, f.along),
                     across_d = dot(f.by_d, athwart), across_q = dot(f.by_q, athwart);
        if (counts) {
            angle_facts facts;
            facts.direction = direction;
            facts.across = times(over, beside);
            facts.across_psi = -over * athwart.re;
            facts.time = since;
            facts.reference =
                dot(facts.across, correction) + facts.across_psi * (psi - reference);
            for (size_t n = 0; n < w->columns; n++) {
                const int j = w->active[n];
                facts.column[n] = over * (dot(beside, total[j]) - dot(athwart, change[j]));
                s.column[j] += dot(along, total[j]) - dot(f.along, change[j]);
                s.across[j] += facts.column[n];
            }
            s.across[FO_P_delay] += speed * h;
            s.along = plus(s.along, along);
            s.along_by_time = plus(s.along_by_time, times(since, along));
            s.psi_row += f.along.re;
            s.measured += dot(along, correction) - residual - f.along.re * (psi - reference);
            s.noise += m->current_noise * sqrt(d * d + q * q);
            s.squares += d * d + q * q;
            s.feedback += m->feedback_d * d * f.along.re + m->feedback_q * q * f.along.im;
            s.square_d += (one_inductance ? d * d + q * q : d * d) / (1.0 + p[FO_P_L_d]);
            s.square_q += one_inductance ? 0.0 : q * q / (1.0 + p[FO_P_L_q]);
            s.across_noise += noise2 * (across_d * across_d + across_q * across_q) * over * over;
            s.across_psi += facts.across_psi;
            s.mean = plus(s.mean, at.mean);
            s.current = plus(s.current, i_dq);
            s.current_still = plus(s.current_still, at.current);
            s.flux = plus(s.flux, lambda);
            s.phase = plus(s.phase, direction);
            s.voltage += length_of(at.voltage);
            s.size += f.size + (residual < 0.0 ? residual : 0.0);
            s.rotor_flux += psi + (residual < 0.0 ? residual : 0.0);
            s.speed += speed;
            s.flux_across = plus(s.flux_across, facts.across);
            const bool is_measured = fo_is_measured(&w->record, k);
            s.usable = s.usable && is_measured;
            if (injection) {
                const fo_ripple_row now = {times(residual, f.along),
                                           product(lambda, conjugate(direction)),
                                           times(f.size, f.along), w->angle[k]};
                facts.total = total;
                facts.change = change;
                fo_relation given;
                fo_relate(m, as_given, psi, i_dq, direction, &given);
                add_direction(w, &changes, &now, &f, &given, &facts, is_measured, speed * h);
            }
            if (inside + 1 == w->per_block) {
                finish(w, b, &s, total);
                if (injection) finish_direction(w, p, b, &changes);
            }
        }
        i_d += i_dq.re > 0.0 ? i_dq.re : 0.0;
        if (rows != NULL) {
            rows[k].flux = lambda;
            rows[k].angle = w->angle[k] + speed * h * p[FO_P_delay];
            rows[k].size = f.size;
        }
    }
    fo_fit_speed(w);
    if (rows != NULL)
        for (size_t k = 0; k < w->record.rows; k++) rows[k].speed = w->speed[k];
    if (cage)
        w->start_rotor_flux = m->rotor_flux_start * m->L_M * i_d / (double)w->record.rows;
}
