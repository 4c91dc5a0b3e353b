/* The start of the adaptive observer; not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_CANDIDATES_H
#define FLUXOBS_CANDIDATES_H

#include "fluxobs_adaptive.h"

#ifdef FO_SINGLE
#define fo_candidates_sow fo_candidates_sow_single
#define fo_candidates_step fo_candidates_step_single
#define fo_project fo_project_single
#endif

/* Information on the manifold: U (p - p0) = z with weights d, U unit upper triangular, row by row. */
typedef struct {
    fo_real U[FO_NM * (FO_NM - 1) / 2];
    fo_real d[FO_NM];
    fo_real z[FO_NM];
} fo_manifold;

/* What is left of the start once it is decided. */
typedef struct {
    fo_candidate best;
    fo_manifold information; /* at its last turn, where that was this one */
    bool found;              /* else nothing here means anything          */
    bool decided;            /* and this was its turn                     */
    fo_real inflation;       /* of its covariance                         */
    fo_real other, weight;   /* angle and weight of the second best       */
} fo_choice;

/* Candidates all around, the first where the position was last. */
void fo_candidates_sow(const fo_adaptive *observer, fo_adaptive_state *state);

/* One sample with these volt-seconds: one candidate's turn. */
void fo_candidates_step(const fo_adaptive *observer, fo_adaptive_state *state,
                        const fo_real v[FO_N], fo_choice *choice);

/* One Gauss-Newton step of a candidate towards what the information says. */
void fo_project(const fo_adaptive *observer, const fo_adaptive_state *state,
                fo_candidate *candidate, fo_manifold *information);

#endif
