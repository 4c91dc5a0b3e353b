#include "estimate.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    SEED = 2500,      /* rows of the first part */
    PLACES = 5,       /* its possible places in its own length */
    DIRECTION = 400,  /* rows from which the first angle is taken, at most */
    REACH = 8,        /* rows over which the voltage's rotation is measured */
    SMOOTHED = 1500,  /* rows whose smoothing tells the state at the first of them */
    SKIPPED = 20,     /* rows until innovations count: the first flux is rough */
    EVALUATIONS = 60, /* of a stage, at most */
    BRIEF = 12        /* of a stage of growth */
};
static const double quarter_turn = 1.5707963267948966; /* [rad]: shorter, and offsets count */
static const double price = 9.2; /* half squares, ln 10⁴: a jump in ten thousand rows is assumed */
/* Half squares: a step that gains less ends a stage. A parameter that is d standard deviations off
 * costs d²/2, so it remains within 1.4 and 0.2 of them. */
static const double coarse = 1.0, fine = 0.02;

/* Root mean square of the voltages of a part. */
static double mean_voltage(const fo_log *record, size_t first, size_t rows)
{
    double sum = 0.0, known = 0.0;
    for (size_t k = 2 * first; k < 2 * (first + rows); k++) {
        if (!isfinite(record->voltage[k])) continue;
        sum += record->voltage[k] * record->voltage[k];
        known += 0.5;
    }
    return sqrt(sum / fmax(known, 1.0));
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
    const double u = fmax(mean_voltage(record, 0, record->rows), 1e-9), h = fabs(record->sample_time);
    const double speed = u / file->psi_f; /* at which the magnet alone gives the mean voltage */
    put(&p, FO_L_resistance, log(file->R), file->R_std);
    put(&p, FO_L_L_d, log(file->L_d), file->L_std);
    put(&p, FO_L_L_q, log(file->L_q), file->L_std);
    put(&p, FO_L_psi_f, log(file->psi_f), file->psi_std);
    put(&p, FO_L_loss, 0.0, 0.02 * u);
    put(&p, FO_L_knee, log(0.03 * file->rated_current), 0.7);
    /* Rated current alone accelerates to that speed in 5 ms, or much more slowly. */
    put(&p, FO_L_mobility, 0.0, speed / (0.005 * file->psi_f * file->rated_current));
    put(&p, FO_L_lag, file->lag, file->lag_std);
    put(&p, FO_L_noise, log(0.003 * file->rated_current), 1.5);
    put(&p, FO_L_acceleration, log(10.0 * speed), 3.0);
    put(&p, FO_L_voltage, log(0.001 * u * sqrt(h)), 1.5);
    put(&p, FO_L_drift, log(0.01 * u), 2.0);
    put(&p, FO_L_gain, log(0.01), 1.5);
    p.harmonics = 0.01 * file->psi_f;
    p.round = file->L_d == file->L_q;
    return p;
}

/* First values: levels of a poor drive, so that the filter follows while the parameters are wrong. */
static void begin(const fo_log *record, const fo_file *file, const fo_prior *prior, fo_posterior *out)
{
    memset(out, 0, sizeof *out);
    memcpy(out->parameters, prior->mean, sizeof prior->mean);
    out->parameters[FO_L_noise] = log(0.01 * file->rated_current);
    out->parameters[FO_L_drift] = log(0.02 * fmax(mean_voltage(record, 0, record->rows), 1e-9));
    out->harmonics = prior->harmonics;
}

typedef struct {
    double angle, speed;
} place;

/* A part of the log, and the state at its first row. */
static fo_log part(const fo_log *record, size_t first, size_t rows)
{
    fo_log own = *record;
    own.voltage += 2 * first;
    own.current += 2 * first;
    own.rows = rows;
    return own;
}

static fo_start start_at(const fo_log *record, const fo_file *file, place at, double jump)
{
    const double u = fmax(mean_voltage(record, 0, record->rows), 1e-9), speed = u / file->psi_f;
    const fo_start start = {
        .angle = at.angle,
        .angle_std = 0.15,
        .speed = at.speed,
        .speed_std = 0.05 * speed + 1.0,
        .acceleration_std = 10.0 * speed, /* to that speed in a tenth of a second */
        .flux_std = 0.03 * file->psi_f,
        .drift_std = 0.02 * u,
        .gain_std = 0.0, /* by definition: R, L and ψ belong to the gain of the first row */
        .skipped = SKIPPED < record->rows ? SKIPPED : 0,
        .price = jump,
    };
    return start;
}

/* Angle and speed from the rotation of the voltages: λ = (u − R i)/(jω), ψ e^{jθ} = λ − L_q i. */
static place from_rotation(const fo_log *record, const fo_file *file)
{
    const double h = record->sample_time, *u = record->voltage;
    double dot = 0.0, cross = 0.0, turn = 0.0;
    size_t rows = record->rows < REACH ? record->rows : REACH;
    for (; rows < record->rows && rows < DIRECTION; rows++) {
        const double *a = u + 2 * (rows - REACH), *b = u + 2 * rows;
        if (!isfinite(a[0] + a[1] + b[0] + b[1])) continue;
        dot += a[0] * b[0] + a[1] * b[1];
        cross += a[0] * b[1] - a[1] * b[0];
        turn = atan2(cross, dot) / (double)REACH;
        if (rows > 4 * REACH && fabs(turn) * (double)rows > quarter_turn) break;
    }
    double v[2] = {0.0, 0.0}, i[2] = {0.0, 0.0}, known = 0.0;
    for (size_t k = 0; k < rows; k++) {
        const double *own = record->current + 2 * k;
        if (!isfinite(own[0] + own[1] + u[2 * k] + u[2 * k + 1])) continue;
        double c = cos(turn * ((double)k + 0.5)), s = sin(turn * ((double)k + 0.5));
        v[0] += c * u[2 * k] + s * u[2 * k + 1];
        v[1] += c * u[2 * k + 1] - s * u[2 * k];
        c = cos(turn * (double)k);
        s = sin(turn * (double)k);
        i[0] += c * own[0] + s * own[1];
        i[1] += c * own[1] - s * own[0];
        known += 1.0;
    }
    const double speed = turn / h;
    for (int a = 0; a < 2; a++) {
        i[a] /= fmax(known, 1.0);
        v[a] = v[a] / fmax(known, 1.0) - file->R * i[a];
    }
    /* Division by jω: at rest, the direction of the current is as good as any. */
    const double w = fabs(speed) > 1e-6 ? speed : 1e-6;
    const place at = {atan2(-v[0] / w - file->L_q * i[1], v[1] / w - file->L_q * i[0]), speed};
    return at;
}

/* The part with the largest voltages: there the magnet's share of them is largest. */
static size_t fastest(const fo_log *record, size_t rows)
{
    size_t best = 0;
    double most = -1.0;
    const size_t stride = rows / PLACES > 0 ? rows / PLACES : 1;
    for (size_t first = 0; first + rows <= record->rows; first += stride) {
        const double u = mean_voltage(record, first, rows);
        if (u > most) {
            most = u;
            best = first;
        }
    }
    return best;
}

/* State at the first row, smoothed with those that follow. */
static bool smoothed_start(const fo_log *record, const fo_start *start, const double *parameters,
                           fo_row *rows, fo_smoothed *smoothed, place *at)
{
    fo_likelihood out;
    const fo_log own = part(record, 0, record->rows < SMOOTHED ? record->rows : SMOOTHED);
    if (!fo_innovations(&own, parameters, start, &out, rows)) return false;
    fo_smooth(rows, own.rows, NULL, smoothed);
    at->angle = smoothed[0].angle;
    at->speed = smoothed[0].speed;
    return true;
}

/* The filter backwards in time from row `last` to row `first`: where a longer part begins. The
 * controller's answers precede their causes here, so this serves as a start only. */
static bool backwards(const fo_log *record, const fo_file *file, const double *parameters, size_t first,
                      size_t last, double *reversed, fo_row *rows, place *at)
{
    const size_t count = last - first + 1;
    double *current = reversed, *voltage = reversed + 2 * count;
    for (size_t k = 0; k < count; k++)
        for (int a = 0; a < 2; a++) {
            current[2 * k + (size_t)a] = record->current[2 * (last - k) + (size_t)a];
            const size_t from = last - k > first ? last - k - 1 : first;
            voltage[2 * k + (size_t)a] = record->voltage[2 * from + (size_t)a];
        }
    const fo_log own = {count, -record->sample_time, voltage, current};
    fo_start start = start_at(record, file, *at, 0.0);
    start.angle_std = 0.05;
    start.skipped = 0;
    fo_likelihood out;
    if (!fo_innovations(&own, parameters, &start, &out, rows)) return false;
    at->angle = rows[count - 1].angle;
    at->speed = rows[count - 1].speed;
    return true;
}

/* Both stages of a part: the mobility moves when the rest is nearly right. */
static bool maximise(const fo_log *record, const fo_start *start, const fo_prior *prior, bool last,
                     bool first, fo_posterior *out)
{
    bool free[FO_L];
    for (int k = 0; k < FO_L; k++) free[k] = k != FO_L_mobility;
    size_t evaluations = out->evaluations;
    if (first || last) {
        if (!fo_maximise(record, start, prior, free, coarse, EVALUATIONS, out)) return false;
        evaluations += out->evaluations;
    }
    if (!fo_maximise(record, start, prior, NULL, last ? fine : coarse, last ? EVALUATIONS : BRIEF, out))
        return false;
    out->evaluations += evaluations;
    return true;
}

/* All rows at the final parameters. So far the first angle was a crutch of the linearisation. Now it
 * is known where to linearise, and nothing is known of the angle but what the log tells. */
static bool last_pass(const fo_log *record, const fo_file *file, const fo_prior *prior, place first,
                      double jump, fo_row *rows, fo_smoothed *smoothed, fo_posterior *out)
{
    fo_likelihood last;
    fo_start start = start_at(record, file, first, jump);
    start.angle_std = 0.0;
    start.flux_std *= 0.1;
    if (!fo_innovations(record, out->parameters, &start, &last, rows) ||
        !fo_covariance(&last, prior, out))
        return false;
    fo_smooth(rows, record->rows, out->covariance, smoothed);
    return true;
}

static bool grow(const fo_log *record, const fo_file *file, const fo_prior *prior, fo_row *rows,
                 double jump, fo_smoothed *smoothed, double *reversed, fo_posterior *out)
{
    size_t length = record->rows < SEED ? record->rows : SEED, first = fastest(record, length);
    fo_log own = part(record, first, length);
    place at = from_rotation(&own, file);
    begin(record, file, prior, out);
    for (bool seed = true;; seed = false) {
        const bool whole = length == record->rows;
        fo_start start = start_at(&own, file, at, jump);
        if (!maximise(&own, &start, prior, whole, seed, out)) return false;
        if (!smoothed_start(&own, &start, out->parameters, rows, smoothed, &at)) return false;
        if (whole) return last_pass(&own, file, prior, at, jump, rows, smoothed, out);
        /* Twice as long, half of it on each side as far as the log goes. */
        const size_t wanted = 2 * length < record->rows ? 2 * length : record->rows;
        size_t begins = first > length / 2 ? first - length / 2 : 0;
        if (begins + wanted > record->rows) begins = record->rows - wanted;
        if (begins < first &&
            !backwards(record, file, out->parameters, begins, first, reversed, rows, &at))
            return false;
        first = begins;
        length = wanted;
        own = part(record, first, length);
    }
}

/* Whether the normalised innovations of no short stretch are several times as large as usual. */
static bool is_followed(const fo_row *rows, size_t count)
{
    double recent = 1.0;
    for (size_t k = SKIPPED; k < count; k++)
        if (rows[k].measured && fo_is_lost(&rows[k], &recent)) return false;
    return true;
}

fo_outcome fo_estimate(const fo_log *record, const fo_file *file, fo_posterior *posterior,
                       fo_smoothed *rows)
{
    const fo_prior prior = fo_ordinary_prior(record, file);
    fo_row *kept = malloc(record->rows * sizeof *kept);
    double *reversed = malloc(4 * record->rows * sizeof *reversed);
    fo_smoothed *other = malloc(record->rows * sizeof *other);
    fo_outcome outcome = FO_NO_MEMORY;
    if (kept && reversed && other) {
        bool done = grow(record, file, &prior, kept, 0.0, rows, reversed, posterior);
        if (!done || !is_followed(kept, record->rows)) {
            /* The rotor jumps somewhere, or the filter lost it: the same objective tells. */
            fo_posterior jumping;
            const bool more = grow(record, file, &prior, kept, price, other, reversed, &jumping);
            if (more && !(done && posterior->objective <= jumping.objective)) {
                *posterior = jumping;
                memcpy(rows, other, record->rows * sizeof *rows);
            }
            done = done || more;
        }
        outcome = done ? FO_ESTIMATED : FO_NO_ESTIMATE;
    }
    free(kept);
    free(reversed);
    free(other);
    return outcome;
}
