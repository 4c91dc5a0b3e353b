/* fluxobs, changes while the drive runs: resistance, inverter voltage, magnet flux and limits may
 * change. Also an estimate that slower tasks read.
 *
 * A task prepares the changed observer beside the observer in use. Between two steps, the interrupt
 * takes the changed observer. The state is kept.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_RETUNE_H
#define FLUXOBS_RETUNE_H

#include "fluxobs_observers.h"

#ifdef __cplusplus
extern "C" {
#endif

#define fo_retunable FO_NAME(fo_retunable)
#define fo_retunable_init FO_NAME(fo_retunable_init)
#define fo_retune FO_NAME(fo_retune)
#define fo_take FO_NAME(fo_take)
#define fo_snapshot FO_NAME(fo_snapshot)
#define fo_publish FO_NAME(fo_publish)
#define fo_read FO_NAME(fo_read)
#if FO_ASYMMETRIC
#define fo_adaptive_retunable FO_NAME(fo_adaptive_retunable_asymmetric)
#define fo_adaptive_retunable_init FO_NAME(fo_adaptive_retunable_init_asymmetric)
#define fo_adaptive_retune FO_NAME(fo_adaptive_retune_asymmetric)
#define fo_adaptive_take FO_NAME(fo_adaptive_take_asymmetric)
#define fo_adaptive_in_use FO_NAME(fo_adaptive_in_use_asymmetric)
#else
#define fo_adaptive_retunable FO_NAME(fo_adaptive_retunable)
#define fo_adaptive_retunable_init FO_NAME(fo_adaptive_retunable_init)
#define fo_adaptive_retune FO_NAME(fo_adaptive_retune)
#define fo_adaptive_take FO_NAME(fo_adaptive_take)
#define fo_adaptive_in_use FO_NAME(fo_adaptive_in_use)
#endif

/* Keeps the order of memory accesses before and after this barrier, also for other cores. */
#ifndef FO_BARRIER
#if defined(__GNUC__)
#define FO_BARRIER() __atomic_thread_fence(__ATOMIC_SEQ_CST)
#else
#error "define FO_BARRIER for this compiler: a full memory barrier"
#endif
#endif

/* ---- another configuration --------------------------------------------------------------- */

/* The observer in use, and memory for its successor. Treat this struct as opaque. */
typedef struct {
    fo_observer both[2];
    volatile uint32_t active; /* only the interrupt writes it   */
    volatile uint32_t ready;  /* only the task writes it        */
} fo_retunable;

/* Call this before the interrupt runs. `first` may be an export's observer. */
void fo_retunable_init(fo_retunable *retunable, const fo_observer *first);

/* For a task: prepares another configuration. Change a copy of the configuration in use, but keep
 * sample time, memory, Q1, flux_base and constraint_base: they are the units of the state.
 * FO_ERROR_BUSY: the interrupt has not yet taken the last configuration. */
fo_error fo_retune(fo_retunable *retunable, const fo_config *config);

/* For the interrupt, before its step: returns the observer to use from now on. */
const fo_observer *fo_take(fo_retunable *retunable);

#if FO_ADAPTIVE
/* The same functions for the adaptive observer. If a prior mean changes, the estimate stays: its
 * estimated error changes by the opposite amount. What the data have not determined follows the new
 * prior mean. Standard deviations and inductances must not change. psi_f may change, flux_base must
 * not. */
typedef struct {
    fo_adaptive both[2];
    volatile uint32_t active;
    volatile uint32_t ready;
} fo_adaptive_retunable;

void fo_adaptive_retunable_init(fo_adaptive_retunable *retunable, const fo_adaptive *first);
fo_error fo_adaptive_retune(fo_adaptive_retunable *retunable, const fo_config *config,
                            const fo_adaptive_config *adaptive);
const fo_adaptive *fo_adaptive_take(fo_adaptive_retunable *retunable, fo_adaptive_state *state);

/* For the task that calls fo_adaptive_learn, in which also fo_adaptive_retune must be called: the
 * observer in use. */
const fo_adaptive *fo_adaptive_in_use(const fo_adaptive_retunable *retunable);
#endif

/* ---- an estimate for slower tasks -------------------------------------------------------- */

/* An estimate that the interrupt writes and tasks read. Set this struct to zero before use. */
typedef struct {
    fo_estimate estimate;
    volatile uint32_t begun, ended; /* how often it has been written */
} fo_snapshot;

/* For the interrupt: call this after its step. */
void fo_publish(fo_snapshot *snapshot, const fo_estimate *estimate);

/* For a task: copies the whole last estimate. Returns false if no estimate exists yet, or if
 * interrupts disturbed four reads. */
bool fo_read(const fo_snapshot *snapshot, fo_estimate *estimate);

#ifdef __cplusplus
}
#endif

#endif
