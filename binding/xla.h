/* The observers as custom calls of XLA, for simulations in JAX: the C of the firmware in the loop
 * of a compiled simulation, in batches. The handlers are part of the compiled modules; they neither
 * include nor link jaxlib. Only the part of the interface that they use is declared in xla.cpp. */
#ifndef FLUXOBS_XLA_H
#define FLUXOBS_XLA_H

/* XLA_FFI_Handler functions for jax.ffi.register_ffi_target. Arguments: parameters (..., bytes)
 * uint8, state (..., bytes) uint8, voltage (..., 2) and current (..., 2) float64. Results: state,
 * and the columns of the estimate and `valid` (..., columns + 1) float64. Leading dimensions of 1
 * broadcast. */
extern "C" void *xla_step(void *frame);
extern "C" void *xla_adaptive_step(void *frame);

#endif
