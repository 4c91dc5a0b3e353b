#include "thinning.h"

#include <math.h>
#include <stdlib.h>

/* Largest turn within a row of the thinned log [rad], and the largest share of its time constant by which
 * the current decays: mean voltages and currents are then near enough for a start. Assumed: with 0.3, the
 * drives of tests/engine/drive_table.py ended in the same minima. */
static const double turn = 1.0;
/* Rows that remain, at least. */
enum { REMAIN = 1000, MOST = 16, OVER = 16 };

size_t fo_thinning(const fo_log *log, const double *angle, double decay)
{
    double most = decay * fabs(log->sample_time);
    for (size_t k = 0; k + OVER < log->rows; k += OVER)
        most = fmax(most, fabs(angle[k + OVER] - angle[k]) / (double)OVER);
    size_t factor = log->rows / REMAIN;
    if (factor > MOST) factor = MOST;
    if (most * (double)factor > turn) factor = (size_t)(turn / most);
    size_t power = 1;
    while (2 * power <= factor) power *= 2;
    return power;
}

static bool is_known(const double *value)
{
    return isfinite(value[0]) && isfinite(value[1]);
}

/* Mean voltage of `count` rows; NaN if one is missing. Before the first row and behind the last, theirs holds. */
static void voltage_of(const fo_log *log, long first, size_t count, double mean[2])
{
    mean[0] = mean[1] = 0.0;
    for (size_t n = 0; n < count; n++) {
        long k = first + (long)n;
        if (k < 0) k = 0;
        if (k >= (long)log->rows) k = (long)log->rows - 1;
        const double *u = log->voltage + 2 * k;
        for (int a = 0; a < 2; a++) mean[a] += u[a] / (double)count;
        if (!is_known(u)) mean[0] = (double)NAN;
    }
}

bool fo_thin(const fo_log *log, size_t factor, double lag, fo_thinned *out)
{
    const size_t rows = (log->rows + factor - 1) / factor;
    const long shift = lround(lag);
    *out = (fo_thinned){*log, factor, shift, malloc(4 * rows * sizeof(double))};
    if (!out->values) return false;
    double *voltage = out->values, *current = voltage + 2 * rows;
    for (size_t n = 0; n < rows; n++) {
        const size_t k = n * factor;
        voltage_of(log, (long)k - shift, factor, voltage + 2 * n);
        for (size_t a = 0; a < 2; a++) current[2 * n + a] = log->current[2 * k + a];
    }
    out->log.rows = rows;
    out->log.sample_time = (double)factor * log->sample_time;
    out->log.voltage = voltage;
    out->log.current = current;
    out->log.rounding = NULL;
    out->log.periods = factor * (log->periods ? log->periods : 1);
    return true;
}

void fo_free_thinned(fo_thinned *thinned)
{
    free(thinned->values);
    thinned->values = NULL;
}

typedef struct {
    double of[4]; /* flux in rotor coordinates, angle, ψ */
} point;

static point point_of(const fo_course *c)
{
    const double x = cos(c->angle), y = sin(c->angle);
    return (point){{x * c->flux[0] + y * c->flux[1], x * c->flux[1] - y * c->flux[0], c->angle, c->psi}};
}

static point beyond(const point *last, const point *before)
{
    point out;
    for (int k = 0; k < 4; k++) out.of[k] = 2.0 * last->of[k] - before->of[k];
    return out;
}

/* Between b and c, after Catmull and Rom. */
static point between(const point *a, const point *b, const point *c, const point *d, double x)
{
    point out;
    for (int k = 0; k < 4; k++) {
        const double p = a->of[k], q = b->of[k], r = c->of[k], s = d->of[k];
        const double cubic = 3.0 * (q - r) + s - p, square = 2.0 * p - 5.0 * q + 4.0 * r - s;
        out.of[k] = q + 0.5 * x * (r - p + x * (square + x * cubic));
    }
    return out;
}

void fo_fill(const fo_course *thinned, size_t count, size_t factor, fo_course *out, size_t rows)
{
    for (size_t n = 0; n < count; n++) {
        const point b = point_of(thinned + n);
        const point before = n ? point_of(thinned + n - 1) : b;
        const point c = n + 1 < count ? point_of(thinned + n + 1) : beyond(&b, &before);
        const point a = n ? before : beyond(&b, &c);
        const point d = n + 2 < count ? point_of(thinned + n + 2) : beyond(&c, &b);
        for (size_t k = n * factor; k < rows && k < (n + 1) * factor; k++) {
            const point p = between(&a, &b, &c, &d, (double)(k - n * factor) / (double)factor);
            const double x = cos(p.of[2]), y = sin(p.of[2]);
            out[k] = (fo_course){{x * p.of[0] - y * p.of[1], x * p.of[1] + y * p.of[0]},
                                 p.of[2], p.of[3], 1.0, 1.0};
        }
    }
}
