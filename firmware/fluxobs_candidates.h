/* The start of the adaptive observer; not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_CANDIDATES_H
#define FLUXOBS_CANDIDATES_H

#include "fluxobs_adaptive.h"

#define fo_candidates_learn FO_NAME(fo_candidates_learn)
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

/* Fits the candidates to the plain observer's information of the mail. Answers with the best
 * candidate, or with a start of the filter once the choice is decided and the rotor has turned far
 * enough. */
void fo_candidates_learn(const fo_adaptive *observer, fo_learner *learner, fo_search *search,
                         const fo_mail *mail, fo_answer *answer);

/* Makes one Gauss-Newton step of a candidate towards the best fit to the plain observer's
 * information. */
void fo_gauss_newton_step(const fo_adaptive *observer, const fo_learner *learner,
                          const fo_mail *mail, fo_candidate *candidate, fo_manifold *information);

#endif
