/* Inputs of the observer as frames for `fluxobs live` and the fluxobs page, which run the same
 * observer as the firmware, plot its estimates and record its inputs. */
#ifndef TELEMETRY_H
#define TELEMETRY_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Largest length of a frame [bytes]. */
#define TELEMETRY_MOST 64

/* Both functions write a frame and return its length. `number` counts all samples from 0, also
 * samples that are not sent: a jump tells the reader how many samples are missing. */

/* Names of the columns: send this frame first, and again about every thousand samples. */
unsigned telemetry_names(unsigned char out[TELEMETRY_MOST], uint32_t number);

/* One sample, 24 bytes: call it in the interrupt with the arguments of the observer. */
unsigned telemetry_sample(unsigned char out[TELEMETRY_MOST], uint32_t number,
                          const float voltage[2], const float current[2]);

#ifdef __cplusplus
}
#endif
#endif
