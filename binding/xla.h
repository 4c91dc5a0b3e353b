/* The observers as custom calls of XLA, for simulations in JAX: a compiled simulation calls the
 * firmware's C in its loop, in batches. The handlers are part of the compiled modules; they
 * neither include nor link jaxlib. xla.cpp declares only the part of the interface that the
 * handlers use. */
#ifndef FLUXOBS_XLA_H
#define FLUXOBS_XLA_H

/* XLA_FFI_Handler functions for jax.ffi.register_ffi_target.
 * Arguments: parameters (..., bytes) uint8, state (..., bytes) uint8, voltage (..., 2) and current
 * (..., 2) float64.
 * Results: state, and the columns of the estimate and `valid` (..., columns + 1) float64.
 * Leading dimensions of 1 broadcast. */
extern "C" void *xla_step(void *frame);
extern "C" void *xla_adaptive_step(void *frame);

#endif
