#include "estimate.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    SKIPPED = 20,     /* rows until innovations count: the first speed is rough */
    FIRST = 30,       /* evaluations of the first stage, at most */
    MOST = 60,        /* of the second */
    LAST = 40         /* of the third: what is left of the unrest hardly moves the rest */
};
/* Half squares: a stage ends when a step is expected to gain less. A parameter that is d standard
 * deviations off costs d²/2, so it remains within 0.3 of them. */
static const double rough = 5.0, coarse = 2.0, fine = 0.05;

/* Share of the flux by which magnets change in a second (root of it): their temperature changes by 30 K
 * in ten minutes. A cage's flux changes as its inductances do. A reluctance machine has none, but the
 * walk stands for what the derivative of ∂i/∂λ by the saturation lacks: without it, L_d and saturation
 * of a machine with constant i_d are 5 standard deviations off. */
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

/* First values. The levels are those of a poor drive: as small as the filter can follow with, since
 * large levels of voltage and drift lose the course where the rotor stands. */
static void begin(const fo_log *record, const fo_file *file, const fo_prior *prior,
                  const double *parameters, fo_posterior *out)
{
    const double u = mean_voltage(record);
    memset(out, 0, sizeof *out);
    memcpy(out->parameters, prior->mean, sizeof prior->mean);
    out->parameters[FO_L_noise] = log(0.02 * file->rated_current);
    out->parameters[FO_L_voltage] = log(0.01 * u * sqrt(fabs(record->sample_time)));
    out->parameters[FO_L_drift] = log(0.02 * u);
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
        .psi_rate = psi_walk * file->flux,
    };
    return machine;
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
        if (isfinite(own[0] + own[1])) memcpy(i, own, sizeof i);
        const double rotor[2] = {c * i[0] + s * i[1], c * i[1] - s * i[0]};
        if (m.machine.cage)
            psi += k ? decay * (rotor[0] / m.over_L_M - psi) : rotor[0] / m.over_L_M;
        double dq[2];
        fo_flux_of(&m, psi + m.psi.d[0], rotor, dq);
        problem->course[k] = (fo_course){
            {c * dq[0] - s * dq[1], s * dq[0] + c * dq[1]}, angle[k], psi, 1.0, 1.0};
    }
}

/* First levels, the loss and the sensors, about the given course; then all but the mobility, which moves
 * when the rest is nearly right. */
static bool begin_learning(const fo_work *w, const fo_prior *prior, fo_posterior *out)
{
    bool some[FO_L] = {false}, most[FO_L];
    static const int early[] = {FO_L_noise, FO_L_acceleration, FO_L_voltage, FO_L_drift, FO_L_loss,
                                FO_L_knee, FO_L_offset_alpha, FO_L_offset_beta, FO_L_range};
    for (size_t k = 0; k < sizeof early / sizeof *early; k++) some[early[k]] = true;
    for (int k = 0; k < FO_L; k++) most[k] = k != FO_L_mobility;
    fo_prior first = *prior;
    first.harmonics = 0.0;
    const fo_stage stages[2] = {{some, rough, FIRST, false, false}, {most, coarse, MOST, true, false}};
    return fo_learn(w, &first, &stages[0], out) && fo_learn(w, prior, &stages[1], out);
}

/* All, with the unrest of the acceleration, which takes its level along. */
static bool end_learning(const fo_work *w, const fo_prior *prior, fo_posterior *out)
{
    bool last[FO_L];
    for (int k = 0; k < FO_L; k++) last[k] = k != FO_L_acceleration;
    const fo_stage stage = {last, fine, LAST, true, true};
    return fo_learn(w, prior, &stage, out);
}

/* Both hypotheses on the sensors of the current, with and without a limit of their range: the smaller
 * objective counts. `other`: working space. */
static bool learn(fo_work *w, const fo_file *file, const fo_prior *prior, const double *angle,
                  const double *parameters, fo_course *other, fo_posterior *out, fo_smoothed *rows)
{
    fo_prior priors[2] = {*prior, *prior};
    put(&priors[0], FO_L_range, 0.0, 0.0);
    fo_posterior posteriors[2];
    fo_course *courses[2] = {w->problem.course, other};
    int best = -1;
    for (int n = 0; n < 2; n++) {
        begin(w->problem.log, file, &priors[n], parameters, &posteriors[n]);
        w->problem.course = courses[n];
        set_course(&w->problem, angle, posteriors[n].parameters);
        const bool learnt = begin_learning(w, &priors[n], &posteriors[n]);
        if (learnt && (best < 0 || posteriors[n].objective < posteriors[best].objective)) best = n;
    }
    if (best < 0) return false;
    w->problem.course = courses[best];
    const bool learnt = end_learning(w, &priors[best], &posteriors[best]);
    *out = posteriors[best];
    out->evaluations = posteriors[0].evaluations + posteriors[1].evaluations;
    fo_likelihood last;
    if (!learnt || !fo_innovations(&w->problem, out->parameters, true, &last, w->checkpoints) ||
        !fo_covariance(&last, &priors[best], out))
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
    fo_course *course = malloc(record->rows * sizeof *course);
    fo_course *other = malloc(record->rows * sizeof *other);
    fo_work w = {.problem = {record, &machine, &start, course},
                 .checkpoints = malloc(fo_checkpoints(record->rows) * sizeof(fo_filter)),
                 .rows = malloc(FO_CHUNK * sizeof(fo_row)),
                 .squares = malloc(record->rows * sizeof(fo_squares))};
    fo_outcome outcome = FO_NO_MEMORY;
    if (course && other && w.checkpoints && w.rows && w.squares) {
        const bool learnt = learn(&w, file, &prior, angle, parameters, other, posterior, rows);
        outcome = learnt ? FO_ESTIMATED : FO_NO_ESTIMATE;
    }
    free(course);
    free(other);
    free(w.checkpoints);
    free(w.rows);
    free(w.squares);
    return outcome;
}
