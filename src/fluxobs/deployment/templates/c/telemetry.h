/* What the observer gets, as frames for `fluxobs live` and the fluxobs page: they run the same
 * observer beside the firmware's, draw it and record it. */
#ifndef TELEMETRY_H
#define TELEMETRY_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Bytes that a frame has at most. */
#define TELEMETRY_MOST 64

/* Both write a frame and return its length. `number` counts the samples from 0, those that are not
 * sent included: where it jumps, the reader knows how many are missing. */

/* Names of the columns: send it first, and again every thousand samples or so. */
unsigned telemetry_names(unsigned char out[TELEMETRY_MOST], uint32_t number);

/* A sample, 24 bytes: in the interrupt, with the arguments of the observer. */
unsigned telemetry_sample(unsigned char out[TELEMETRY_MOST], uint32_t number,
                          const float voltage[2], const float current[2]);

#ifdef __cplusplus
}
#endif
#endif
