/* Compile-time choices for all sources: the number type, and features that a machine may not need.
 * The names of functions and types depend on the choices, so that a mixture does not link.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef FLUXOBS_REAL_H
#define FLUXOBS_REAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* 1: single precision; 0: double. An export sets 1; -DFO_SINGLE=0 for all files overrides it. */
#ifndef FO_SINGLE
#define FO_SINGLE 0
#endif

/* 0 leaves out flux maps, which saves memory and time. An export sets 0 for a machine without a
 * map. */
#ifndef FO_MAPPED
#define FO_MAPPED 1
#endif

/* 0 leaves out the asymmetry of the phases, which saves memory and time. The numbers are the same
 * as with asymmetry_std = 0. An export sets 0 where the asymmetry is not an unknown. */
#ifndef FO_ASYMMETRIC
#define FO_ASYMMETRIC 1
#endif

/* 1 assumes that the machine's matrices are multiples of the identity, and that its relation has no
 * linear terms. This saves time; the numbers are the same. An export sets 1 for every machine of
 * this kind. */
#ifndef FO_ISOTROPIC
#define FO_ISOTROPIC 0
#endif

/* 0 leaves out voltages that are held over a sample, which saves time. The numbers are the same as
 * with kink_now = 0. An export sets 0 where kink_now is 0. */
#ifndef FO_HELD
#define FO_HELD 1
#endif

/* 0 if only the plain observer is used: configuration, seeds and storage then do not support the
 * adaptive observer. */
#ifndef FO_ADAPTIVE
#define FO_ADAPTIVE 1
#endif

#if FO_SINGLE
typedef float fo_real;
#else
typedef double fo_real;
#endif

#if FO_SINGLE && FO_MAPPED
#define FO_NAME(name) name##_single_mapped
#elif FO_SINGLE
#define FO_NAME(name) name##_single
#elif FO_MAPPED
#define FO_NAME(name) name##_mapped
#else
#define FO_NAME(name) name
#endif

#define fo_config FO_NAME(fo_config)
#define fo_observer FO_NAME(fo_observer)
#define fo_information FO_NAME(fo_information)
#define fo_tracker FO_NAME(fo_tracker)
#define fo_map_point FO_NAME(fo_map_point)
#define fo_state FO_NAME(fo_state)
#define fo_estimate FO_NAME(fo_estimate)
#define fo_gathered FO_NAME(fo_gathered)
#define fo_merged FO_NAME(fo_merged)
#define fo_map FO_NAME(fo_map)
#define fo_mapped FO_NAME(fo_mapped)
#define fo_init FO_NAME(fo_init)
#define fo_wrong FO_NAME(fo_wrong)
#define fo_use_map FO_NAME(fo_use_map)
#define fo_reset FO_NAME(fo_reset)
#define fo_step FO_NAME(fo_step)
#define fo_step_volt_seconds FO_NAME(fo_step_volt_seconds)
#define fo_gather FO_NAME(fo_gather)
#define fo_step_for FO_NAME(fo_step_for)
#define fo_map_at FO_NAME(fo_map_at)
#define fo_map_good FO_NAME(fo_map_good)
#define fo_direction FO_NAME(fo_direction)

#endif
