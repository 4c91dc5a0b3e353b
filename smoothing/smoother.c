#include "smoother.h"

#include <math.h>
#include <string.h>

enum { N = FO_SMOOTH, DRIFT = 2, PSI = 4, RESISTANCE = 5 };

typedef double square[N][N];

/* The transition is the identity but for these elements: c += duration θ + coupling R, ψ *= decay. */
static void predict_state(const fo_smooth_block *b, double *x, size_t sides)
{
    for (size_t n = 0; n < 2; n++) {
        double *c = x + n * sides;
        const double *drift = x + (DRIFT + n) * sides, *resistance = x + RESISTANCE * sides;
        for (size_t j = 0; j < sides; j++)
            c[j] += b->duration * drift[j] + b->coupling[n] * resistance[j];
    }
    for (size_t j = 0; j < sides; j++) x[PSI * sides + j] *= b->decay;
}

static void predict_adjoint(const fo_smooth_block *b, double *l, size_t sides)
{
    for (size_t n = 0; n < 2; n++) {
        const double *c = l + n * sides;
        double *drift = l + (DRIFT + n) * sides, *resistance = l + RESISTANCE * sides;
        for (size_t j = 0; j < sides; j++) {
            drift[j] += b->duration * c[j];
            resistance[j] += b->coupling[n] * c[j];
        }
    }
    for (size_t j = 0; j < sides; j++) l[PSI * sides + j] *= b->decay;
}

static void transpose(square a)
{
    for (int i = 0; i < N; i++)
        for (int k = 0; k < i; k++) {
            const double kept = a[i][k];
            a[i][k] = a[k][i];
            a[k][i] = kept;
        }
}

/* F P F'. */
static void transport_covariance(const fo_smooth_block *b, square p)
{
    for (int side = 0; side < 2; side++) {
        predict_state(b, &p[0][0], N);
        transpose(p);
    }
}

/* F P F', then the process noise. */
static void predict_covariance(const fo_smooth_block *b, square p)
{
    transport_covariance(b, p);
    for (int n = 0; n < N; n++) p[n][n] += b->walk[n < PSI ? n / 2 : n - 2];
    p[0][0] += b->floating[0];
    p[1][1] += b->floating[2];
    p[0][1] = p[1][0] += b->floating[1];
}

/* F' L F. */
static void predict_information(const fo_smooth_block *b, square l)
{
    for (int side = 0; side < 2; side++) {
        predict_adjoint(b, &l[0][0], N);
        transpose(l);
    }
}

static int measures(const fo_smooth_block *b, size_t m) { return isfinite(b->variance[m]); }

static void update(const double row[N], double variance, const double *measured, size_t sides,
                   square p, double *x, double *gain, double *innovation, double *spread)
{
    double by_row[N]; /* P h */
    *spread = variance;
    for (int n = 0; n < N; n++) {
        by_row[n] = 0.0;
        for (int k = 0; k < N; k++) by_row[n] += p[n][k] * row[k];
    }
    for (int n = 0; n < N; n++) *spread += row[n] * by_row[n];
    for (int n = 0; n < N; n++) gain[n] = by_row[n] / *spread;
    memcpy(innovation, measured, sides * sizeof *innovation);
    for (int n = 0; n < N; n++)
        for (size_t j = 0; j < sides; j++) innovation[j] -= row[n] * x[n * sides + j];
    for (int n = 0; n < N; n++)
        for (size_t j = 0; j < sides; j++) x[n * sides + j] += gain[n] * innovation[j];
    for (int n = 0; n < N; n++)
        for (int k = 0; k <= n; k++) p[n][k] = p[k][n] -= gain[n] * by_row[k];
}

/* Adjoint before the measurement: l <- (I - K h')' l - h e/s, L <- (I - K h')' L (I - K h') + h h'/s. */
static void update_adjoint(const double row[N], const double *gain, const double *innovation,
                           double spread, size_t sides, double *l, square information, double *sum)
{
    double by_gain[N], quadratic = 1.0 / spread;
    for (size_t j = 0; j < sides; j++) sum[j] = innovation[j] / spread;
    for (int n = 0; n < N; n++)
        for (size_t j = 0; j < sides; j++) sum[j] += gain[n] * l[n * sides + j];
    for (int n = 0; n < N; n++)
        for (size_t j = 0; j < sides; j++) l[n * sides + j] -= row[n] * sum[j];
    for (int n = 0; n < N; n++) {
        by_gain[n] = 0.0;
        for (int k = 0; k < N; k++) by_gain[n] += information[n][k] * gain[k];
    }
    for (int n = 0; n < N; n++) quadratic += gain[n] * by_gain[n];
    for (int n = 0; n < N; n++)
        for (int k = 0; k < N; k++)
            information[n][k] += row[n] * row[k] * quadratic - row[n] * by_gain[k] -
                                 by_gain[n] * row[k];
}

/* Smoothed state x - P l and covariance P - P L P, in place of the predicted ones. */
static void smooth_block(const double *l, square information, size_t sides, double *x, square p,
                         double *work)
{
    square half; /* P L */
    memset(work, 0, N * sides * sizeof *work);
    for (int n = 0; n < N; n++)
        for (int k = 0; k < N; k++)
            for (size_t j = 0; j < sides; j++) work[n * sides + j] += p[n][k] * l[k * sides + j];
    for (size_t m = 0; m < N * sides; m++) x[m] -= work[m];
    for (int n = 0; n < N; n++)
        for (int k = 0; k < N; k++) {
            half[n][k] = 0.0;
            for (int m = 0; m < N; m++) half[n][k] += p[n][m] * information[m][k];
        }
    square kept;
    memcpy(kept, p, sizeof kept);
    for (int n = 0; n < N; n++)
        for (int k = 0; k < N; k++)
            for (int m = 0; m < N; m++) p[n][k] -= half[n][m] * kept[m][k];
}

static void forwards(const fo_smooth_block *block, size_t blocks, size_t measurements,
                     const double *measured, size_t sides, const double start[N],
                     const fo_smooth_room *room)
{
    square p = {{0.0}};
    double *x = room->work;
    for (int n = 0; n < N; n++) p[n][n] = start[n];
    memset(x, 0, N * sides * sizeof *x);
    for (size_t k = 0; k < blocks; k++) {
        if (k > 0) {
            predict_state(&block[k], x, sides);
            predict_covariance(&block[k], p);
        }
        memcpy(room->state + k * N * sides, x, N * sides * sizeof *x);
        memcpy(room->covariance + k * N * N, p, sizeof p);
        for (size_t m = 0; m < measurements; m++) {
            const size_t at = k * measurements + m;
            if (measures(&block[k], m)) {
                update(block[k].row[m], block[k].variance[m], measured + at * sides, sides, p, x,
                       room->gain + at * N, room->innovation + at * sides, room->spread + at);
            } else {
                memset(room->innovation + at * sides, 0, sides * sizeof *room->innovation);
                room->spread[at] = INFINITY;
            }
        }
    }
}

static void backwards(const fo_smooth_block *block, size_t blocks, size_t measurements,
                      size_t sides, const fo_smooth_room *room)
{
    square information = {{0.0}};
    double *l = room->work, *work = room->work + N * sides;
    memset(l, 0, N * sides * sizeof *l);
    for (size_t k = blocks; k-- > 0;) {
        for (size_t m = measurements; m-- > 0;) {
            const size_t at = k * measurements + m;
            if (measures(&block[k], m))
                update_adjoint(block[k].row[m], room->gain + at * N, room->innovation + at * sides,
                               room->spread[at], sides, l, information, work);
        }
        smooth_block(l, information, sides, room->state + k * N * sides,
                     (double(*)[N])(room->covariance + k * N * N), work);
        if (k > 0) {
            predict_adjoint(&block[k], l, sides);
            predict_information(&block[k], information);
        }
    }
}

void fo_smooth(const fo_smooth_block *block, size_t blocks, size_t measurements,
               const double *measured, size_t sides, const double start[FO_SMOOTH],
               const fo_smooth_room *room)
{
    forwards(block, blocks, measurements, measured, sides, start, room);
    backwards(block, blocks, measurements, sides, room);
}

void fo_smooth_noise(const fo_smooth_block *block, size_t blocks, size_t measurements,
                     const fo_smooth_room *room, const double *noise, double *through)
{
    square p = {{0.0}};
    for (size_t k = 0; k < blocks; k++) {
        const fo_smooth_block *b = &block[k];
        if (k > 0) transport_covariance(b, p);
        for (size_t j = 0; j < measurements; j++) {
            const size_t at = k * measurements + j;
            const double *gain = room->gain + at * N, *row = b->row[j];
            const double own = noise[at]; /* `through` may be `noise` */
            double by_row[N];
            through[at] = 0.0;
            if (!measures(b, j)) continue;
            for (int n = 0; n < N; n++) {
                by_row[n] = 0.0;
                for (int m = 0; m < N; m++) by_row[n] += p[n][m] * row[m];
            }
            through[at] = own;
            for (int n = 0; n < N; n++) through[at] += row[n] * by_row[n];
            /* (I - K h') P (I - K h')' + K r K' */
            for (int n = 0; n < N; n++)
                for (int m = 0; m < N; m++)
                    p[n][m] += gain[n] * gain[m] * through[at] - gain[n] * by_row[m] -
                               by_row[n] * gain[m];
        }
    }
}
