/* fluxobs, seeds: starts at a known angle. The angle may come from Hall sensors, an alignment,
 * high-frequency injection, an encoder before it is switched off, or another observer.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_SEED_H
#define FLUXOBS_SEED_H

#include "fluxobs_observers.h"

#ifdef __cplusplus
extern "C" {
#endif

#define fo_seed FO_NAME(fo_seed)
#define fo_seed_state FO_NAME(fo_seed_state)
#if FO_ASYMMETRIC
#define fo_adaptive_seed_state FO_NAME(fo_adaptive_seed_state_asymmetric)
#else
#define fo_adaptive_seed_state FO_NAME(fo_adaptive_seed_state)
#endif

/* Angle, speed and flux at the present current sample, with standard deviations. */
#define FO_SEED_FIELDS(NUMBER)                                                                    \
    NUMBER(theta_e)     /* in (-pi, pi] [rad]                                                 */ \
    NUMBER(theta_e_std) /* std of theta_e, 0.3 for Hall sensors (sector / sqrt(12)) [rad]     */ \
    NUMBER(speed_e)     /* electrical speed [rad/s]; 0 at rest                                */ \
    NUMBER(psi_f)       /* magnet or active flux; 0: the flux base [Wb]                       */ \
                        /* negative if the position vector points backwards                   */ \
    NUMBER(psi_f_std)   /* std of psi_f; 0: a quarter of psi_f [Wb]                           */ \
    NUMBER(weight_other) /* weight of the angle half a turn away, 0 to 1/2                    */

typedef struct {
    FO_SEED_FIELDS(FO_NUMBER_FIELD)
} fo_seed;

/* Resets the state, and starts it at this angle and current [A]. The angle is integrated with a
 * growing standard deviation until the least squares determines the flux, which is earlier with a
 * seed than without (benchmarks/seeds.py). `valid` needs the same evidence as without a seed, so
 * that a wrong angle is corrected: half a turn of the rotor or, in the adaptive observer, rows of
 * the direction at rest. The latter know no half turn, so with a `weight_other` only the former
 * counts. An unusable seed only resets the state: a seed that is not
 * finite, has no positive standard deviation, an absurd current, or a flux too short for a
 * position. Do not call this function while an interrupt may step the same state. */
void fo_seed_state(const fo_observer *observer, fo_state *state, const fo_seed *seed,
                   const fo_real current[FO_N]);

#if FO_ADAPTIVE
/* Like fo_seed_state, for the adaptive observer. Its filter runs from the first sample if the
 * angle is known to ten degrees and the machine needs no flux map. The parameters keep their
 * estimates. */
void fo_adaptive_seed_state(const fo_adaptive *observer, fo_adaptive_state *state,
                            const fo_seed *seed, const fo_real current[FO_N]);
#endif

#ifdef __cplusplus
}
#endif

#endif
