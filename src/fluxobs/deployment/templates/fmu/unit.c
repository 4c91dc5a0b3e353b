/* SPDX-License-Identifier: MIT */
#include "unit.h"

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
    u->data.estimate@position@.theta_e_std = (fo_real)1.8137993642342178; /* nothing is known */
}

bool unit_step(unit *u, double time, double step)
{
    const double due = (double)@prefix@_observer@plain@.sample_time;
    const bool good = fabs(step - due) <= 1e-6 * due;
    if (good) {
        @fo@_step(&@prefix@_observer, &u->data.state, &u->data.input[0], &u->data.input[2],
                  &u->data.estimate);
        u->data.time = time + step;
    } else {
        char message[128];
        (void)snprintf(message, sizeof message,
                       "communication step size %g s: this observer steps every @step_time@ s", step);
        u->log(u, true, message);
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

/* FNV-1a, 64 bit. */
static uint64_t checksum(const unsigned char *bytes, size_t count)
{
    uint64_t sum = 0xCBF29CE484222325U;
    for (size_t k = 0; k < count; k++) {
        sum = (sum ^ bytes[k]) * 0x100000001B3U;
    }
    return sum;
}

/* Memory for a saved state, if there is none yet. */
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
        const uint64_t sum = checksum(bytes, sizeof u->data);
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
    const bool good = sum == checksum(bytes, sizeof u->data);
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
