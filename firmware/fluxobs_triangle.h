/* Triangles of least squares: U x = z with weights d, U unit upper triangular, packed row by row
 * without its diagonal: the square-root information R x = sqrt(d) z, R = sqrt(d) U, without its
 * roots. Not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_TRIANGLE_H
#define FLUXOBS_TRIANGLE_H

#include "fluxobs.h"

/* Elements of the strict upper triangle of order n, and those before row i. */
#define FO_PACKED(n) ((n) * ((n) - 1) / 2)
#define FO_ROW(n, i) ((i) * (2 * (n) - (i) - 1) / 2)
/* Element (i, j), i < j, of a triangle of order n. */
#define FO_AT(n, i, j) (FO_ROW((int)(n), (int)(i)) + (int)(j) - (int)(i) - 1)

#define fo_rotate FO_NAME(fo_rotate)
#define fo_solve FO_NAME(fo_solve)
#define fo_variance FO_NAME(fo_variance)

/* Takes in row'x = value with this much information, by Gentleman's rotations, into the rows first
 * to last - 1 of a triangle of order n. The row ends as what is left of it, with its value and
 * information: zero before `last`, unless that is n. The weights must be positive where the row is
 * not zero. */
void fo_rotate(int n, fo_real U[], fo_real d[], fo_real z[], int first, int last, fo_real row[],
               fo_real *value, fo_real *information);

/* Solves the rows first to last - 1 of U x = z for x, given what follows in x. */
void fo_solve(int n, const fo_real U[], const fo_real z[], int first, int last, fo_real x[]);

/* Variance of direction'x over the rows first to last - 1: the sum of y^2 / d, U'y = direction. The
 * direction ends as what is left of it, for the rows that follow. */
fo_real fo_variance(int n, const fo_real U[], const fo_real d[], int first, int last,
                    fo_real direction[]);

#endif
