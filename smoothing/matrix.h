/* Small symmetric positive definite matrices, n rows of n numbers. */
#ifndef FLUXOBS_MATRIX_H
#define FLUXOBS_MATRIX_H

#include <math.h>
#include <stdbool.h>

/* Replaces the lower triangle by its Cholesky factor; false if the matrix is not positive. */
static inline bool fo_factorise(double *a, int n)
{
    for (int r = 0; r < n; r++)
        for (int c = 0; c <= r; c++) {
            double sum = a[r * n + c];
            for (int k = 0; k < c; k++) sum -= a[r * n + k] * a[c * n + k];
            if (r > c)
                a[r * n + c] = sum / a[c * n + c];
            else if (sum > 0.0)
                a[r * n + r] = sqrt(sum);
            else
                return false;
        }
    return true;
}

/* Solves A x = b in place, given the factor of A. */
static inline void fo_substitute(const double *factor, int n, double *b)
{
    for (int r = 0; r < n; r++) {
        for (int k = 0; k < r; k++) b[r] -= factor[r * n + k] * b[k];
        b[r] /= factor[r * n + r];
    }
    for (int r = n - 1; r >= 0; r--) {
        for (int k = r + 1; k < n; k++) b[r] -= factor[k * n + r] * b[k];
        b[r] /= factor[r * n + r];
    }
}

#endif
