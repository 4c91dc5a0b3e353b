/* Functions called from Rust. An estimate is passed as numbers in the order of its fields, a state
 * as bytes.
 *
 * SPDX-License-Identifier: MIT
 */
#include "fluxobs_seed.h"
#include "@prefix@_observer.h"

enum { OUTPUTS = @outputs@, STATE_BYTES = @state_bytes@ };

/* This line does not compile if the state in lib.rs is too small. */
typedef char state_fits[sizeof(@fo@_state) <= (size_t)STATE_BYTES ? 1 : -1];

void fluxobs_@prefix@_reset(@fo@_state *state);
void fluxobs_@prefix@_seed(@fo@_state *state, const fo_real seed[5], const fo_real current[2]);
void fluxobs_@prefix@_step(@fo@_state *state, const fo_real voltage[2], const fo_real current[2],
                           fo_real out[OUTPUTS]);

void fluxobs_@prefix@_reset(@fo@_state *state) { @fo@_reset(&@prefix@_observer, state); }

void fluxobs_@prefix@_seed(@fo@_state *state, const fo_real seed[5], const fo_real current[2])
{
    const fo_seed at = {seed[0], seed[1], seed[2], seed[3], seed[4], 0};
    @fo@_seed_state(&@prefix@_observer, state, &at, current);
}

void fluxobs_@prefix@_step(@fo@_state *state, const fo_real voltage[2], const fo_real current[2],
                           fo_real out[OUTPUTS])
{
    @fo@_estimate estimate;
    const @fo@_estimate *e = &estimate;
    @fo@_step(&@prefix@_observer, state, voltage, current, &estimate);
    const fo_real values[OUTPUTS] = {
@values@
    };
    for (int k = 0; k < OUTPUTS; k++) {
        out[k] = values[k];
    }
}
