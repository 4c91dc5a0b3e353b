#include "begin.h"

#include <math.h>
#include <stdlib.h>

/* Rows in which the current hardly changes in rotor coordinates, for a first value. */
enum { STEADY = 250 };

/* First offset of the measured current: what does not turn with the rotor. Regression on each block's
 * mean current in rotor coordinates and on a constant in stator coordinates, with the prior; where the
 * rotor stands, both are the same. */
void fo_begin_offset(const fo_log *record, const double *angle, const fo_prior *prior,
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
void fo_set_course(const fo_problem *problem, const double *angle, const double *p)
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
double fo_first_noise(const fo_log *record, const double *angle, double *spare)
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
void fo_begin_unrest(const fo_problem *problem, double *parameters)
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
