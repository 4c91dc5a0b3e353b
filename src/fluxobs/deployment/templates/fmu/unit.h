/* An instance of the unit: observer, inputs and estimate. Both versions of FMI share it.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef UNIT_H
#define UNIT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "@prefix@_observer.h"

#ifdef _WIN32
#define UNIT_EXPORT __declspec(dllexport)
#else
#define UNIT_EXPORT __attribute__((visibility("default")))
#endif

/* Value references: 0 is time, then the inputs, then the outputs. */
enum { UNIT_INPUTS = 4, UNIT_OUTPUTS = @outputs@, UNIT_FIRST = 1 + UNIT_INPUTS };

/* Phase of an instance; a reset leads to UNIT_NEW. */
typedef enum { UNIT_NEW = 0, UNIT_INITIALISING, UNIT_STEPPING, UNIT_ENDED } unit_phase;

/* All data that change; they are copied to save, restore and serialise. */
typedef struct {
    double time; /* of the next step */
    uint32_t phase; /* a unit_phase */
    fo_real input[UNIT_INPUTS]; /* u_alpha, u_beta, i_alpha, i_beta */
    @fo@_state state;
    @fo@_estimate estimate;
} unit_data;

typedef void (*unit_log)(void *unit, bool failed, const char *message);

typedef struct {
    unit_data data;
    unit_log log;
    void *environment;
    void *callback;
    char name[64];
} unit;

unit *unit_new(const char *name, const char *token, unit_log log, void *environment, void *callback);
void unit_free(unit *u);
void unit_reset(unit *u);

/* Moves from the phase `from` to `to`; in any other phase, returns false and logs a message for
 * `call`. */
bool unit_move(unit *u, unit_phase from, unit_phase to, const char *call);

/* Moves a new instance to the phase `to`; its first step begins at `start`. */
bool unit_begin(unit *u, unit_phase to, double start, const char *call);

/* Processes the inputs at `time`. The estimate belongs to that instant and is read a step later. */
bool unit_step(unit *u, double time, double step);

/* Get or set values by reference; for an unknown reference, return false and log a message. */
bool unit_get(unit *u, uint32_t reference, double *value);
bool unit_get_all(unit *u, const uint32_t references[], size_t count, double values[]);
bool unit_set_all(unit *u, const uint32_t references[], size_t count, const double values[]);

/* Copies of unit_data, with a checksum that only this machine has. unit_save and unit_unpack allocate
 * memory if *saved is NULL. */
enum { UNIT_SAVED = (int)sizeof(unit_data) + 8 };
bool unit_save(const unit *u, void **saved);
bool unit_unpack(const void *bytes, size_t size, void **saved);
bool unit_pack(const void *saved, void *bytes, size_t size);
bool unit_restore(unit *u, const void *saved);
void unit_forget(void **saved);

#endif
