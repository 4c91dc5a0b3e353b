/* The observer as a WebAssembly module without imports. An instance of the module is one observer.
 *
 * SPDX-License-Identifier: MIT
 */
#include "@prefix@_observer.h"

#define EXPORT(name) __attribute__((export_name(#name)))

enum { INPUTS = 4, OUTPUTS = @outputs@ };

static double input[INPUTS]; /* u_alpha, u_beta, i_alpha, i_beta */
static double output[OUTPUTS];
static @fo@_state state;
static @fo@_estimate estimate;

EXPORT(inputs) double *inputs(void) { return input; }
EXPORT(outputs) double *outputs(void) { return output; }
/* Identifies the machine, because a state of another machine may have the same size. */
EXPORT(content) const char *content(void) { return "@content@"; }
EXPORT(content_size) int content_size(void) { return (int)sizeof "@content@" - 1; }

EXPORT(state) void *state_bytes(void) { return &state; }
EXPORT(state_size) int state_size(void) { return (int)sizeof state; }
EXPORT(reset) void reset(void) { @fo@_reset(&@prefix@_observer, &state); }

EXPORT(step) void step(void)
{
    const @fo@_estimate *e = &estimate;
    @fo@_step(&@prefix@_observer, &state, &input[0], &input[2], &estimate);
    const double values[OUTPUTS] = {
@values@
    };
    for (int k = 0; k < OUTPUTS; k++) {
        output[k] = values[k];
    }
}
