/* Square-root-free least squares: U x = z with weights d. U is unit upper triangular, packed row by
 * row without its diagonal. The information matrix is U' diag(d) U. Not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_TRIANGLE_H
#define FLUXOBS_TRIANGLE_H

#include "fluxobs.h"

/* Elements of the strict upper triangle of order n, and elements before row i. */
#define FO_PACKED(n) ((n) * ((n) - 1) / 2)
#define FO_ROW(n, i) ((i) * (2 * (n) - (i) - 1) / 2)
/* Index of element (i, j), i < j, of a factor of order n. */
#define FO_AT(n, i, j) (FO_ROW((int)(n), (int)(i)) + (int)(j) - (int)(i) - 1)

#define fo_add_row_to FO_NAME(fo_add_row_to)
#define fo_solve FO_NAME(fo_solve)
#define fo_marginal_variance FO_NAME(fo_marginal_variance)

/* Adds row'x = value with this information to the rows first .. last - 1 of a factor of order n, by
 * Gentleman's rotations. On return the row, its value and its information are the remainder that
 * those rows do not contain. For last < n, the remainder is a row on the unknowns from `last` on.
 * Weights must be positive where the row is not zero. */
void fo_add_row_to(int n, fo_real U[], fo_real d[], fo_real z[], int first, int last, fo_real row[],
               fo_real *value, fo_real *information);

/* Solves the rows first .. last - 1 of U x = z for x, given the later elements of x. */
void fo_solve(int n, const fo_real U[], const fo_real z[], int first, int last, fo_real x[]);

/* Returns the part of the variance of direction'x that comes from the rows first .. last - 1: the
 * sum of y^2 / d, where U'y = direction. On return, `direction` is the direction for the later
 * rows. The sum of the parts is the marginal variance. */
fo_real fo_marginal_variance(int n, const fo_real U[], const fo_real d[], int first, int last,
                    fo_real direction[]);

#endif
