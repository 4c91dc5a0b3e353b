/* The start of the adaptive observer; not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_CANDIDATES_H
#define FLUXOBS_CANDIDATES_H

#include "fluxobs_adaptive.h"

#define fo_candidates_sow FO_NAME(fo_candidates_sow)
#define fo_candidates_step FO_NAME(fo_candidates_step)
#define fo_project FO_NAME(fo_project)

/* Std of the angle below which the start may be decided: ten degrees [rad], where linearising is good
 * to a degree (benchmarks/adaptive.py, the start; noise 2.5 %). */
#define START_STD (PI / (fo_real)18)

/* Information on the manifold, U (p - p0) = z. */
typedef struct {
    fo_real U[FO_PACKED(FO_NM)];
    fo_real d[FO_NM];
    fo_real z[FO_NM];
} fo_manifold;

/* The result of the start. */
typedef struct {
    fo_candidate best;
    fo_manifold information; /* at its last turn, if that was this one    */
    bool found;              /* else nothing here means anything          */
    bool decided;            /* the start is, and this was best's turn    */
    fo_real inflation;       /* of its covariance                         */
    fo_real other, weight;   /* angle and weight of the second best       */
} fo_choice;

/* Sows candidates all around, the first at the last known position. */
void fo_candidates_sow(const fo_adaptive *observer, fo_adaptive_state *state);

/* Processes one sample with these volt-seconds: it is one candidate's turn. */
void fo_candidates_step(const fo_adaptive *observer, fo_adaptive_state *state,
                        const fo_real v[FO_N], fo_choice *choice);

/* One Gauss-Newton step of a candidate towards the best fit to the information. */
void fo_project(const fo_adaptive *observer, const fo_adaptive_state *state,
                fo_candidate *candidate, fo_manifold *information);

#endif
