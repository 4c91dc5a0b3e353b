#include "growth.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "begin.h"

/* A part has so many rows, at least; the first may have fewer. The filter starts so many rows inside it, to know
 * the speed and the drift where it leaves it. Assumed. */
enum { SHORTEST = 100, FIRST = 40, INSIDE = 400 };
/* Behind rows that do not fit, so many are left out. Assumed. */
enum { APART = 64 };
/* An observer notices so many rows late that it is wrong. Assumed. */
enum { LATE = 60 };
/* What is known of the state at the first of these rows, as shares of what is usual: the course is right there. */
static const double flux_share = 0.03, angle_std = 0.1, speed_share = 0.1;
/* Angle by which parts that touch may disagree [rad]. Assumed. */
static const double agrees = 0.5;

bool fo_begin_part(fo_growth *g, size_t longest)
{
    if (g->count == FO_MOST_PARTS) return false;
    fo_part best = {0, 0};
    size_t from = 0;
    for (size_t k = 0; k <= g->log->rows; k++) {
        if (k < g->log->rows && isfinite(g->hints[k]) && !isfinite(g->angles[k])) continue;
        if (k - from > best.rows) best = (fo_part){from, k - from};
        from = k + 1;
    }
    if (best.rows < (g->count ? SHORTEST : FIRST)) return false;
    if (best.rows > SHORTEST + LATE) best.rows -= LATE;
    if (best.rows > longest) best = (fo_part){best.first + (best.rows - longest) / 2, longest};
    for (size_t k = best.first; k < best.first + best.rows; k++) {
        const double before = k > best.first ? g->angles[k - 1] : g->hints[k];
        g->angles[k] = before + remainder(g->hints[k] - before, FO_TURN);
    }
    g->parts[g->count++] = best;
    return true;
}

/* The rows on which a part grows in one direction, in its order; backwards in time, the sample time is negative. */
typedef struct {
    fo_log log;
    fo_course *course;
    double *hints, *values;
} direction;

/* Mean voltage of an interval, with its lag in rows; the first and the last hold. */
static void voltage_of(const fo_log *log, double place, double out[2])
{
    const double last = (double)log->rows - 1.0, at = place < 0.0 ? 0.0 : place > last ? last : place;
    const size_t k = at < last ? (size_t)at : log->rows - 2;
    const double share = at - (double)k;
    for (size_t a = 0; a < 2; a++) {
        const double *u = log->voltage + 2 * k + a;
        out[a] = share > 0.0 ? u[0] + share * (u[2] - u[0]) : u[0];
    }
}

/* `count` rows from `row` on. */
static bool open_direction(const fo_growth *g, size_t row, size_t count, bool back, double lag, direction *d)
{
    const fo_log *log = g->log;
    *d = (direction){.log = {.rows = count,
                             .sample_time = back ? -log->sample_time : log->sample_time,
                             .periods = log->periods},
                     .course = malloc(count * sizeof *d->course),
                     .values = malloc(6 * count * sizeof *d->values)};
    if (!d->course || !d->values) {
        free(d->course);
        free(d->values);
        return false;
    }
    double *voltage = d->values, *current = voltage + 2 * count, *rounding = current + 2 * count;
    d->hints = rounding + count;
    for (size_t n = 0; n < count; n++) {
        const size_t k = back ? row - n : row + n;
        voltage_of(log, (double)k - (back ? 1.0 : 0.0) - lag, voltage + 2 * n);
        for (size_t a = 0; a < 2; a++) current[2 * n + a] = log->current[2 * k + a];
        rounding[n] = log->rounding ? log->rounding[k] : 0.0;
        d->hints[n] = g->hints[k];
    }
    d->log.voltage = voltage;
    d->log.current = current;
    d->log.rounding = rounding;
    return true;
}

static void close_direction(direction *d)
{
    free(d->course);
    free(d->values);
}

/* Rows beside a part that belong to no other. */
static size_t room(const fo_growth *g, const fo_part *part, bool back)
{
    const size_t end = part->first + part->rows;
    size_t k = 0;
    if (back)
        while (k < part->first && !isfinite(g->angles[part->first - 1 - k])) k++;
    else
        while (end + k < g->log->rows && !isfinite(g->angles[end + k])) k++;
    return k;
}

/* The course of the rows inside the part that the filter passes first, in the order of the direction. */
static void give_course(const fo_growth *g, size_t row, size_t given, bool back, const double *p, fo_course *course)
{
    const size_t first = back ? row - given : row;
    const fo_log log = fo_rows_of(g->log, first, given + 1);
    const fo_problem inside = {&log, g->machine, g->start, course};
    fo_set_course(&inside, g->angles + first, p);
    for (size_t n = 0; back && 2 * n < given; n++) {
        const fo_course own = course[n];
        course[n] = course[given - n];
        course[given - n] = own;
    }
}

static fo_start known_start(const fo_growth *g)
{
    fo_start start = *g->start;
    start.flux_std *= flux_share;
    start.angle_std = angle_std;
    start.speed_std *= speed_share;
    return start;
}

static bool grow(const fo_growth *g, fo_part *part, bool back, const double *p)
{
    const size_t beside = room(g, part, back), given = part->rows - 1 < INSIDE ? part->rows - 1 : INSIDE;
    const size_t row = back ? part->first + given : part->first + part->rows - 1 - given;
    const size_t count = given + 1 + beside;
    direction d;
    if (!beside) return true;
    if (!open_direction(g, row, count, back, p[FO_L_lag] + p[FO_L_delay], &d)) return false;
    give_course(g, row, given, back, p, d.course);
    double own[FO_UNKNOWNS];
    memcpy(own, p, sizeof own);
    own[FO_L_lag] = own[FO_L_delay] = own[FO_L_heat] = 0.0;
    own[FO_L_resistance] += log1p(p[FO_L_heat] * (double)row / (double)g->log->rows);
    const fo_start start = known_start(g);
    const fo_problem problem = {&d.log, g->machine, &start, d.course};
    const fo_follower follower = {given, d.hints, g->covariance};
    const size_t reached = fo_follow(&problem, own, &follower);
    for (size_t n = given + 1; n < reached; n++) g->angles[back ? row - n : row + n] = d.course[n].angle;
    if (reached > given + 1) {
        part->rows += reached - given - 1;
        if (back) part->first -= reached - given - 1;
    }
    close_direction(&d);
    return true;
}

bool fo_grow_part(const fo_growth *g, fo_part *part, const double parameters[FO_UNKNOWNS])
{
    return grow(g, part, false, parameters) && grow(g, part, true, parameters);
}

void fo_forget(const fo_growth *g, const fo_part *part)
{
    for (size_t k = part->first; k < part->first + part->rows; k++) g->angles[k] = g->hints[k] = (double)NAN;
}

/* These rows are a part, unless they are too few. */
static void keep(fo_growth *g, size_t first, size_t end)
{
    if (end - first >= SHORTEST && g->count < FO_MOST_PARTS)
        g->parts[g->count++] = (fo_part){first, end - first};
    else {
        const fo_part few = {first, end - first};
        fo_forget(g, &few);
    }
}

void fo_cut_parts(fo_growth *g, fo_course *course, const double parameters[FO_UNKNOWNS],
                  bool witnesses)
{
    fo_part before[FO_MOST_PARTS];
    const size_t count = g->count;
    const fo_start start = known_start(g);
    memcpy(before, g->parts, sizeof before);
    g->count = 0;
    for (size_t n = 0; n < count; n++) {
        const size_t end = before[n].first + before[n].rows;
        for (size_t first = before[n].first; first < end;) {
            const fo_log log = fo_rows_of(g->log, first, end - first);
            const fo_problem problem = {&log, g->machine, &start, course + first};
            const fo_follower follower = {log.rows, witnesses ? g->hints + first : NULL, g->covariance};
            const size_t fits = first + fo_follow(&problem, parameters, &follower);
            keep(g, first, fits);
            const size_t next = fits + APART < end ? fits + APART : end;
            const fo_part misfit = {fits, next - fits};
            fo_forget(g, &misfit);
            first = next;
        }
    }
}

static int by_place(const void *a, const void *b)
{
    const size_t x = ((const fo_part *)a)->first, y = ((const fo_part *)b)->first;
    return (x > y) - (x < y);
}

/* Joins a part to the one before it. False: they do not agree. */
static bool join(const fo_growth *g, fo_part *last, const fo_part *next)
{
    double *angle = g->angles + next->first;
    const double step = angle[0] - (2.0 * angle[-1] - angle[-2]);
    const double error = remainder(step, FO_TURN);
    if (fabs(error) >= agrees) return false;
    for (size_t k = 0; k < next->rows; k++) angle[k] += error - step;
    last->rows += next->rows;
    return true;
}

static bool has_seed(const fo_growth *g, const fo_part *part)
{
    return g->seed >= part->first && g->seed - part->first < part->rows;
}

void fo_join_parts(fo_growth *g)
{
    size_t count = 0;
    qsort(g->parts, g->count, sizeof *g->parts, by_place);
    for (size_t n = 0; n < g->count; n++) {
        const fo_part next = g->parts[n];
        fo_part *last = count ? g->parts + count - 1 : NULL;
        if (last && last->first + last->rows == next.first) {
            if (join(g, last, &next)) continue;
            if (has_seed(g, last) || (!has_seed(g, &next) && last->rows >= next.rows)) {
                fo_forget(g, &next);
                continue;
            }
            fo_forget(g, last);
            count--;
        }
        g->parts[count++] = next;
    }
    g->count = count;
}
