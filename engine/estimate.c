#include "estimate.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "begin.h"
#include "exact_file.h"
#include "growth.h"
#include "thinning.h"

enum {
    SKIPPED = 20, /* rows until innovations count: the first speed is rough */
    MOST = 120,   /* evaluations, at most */
};
/* Share of the flux by which magnets change in a second (root of it): their temperature changes by 30 K
 * in ten minutes. A cage's flux changes as its inductances do. A reluctance machine has none. */
static const double psi_walk = 1e-3;

/* Root mean square of the voltages. */
static double mean_voltage(const fo_log *record)
{
    double sum = 0.0, known = 0.0;
    for (size_t k = 0; k < 2 * record->rows; k++) {
        if (!isfinite(record->voltage[k])) continue;
        sum += record->voltage[k] * record->voltage[k];
        known += 0.5;
    }
    return fmax(sqrt(sum / fmax(known, 1.0)), 1e-9);
}

/* Largest of the phases' currents in a row; zero if it is not known. */
static double phase_current(const fo_log *record, size_t row)
{
    const double *i = record->current + 2 * row;
    if (!isfinite(i[0]) || !isfinite(i[1])) return 0.0;
    return fmax(fabs(i[0]), 0.5 * fabs(i[0]) + 0.86602540378443864676 * fabs(i[1]));
}

static double largest_current(const fo_log *record)
{
    double most = 0.0;
    for (size_t k = 0; k < record->rows; k++) most = fmax(most, phase_current(record, k));
    return most;
}

static void put(fo_prior *prior, int k, double mean, double std)
{
    prior->mean[k] = mean;
    prior->std[k] = std;
}

fo_prior fo_ordinary_prior(const fo_log *record, const fo_file *file)
{
    fo_prior p;
    memset(&p, 0, sizeof p);
    const double u = mean_voltage(record), h = fabs(record->sample_time);
    const double speed = u / file->flux; /* at which this flux alone gives the mean voltage */
    put(&p, FO_L_resistance, log(file->R), file->R_std);
    put(&p, FO_L_L_d, log(file->L_d), file->L_d_std);
    put(&p, FO_L_L_q, log(file->L_q), file->L_q_std);
    put(&p, FO_L_psi_f, log(file->psi_f), file->psi_f > 0.0 ? file->psi_std : 0.0);
    /* Rated current alone accelerates to that speed in 2 ms, or much more slowly. */
    put(&p, FO_L_mobility, 0.0, speed / (0.002 * file->flux * file->rated_current));
    put(&p, FO_L_noise, log(0.003 * file->rated_current), 1.5);
    put(&p, FO_L_acceleration, log(10.0 * speed), 3.0);
    put(&p, FO_L_voltage, log(0.001 * u * sqrt(h)), 1.5);
    put(&p, FO_L_drift, log(0.001 * u), 1.0);
    if (file->loss > 0.0)
        put(&p, FO_L_loss, log(file->loss), file->loss_std);
    else
        put(&p, FO_L_loss, log(0.02 * u), 1.5);
    put(&p, FO_L_knee, log(0.03 * file->rated_current), 0.7);
    put(&p, FO_L_lag, file->lag, file->lag_std);
    put(&p, FO_L_delay, 0.0, file->delay_std);
    put(&p, FO_L_rotation, file->rotation, file->rotation_std);
    put(&p, FO_L_iron_loss, 0.0, file->iron_std);
    put(&p, FO_L_heat, 0.0, file->heat_std);
    put(&p, FO_L_offset_alpha, 0.0, file->offset_std);
    put(&p, FO_L_offset_beta, 0.0, file->offset_std);
    put(&p, FO_L_gain_re, 0.0, file->gain_std);
    put(&p, FO_L_gain_im, 0.0, file->gain_std);
    put(&p, FO_L_saturation_d, 0.0, file->saturation_std);
    put(&p, FO_L_saturation_q, 0.0, file->saturation_std);
    if (file->R_R > 0.0) {
        put(&p, FO_L_rotor_resistance, log(file->R_R), file->R_R_std);
        put(&p, FO_L_magnetizing, log(file->L_M), file->L_M_std);
    }
    /* The angle of a cage's flux is no place on its rotor. */
    p.harmonics = file->R_R > 0.0 ? 0.0 : file->harmonics * file->flux;
    p.round = !file->map && file->L_d == file->L_q;
    return p;
}

/* The levels of a poor drive, for the filter to follow with. */
static void begin_levels(const fo_log *record, const fo_file *file, const fo_prior *prior,
                         double *parameters)
{
    const double u = mean_voltage(record);
    parameters[FO_L_noise] = log(0.02 * file->rated_current);
    parameters[FO_L_acceleration] = prior->mean[FO_L_acceleration];
    parameters[FO_L_voltage] = log(0.01 * u * sqrt(fabs(record->sample_time)));
    parameters[FO_L_drift] = log(0.02 * u);
}

/* First values. */
static void begin(const fo_log *record, const fo_file *file, const fo_prior *prior,
                  const double *parameters, fo_posterior *out)
{
    memset(out, 0, sizeof *out);
    memcpy(out->parameters, prior->mean, sizeof prior->mean);
    begin_levels(record, file, prior, out->parameters);
    out->harmonics = prior->harmonics;
    for (int k = 0; parameters && k < FO_UNKNOWNS; k++)
        if (isfinite(parameters[k])) out->parameters[k] = parameters[k];
}

/* Nothing is known of the state at the first row. */
static fo_start any_start(const fo_log *record, const fo_file *file)
{
    const double u = mean_voltage(record), speed = u / file->flux;
    const fo_start start = {
        .flux_std = 3.0 * file->flux,
        .angle_std = 1.8137993642342178, /* π/√3, of a uniform angle */
        .speed_std = speed,
        .acceleration_std = 10.0 * speed, /* to that speed in a tenth of a second */
        .psi_std = file->R_R > 0.0 ? file->flux : 0.0,
        .drift_std = 0.02 * u,
        .skipped = SKIPPED < record->rows ? SKIPPED : 0,
    };
    return start;
}

static fo_machine machine_of(const fo_file *file)
{
    const fo_machine machine = {
        .map = file->map,
        .cage = file->R_R > 0.0,
        .saturates = file->map || file->saturation_std > 0.0,
        .current = file->rated_current,
        .psi_rate = file->psi_f > 0.0 || file->R_R > 0.0 ? psi_walk * file->flux : 0.0,
    };
    return machine;
}

static double square_of_step(const fo_log *record, size_t k)
{
    const double *i = record->current + 2 * k, a = i[0] - i[-2], b = i[1] - i[-1];
    return a * a + b * b;
}

void fo_rounding_of(const fo_log *record, double *rounding)
{
    for (size_t first = 0, end; first < record->rows; first = end) {
        for (end = first + 1; end < record->rows && square_of_step(record, end) == 0.0;) end++;
        /* The steps at both ends of the run, unless a current is missing there. */
        double sum = 0.0, steps = 0.0;
        for (int n = 0; n < 2; n++) {
            const size_t at = n ? end : first;
            if (at == 0 || at == record->rows) continue;
            const double square = square_of_step(record, at);
            if (!isfinite(square)) continue;
            sum += square;
            steps += 1.0;
        }
        const double length = (double)(end - first);
        const double variance = steps > 0.0 && length > 1.0 ? length * sum / steps / 12.0 : 0.0;
        for (size_t k = first; k < end; k++) rounding[k] = variance;
    }
}

/* What learning needs: two courses, the second for a trial. */
typedef struct {
    const fo_file *file;
    fo_machine machine;
    fo_start start;
    fo_log log;
    double *rounding, *spare; /* a number for each row */
    fo_work work;
    fo_part whole;
    fo_prior prior;
    fo_posterior *posterior;
    fo_course *course, *other;
    bool sure; /* hints */
} learning;

static void free_learning(learning *l)
{
    free(l->rounding);
    free(l->spare);
    free(l->course);
    free(l->other);
    free(l->work.checkpoints);
    free(l->work.rows);
    free(l->work.squares);
    free(l->work.before);
    free(l->work.best);
}

/* False: no memory; then nothing is left to free. */
static bool open_learning(const fo_log *record, const fo_file *file, const fo_prior *prior,
                          fo_posterior *posterior, learning *l)
{
    const size_t count = record->rows;
    *l = (learning){.file = file,
                    .machine = machine_of(file),
                    .start = any_start(record, file),
                    .log = *record,
                    .rounding = malloc(count * sizeof *l->rounding),
                    .spare = malloc(count * sizeof *l->spare),
                    .whole = {0, count},
                    .prior = *prior,
                    .posterior = posterior,
                    .course = malloc(count * sizeof *l->course),
                    .other = malloc(count * sizeof *l->other)};
    l->log.rounding = l->rounding;
    l->work = (fo_work){
        .problem = {&l->log, &l->machine, &l->start, l->course},
        .parts = &l->whole,
        .count = 1,
        .checkpoints = malloc((fo_checkpoints(count) + FO_MOST_PARTS) * sizeof(fo_filter)),
        .rows = malloc(FO_CHUNK * sizeof(fo_row)),
        .squares = malloc(count * sizeof(fo_squares)),
        .before = malloc(count * sizeof(fo_course)),
        .best = malloc(count * sizeof(fo_course))};
    if (!l->rounding || !l->spare || !l->course || !l->other || !l->work.checkpoints ||
        !l->work.rows || !l->work.squares || !l->work.before || !l->work.best) {
        free_learning(l);
        return false;
    }
    fo_rounding_of(record, l->rounding);
    return true;
}

static void exchange_courses(learning *l)
{
    fo_course *course = l->course;
    l->course = l->other;
    l->other = course;
    l->work.problem.course = l->course;
}

/* First values, and the course. */
static void begin_learning(const learning *l, const double *angle, const double *parameters)
{
    fo_posterior *out = l->posterior;
    double *p = out->parameters;
    const fo_problem *problem = &l->work.problem;
    begin(problem->log, l->file, &l->prior, parameters, out);
    fo_begin_offset(problem->log, angle, &l->prior, p);
    fo_set_course(problem, angle, p);
    const double noise = fo_first_noise(problem->log, angle, l->spare);
    const double least = l->prior.mean[FO_L_noise] - 3.0;
    p[FO_L_noise] = noise > 0.0 ? fmax(log(noise), least) : least;
}

/* A current that reaches the range of its sensor, as a share of the largest one; parts about rows with such a
 * current; the evaluations of each hypothesis on them, for one that has more of them gains what more steps of doubt and
 * unrest gain; and −ln of the share of the logs in which a sensor saturates. Assumed; the last: one of twenty. */
static const double reached = 0.985, saturated = 3.0;
enum { NEAR = 200, PLACES = 8, TRIED = 10 };

/* Rows near the largest currents, in no more than PLACES parts. */
static size_t largest_rows(const learning *l, const fo_growth *g, fo_part places[PLACES])
{
    const double least = reached * largest_current(&l->log);
    size_t count = 0, next = 0;
    for (size_t n = 0; n < g->count && count < PLACES; n++) {
        const size_t first = g->parts[n].first, end = first + g->parts[n].rows;
        for (size_t k = first > next ? first : next; k < end && count < PLACES; k++) {
            if (phase_current(&l->log, k) < least) continue;
            size_t from = k > first + NEAR ? k - NEAR : first;
            if (from < next) from = next;
            next = k + NEAR < end ? k + NEAR : end;
            places[count++] = (fo_part){from, next - from};
        }
    }
    return count;
}

/* Does a sensor of the current saturate? A range just below the largest current explains the rows near it better, or
 * rises and changes nothing. True: it is a parameter from now on. */
static bool try_range(learning *l, const fo_growth *g)
{
    const double largest = largest_current(&l->log);
    fo_part places[PLACES];
    fo_work w = l->work;
    fo_prior prior = l->prior;
    fo_posterior tried[2] = {*l->posterior, *l->posterior};
    w.count = largest_rows(l, g, places);
    w.parts = places;
    if (!w.count) return false;
    put(&prior, FO_L_range, 1.05 * largest, 0.2 * largest);
    tried[1].parameters[FO_L_range] = reached * largest;
    bool learnt = true;
    w.problem.course = l->other;
    for (int n = 0; n < 2; n++) {
        memcpy(l->other, l->course, l->log.rows * sizeof *l->course);
        learnt = learnt && fo_learn_parts(&w, n ? &prior : &l->prior, FO_FINE, TRIED, tried + n);
    }
    const double range = tried[1].parameters[FO_L_range];
    if (!learnt || range >= largest || tried[1].objective + saturated >= tried[0].objective) return false;
    l->prior = prior;
    l->posterior->parameters[FO_L_range] = range;
    return true;
}

/* Evaluations of all rows after those of the thinned log, at most. They are made once more if there is more to gain, or
 * if the mean square is not one within this (ln), for then the levels are not right yet. */
enum { LAST = 8 };
static const double fitted = 0.1;

/* Mean square from which on the innovations contradict their covariance. Assumed. */
static const double contradicted = 2.0;

/* Voltages that act earlier than this [samples]: they may be those of the next row. */
static const double early = -0.02;

/* Is the voltage of the next row already there before it? The score of its share would not have mean zero
 * if it answers the noise of that row, so it is tried, not a value between. */
static void try_early(learning *l)
{
    fo_work *w = &l->work;
    const double *p = l->posterior->parameters, *C = l->posterior->covariance;
    const double late = p[FO_L_lag] + p[FO_L_delay];
    const double variance = C[FO_L_lag * FO_UNKNOWNS + FO_L_lag] + 2.0 * C[FO_L_lag * FO_UNKNOWNS + FO_L_delay] +
                            C[FO_L_delay * FO_UNKNOWNS + FO_L_delay];
    if (!(late < early) || late * late < 4.0 * variance) return;
    fo_posterior tried = *l->posterior;
    w->problem.course = l->other;
    memcpy(l->other, l->course, l->log.rows * sizeof *l->course);
    l->log.early = w->held = true; /* as for an exact file */
    const bool learnt = fo_learn_parts(w, &l->prior, FO_FINE, LAST, &tried);
    w->held = false;
    l->posterior->evaluations = tried.evaluations;
    l->log.early = learnt && tried.objective < l->posterior->objective;
    if (l->log.early) {
        *l->posterior = tried;
        exchange_courses(l);
    }
    w->problem.course = l->course;
}

/* A log that hardly tells a value of the file from another one leaves both where the search for levels and unrest has
 * led them. So it is asked whether the file is exact. */
static void try_file(learning *l)
{
    const fo_trial trial = {&l->work, &l->prior, l->file->guessed > 0.0, l->other};
    if (fo_try_file(&trial, l->posterior)) exchange_courses(l);
}

/* What is in samples, in those of a thinned log, or back: within a longer row, the voltage turns in steps. */
static void count_in(const fo_thinned *thin, bool back, double *parameters)
{
    const double n = (double)thin->factor, shift = (double)thin->shift;
    double *lag = parameters + FO_L_lag, *delay = parameters + FO_L_delay, *rotation = parameters + FO_L_rotation;
    *lag = back ? *lag * n + shift : (*lag - shift) / n;
    *delay = back ? *delay * n : *delay / n;
    *rotation = 1.0 - (1.0 - *rotation) * (back ? n * n : 1.0 / (n * n));
}

static void scale_covariance(double factor, double *covariance)
{
    static const int scaled[] = {FO_L_lag, FO_L_delay, FO_L_rotation, FO_L_rotation}; /* that one by its square */
    for (size_t n = 0; n < sizeof scaled / sizeof *scaled; n++)
        for (int k = 0, at = scaled[n]; k < FO_UNKNOWNS; k++) {
            covariance[at * FO_UNKNOWNS + k] *= factor;
            covariance[k * FO_UNKNOWNS + at] *= factor;
        }
}

/* Learning on a thinned log. */
typedef struct {
    fo_thinned thin;
    fo_posterior posterior;
    learning own;
} thinned;

/* Starts from the posterior of the log. False: no memory; nothing must be closed then. */
static bool open_thinned(const learning *l, const fo_log *log, size_t factor, thinned *t)
{
    fo_prior prior = l->prior;
    const double n = (double)factor;
    if (!fo_thin(log, factor, prior.mean[FO_L_lag], &t->thin)) return false;
    count_in(&t->thin, false, prior.mean);
    prior.std[FO_L_lag] /= n;
    prior.std[FO_L_delay] /= n;
    prior.std[FO_L_rotation] /= n * n;
    t->posterior = *l->posterior;
    count_in(&t->thin, false, t->posterior.parameters);
    scale_covariance(1.0 / n, t->posterior.covariance);
    if (open_learning(&t->thin.log, l->file, &prior, &t->posterior, &t->own)) return true;
    fo_free_thinned(&t->thin);
    return false;
}

static void take_posterior(const thinned *t, fo_posterior *out)
{
    *out = t->posterior;
    count_in(&t->thin, true, out->parameters);
    scale_covariance((double)t->thin.factor, out->covariance);
}

static void close_thinned(thinned *t)
{
    free_learning(&t->own);
    fo_free_thinned(&t->thin);
}

/* Time constant of the current, its inverse [1/s]. */
static double decay_of(const fo_file *file)
{
    const double d = file->L_d, q = file->L_q;
    return file->map ? 0.0 : file->R / fmin(d, q);
}

/* A part as a problem. */
static fo_problem part_of(const learning *l, const fo_part *part, fo_log *log)
{
    *log = fo_rows_of(&l->log, part->first, part->rows);
    return (fo_problem){log, &l->machine, &l->start, l->course + part->first};
}

/* Evaluations with one unrest for all rows, and what they may gain in the end. Assumed. */
enum { CALM_EVALUATIONS = 12 };
static const double roughly = 3.0;

/* Level and unrest of the acceleration, from the course of the parts. `calm`: one unrest for all rows. */
static void begin_unrest(const learning *l, bool calm)
{
    const fo_work *w = &l->work;
    double sum = 0.0, rows = 0.0;
    for (size_t n = 0; n < w->count; n++) {
        fo_log rows_of_part;
        const fo_problem own = part_of(l, w->parts + n, &rows_of_part);
        double level[FO_UNKNOWNS], squares = 0.0;
        memcpy(level, l->posterior->parameters, sizeof level);
        level[FO_L_acceleration] = l->prior.mean[FO_L_acceleration];
        fo_begin_unrest(&own, level);
        for (size_t k = 0; calm && k < own.log->rows; k++) {
            squares += own.course[k].unrest;
            own.course[k].unrest = 1.0;
        }
        if (calm) level[FO_L_acceleration] += 0.5 * log(squares / (double)own.log->rows);
        sum += (double)own.log->rows * level[FO_L_acceleration];
        rows += (double)own.log->rows;
    }
    l->posterior->parameters[FO_L_acceleration] = sum / rows;
}

/* First steps go wrong while the levels settle, and where nothing informs about a parameter, the heavy tails of its
 * prior would not bring it back. So at first it is known this much better, without such tails, about where it begins.
 * Assumed. */
static const double nearer = 0.2;

static fo_prior near_parameters(const fo_prior *prior, const double *parameters)
{
    static const int of_file[] = {FO_L_resistance, FO_L_L_d, FO_L_L_q, FO_L_psi_f};
    fo_prior near = *prior;
    near.normal = true;
    for (size_t n = 0; n < sizeof of_file / sizeof *of_file; n++) {
        near.mean[of_file[n]] = parameters[of_file[n]];
        near.std[of_file[n]] *= nearer;
    }
    return near;
}

/* Learns on the parts. About a course whose inductance is wrong, each load step looks like a jump of the acceleration;
 * with an unrest that explains it, no load step would tell the inductance any more. So one unrest for all rows comes
 * first, and that of the course it leads to then. */
static bool learn_course(const learning *l)
{
    const fo_prior near = near_parameters(&l->prior, l->posterior->parameters);
    begin_unrest(l, true);
    if (!fo_learn_parts(&l->work, &near, roughly, CALM_EVALUATIONS, l->posterior)) return false;
    begin_unrest(l, false);
    return fo_learn_parts(&l->work, &l->prior, FO_FINE, MOST, l->posterior);
}

/* The parameters are learnt first on a part with so many rows at most. */
enum { SEED = 4096 };

/* Learns on a part of the log, which is thinned; its angles become the smoothed ones. */
static fo_outcome learn_seed(const learning *l, const fo_part *part, const double *parameters, double *angles)
{
    fo_log log = fo_rows_of(&l->log, part->first, part->rows);
    log.first = log.whole = 0; /* its heat begins with the part */
    double begin[FO_UNKNOWNS], *own = angles + part->first;
    const size_t factor = fo_thinning(&log, own, decay_of(l->file));
    thinned *t = malloc(sizeof *t);
    if (!t || !open_thinned(l, &log, factor, t)) {
        free(t);
        return FO_NO_MEMORY;
    }
    const size_t rows = t->thin.log.rows;
    for (size_t k = 0; k < rows; k++) l->spare[k] = own[k * factor];
    for (int k = 0; k < FO_UNKNOWNS; k++) begin[k] = parameters ? parameters[k] : (double)NAN;
    count_in(&t->thin, false, begin);
    begin_learning(&t->own, l->spare, begin);
    const bool learnt = learn_course(&t->own);
    if (learnt) {
        take_posterior(t, l->posterior);
        fo_fill(t->own.work.problem.course, rows, factor, l->other, part->rows);
        for (size_t k = 0; k < part->rows; k++) own[k] = l->other[k].angle;
    }
    close_thinned(t);
    free(t);
    return learnt ? FO_ESTIMATED : FO_NO_ESTIMATE;
}

/* ln: levels of a growing part are no smaller than an ordinary drive's by this much, for the log may be less calm
 * beside it; the acceleration's is an ordinary drive's. Assumed. */
static const double calmer = 1.0;

static void raise_levels(const fo_prior *prior, const double *parameters, double p[FO_UNKNOWNS])
{
    memcpy(p, parameters, FO_UNKNOWNS * sizeof *p);
    for (int k = 0; k < FO_LEVELS; k++) {
        const double less = k == FO_L_acceleration ? 0.0 : calmer;
        p[k] = fmax(p[k], prior->mean[k] - less);
    }
}

/* Grows the parts at the learnt parameters, and begins others. False: no memory. */
static bool grow_parts(const learning *l, fo_growth *g)
{
    double p[FO_UNKNOWNS];
    size_t n = 0;
    raise_levels(&l->prior, l->posterior->parameters, p);
    do {
        for (; n < g->count; n++)
            if (!fo_grow_part(g, g->parts + n, p)) return false;
    } while (fo_begin_part(g, g->log->rows));
    fo_join_parts(g);
    return true;
}

static double rows_of(const fo_growth *g)
{
    double rows = 0.0;
    for (size_t n = 0; n < g->count; n++) rows += (double)g->parts[n].rows;
    return rows;
}

/* Passes of smoothing of a course that has grown. */
enum { ROUGH = 2 };

/* The course of the parts, from their angles. A part that cannot be evaluated, or what does not fit, goes. */
static void set_parts(learning *l, fo_growth *g, const double *parameters)
{
    fo_work *w = &l->work;
    double rough[FO_UNKNOWNS];
    raise_levels(&l->prior, parameters, rough);
    for (size_t k = 0; k < l->log.rows; k++) l->course[k] = (fo_course){.unrest = 1.0, .doubt = 1.0};
    size_t count = 0;
    for (size_t n = 0; n < g->count; n++) {
        const fo_part part = g->parts[n];
        fo_log log;
        const fo_problem own = part_of(l, &part, &log);
        fo_set_course(&own, g->angles + part.first, parameters);
        w->parts = &part;
        w->count = 1;
        if (fo_settle(w, rough, ROUGH))
            g->parts[count++] = part;
        else
            for (size_t k = part.first; k < part.first + part.rows; k++) g->angles[k] = (double)NAN;
    }
    g->count = count;
    fo_cut_parts(g, l->course, rough, true);
    w->parts = g->parts;
    w->count = g->count;
}

/* Learns on all parts, from what the first gave. */
static bool learn_parts(learning *l, fo_growth *g)
{
    set_parts(l, g, l->posterior->parameters);
    return g->count && learn_course(l);
}

/* Parts of a log as those of a thinned one. */
static void thin_parts(const fo_growth *g, size_t factor, fo_growth *thin)
{
    for (size_t k = 0; k < thin->log->rows; k++) {
        thin->hints[k] = g->hints[k * factor];
        thin->angles[k] = g->angles[k * factor];
    }
    thin->count = 0;
    thin->seed = g->seed / factor;
    for (size_t n = 0; n < g->count; n++) {
        const size_t first = (g->parts[n].first + factor - 1) / factor;
        const size_t end = (g->parts[n].first + g->parts[n].rows - 1) / factor + 1;
        if (end > first + 1) thin->parts[thin->count++] = (fo_part){first, end - first};
    }
}

/* Parts of a thinned log, with their course, for the log of which it is made; a row without a course has no angle. */
static void fill_parts(const learning *from, const fo_growth *thin, size_t factor, learning *l, fo_growth *g)
{
    const size_t rows = l->log.rows;
    for (size_t k = 0; k < rows; k++) {
        if (!isfinite(thin->hints[k / factor])) g->hints[k] = (double)NAN;
        g->angles[k] = (double)NAN;
        l->course[k] = (fo_course){.angle = (double)NAN, .unrest = 1.0, .doubt = 1.0};
    }
    g->count = thin->count;
    for (size_t n = 0; n < thin->count; n++) {
        const fo_part *part = thin->parts + n;
        const size_t first = part->first * factor, count = (part->rows - 1) * factor + 1;
        const fo_course *course = from->work.problem.course;
        fo_fill(course + part->first, part->rows, factor, l->course + first, count);
        for (size_t k = first; k < first + count; k++) {
            const size_t at = k / FO_STRETCH * FO_STRETCH / factor;
            l->course[k].unrest = course[at < part->first ? part->first : at].unrest;
            g->angles[k] = l->course[k].angle;
        }
        g->parts[n] = (fo_part){first, count};
    }
    l->work.parts = g->parts;
    l->work.count = g->count;
}

/* The course of the rows of the parts that have none yet, from their angles. */
static void set_rest(const learning *l, const fo_growth *g)
{
    for (size_t n = 0; n < g->count; n++) {
        const size_t end = g->parts[n].first + g->parts[n].rows;
        for (size_t k = g->parts[n].first, next; k < end; k = next) {
            const bool set = isfinite(l->course[k].angle);
            for (next = k + 1; next < end && isfinite(l->course[next].angle) == set;) next++;
            for (size_t at = k; set && at < next; at++) /* it may be another turn */
                if (isfinite(g->angles[at])) l->course[at].angle = g->angles[at];
            if (set) continue;
            const fo_part rest = {k, next - k};
            fo_log log;
            const fo_problem own = part_of(l, &rest, &log);
            fo_set_course(&own, g->angles + k, l->posterior->parameters);
        }
    }
}

/* Of parts with many more rows, these windows are learnt, evenly spread; each is within a part. Assumed: they take a second
 * or two. */
enum { WINDOWS = 3, WINDOW = 2000 };

static bool keep_windows(fo_growth *g)
{
    const fo_growth all = *g;
    const double apart = rows_of(g) / (double)WINDOWS;
    double before = 0.0;
    if (apart < 2.0 * (double)WINDOW) return false;
    g->count = 0;
    for (size_t n = 0; n < all.count; n++) {
        const fo_part *own = all.parts + n;
        const double behind = before + (double)own->rows;
        size_t end = 0;
        while (g->count < WINDOWS && apart * ((double)g->count + 0.5) < behind) {
            const size_t middle = (size_t)(apart * ((double)g->count + 0.5) - before);
            size_t first = middle > WINDOW / 2 ? middle - WINDOW / 2 : 0;
            if (first < end) first = end;
            end = own->rows - first < WINDOW ? own->rows : first + WINDOW;
            g->parts[g->count++] = (fo_part){own->first + first, end - first};
        }
        before = behind;
    }
    return true;
}

/* Passes of doubt and unrest of all rows, after the windows: each costs a third of an evaluation. Assumed. */
enum { UNREST_PASSES = 6 };

/* Takes the rows outside the windows again, with the angles that they had; their course is smoothed. */
static void keep_all_rows(const fo_growth *all, learning *l, fo_growth *g)
{
    for (size_t k = 0; k < l->log.rows; k++) {
        const double grown = l->spare[k], smoothed = g->angles[k];
        g->angles[k] = isfinite(smoothed) ? grown + remainder(smoothed - grown, FO_TURN) : grown;
    }
    memcpy(g->parts, all->parts, sizeof g->parts);
    g->count = all->count;
    set_rest(l, g);
    double rough[FO_UNKNOWNS];
    raise_levels(&l->prior, l->posterior->parameters, rough);
    if (!fo_settle(&l->work, rough, ROUGH)) return;
    begin_unrest(l, false);
    fo_settle_unrest(&l->work, &l->prior, UNREST_PASSES, l->posterior->parameters);
}

/* Learns on the parts of the thinned log; before, l->spare has the angles of all rows. */
static fo_outcome learn_thinned(learning *l, size_t factor, fo_growth *g)
{
    thinned *t = malloc(sizeof *t);
    if (!t || !open_thinned(l, &l->log, factor, t)) {
        free(t);
        return FO_NO_MEMORY;
    }
    const size_t rows = t->thin.log.rows;
    fo_growth own = {.log = &t->own.log,
                     .machine = &t->own.machine,
                     .start = &t->own.start,
                     .covariance = t->posterior.covariance,
                     .hints = malloc(2 * rows * sizeof *own.hints)};
    fo_outcome outcome = FO_NO_MEMORY;
    bool windows = false;
    if (own.hints) {
        own.angles = own.hints + rows;
        thin_parts(g, factor, &own);
        windows = keep_windows(&own);
        outcome = learn_parts(&t->own, &own) ? FO_ESTIMATED : FO_NO_ESTIMATE;
    }
    if (outcome == FO_ESTIMATED) {
        const fo_growth all = *g;
        fill_parts(&t->own, &own, factor, l, g);
        take_posterior(t, l->posterior);
        if (windows) keep_all_rows(&all, l, g);
    }
    free(own.hints);
    close_thinned(t);
    free(t);
    return outcome;
}

/* Learns on all rows of the parts, with those that have grown since. */
static fo_outcome finish(learning *l, fo_growth *g)
{
    double rough[FO_UNKNOWNS];
    raise_levels(&l->prior, l->posterior->parameters, rough);
    set_rest(l, g);
    fo_cut_parts(g, l->course, rough, false);
    l->work.parts = g->parts;
    l->work.count = g->count;
    bool learnt = fo_learn_parts(&l->work, &l->prior, FO_FINE, LAST, l->posterior);
    if (learnt && (!l->posterior->converged || fabs(log(l->posterior->mean_square)) > fitted))
        learnt = fo_learn_parts(&l->work, &l->prior, FO_FINE, LAST, l->posterior);
    if (learnt) try_file(l);
    return learnt && l->posterior->mean_square < contradicted ? FO_ESTIMATED : FO_NO_ESTIMATE;
}

/* Times that parts grow at parameters that they gave, at most, and the growth after which they do so again. */
enum { ROUNDS = 4 };
/* The parts are learnt on every fourth row at most: more coarsely, where they end would be. */
enum { COARSEST = 4 };
/* Rows of the parts of a thinned log, at least. */
enum { FEWEST = 1500 };
static const double grown = 1.02;

/* Prior–data conflict from which on a course is not believed: 99 % of χ² with 18 degrees of freedom, and 90 % if the
 * hints are not sure, for a wrong course is more probable then. And runs of hints that are tried, at most. */
static const double conflicting = 35.0, conflicting_if_unsure = 26.0;
enum { SEEDS = 6 };

static double conflict_of(const learning *l)
{
    return fo_conflict_of(&l->prior, l->posterior);
}

static bool is_believed(const learning *l)
{
    return conflict_of(l) < (l->sure ? conflicting : conflicting_if_unsure);
}

/* Learns on the longest run of hints that gives parameters which a machine may have. Other runs that were tried are
 * forgotten, and all hints if they are not sure. */
static fo_outcome learn_seeds(const learning *l, const double *parameters, fo_growth *g)
{
    for (int n = 0; n < SEEDS && fo_begin_part(g, SEED); n++) {
        const fo_part own = g->parts[0];
        const fo_outcome outcome = learn_seed(l, &own, parameters, g->angles);
        g->seed = own.first + own.rows / 2;
        if (outcome == FO_NO_MEMORY) return outcome;
        if (outcome == FO_ESTIMATED && is_believed(l)) {
            for (size_t k = 0; !l->sure && k < l->log.rows; k++) g->hints[k] = (double)NAN;
            return outcome;
        }
        fo_forget(g, &own);
        g->count = 0;
    }
    return FO_NO_ESTIMATE;
}

/* Parameters must explain this share of the rows with hints. If these are not sure, they must explain most of the rows
 * that are measured, and other ones: so many times those of the seed, or this share of the log. Assumed. */
static const double most_hints = 0.33, most_rows = 0.5, proof = 2.0, nearly_all = 0.9;

static double measured_rows(const fo_log *log)
{
    double rows = 0.0;
    for (size_t k = 0; k < log->rows; k++) {
        const double *u = log->voltage + 2 * k, *i = log->current + 2 * k;
        rows += isfinite(u[0] + u[1] + i[0] + i[1]) ? 1.0 : 0.0;
    }
    return rows;
}

static bool is_proven(const fo_growth *g, bool sure, double hinted, double seed)
{
    const double known = rows_of(g);
    if (sure) return known > most_hints * hinted;
    if (known < most_rows * measured_rows(g->log)) return false;
    return known > proof * seed || known > nearly_all * (double)g->log->rows;
}

/* Learns on the parts of the thinned log; if that gives a conflict, on more of its rows. */
static fo_outcome learn_coarsely(learning *l, fo_growth *g)
{
    const fo_growth all = *g;
    const fo_posterior before = *l->posterior;
    const size_t size = l->log.rows * sizeof *g->angles;
    size_t factor = fo_thinning(&l->log, g->angles, decay_of(l->file));
    if (factor > COARSEST) factor = COARSEST;
    while (factor > 1 && rows_of(g) < (double)(factor * FEWEST)) factor /= 2;
    memcpy(l->spare, g->angles, size);
    for (;; factor = 1) {
        const fo_outcome outcome = learn_thinned(l, factor, g);
        if (outcome != FO_ESTIMATED || factor == 1 || is_believed(l)) return outcome;
        *g = all;
        *l->posterior = before;
        memcpy(g->angles, l->spare, size);
    }
}

/* Grows the parts and learns on them, until they grow no more or what they give is no machine. */
static fo_outcome learn_grown(learning *l, double hinted, fo_growth *g)
{
    const double own = rows_of(g);
    bool again = true;
    for (int n = 0; n < ROUNDS; n++) {
        const fo_growth learnt = *g;
        const fo_posterior before = *l->posterior;
        if (!grow_parts(l, g)) return FO_NO_MEMORY;
        if (!again && !(rows_of(g) > grown * rows_of(&learnt))) break;
        memcpy(l->other, l->course, l->log.rows * sizeof *l->course);
        const fo_outcome outcome = learn_coarsely(l, g);
        if (outcome != FO_ESTIMATED) return outcome;
        if (!is_believed(l)) {
            if (n == 0) return FO_NO_ESTIMATE;
            *g = learnt;
            *l->posterior = before;
            exchange_courses(l);
            break;
        }
        again = n == 0 && try_range(l, g);
    }
    const fo_outcome outcome = finish(l, g);
    if (outcome != FO_ESTIMATED) return outcome;
    if (!is_believed(l)) return FO_NO_ESTIMATE;
    return is_proven(g, l->sure, hinted, own) ? FO_ESTIMATED : FO_NO_ESTIMATE;
}

/* The parts of the log that one set of parameters explains, and those. */
static fo_outcome learn_log(learning *l, const double *parameters, fo_growth *g)
{
    double hinted = 0.0;
    for (size_t k = 0; k < l->log.rows; k++) hinted += isfinite(g->hints[k]) ? 1.0 : 0.0;
    const fo_outcome outcome = learn_seeds(l, parameters, g);
    return outcome == FO_ESTIMATED ? learn_grown(l, hinted, g) : outcome;
}

static bool smooth(learning *l, const fo_estimates *estimates)
{
    const fo_smoothed unknown = {.angle = (double)NAN, .angle_std = HUGE_VAL, .speed = (double)NAN,
                                 .speed_std = HUGE_VAL};
    l->posterior->conflict = fo_conflict_of(&l->prior, l->posterior);
    for (size_t k = 0; k < l->log.rows; k++) estimates->rows[k] = unknown;
    return fo_smooth_parts(&l->work, &l->prior, l->posterior, estimates);
}

fo_outcome fo_estimate_log(const fo_log *record, const fo_file *file, const double *angles, bool sure,
                           const double *parameters, fo_posterior *posterior, const fo_estimates *estimates)
{
    const fo_prior prior = fo_ordinary_prior(record, file);
    learning l;
    memset(posterior, 0, sizeof *posterior);
    if (!open_learning(record, file, &prior, posterior, &l)) return FO_NO_MEMORY;
    fo_growth g = {.log = &l.log,
                   .machine = &l.machine,
                   .start = &l.start,
                   .covariance = posterior->covariance,
                   .hints = malloc(record->rows * sizeof *g.hints),
                   .angles = malloc(record->rows * sizeof *g.angles)};
    fo_outcome outcome = g.hints && g.angles ? FO_ESTIMATED : FO_NO_MEMORY;
    for (size_t k = 0; outcome == FO_ESTIMATED && k < record->rows; k++) {
        g.hints[k] = angles[k];
        g.angles[k] = (double)NAN;
    }
    l.sure = sure;
    if (outcome == FO_ESTIMATED) outcome = learn_log(&l, parameters, &g);
    if (outcome == FO_ESTIMATED) {
        try_early(&l);
        if (!smooth(&l, estimates)) outcome = FO_NO_ESTIMATE;
    }
    free(g.hints);
    free(g.angles);
    free_learning(&l);
    return outcome;
}
