/* The number type of all sources. FO_SINGLE, defined for all of them or for none, chooses single
 * precision. Each precision has its own function names, so that a mixture does not link.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_REAL_H
#define FLUXOBS_REAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef FO_SINGLE
typedef float fo_real;
#define fo_init fo_init_single
#define fo_use_map fo_use_map_single
#define fo_reset fo_reset_single
#define fo_step fo_step_single
#define fo_step_volt_seconds fo_step_volt_seconds_single
#define fo_gather fo_gather_single
#define fo_map_at fo_map_at_single
#define fo_map_good fo_map_good_single
#define fo_direction fo_direction_single
#else
typedef double fo_real;
#endif

#endif
