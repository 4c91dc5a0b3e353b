#include "estimate.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    SKIPPED = 20,     /* rows until innovations count: the first speed is rough */
    FIRST = 30,       /* evaluations of the first stage, at most */
    MOST = 60,        /* of the second */
    LAST = 60         /* of the third: what is left of the unrest hardly moves the rest */
};
/* Half squares: a stage ends when it gains less. A parameter that is d standard deviations off costs d²/2,
 * so after the last stage it remains within 0.8 of them. */
static const double rough = 5.0, coarse = 2.0, fine = 0.3;

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
    put(&p, FO_L_range, 1.05 * largest_current(record), 0.2 * largest_current(record));
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

/* The levels of a poor drive: as small as the filter can follow with, since large levels of voltage and
 * drift lose the course where the rotor stands. */
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
    /* Below the largest current: from there it rises if no sensor saturates. */
    if (prior->std[FO_L_range] > 0.0) out->parameters[FO_L_range] = 0.93 * largest_current(record);
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

/* The course through these angles: the flux is that of the measured current. A cage's rotor flux
 * follows i_d, from its steady value at the first row. */
static void set_course(const fo_problem *problem, const double *angle, const double *p)
{
    const fo_log *record = problem->log;
    const fo_model m = fo_model_of(problem->machine, p);
    const double decay = m.R_R * m.over_L_M * fabs(record->sample_time);
    double i[2] = {0.0, 0.0}, psi = 0.0;
    for (size_t k = 0; k < record->rows; k++) {
        const double *own = record->current + 2 * k, c = cos(angle[k]), s = sin(angle[k]);
        if (isfinite(own[0] + own[1]))
            for (int a = 0; a < 2; a++) i[a] = own[a] - m.offset[a];
        const double rotor[2] = {c * i[0] + s * i[1], c * i[1] - s * i[0]};
        if (m.machine.cage)
            psi += k ? decay * (rotor[0] / m.over_L_M - psi) : rotor[0] / m.over_L_M;
        double dq[2];
        fo_flux_of(&m, psi + m.psi.d[0], rotor, dq);
        problem->course[k] = (fo_course){
            {c * dq[0] - s * dq[1], s * dq[0] + c * dq[1]}, angle[k], psi, 1.0, 1.0};
    }
}

/* First levels, the loss and the sensors, about the given course. Its errors count as errors of the voltage
 * for now; if the voltage is `sure`, its errors are those of a poor drive. */
static bool learn_levels(const fo_work *w, const fo_prior *prior, bool sure, fo_posterior *out)
{
    static const int early[] = {FO_L_noise, FO_L_acceleration, FO_L_voltage, FO_L_drift, FO_L_loss,
                                FO_L_knee, FO_L_offset_alpha, FO_L_offset_beta, FO_L_range};
    bool some[FO_L] = {false};
    for (size_t k = 0; k < sizeof early / sizeof *early; k++) some[early[k]] = true;
    if (sure) some[FO_L_voltage] = some[FO_L_drift] = false;
    fo_prior first = *prior;
    first.harmonics = 0.0;
    const fo_stage stage = {some, rough, FIRST, false, false};
    const double voltage = out->parameters[FO_L_voltage], drift = out->parameters[FO_L_drift];
    const bool learnt = fo_learn(w, &first, &stage, out);
    out->parameters[FO_L_voltage] = voltage;
    out->parameters[FO_L_drift] = drift;
    return learnt;
}

/* Then all but the errors of the voltage, since large levels of these would explain what the parameters
 * should, and the mobility, which moves when the rest is nearly right. */
static bool learn_machine(const fo_work *w, const fo_prior *prior, fo_posterior *out)
{
    bool most[FO_L];
    for (int k = 0; k < FO_L; k++)
        most[k] = k != FO_L_mobility && k != FO_L_voltage && k != FO_L_drift;
    const fo_stage stage = {most, coarse, MOST, true, false};
    return fo_learn(w, prior, &stage, out);
}

/* All, with the unrest of the acceleration. */
static bool learn_all(const fo_work *w, const fo_prior *prior, fo_posterior *out)
{
    const fo_stage stage = {NULL, fine, LAST, true, true};
    return fo_learn(w, prior, &stage, out);
}

/* Starts of the one objective: with and without a limit of the range of the current sensors, and with a
 * voltage that is `sure` (see learn_levels). */
typedef struct {
    bool range, sure;
} start_of;
static const start_of starts[] = {{false, false}, {false, true}, {true, false}};
enum { STARTS = sizeof starts / sizeof *starts };

/* Learning begins on parts of a long log: so many, and so many rows in all. */
enum { PARTS = 8, LEARNT = 8192 };
/* Passes of smoothing of the rows between them. */
enum { ROUGH = 2 };

/* What learning needs: for each start its prior, its posterior and a course. */
typedef struct {
    const fo_file *file;
    fo_work work;
    fo_part parts[PARTS], whole;
    size_t count;
    fo_prior priors[STARTS];
    fo_posterior posteriors[STARTS];
    fo_course *courses[STARTS];
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

/* First values of a start, and its course. */
static void begin_start(learning *l, int n, const double *angle, const double *parameters)
{
    fo_posterior *out = &l->posteriors[n];
    fo_work *w = &l->work;
    begin(w->problem.log, l->file, &l->priors[n], parameters, out);
    w->problem.course = l->courses[n];
    w->parts = l->parts;
    w->count = l->count;
    begin_offset(w->problem.log, angle, &l->priors[n], out->parameters);
    set_course(&w->problem, angle, out->parameters);
}

/* Learns from all starts, on parts of the log; the smallest objective counts. */
static int learn_parts(learning *l, const double *angle, const double *parameters)
{
    fo_work *w = &l->work;
    int best = -1;
    for (int n = 0; n < STARTS; n++) {
        fo_posterior *out = &l->posteriors[n];
        if (!starts[n].range) put(&l->priors[n], FO_L_range, 0.0, 0.0);
        begin_start(l, n, angle, parameters);
        bool learnt = learn_levels(w, &l->priors[n], starts[n].sure, out);
        /* Beyond the largest current, a range changes nothing: this start is like the first. */
        if (learnt && best >= 0 && out->parameters[FO_L_range] > largest_current(w->problem.log))
            continue;
        learnt = learnt && learn_machine(w, &l->priors[n], out);
        if (learnt && (best < 0 || out->objective < l->posteriors[best].objective)) best = n;
    }
    return best;
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

/* Learns all of a start on the whole log, after its machine on parts. `spare`: a course. */
static bool learn_whole(learning *l, int n, const double *angle, fo_course *spare)
{
    fo_work *w = &l->work;
    fo_posterior *own = &l->posteriors[n];
    w->problem.course = l->courses[n];
    w->parts = &l->whole;
    w->count = 1;
    if (l->count > 1) {
        set_rest(&w->problem, angle, own->parameters, l->parts, l->count, spare);
        /* The course of the other rows is rough yet: first with large levels. */
        double p[FO_UNKNOWNS];
        memcpy(p, own->parameters, sizeof p);
        begin_levels(w->problem.log, l->file, &l->priors[n], p);
        if (!fo_settle(w, p, ROUGH) || !fo_settle(w, own->parameters, ROUGH)) return false;
    }
    return learn_all(w, &l->priors[n], own);
}

static bool learn(learning *l, const double *angle, const double *parameters, fo_posterior *out,
                  fo_smoothed *rows)
{
    fo_work *w = &l->work;
    const int best = learn_parts(l, angle, parameters);
    if (best < 0) return false;
    const bool learnt = learn_whole(l, best, angle, l->courses[best ? 0 : 1]);
    *out = l->posteriors[best];
    out->evaluations = 0;
    for (int n = 0; n < STARTS; n++) out->evaluations += l->posteriors[n].evaluations;
    fo_likelihood last;
    if (!learnt || !fo_innovations(&w->problem, out->parameters, true, &last, w->checkpoints) ||
        !fo_covariance(&last, &l->priors[best], out))
        return false;
    const fo_outputs wanted = {.smoothed = rows, .covariance = out->covariance};
    fo_backward(&w->problem, out->parameters, w->checkpoints, w->rows, &wanted, NULL);
    return true;
}

fo_outcome fo_estimate_log(const fo_log *record, const fo_file *file, const double *angle,
                           const double *parameters, fo_posterior *posterior, fo_smoothed *rows)
{
    const fo_prior prior = fo_ordinary_prior(record, file);
    const fo_machine machine = machine_of(file);
    const fo_start start = any_start(record, file);
    const size_t count = record->rows;
    double *rounding = malloc(count * sizeof *rounding);
    fo_log log = *record;
    log.rounding = rounding;
    learning l = {.file = file, .whole = {0, count}};
    for (int n = 0; n < STARTS; n++) l.priors[n] = prior;
    l.count = parts_of(record, l.parts);
    l.work = (fo_work){.problem = {&log, &machine, &start, NULL},
                       .checkpoints = malloc((fo_checkpoints(count) + PARTS) * sizeof(fo_filter)),
                       .rows = malloc(FO_CHUNK * sizeof(fo_row)),
                       .squares = malloc(count * sizeof(fo_squares)),
                       .before = malloc(count * sizeof(fo_course))};
    bool memory = rounding && l.work.checkpoints && l.work.rows && l.work.squares && l.work.before;
    for (int n = 0; n < STARTS; n++) {
        l.courses[n] = malloc(count * sizeof *l.courses[n]);
        memory = memory && l.courses[n];
    }
    fo_outcome outcome = FO_NO_MEMORY;
    if (memory) {
        fo_rounding_of(record, rounding);
        outcome = learn(&l, angle, parameters, posterior, rows) ? FO_ESTIMATED : FO_NO_ESTIMATE;
    }
    free(rounding);
    for (int n = 0; n < STARTS; n++) free(l.courses[n]);
    free(l.work.checkpoints);
    free(l.work.rows);
    free(l.work.squares);
    free(l.work.before);
    return outcome;
}
