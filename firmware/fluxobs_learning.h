/* The adaptive observer's filter and its parameters, in one triangle; not for users.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_LEARNING_H
#define FLUXOBS_LEARNING_H

#include "fluxobs_candidates.h"

#define fo_learning_forget FO_NAME(fo_learning_forget)
#define fo_learning_start FO_NAME(fo_learning_start)
#define fo_learning_sample FO_NAME(fo_learning_sample)
#define fo_learning_since FO_NAME(fo_learning_since)
#define fo_learning_doubt FO_NAME(fo_learning_doubt)
#define fo_learning_unmodelled FO_NAME(fo_learning_unmodelled)
#define fo_learning_value FO_NAME(fo_learning_value)
#define fo_learning_deviation FO_NAME(fo_learning_deviation)
#define fo_learning_warm FO_NAME(fo_learning_warm)
#define fo_learning_means FO_NAME(fo_learning_means)
#define fo_learning_rebase FO_NAME(fo_learning_rebase)

/* Share of the EMF that the parameters may be off, above which another angle explains the data as
 * well [1]: twice it, four stds, would turn the EMF round. */
#define DOUBT_LIMIT ((fo_real)0.5)

/* An interval: its volt-seconds, with all that has been learnt, and what one std of each parameter
 * adds to them. Per-unit. */
typedef struct {
    fo_real v[FO_N];
    fo_real effect[FO_NP][FO_N];
} fo_effects;

/* Forgets the parameters: they are their prior. */
void fo_learning_forget(const fo_adaptive *observer, fo_adaptive_state *state);

/* Starts the filter at a candidate, with the covariance of its projection times `inflation`.
 * `effects` are those of the last interval. What was learnt before is kept. */
void fo_learning_start(const fo_adaptive *observer, fo_adaptive_state *state,
                       const fo_candidate *candidate, const fo_manifold *information,
                       fo_real inflation, const fo_effects *effects);

/* Moves the filter over an interval and, where that ends a block, takes in its row. Returns the
 * length of the position vector; 0 if its numbers have run away. */
fo_real fo_learning_sample(const fo_adaptive *observer, fo_adaptive_state *state,
                           const fo_effects *effects, bool measured);

/* Square of the flux by which the parameters may be off since the position's variance was found. */
fo_real fo_learning_since(const fo_adaptive_state *state);

/* Follows what share of the EMF the parameters may be off: the angle by which that may have turned
 * the flux, which adds up until the rotor has turned by a radian. */
void fo_learning_doubt(const fo_adaptive *observer, fo_adaptive_state *state,
                       const fo_effects *effects, fo_real length, fo_real turned);

/* Voltage of the inverter that is in no model, per-unit. */
fo_real fo_learning_unmodelled(const fo_adaptive *observer, const fo_adaptive_state *state);

/* Value of a parameter [its unit]. */
fo_real fo_learning_value(const fo_adaptive *observer, const fo_adaptive_state *state, int n);

/* Standard deviation of the sum of `count` parameters from n on, and of the inverter's curve times
 * `curve` [their unit]. */
fo_real fo_learning_deviation(const fo_adaptive *observer, const fo_adaptive_state *state, int n,
                              int count, fo_real curve);

/* The resistance may have changed since it was learnt, by this std, in stds of its prior. */
void fo_learning_warm(const fo_adaptive *observer, fo_adaptive_state *state, fo_real stds);

/* The assumed values that may be given anew: magnet flux, resistance [Ohm], half the inverter's
 * loss [V]. */
enum { FO_MEANS = 3 };
void fo_learning_means(const fo_adaptive *observer, fo_real means[FO_MEANS]);

/* What was learnt with other assumed values stays true: the errors move the other way. */
void fo_learning_rebase(const fo_adaptive *observer, fo_adaptive_state *state,
                        const fo_real before[FO_MEANS]);

#endif
