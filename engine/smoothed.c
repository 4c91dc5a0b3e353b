#include "smoothed.h"

#include <math.h>
#include <string.h>

/* Bryson–Frazier form: x_s = x − P λ and P_s = P − P Λ P. The adjoint λ sums up the later
 * innovations; Λ is its covariance. No covariance is inverted, so a state may have no process noise. */
enum { COLUMNS = FO_UNKNOWNS + 1 }; /* λ, and its derivatives by the parameters, gain held */

typedef struct {
    double lambda[FO_STATES][COLUMNS];
    double Lambda[FO_STATES][FO_STATES];
} adjoint;

/* y ← Fᵀ y, for the first `width` columns of rows of `stride` numbers. */
static void transition_transposed(const fo_row *row, double *y, size_t stride, size_t width)
{
    double moved[FO_STATES * COLUMNS];
    memset(moved, 0, FO_STATES * width * sizeof *moved);
    for (int k = 0; k < FO_ELEMENTS; k++) {
        const double f = row->F[k], *from = y + fo_pattern[k][0] * stride;
        double *to = moved + fo_pattern[k][1] * width;
        for (size_t c = 0; c < width; c++) to[c] += f * from[c];
    }
    for (size_t r = 0; r < FO_STATES; r++)
        memcpy(y + r * stride, moved + r * width, width * sizeof *y);
}

/* y ← y − Hᵀ (Kᵀ y + v); v: two rows of `width` numbers, or null. */
static void measurement_transposed(const fo_row *row, double *y, size_t stride, size_t width,
                                   const double *v)
{
    double g[2][COLUMNS];
    for (size_t a = 0; a < 2; a++) {
        for (size_t c = 0; c < width; c++) g[a][c] = v ? v[a * width + c] : 0.0;
        for (size_t r = 0; r < FO_STATES; r++)
            for (size_t c = 0; c < width; c++) g[a][c] += row->K[r][a] * y[r * stride + c];
    }
    const double *A = row->by_flux, *b = row->by_angle, *p = row->by_psi;
    for (size_t c = 0; c < width; c++) {
        y[c] -= A[0] * g[0][c] + A[2] * g[1][c];
        y[stride + c] -= A[1] * g[0][c] + A[3] * g[1][c];
        y[FO_ANGLE * stride + c] -= b[0] * g[0][c] + b[1] * g[1][c];
        y[FO_PSI * stride + c] -= p[0] * g[0][c] + p[1] * g[1][c];
        y[FO_NOISE * stride + c] -= g[0][c];
        y[(FO_NOISE + 1) * stride + c] -= g[1][c];
    }
}

static void weighted_error(const fo_row *row, const double e[2], double v[2])
{
    v[0] = row->inverse[0] * e[0] + row->inverse[1] * e[1];
    v[1] = row->inverse[1] * e[0] + row->inverse[2] * e[1];
}

static void transpose(double *M)
{
    for (int r = 0; r < FO_STATES; r++)
        for (int c = 0; c < r; c++) {
            double *lower = M + r * FO_STATES + c, *upper = M + c * FO_STATES + r;
            const double x = *lower;
            *lower = *upper;
            *upper = x;
        }
}

/* The transition to the next row, for `width` columns of λ and both sides of Λ. */
static void pass_transition(const fo_row *row, adjoint *a, size_t width)
{
    transition_transposed(row, &a->lambda[0][0], COLUMNS, width);
    for (int side = 0; side < 2; side++) {
        transition_transposed(row, &a->Lambda[0][0], FO_STATES, FO_STATES);
        transpose(&a->Lambda[0][0]);
    }
}

/* The row's measurement: λ ← (1 − K H)ᵀ λ − Hᵀ S⁻¹ e, Λ ← (1 − K H)ᵀ Λ (1 − K H) + Hᵀ S⁻¹ H. */
static void pass_measurement(const fo_row *row, adjoint *a, size_t width)
{
    double v[2 * COLUMNS];
    for (size_t k = 0; k < width; k++) {
        const double e[2] = {k ? row->error_by[0][k - 1] : row->error[0],
                             k ? row->error_by[1][k - 1] : row->error[1]};
        double own[2];
        weighted_error(row, e, own);
        v[k] = own[0];
        v[width + k] = own[1];
    }
    measurement_transposed(row, &a->lambda[0][0], COLUMNS, width, v);
    for (int side = 0; side < 2; side++) {
        measurement_transposed(row, &a->Lambda[0][0], FO_STATES, FO_STATES, NULL);
        transpose(&a->Lambda[0][0]);
    }
    double H[2][FO_STATES] = {{0.0}};
    for (int b = 0; b < 2; b++) {
        H[b][0] = row->by_flux[2 * b];
        H[b][1] = row->by_flux[2 * b + 1];
        H[b][FO_ANGLE] = row->by_angle[b];
        H[b][FO_PSI] = row->by_psi[b];
        H[b][FO_NOISE + b] = 1.0;
    }
    for (int c = 0; c < FO_STATES; c++) {
        const double e[2] = {H[0][c], H[1][c]};
        double VH[2];
        weighted_error(row, e, VH);
        for (int r = 0; r < FO_STATES; r++) a->Lambda[r][c] += H[0][r] * VH[0] + H[1][r] * VH[1];
    }
}

/* Largest turn of a row of the course in a pass [rad]: the relation is still linear there. Assumed. */
static const double longest_turn = 0.3;

void fo_smooth_course(const fo_row *rows, size_t count, fo_course *out)
{
    double lambda[FO_STATES] = {0.0};
    for (size_t n = count; n-- > 0;) {
        const fo_row *row = rows + n;
        if (n + 1 < count) transition_transposed(row, lambda, 1, 1);
        double x[FO_OWN];
        for (int s = 0; s < FO_OWN; s++) {
            x[s] = row->own[s];
            for (int r = 0; r < FO_STATES; r++) x[s] -= row->P[s][r] * lambda[r];
        }
        const double turn = fabs(x[FO_ANGLE] - out[n].angle);
        const double share = turn > longest_turn ? longest_turn / turn : 1.0;
        out[n].flux[0] += share * (x[FO_FLUX] - out[n].flux[0]);
        out[n].flux[1] += share * (x[FO_FLUX + 1] - out[n].flux[1]);
        out[n].angle += share * (x[FO_ANGLE] - out[n].angle);
        out[n].psi += share * (x[FO_PSI] - out[n].psi);
        if (!row->measured) continue;
        double v[2];
        weighted_error(row, row->error, v);
        measurement_transposed(row, lambda, 1, 1, v);
    }
}

/* Smoothed noise of a row: R (S⁻¹ e + Kᵀ λ), with the variance R − R (S⁻¹ + Kᵀ Λ K) R. */
static double square_of_noise(const fo_row *row, const adjoint *a, double variance)
{
    double v[2], sum = 2.0;
    weighted_error(row, row->error, v);
    for (size_t n = 0; n < 2; n++) {
        double u = v[n], information = row->inverse[2 * n];
        for (int r = 0; r < FO_STATES; r++) {
            u += row->K[r][n] * a->lambda[r][0];
            for (int c = 0; c < FO_STATES; c++)
                information += row->K[r][n] * a->Lambda[r][c] * row->K[c][n];
        }
        sum += variance * (u * u - information);
    }
    return sum;
}

void fo_smooth_squares(const fo_row *rows, size_t count, double acceleration, double noise,
                       const fo_course *course, fo_squares *out)
{
    adjoint a;
    memset(&a, 0, sizeof a);
    for (size_t n = count; n-- > 0;) {
        /* Before its own transition, λ is that of the next row's state: the change has q λ. */
        const double q = acceleration * course[n].unrest, l = a.lambda[FO_ACCELERATION][0];
        out[n].change = 1.0 - q * a.Lambda[FO_ACCELERATION][FO_ACCELERATION] + q * l * l;
        out[n].noise = 2.0;
        if (n + 1 < count) pass_transition(rows + n, &a, 1);
        if (!rows[n].measured) continue;
        out[n].noise = square_of_noise(rows + n, &a, noise * course[n].doubt);
        pass_measurement(rows + n, &a, 1);
    }
}

/* Variance that the parameters add to a state, from its derivatives. */
static double share_of_parameters(const double *by, const double *covariance)
{
    double sum = 0.0;
    for (int r = 0; r < FO_UNKNOWNS; r++) {
        double own = 0.0;
        for (int c = 0; c < FO_UNKNOWNS; c++) own += covariance[r * FO_UNKNOWNS + c] * by[c];
        sum += by[r] * own;
    }
    return sum;
}

void fo_smooth(const fo_row *rows, size_t count, double sample_time, const double *parameters,
               const double *covariance, fo_smoothed *out)
{
    static const int own[2] = {FO_ANGLE, FO_SPEED};
    adjoint a;
    memset(&a, 0, sizeof a);
    for (size_t n = count; n-- > 0;) {
        const fo_row *row = rows + n;
        if (n + 1 < count) pass_transition(row, &a, COLUMNS);
        double value[2], std[2];
        for (int s = 0; s < 2; s++) {
            const double *P = row->P[own[s]];
            double variance = P[own[s]], x[COLUMNS];
            x[0] = row->own[own[s]];
            memcpy(x + 1, row->own_by[s], sizeof row->own_by[s]);
            for (int r = 0; r < FO_STATES; r++) {
                double PL = 0.0;
                for (int c = 0; c < FO_STATES; c++) PL += P[c] * a.Lambda[c][r];
                variance -= PL * P[r];
                for (int c = 0; c < COLUMNS; c++) x[c] -= P[r] * a.lambda[r][c];
            }
            if (s == 0) { /* The current is older than the row, and the angle is that of the row. */
                const double turn = sample_time * row->own[FO_SPEED];
                x[0] += parameters[FO_L_delay] * turn;
                x[1 + FO_L_delay] += turn;
            }
            variance += share_of_parameters(x + 1, covariance);
            value[s] = x[0];
            std[s] = sqrt(fmax(variance, 0.0));
        }
        out[n] = (fo_smoothed){value[0], std[0], value[1], std[1]};
        if (row->measured) pass_measurement(row, &a, COLUMNS);
    }
}
