/* The learner: start, filter and parameters of the adaptive observer in one information factor; not
 * for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_LEARNING_H
#define FLUXOBS_LEARNING_H

#include "fluxobs_candidates.h"

#define fo_learning_reset FO_NAME(fo_learning_reset)
#define fo_learning_start FO_NAME(fo_learning_start)
#define fo_learning_values FO_NAME(fo_learning_values)
#define fo_learning_std FO_NAME(fo_learning_std)
#define fo_learning_update_voltage_std FO_NAME(fo_learning_update_voltage_std)
#define fo_learning_widen_resistance FO_NAME(fo_learning_widen_resistance)
#define fo_learning_prior_means FO_NAME(fo_learning_prior_means)
#define fo_learning_shift_values FO_NAME(fo_learning_shift_values)
#define fo_learning_move_prior_means FO_NAME(fo_learning_move_prior_means)

/* Rotation over which residuals are averaged to one measurement row [rad]: an eighth of a turn.
 * Model errors are functions of the angle with harmonics up to the sixth. Rows of shorter blocks
 * would repeat the same error and count as new information. */
#define BLOCK (PI / (fo_real)4)
/* Time after which a block ends if the rotor is slow [memories]. The weight of its row is the share
 * of BLOCK that the rotor has turned. */
#define BLOCK_MAX ((fo_real)0.3)
/* Change of the current as a share of the rated current, or of the speed as a share of itself, that
 * makes a new operating point [1]. Rows at one operating point repeat the same error: the n-th row
 * counts 1/n. */
#define NEW_POINT ((fo_real)0.3)
/* Share of the inverter's voltage that the model of the loss does not describe [1]. */
#define INVERTER_UNMODELLED ((fo_real)0.05)
/* Additional share of the difference between the two signs, which is largest within the knee
 * [1]. */
#define KNEE_UNMODELLED ((fo_real)0.3)
/* Parameter-to-EMF ratio above which another angle explains the data equally well [1]. At twice
 * this ratio, which is four stds, the EMF could have the opposite direction. */
#define EMF_RATIO_LIMIT ((fo_real)0.5)

/* Owners of the mail. */
enum { FO_MAIL_FREE, FO_MAIL_WITH_LEARNER, FO_MAIL_ANSWERED };

/* The map at the end of a block. */
static inline const fo_map_point *map_of(const fo_block_end *end)
{
#if FO_MAPPED
    return &end->map_point;
#else
    (void)end;
    return NULL;
#endif
}

/* Sums over a block of w, of w h and of w t h, for the weights w = 1, h_0, h_1. */
static inline fo_real sum_of_weight(const fo_sums *sums, int w)
{
    return w == 0 ? (fo_real)sums->samples : sums->h[w - 1];
}

static inline const fo_real *sums_of_h(const fo_sums *sums, int w)
{
    return w == 0 ? sums->h : &sums->hh[w - 1];
}

static inline const fo_real *sums_of_th(const fo_sums *sums, int w)
{
    return w == 0 ? sums->th : &sums->thh[w - 1];
}

/* Resets the parameters to their prior. */
void fo_learning_reset(const fo_adaptive *observer, fo_learner *learner);

/* Starts the filter at a candidate, with the covariance of its Gauss-Newton fit times `inflation`.
 * The parameters keep their estimates. */
void fo_learning_start(const fo_adaptive *observer, fo_learner *learner,
                       const fo_candidate *candidate, const fo_manifold *information,
                       fo_real inflation, const fo_block_end *end);

/* Estimated errors of the parameters [their units]. */
void fo_learning_values(const fo_adaptive *observer, const fo_learner *learner,
                        fo_real value[FO_NP]);

/* Standard deviation of the sum of `count` parameters from n on [their unit]. */
fo_real fo_learning_std(const fo_adaptive *observer, const fo_learner *learner, int n, int count);

/* Updates the std of the voltage at this current due to errors of the parameters. */
void fo_learning_update_voltage_std(const fo_adaptive *observer, fo_learner *learner,
                                    const fo_block_end *end);

/* Adds process noise of this std, in prior stds, to the resistance, which may have changed with the
 * temperature. */
void fo_learning_widen_resistance(const fo_adaptive *observer, fo_learner *learner, fo_real stds);

/* Prior means that may change with a new configuration: magnet flux, resistance [Ohm], half the
 * inverter's loss [V]. */
enum { FO_PRIOR_MEANS = 3 };
void fo_learning_prior_means(const fo_adaptive *observer, fo_real means[FO_PRIOR_MEANS]);

/* Makes errors of parameters that are relative to the prior means `before` relative to `now`. */
void fo_learning_shift_values(const fo_real before[FO_PRIOR_MEANS],
                              const fo_real now[FO_PRIOR_MEANS], fo_real value[FO_NP]);

/* Keeps the estimates if the prior means have changed: the estimated errors change by the opposite
 * amount. Adds the changes of the filter's flux and drift. */
void fo_learning_move_prior_means(const fo_adaptive *observer, fo_learner *learner,
                                  fo_real flux[FO_N], fo_real drift[FO_N]);

#endif
