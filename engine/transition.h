/* Products with a transition, whose elements are mostly zero. */
#ifndef FLUXOBS_TRANSITION_H
#define FLUXOBS_TRANSITION_H

#include <string.h>

#include "innovations.h"

/* y = F x, or Fᵀ x; x and y: FO_STATES rows of `width` numbers, of which the first `used` are not zero. */
static inline void fo_times_part(const fo_elements *elements, const double F[FO_ELEMENTS],
                                 bool transposed, int width, int used, const double *x, double *y)
{
    memset(y, 0, sizeof *y * (size_t)(FO_STATES * width));
    for (int n = 0; n < elements->count; n++) {
        const int k = elements->at[n];
        const double f = F[k], *from = x + fo_pattern[k][!transposed] * width;
        double *to = y + fo_pattern[k][transposed] * width;
        for (int c = 0; c < used; c++) to[c] += f * from[c];
    }
}

static inline void fo_times(const fo_elements *elements, const double F[FO_ELEMENTS],
                            bool transposed, int width, const double *x, double *y)
{
    fo_times_part(elements, F, transposed, width, width, x, y);
}

static inline void fo_on_both_sides_of(const fo_elements *elements, const double F[FO_ELEMENTS],
                                       bool transposed, int used, double P[FO_STATES][FO_STATES],
                                       double half[FO_STATES][FO_STATES])
{
    double M[FO_STATES][FO_STATES];
    fo_times_part(elements, F, transposed, FO_STATES, used, P[0], M[0]);
    for (int r = 0; r < FO_STATES; r++)
        for (int c = 0; c < FO_STATES; c++) half[r][c] = M[c][r];
    fo_times_part(elements, F, transposed, FO_STATES, used, half[0], M[0]);
    for (int r = 0; r < used; r++)
        for (int c = r; c < used; c++) P[r][c] = P[c][r] = M[r][c];
}

/* P ← F P Fᵀ, or Fᵀ P F; `half`: P Fᵀ, or P F. Without coloured noise, its states are zero. */
static inline void fo_on_both_sides(const fo_elements *elements, const double F[FO_ELEMENTS],
                                    bool transposed, double P[FO_STATES][FO_STATES],
                                    double half[FO_STATES][FO_STATES])
{
    if (elements->states == FO_STATES)
        fo_on_both_sides_of(elements, F, transposed, FO_STATES, P, half);
    else
        fo_on_both_sides_of(elements, F, transposed, FO_NOISE, P, half);
}

#endif
