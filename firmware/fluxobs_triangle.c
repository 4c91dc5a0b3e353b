/* SPDX-License-Identifier: MIT */
#include "fluxobs_triangle.h"

#include "fluxobs_internal.h"

void fo_add_row_to(int n, fo_real U[], fo_real d[], fo_real z[], int first, int last, fo_real row[],
               fo_real *value, fo_real *information)
{
    fo_real rhs = *value, weight = *information;
    fo_real *u = &U[FO_ROW(n, first)];
    for (int i = first; i < last; i++) {
        const fo_real pivot = row[i], weighted = weight * pivot, d_new = d[i] + weighted * pivot;
        if (pivot != ZERO && d_new > ZERO) {
            const fo_real inverse = ONE / d_new, gain = weighted * inverse;
            weight *= d[i] * inverse;
            d[i] = d_new;
            row[i] = ZERO;
            for (int j = i + 1; j < n; j++) {
                const fo_real reduced = row[j] - pivot * *u;
                row[j] = reduced;
                *u++ += gain * reduced;
            }
            rhs -= pivot * z[i];
            z[i] += gain * rhs;
        } else {
            u = &u[n - 1 - i];
        }
    }
    *value = rhs;
    *information = weight;
}

void fo_solve(int n, const fo_real U[], const fo_real z[], int first, int last, fo_real x[])
{
    for (int i = last - 1; i >= first; i--) {
        const fo_real *u = &U[FO_ROW(n, i)];
        fo_real sum = z[i];
        for (int j = i + 1; j < n; j++) {
            sum -= *u++ * x[j];
        }
        x[i] = sum;
    }
}

fo_real fo_marginal_variance(int n, const fo_real U[], const fo_real d[], int first, int last,
                    fo_real direction[])
{
    const fo_real d_min = (fo_real)1e-30; /* rounding may make the weight zero */
    fo_real sum = ZERO;
    const fo_real *u = &U[FO_ROW(n, first)];
    for (int i = first; i < last; i++) {
        const fo_real y = direction[i];
        sum += y * y / (d[i] > d_min ? d[i] : d_min);
        for (int j = i + 1; j < n; j++) {
            direction[j] -= y * *u++;
        }
    }
    return sum;
}
