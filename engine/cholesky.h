/* Linear equations with a symmetric, positive matrix. */
#ifndef FLUXOBS_CHOLESKY_H
#define FLUXOBS_CHOLESKY_H

#include <math.h>
#include <stdbool.h>

#include "parameters.h"

/* Cholesky factor of H + μ D, scaled by the diagonal of H: the units of the parameters differ by many
 * powers of ten. D is diagonal. False: the matrix is not positive. */
static inline bool fo_factor(int n, double H[FO_UNKNOWNS][FO_UNKNOWNS], double mu, const double D[FO_UNKNOWNS],
                             double scale[FO_UNKNOWNS], double R[FO_UNKNOWNS][FO_UNKNOWNS])
{
    for (int r = 0; r < n; r++) {
        if (!(H[r][r] > 0.0) || !isfinite(H[r][r])) return false;
        scale[r] = 1.0 / sqrt(H[r][r]);
    }
    for (int r = 0; r < n; r++)
        for (int c = 0; c <= r; c++) {
            double sum = scale[r] * scale[c] * (H[r][c] + (r == c ? mu * D[r] : 0.0));
            for (int k = 0; k < c; k++) sum -= R[r][k] * R[c][k];
            if (r != c) {
                R[r][c] = sum / R[c][c];
            } else {
                if (!(sum > 1e-14) || !isfinite(sum)) return false;
                R[r][r] = sqrt(sum);
            }
        }
    return true;
}

/* Solves with the factor. */
static inline void fo_solve(int n, double R[FO_UNKNOWNS][FO_UNKNOWNS], const double scale[FO_UNKNOWNS],
                            const double *b, double *x)
{
    for (int r = 0; r < n; r++) {
        x[r] = b[r] * scale[r];
        for (int k = 0; k < r; k++) x[r] -= R[r][k] * x[k];
        x[r] /= R[r][r];
    }
    for (int r = n - 1; r >= 0; r--) {
        for (int k = r + 1; k < n; k++) x[r] -= R[k][r] * x[k];
        x[r] /= R[r][r];
    }
    for (int r = 0; r < n; r++) x[r] *= scale[r];
}

#endif
