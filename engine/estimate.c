#include "estimate.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "thinning.h"

enum {
    SKIPPED = 20, /* rows until innovations count: the first speed is rough */
    MOST = 120,   /* evaluations, at most */
    RACE = 12,    /* of each start, if there are several: levels and loss are nearly right then. On a log
                   * that is thinned n times, n times as many: they cost the same */
    FIRST = 4,    /* of a range, until it is tried in earnest */
    TRIED = 40    /* then */
};
/* Half squares that the last step may gain. A parameter that is d standard deviations off costs d²/2, so it
 * remains within 0.8 of them. */
static const double fine = 0.3;

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

/* Largest current of a phase. */
static double largest_current(const fo_log *record)
{
    double most = 0.0;
    for (size_t k = 0; k < record->rows; k++) {
        const double *i = record->current + 2 * k;
        if (!isfinite(i[0]) || !isfinite(i[1])) continue;
        const double b = 0.5 * fabs(i[0]) + 0.86602540378443864676 * fabs(i[1]);
        most = fmax(most, fmax(fabs(i[0]), b));
    }
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
    put(&p, FO_L_L_d, log(file->L_d), file->L_std);
    put(&p, FO_L_L_q, log(file->L_q), file->L_std);
    put(&p, FO_L_psi_f, log(file->psi_f), file->psi_f > 0.0 ? file->psi_std : 0.0);
    /* Rated current alone accelerates to that speed in 5 ms, or much more slowly. */
    put(&p, FO_L_mobility, 0.0, speed / (0.005 * file->flux * file->rated_current));
    put(&p, FO_L_noise, log(0.003 * file->rated_current), 1.5);
    put(&p, FO_L_acceleration, log(10.0 * speed), 3.0);
    put(&p, FO_L_voltage, log(0.001 * u * sqrt(h)), 1.5);
    put(&p, FO_L_drift, log(0.01 * u), 2.0);
    put(&p, FO_L_loss, log(0.02 * u), 1.5);
    put(&p, FO_L_knee, log(0.03 * file->rated_current), 0.7);
    put(&p, FO_L_lag, file->lag, file->lag_std);
    put(&p, FO_L_delay, 0.0, file->delay_std);
    put(&p, FO_L_iron_loss, 0.0, file->iron_std);
    put(&p, FO_L_heat, 0.0, file->heat_std);
    put(&p, FO_L_offset_alpha, 0.0, file->offset_std);
    put(&p, FO_L_offset_beta, 0.0, file->offset_std);
    put(&p, FO_L_gain_re, 0.0, file->gain_std);
    put(&p, FO_L_gain_im, 0.0, file->gain_std);
    put(&p, FO_L_saturation_d, 0.0, file->saturation_std);
    put(&p, FO_L_saturation_q, 0.0, file->saturation_std);
    if (file->R_R > 0.0) {
        put(&p, FO_L_rotor_resistance, log(file->R_R), file->cage_std);
        put(&p, FO_L_magnetizing, log(file->L_M), file->cage_std);
    }
    /* The angle of a cage's flux is no place on its rotor. */
    p.harmonics = file->R_R > 0.0 ? 0.0 : 0.01 * file->flux;
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

/* Rows in which the current hardly changes in rotor coordinates, for a first value. */
enum { STEADY = 250 };

/* First offset of the measured current: what does not turn with the rotor. Regression on each block's
 * mean current in rotor coordinates and on a constant in stator coordinates, with the prior; where the
 * rotor stands, both are the same. */
static void begin_offset(const fo_log *record, const double *angle, const fo_prior *prior,
                         double *parameters)
{
    double sums[2] = {0.0, 0.0}, weight = 0.0, squares = 0.0, rows = 0.0;
    if (!(prior->std[FO_L_offset_alpha] > 0.0)) return;
    for (size_t first = 0; first < record->rows; first += STEADY) {
        const size_t end = first + STEADY < record->rows ? first + STEADY : record->rows;
        double mean[2] = {0.0, 0.0}, turn[2] = {0.0, 0.0}, known = 0.0;
        for (size_t k = first; k < end; k++) {
            const double *i = record->current + 2 * k, c = cos(angle[k]), s = sin(angle[k]);
            if (!isfinite(i[0] + i[1])) continue;
            mean[0] += c * i[0] + s * i[1];
            mean[1] += c * i[1] - s * i[0];
            turn[0] += c;
            turn[1] -= s;
            known += 1.0;
        }
        for (size_t k = first; k < end; k++) {
            const double *i = record->current + 2 * k, c = cos(angle[k]) / known,
                         s = sin(angle[k]) / known;
            if (!isfinite(i[0] + i[1])) continue;
            const double a = i[0] - c * mean[0] + s * mean[1], b = i[1] - c * mean[1] - s * mean[0];
            const double x = 1.0 - c * turn[0] + s * turn[1], y = -c * turn[1] - s * turn[0];
            sums[0] += x * a + y * b;
            sums[1] += x * b - y * a;
            weight += x * x + y * y;
            squares += a * a + b * b;
            rows += 1.0;
        }
    }
    if (!(rows > 0.0)) return;
    const double own = prior->std[FO_L_offset_alpha];
    const double all = weight + (double)STEADY * squares / rows / (own * own);
    parameters[FO_L_offset_alpha] = sums[0] / all;
    parameters[FO_L_offset_beta] = sums[1] / all;
}

/* Rows before and behind a row over which the current is averaged: about a course that follows the noise of
 * its own row, the score of the inductance would not have mean zero. */
enum { AROUND = 6 };

/* Mean current around a row in rotor coordinates, with weights that fall linearly; `mean` stays where no
 * current is known. */
static void mean_current(const fo_log *record, const fo_model *m, const double *angle, size_t row,
                         double mean[2])
{
    const size_t first = row < AROUND ? 0 : row - AROUND;
    double sum[2] = {0.0, 0.0}, weights = 0.0;
    for (size_t k = first; k <= row + AROUND && k < record->rows; k++) {
        const double *i = record->current + 2 * k;
        if (!isfinite(i[0] + i[1])) continue;
        const double x = i[0] - m->offset[0], y = i[1] - m->offset[1];
        const double c = cos(angle[k]), s = sin(angle[k]);
        const double weight = 1.0 + (double)AROUND - (double)(k > row ? k - row : row - k);
        sum[0] += weight * (c * x + s * y);
        sum[1] += weight * (c * y - s * x);
        weights += weight;
    }
    for (int a = 0; weights > 0.0 && a < 2; a++) mean[a] = sum[a] / weights;
}

/* The course through these angles: the flux is that of the measured current. A cage's rotor flux
 * follows i_d, from its steady value at the first row. */
static void set_course(const fo_problem *problem, const double *angle, const double *p)
{
    const fo_log *record = problem->log;
    const fo_model m = fo_model_of(problem->machine, p);
    const double decay = m.R_R * m.over_L_M * fabs(record->sample_time);
    double rotor[2] = {0.0, 0.0}, psi = 0.0;
    for (size_t k = 0; k < record->rows; k++) {
        const double c = cos(angle[k]), s = sin(angle[k]);
        mean_current(record, &m, angle, k, rotor);
        if (m.machine.cage)
            psi += k ? decay * (rotor[0] / m.over_L_M - psi) : rotor[0] / m.over_L_M;
        double dq[2];
        fo_flux_of(&m, psi + m.psi.d[0], rotor, dq);
        problem->course[k] = (fo_course){
            {c * dq[0] - s * dq[1], s * dq[0] + c * dq[1]}, angle[k], psi, 1.0, 1.0};
    }
}

static int by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* First noise, a std: most of the third difference of the current in rotor coordinates is noise. It has 20
 * times the variance of white noise, and the median square of both components is 2 ln 2 times the variance
 * of one. `spare`: a number for each row. */
static double noise_of(const fo_log *record, const double *angle, double *spare)
{
    static const double weights[4] = {-1.0, 3.0, -3.0, 1.0};
    static const double median = 20.0 * 1.38629436111989062;
    size_t count = 0;
    for (size_t k = 0; k + 3 < record->rows; k++) {
        double x = 0.0, y = 0.0;
        for (size_t n = 0; n < 4; n++) {
            const double *i = record->current + 2 * (k + n), c = cos(angle[k + n]),
                         s = sin(angle[k + n]);
            x += weights[n] * (c * i[0] + s * i[1]);
            y += weights[n] * (c * i[1] - s * i[0]);
        }
        const double square = x * x + y * y;
        if (isfinite(square)) spare[count++] = square;
    }
    if (!count) return 0.0;
    qsort(spare, count, sizeof *spare, by_size);
    return sqrt(spare[count / 2] / median);
}

/* Bounds of the first unrest: far below one, its prior would outweigh the currents; far above, the covariance
 * would lose its digits where the course is wrong. */
static const double calmest = 0.05, wildest = 1e4;

/* First level and unrest of the acceleration: how much that of the course changes in a stretch or beside
 * it. At least a twentieth of the prior's, since no change of a given course is known so well. */
static void begin_unrest(const fo_problem *problem, double *parameters)
{
    const size_t rows = problem->log->rows, count = rows / FO_STRETCH;
    const double T = (double)FO_STRETCH * fabs(problem->log->sample_time);
    const double least = parameters[FO_L_acceleration] - 3.0;
    fo_course *course = problem->course;
    double *level = &parameters[FO_L_acceleration], sum = 0.0;
    if (count < 8) return;
    for (int pass = 0; pass < 2; pass++) /* the sum, then the unrest about its mean */
        for (size_t n = 0; n < count; n++) {
            double own = least;
            for (size_t near = n < 2 ? 1 : n - 1; near <= n + 1 && near + 2 < count; near++) {
                const double a = course[(near - 1) * FO_STRETCH].angle, b = course[near * FO_STRETCH].angle;
                const double c = course[(near + 1) * FO_STRETCH].angle;
                const double d = course[(near + 2) * FO_STRETCH].angle;
                const double change = (d - a + 3.0 * (b - c)) / (T * T * sqrt(T));
                if (change != 0.0) own = fmax(own, log(fabs(change)));
            }
            if (!pass) sum += own / (double)count;
            const size_t end = n + 1 < count ? (n + 1) * FO_STRETCH : rows;
            for (size_t k = n * FO_STRETCH; pass && k < end; k++)
                course[k].unrest = fmin(fmax(exp(2.0 * (own - sum)), calmest), wildest);
        }
    *level = sum;
}

/* Learning begins on parts of a long log: so many, and so many rows in all. */
enum { PARTS = 8, LEARNT = 8192 };
/* Passes of smoothing of the rows between them. */
enum { ROUGH = 2 };

/* What learning needs: two courses, the second for a trial. */
typedef struct {
    const fo_file *file;
    fo_machine machine;
    fo_start start;
    fo_log log;
    const double *angle;
    double *rounding, *spare; /* a number for each row */
    fo_work work;
    fo_part parts[PARTS], whole;
    size_t count;
    fo_prior prior;
    fo_posterior *posterior;
    fo_course *course, *other;
} learning;

/* Parts of equal length at equal distances; the one that contains the largest current, or is the nearest
 * to it, moves there. */
static size_t parts_of(const fo_log *record, fo_part parts[PARTS])
{
    parts[0] = (fo_part){0, record->rows};
    if (record->rows <= 2 * LEARNT) return 1;
    const size_t length = LEARNT / PARTS, apart = record->rows / PARTS;
    size_t largest = 0;
    double most = 0.0;
    for (size_t k = 0; k < record->rows; k++) {
        const double *i = record->current + 2 * k, own = i[0] * i[0] + i[1] * i[1];
        if (own > most) {
            most = own;
            largest = k;
        }
    }
    for (size_t n = 0; n < PARTS; n++) {
        const size_t from = n * apart, last = from + apart - length;
        size_t first = from + (apart - length) / 2;
        if (largest >= from && largest < from + apart) {
            first = largest > from + length / 2 ? largest - length / 2 : from;
            first = first < last ? first : last;
        }
        parts[n] = (fo_part){first, length};
    }
    return PARTS;
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

/* First values, and the course. */
static void begin_learning(const learning *l, const double *angle, const double *parameters,
                           fo_posterior *out)
{
    double *p = out->parameters;
    const fo_problem *problem = &l->work.problem;
    begin(problem->log, l->file, &l->prior, parameters, out);
    begin_offset(problem->log, angle, &l->prior, p);
    set_course(problem, angle, p);
    const double noise = noise_of(problem->log, angle, l->spare);
    const double least = l->prior.mean[FO_L_noise] - 3.0;
    p[FO_L_noise] = noise > 0.0 ? fmax(log(noise), least) : least;
    begin_unrest(problem, p);
}

static void exchange_courses(learning *l)
{
    fo_course *course = l->course;
    l->course = l->other;
    l->other = course;
    l->work.problem.course = l->course;
}

/* Learns a little from each of `count` courses, one behind the other; the smallest objective counts. */
static bool race(learning *l, const double *angles, size_t count, const double *parameters)
{
    const size_t rows = l->work.problem.log->rows;
    const size_t thinned = l->log.periods ? l->log.periods : 1;
    const size_t most = thinned * RACE < MOST ? thinned * RACE : MOST;
    size_t evaluations = 0;
    bool any = false;
    for (size_t n = 0; n < count; n++) {
        fo_posterior tried;
        const double *angle = angles + n * rows;
        l->work.problem.course = l->other;
        begin_learning(l, angle, parameters, &tried);
        const bool learnt = fo_learn(&l->work, &l->prior, fine, most, &tried);
        evaluations += tried.evaluations;
        if (!learnt || (any && tried.objective >= l->posterior->objective)) continue;
        any = true;
        *l->posterior = tried;
        l->angle = angle;
        exchange_courses(l);
    }
    l->work.problem.course = l->course;
    l->posterior->evaluations = evaluations;
    return any;
}

/* −ln of the share of the logs in which a sensor saturates. Assumed: one of twenty. */
static const double saturated = 3.0;

/* Does a sensor of the current saturate? A range just below the largest current rises if none does; then
 * it changes nothing. */
static void try_range(learning *l)
{
    fo_work *w = &l->work;
    const fo_log *record = w->problem.log;
    const double largest = largest_current(record);
    fo_prior prior = l->prior;
    fo_posterior tried = *l->posterior;
    put(&prior, FO_L_range, 1.05 * largest, 0.2 * largest);
    tried.parameters[FO_L_range] = 0.985 * largest;
    w->problem.course = l->other;
    memcpy(l->other, l->course, record->rows * sizeof *l->course);
    bool learnt = fo_learn(w, &prior, fine, FIRST, &tried);
    if (learnt && tried.parameters[FO_L_range] < largest)
        learnt = fo_learn(w, &prior, fine, TRIED, &tried);
    l->posterior->evaluations = tried.evaluations;
    if (learnt && tried.parameters[FO_L_range] < largest &&
        tried.objective + saturated < l->posterior->objective) {
        *l->posterior = tried;
        l->prior = prior;
        exchange_courses(l);
    }
    w->problem.course = l->course;
}

/* Voltages that act earlier than this [samples]: they may be those of the next row. */
static const double early = -0.02;

/* Is the voltage of the next row already there before it? The score of its share would not have mean zero
 * if it answers the noise of that row, so it is tried, not a value between. */
static void try_early(learning *l)
{
    fo_work *w = &l->work;
    const double *p = l->posterior->parameters;
    if (!(p[FO_L_lag] + p[FO_L_delay] < early)) return;
    fo_posterior tried = *l->posterior;
    w->problem.course = l->other;
    memcpy(l->other, l->course, l->log.rows * sizeof *l->course);
    l->log.early = true;
    const bool learnt = fo_learn(w, &l->prior, fine, MOST, &tried);
    l->posterior->evaluations = tried.evaluations;
    l->log.early = learnt && tried.objective < l->posterior->objective;
    if (l->log.early) {
        *l->posterior = tried;
        exchange_courses(l);
    }
    w->problem.course = l->course;
}

/* The course between the parts. */
static void set_rest(const fo_problem *problem, const double *angle, const double *parameters,
                     const fo_part *parts, size_t count, fo_course *other)
{
    fo_problem all = *problem;
    all.course = other;
    set_course(&all, angle, parameters);
    for (size_t n = 0; n <= count; n++) {
        const size_t from = n ? parts[n - 1].first + parts[n - 1].rows : 0;
        const size_t end = n < count ? parts[n].first : problem->log->rows;
        for (size_t k = from; k < end; k++) problem->course[k] = other[k];
    }
}

/* Learns on the whole log, from what the parts gave. */
static bool learn_whole(learning *l)
{
    fo_work *w = &l->work;
    double *own = l->posterior->parameters, p[FO_UNKNOWNS];
    set_rest(&w->problem, l->angle, own, l->parts, l->count, l->other);
    w->parts = &l->whole;
    w->count = 1;
    /* The course of the other rows is rough yet: first with large levels. */
    memcpy(p, own, sizeof p);
    begin_levels(w->problem.log, l->file, &l->prior, p);
    return fo_settle(w, p, ROUGH) && fo_settle(w, own, ROUGH) &&
           fo_learn(w, &l->prior, fine, MOST, l->posterior);
}

static bool learn(learning *l, const double *angles, size_t starts, const double *parameters)
{
    fo_work *w = &l->work;
    fo_posterior *out = l->posterior;
    if (starts > 1) {
        if (!race(l, angles, starts, parameters)) return false;
    } else {
        l->angle = angles;
        begin_learning(l, angles, parameters, out);
    }
    if (!fo_learn(w, &l->prior, fine, MOST, out)) return false;
    try_range(l);
    return l->count == 1 || learn_whole(l);
}

static bool smooth(learning *l, fo_smoothed *rows)
{
    fo_work *w = &l->work;
    fo_posterior *out = l->posterior;
    fo_likelihood last;
    if (!fo_innovations(&w->problem, out->parameters, FO_OF_ALL, &last, w->checkpoints) ||
        !fo_covariance(&last, &l->prior, out))
        return false;
    const fo_outputs wanted = {.smoothed = rows, .covariance = out->covariance};
    fo_backward(&w->problem, out->parameters, w->checkpoints, w->rows, &wanted, NULL);
    return true;
}

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
    l->count = parts_of(record, l->parts);
    l->work = (fo_work){.problem = {&l->log, &l->machine, &l->start, l->course},
                        .parts = l->parts,
                        .count = l->count,
                        .checkpoints = malloc((fo_checkpoints(count) + PARTS) * sizeof(fo_filter)),
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

/* What is in samples, in those of a thinned log, or back. */
static void count_in(const fo_thinned *thin, bool back, double *lag, double *delay)
{
    const double n = (double)thin->factor, shift = (double)thin->shift;
    *lag = back ? *lag * n + shift : (*lag - shift) / n;
    *delay = back ? *delay * n : *delay / n;
}

static fo_prior thinned_prior(const fo_prior *prior, const fo_thinned *thin)
{
    fo_prior own = *prior;
    count_in(thin, false, &own.mean[FO_L_lag], &own.mean[FO_L_delay]);
    own.std[FO_L_lag] /= (double)thin->factor;
    own.std[FO_L_delay] /= (double)thin->factor;
    return own;
}

/* Course and parameters of a thinned log for that of which it is made. */
static void take_over(const learning *from, const fo_thinned *thin, learning *l)
{
    const fo_course *course = from->work.problem.course;
    const size_t rows = l->log.rows;
    fo_posterior *out = l->posterior;
    *out = *from->posterior;
    count_in(thin, true, &out->parameters[FO_L_lag], &out->parameters[FO_L_delay]);
    l->prior.mean[FO_L_range] = from->prior.mean[FO_L_range];
    l->prior.std[FO_L_range] = from->prior.std[FO_L_range];
    fo_fill(course, from->log.rows, thin->factor, l->course, rows);
    for (size_t k = 0; k < rows; k++)
        l->course[k].unrest = course[k / FO_STRETCH * FO_STRETCH / thin->factor].unrest;
    l->work.parts = &l->whole;
    l->work.count = 1;
}

/* From one level to the next, the log is thinned so many times more. */
enum { RATIO = 4 };

/* Learns first on the log thinned by `factor`, a power of two, then on all of it. */
static fo_outcome learn_levels(learning *l, size_t factor, const double *angles, size_t starts,
                               const double *parameters)
{
    if (factor == 1) return learn(l, angles, starts, parameters) ? FO_ESTIMATED : FO_NO_ESTIMATE;
    const size_t ratio = factor < RATIO ? factor : RATIO;
    const size_t rows = l->log.rows, count = (rows + ratio - 1) / ratio;
    fo_thinned thin;
    fo_posterior posterior;
    learning own;
    double begin[FO_UNKNOWNS], *some = malloc(starts * count * sizeof *some);
    fo_outcome outcome = FO_NO_MEMORY;
    if (fo_thin(&l->log, ratio, l->prior.mean[FO_L_lag], &thin)) {
        const fo_prior prior = thinned_prior(&l->prior, &thin);
        for (int k = 0; k < FO_UNKNOWNS; k++) begin[k] = parameters ? parameters[k] : (double)NAN;
        count_in(&thin, false, &begin[FO_L_lag], &begin[FO_L_delay]);
        if (some && open_learning(&thin.log, l->file, &prior, &posterior, &own)) {
            for (size_t n = 0; n < starts; n++)
                for (size_t k = 0; k < count; k++) some[n * count + k] = angles[n * rows + k * ratio];
            outcome = learn_levels(&own, factor / ratio, some, starts, begin);
            if (outcome == FO_ESTIMATED) take_over(&own, &thin, l);
            free_learning(&own);
        }
        fo_free_thinned(&thin);
    }
    free(some);
    if (outcome == FO_ESTIMATED && !fo_learn(&l->work, &l->prior, fine, MOST, l->posterior))
        outcome = FO_NO_ESTIMATE;
    return outcome;
}

/* Time constant of the current, its inverse [1/s]. */
static double decay_of(const fo_file *file)
{
    const double d = file->L_d, q = file->L_q;
    return file->map ? 0.0 : file->R / fmin(d, q);
}

fo_outcome fo_estimate_log(const fo_log *record, const fo_file *file, const double *angles,
                           size_t starts, const double *parameters, fo_posterior *posterior,
                           fo_smoothed *rows)
{
    const fo_prior prior = fo_ordinary_prior(record, file);
    learning l;
    if (!open_learning(record, file, &prior, posterior, &l)) return FO_NO_MEMORY;
    size_t factor = 1;
    for (size_t n = 0; n < starts; n++) {
        const size_t own = fo_thinning(record, angles + n * record->rows, decay_of(file));
        if (own > factor) factor = own;
    }
    fo_outcome outcome = learn_levels(&l, factor, angles, starts, parameters);
    if (outcome == FO_ESTIMATED) try_early(&l);
    if (outcome == FO_ESTIMATED && !smooth(&l, rows)) outcome = FO_NO_ESTIMATE;
    free_learning(&l);
    return outcome;
}
