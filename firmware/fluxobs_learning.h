/* The adaptive observer's filter and its parameters, in one information factor; not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_LEARNING_H
#define FLUXOBS_LEARNING_H

#include "fluxobs_candidates.h"

#define fo_learning_reset FO_NAME(fo_learning_reset)
#define fo_learning_start FO_NAME(fo_learning_start)
#define fo_learning_step FO_NAME(fo_learning_step)
#define fo_learning_variance_growth FO_NAME(fo_learning_variance_growth)
#define fo_learning_update_emf_ratio FO_NAME(fo_learning_update_emf_ratio)
#define fo_learning_unmodelled_voltage FO_NAME(fo_learning_unmodelled_voltage)
#define fo_learning_value FO_NAME(fo_learning_value)
#define fo_learning_std FO_NAME(fo_learning_std)
#define fo_learning_widen_resistance FO_NAME(fo_learning_widen_resistance)
#define fo_learning_prior_means FO_NAME(fo_learning_prior_means)
#define fo_learning_move_prior_means FO_NAME(fo_learning_move_prior_means)

/* Parameter-to-EMF ratio above which another angle explains the data equally well [1]. At twice
 * this ratio, which is four stds, the EMF could have the opposite direction. */
#define EMF_RATIO_LIMIT ((fo_real)0.5)

/* One interval, per-unit: its volt-seconds, corrected by the parameters, and the change of the
 * volt-seconds with one prior std of each parameter. */
typedef struct {
    fo_real v[FO_N];
    fo_real sensitivity[FO_NP][FO_N];
} fo_interval;

/* Resets the parameters to their prior. */
void fo_learning_reset(const fo_adaptive *observer, fo_adaptive_state *state);

/* Starts the filter at a candidate, with the covariance of its Gauss-Newton fit times `inflation`.
 * `interval` is the last interval. The parameters keep their estimates. */
void fo_learning_start(const fo_adaptive *observer, fo_adaptive_state *state,
                       const fo_candidate *candidate, const fo_manifold *information,
                       fo_real inflation, const fo_interval *interval);

/* Steps the filter over an interval. If the interval ends a block, updates the filter by the
 * block's row. Returns the length of the position vector, or 0 if the state has become
 * implausible. */
fo_real fo_learning_step(const fo_adaptive *observer, fo_adaptive_state *state,
                         const fo_interval *interval, bool measured);

/* Variance of the flux that the parameters may have added after the computation of
 * variance_across. */
fo_real fo_learning_variance_growth(const fo_adaptive *a, const fo_adaptive_state *state);

/* Updates the parameter-to-EMF ratio: the angle by which parameter errors may have turned the flux.
 * The ratio accumulates until the rotor has turned by a radian. */
void fo_learning_update_emf_ratio(const fo_adaptive *observer, fo_adaptive_state *state,
                                  const fo_interval *interval, fo_real length, fo_real turned);

/* Voltage of the inverter that the model does not describe, per-unit. */
fo_real fo_learning_unmodelled_voltage(const fo_adaptive *observer, const fo_adaptive_state *state);

/* Estimate of a parameter [its unit]. */
fo_real fo_learning_value(const fo_adaptive *observer, const fo_adaptive_state *state, int n);

/* Standard deviation of the sum of `count` parameters from n on, plus `curve` times the inverter's
 * curve [their unit]. */
fo_real fo_learning_std(const fo_adaptive *observer, const fo_adaptive_state *state, int n,
                        int count, fo_real curve);

/* Adds process noise of this std, in prior stds, to the resistance, which may have changed with the
 * temperature. */
void fo_learning_widen_resistance(const fo_adaptive *observer, fo_adaptive_state *state,
                                  fo_real stds);

/* Prior means that may change with a new configuration: magnet flux, resistance [Ohm], half the
 * inverter's loss [V]. */
enum { FO_PRIOR_MEANS = 3 };
void fo_learning_prior_means(const fo_adaptive *observer, fo_real means[FO_PRIOR_MEANS]);

/* Keeps the estimates if the prior means have changed: the estimated errors change by the opposite
 * amount. */
void fo_learning_move_prior_means(const fo_adaptive *observer, fo_adaptive_state *state,
                                  const fo_real before[FO_PRIOR_MEANS]);

#endif
