/* SPDX-License-Identifier: MIT */
#include "unit.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char TOKEN[] = "@token@";

unit *unit_new(const char *name, const char *token, unit_log log, void *environment, void *callback)
{
    unit *u = token != NULL && strcmp(token, TOKEN) == 0 ? calloc(1, sizeof *u) : NULL;
    if (u != NULL) {
        u->log = log;
        u->environment = environment;
        u->callback = callback;
        (void)snprintf(u->name, sizeof u->name, "%s", name != NULL ? name : "");
        unit_reset(u);
    }
    return u;
}

void unit_free(unit *u) { free(u); }

void unit_reset(unit *u)
{
    (void)memset(&u->data, 0, sizeof u->data);
    @fo@_reset(&@prefix@_observer, &u->data.state);
    u->data.estimate@position@.theta_e_std = (fo_real)1.8137993642342178; /* angle unknown: pi / sqrt(3) */
}

/* Whether the instance is in a phase; if it is not, logs a message for `call`. */
static bool is_in(unit *u, unit_phase phase, const char *call)
{
    static const char *const NEEDS[] = {
        "an instance that is new or reset", "initialization mode",
        "an instance that is initialized and not terminated", "an instance that is terminated"};
    const bool good = u->data.phase == (uint32_t)phase;
    if (!good) {
        char message[128];
        (void)snprintf(message, sizeof message, "%s needs %s", call, NEEDS[phase]);
        u->log(u, true, message);
    }
    return good;
}

bool unit_move(unit *u, unit_phase from, unit_phase to, const char *call)
{
    const bool good = is_in(u, from, call);
    if (good) {
        u->data.phase = (uint32_t)to;
    }
    return good;
}

bool unit_begin(unit *u, unit_phase to, double start, const char *call)
{
    const bool good = unit_move(u, UNIT_NEW, to, call);
    if (good) {
        u->data.time = start;
    }
    return good;
}

/* Whether a step is as long as the observer's step and begins where the last step ended. Times may
 * be multiples or sums of steps, hence the tolerance for rounding. */
static bool is_next(unit *u, double time, double step)
{
    const double due = (double)@prefix@_observer@plain@.sample_time;
    const double rounding = 1e-3 * due + 4.0 * DBL_EPSILON * fabs(time);
    const bool long_enough = fabs(step - due) <= 1e-6 * due;
    const bool good = long_enough && fabs(time - u->data.time) <= rounding;
    char message[160];
    if (!long_enough) {
        (void)snprintf(message, sizeof message,
                       "communication step size %g s: this observer steps every @step_time@ s", step);
        u->log(u, true, message);
    } else if (!good) {
        (void)snprintf(message, sizeof message,
                       "communication point %.15g s: the next step begins at %.15g s; none may be "
                       "left out or repeated", time, u->data.time);
        u->log(u, true, message);
    }
    return good;
}

bool unit_step(unit *u, double time, double step)
{
    const bool good = is_in(u, UNIT_STEPPING, "a step") && is_next(u, time, step);
    if (good) {
        @fo@_step(&@prefix@_observer, &u->data.state, &u->data.input[0], &u->data.input[2],
                  &u->data.estimate);
        u->data.time = time + step;
    }
    return good;
}

bool unit_get(unit *u, uint32_t reference, double *value)
{
    const @fo@_estimate *e = &u->data.estimate;
    const double outputs[UNIT_OUTPUTS] = {
@values@
    };
    const bool good = reference < (uint32_t)UNIT_FIRST + (uint32_t)UNIT_OUTPUTS;
    if (reference == 0U) {
        *value = u->data.time;
    } else if (reference < (uint32_t)UNIT_FIRST) {
        *value = (double)u->data.input[reference - 1U];
    } else if (good) {
        *value = outputs[reference - (uint32_t)UNIT_FIRST];
    } else {
        u->log(u, true, "there is no variable with this value reference");
    }
    return good;
}

static bool set(unit *u, uint32_t reference, double value)
{
    const bool good = reference > 0U && reference < (uint32_t)UNIT_FIRST;
    if (good) {
        u->data.input[reference - 1U] = (fo_real)value;
    } else {
        u->log(u, true, "this variable is no input");
    }
    return good;
}

bool unit_get_all(unit *u, const uint32_t references[], size_t count, double values[])
{
    bool good = true;
    for (size_t k = 0; good && k < count; k++) {
        good = unit_get(u, references[k], &values[k]);
    }
    return good;
}

bool unit_set_all(unit *u, const uint32_t references[], size_t count, const double values[])
{
    bool good = true;
    for (size_t k = 0; good && k < count; k++) {
        good = set(u, references[k], values[k]);
    }
    return good;
}

/* FNV-1a, 64 bit, continued from an earlier sum. */
static uint64_t hashed(uint64_t sum, const void *of, size_t count)
{
    const unsigned char *bytes = of;
    for (size_t k = 0; k < count; k++) {
        sum = (sum ^ bytes[k]) * 0x100000001B3U;
    }
    return sum;
}

/* The checksum includes the token, since a state of another machine may have the same size. */
static uint64_t checksum(const void *data)
{
    return hashed(hashed(0xCBF29CE484222325U, TOKEN, sizeof TOKEN), data, sizeof(unit_data));
}

/* Allocates memory for a saved state if *saved is NULL. */
static bool has_memory(void **saved)
{
    *saved = *saved != NULL ? *saved : malloc((size_t)UNIT_SAVED);
    return *saved != NULL;
}

bool unit_save(const unit *u, void **saved)
{
    const bool good = has_memory(saved);
    if (good) {
        unsigned char *bytes = *saved;
        (void)memcpy(bytes, &u->data, sizeof u->data);
        const uint64_t sum = checksum(bytes);
        (void)memcpy(&bytes[sizeof u->data], &sum, sizeof sum);
    }
    return good;
}

bool unit_unpack(const void *bytes, size_t size, void **saved)
{
    const bool good = has_memory(saved) && size == (size_t)UNIT_SAVED;
    if (good) {
        (void)memcpy(*saved, bytes, size);
    }
    return good;
}

bool unit_pack(const void *saved, void *bytes, size_t size)
{
    const bool good = saved != NULL && size >= (size_t)UNIT_SAVED;
    if (good) {
        (void)memcpy(bytes, saved, (size_t)UNIT_SAVED);
    }
    return good;
}

bool unit_restore(unit *u, const void *saved)
{
    const unsigned char *bytes = saved;
    uint64_t sum = 0;
    if (saved == NULL) {
        return false;
    }
    (void)memcpy(&sum, &bytes[sizeof u->data], sizeof sum);
    const bool good = sum == checksum(bytes);
    if (good) {
        (void)memcpy(&u->data, bytes, sizeof u->data);
    } else {
        u->log(u, true, "the state to restore is not one that this unit has saved");
    }
    return good;
}

void unit_forget(void **saved)
{
    free(*saved);
    *saved = NULL;
}
