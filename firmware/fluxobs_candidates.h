/* The start of the adaptive observer; not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_CANDIDATES_H
#define FLUXOBS_CANDIDATES_H

#include "fluxobs_adaptive.h"

#define fo_candidates_place FO_NAME(fo_candidates_place)
#define fo_candidates_step FO_NAME(fo_candidates_step)
#define fo_gauss_newton_step FO_NAME(fo_gauss_newton_step)

/* Std of the angle below which the filter may start [rad]: ten degrees. There its linearisation is
 * accurate to a degree (benchmarks/adaptive.py, the start; noise 2.5 %). */
#define START_STD (PI / (fo_real)18)

/* Information factor on the manifold: U (p - p0) = z. */
typedef struct {
    fo_real U[FO_PACKED(FO_NM)];
    fo_real d[FO_NM];
    fo_real z[FO_NM];
} fo_manifold;

/* Candidates after a sample. */
typedef struct {
    fo_candidate best;
    fo_manifold information; /* information of the best candidate, if this was its turn */
    bool has_best;           /* false: no candidate has converged              */
    bool decided;            /* the filter may start from the best             */
    fo_real inflation;       /* inflation of its covariance                    */
    fo_real second_theta, second_weight; /* second best: angle [rad], weight 0 to 1/2 */
} fo_choice;

/* Places candidates a quarter of a turn apart. The first candidate is at the last known
 * position. */
void fo_candidates_place(const fo_adaptive *observer, fo_adaptive_state *state);

/* Processes one sample with these volt-seconds: integrates all candidates, and fits one of them by
 * a step. */
void fo_candidates_step(const fo_adaptive *observer, fo_adaptive_state *state,
                        const fo_real v[FO_N], fo_choice *choice);

/* Makes one Gauss-Newton step of a candidate towards the best fit to the plain observer's
 * information. */
void fo_gauss_newton_step(const fo_adaptive *observer, const fo_adaptive_state *state,
                          fo_candidate *candidate, fo_manifold *information);

#endif
