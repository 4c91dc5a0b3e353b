/* The functions of FMI 3.0 for co-simulation (https://fmi-standard.org, version 3.0, section 2 and
 * 4).
 *
 * SPDX-License-Identifier: MIT
 */
#include <string.h>

#include "unit.h"

typedef enum { OK = 0, WARNING, DISCARD, ERROR, FATAL } status;
typedef uint32_t reference;
typedef void (*log_message)(void *environment, status of, const char *category, const char *message);

static void tell(void *of, bool failed, const char *message)
{
    const unit *u = of;
    log_message callback;
    (void)memcpy(&callback, &u->callback, sizeof callback);
    if (callback != NULL) {
        callback(u->environment, failed ? ERROR : OK, failed ? "logStatusError" : "logAll", message);
    }
}

UNIT_EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

UNIT_EXPORT status fmi3SetDebugLogging(void *u, bool on, size_t count, const char *const names[])
{
    (void)u, (void)on, (void)count, (void)names;
    return OK;
}

UNIT_EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token,
                                              const char *resources, bool visible, bool logging,
                                              bool events, bool early, const reference needed[],
                                              size_t count, void *environment, log_message callback,
                                              void (*update)(void))
{
    void *kept;
    (void)resources, (void)visible, (void)logging, (void)events, (void)early;
    (void)needed, (void)count, (void)update;
    (void)memcpy(&kept, &callback, sizeof kept);
    unit *u = unit_new(name, token, tell, environment, kept);
    if (u == NULL && callback != NULL) {
        callback(environment, ERROR, "logStatusError",
                 "no memory, or the instantiation token is that of another unit");
    }
    return u;
}

UNIT_EXPORT void *fmi3InstantiateModelExchange(void) { return NULL; }
UNIT_EXPORT void *fmi3InstantiateScheduledExecution(void) { return NULL; }
UNIT_EXPORT void fmi3FreeInstance(void *u) { unit_free(u); }

UNIT_EXPORT status fmi3EnterInitializationMode(unit *u, bool tolerance, double size, double start,
                                               bool stops, double stop)
{
    (void)tolerance, (void)size, (void)stops, (void)stop;
    return unit_begin(u, UNIT_INITIALISING, start, "fmi3EnterInitializationMode") ? OK : ERROR;
}

UNIT_EXPORT status fmi3ExitInitializationMode(unit *u)
{
    return unit_move(u, UNIT_INITIALISING, UNIT_STEPPING, "fmi3ExitInitializationMode") ? OK : ERROR;
}

UNIT_EXPORT status fmi3Terminate(unit *u)
{
    return unit_move(u, UNIT_STEPPING, UNIT_ENDED, "fmi3Terminate") ? OK : ERROR;
}

UNIT_EXPORT status fmi3EnterStepMode(void *u) { return (void)u, OK; }

UNIT_EXPORT status fmi3Reset(unit *u)
{
    unit_reset(u);
    return OK;
}

UNIT_EXPORT status fmi3GetFloat64(unit *u, const reference of[], size_t count, double values[],
                                  size_t size)
{
    return size == count && unit_get_all(u, of, count, values) ? OK : ERROR;
}

UNIT_EXPORT status fmi3SetFloat64(unit *u, const reference of[], size_t count,
                                  const double values[], size_t size)
{
    return size == count && unit_set_all(u, of, count, values) ? OK : ERROR;
}

UNIT_EXPORT status fmi3GetBoolean(unit *u, const reference of[], size_t count, bool values[],
                                  size_t size)
{
    bool good = size == count;
    for (size_t k = 0; good && k < count; k++) {
        double value = 0.0;
        good = unit_get(u, of[k], &value);
        values[k] = value > 0.5;
    }
    return good ? OK : ERROR;
}

UNIT_EXPORT status fmi3DoStep(unit *u, double time, double step, bool kept, bool *event, bool *ends,
                              bool *early, double *reached)
{
    const bool good = unit_step(u, time, step);
    (void)kept;
    *event = *ends = *early = false;
    *reached = good ? time + step : time;
    return good ? OK : ERROR;
}

UNIT_EXPORT status fmi3GetFMUState(const unit *u, void **saved)
{
    return unit_save(u, saved) ? OK : ERROR;
}

UNIT_EXPORT status fmi3SetFMUState(unit *u, const void *saved)
{
    return unit_restore(u, saved) ? OK : ERROR;
}

UNIT_EXPORT status fmi3FreeFMUState(void *u, void **saved)
{
    (void)u;
    unit_forget(saved);
    return OK;
}

UNIT_EXPORT status fmi3SerializedFMUStateSize(void *u, const void *saved, size_t *size)
{
    (void)u, (void)saved;
    *size = (size_t)UNIT_SAVED;
    return OK;
}

UNIT_EXPORT status fmi3SerializeFMUState(void *u, const void *saved, unsigned char bytes[], size_t size)
{
    (void)u;
    return unit_pack(saved, bytes, size) ? OK : ERROR;
}

UNIT_EXPORT status fmi3DeserializeFMUState(void *u, const unsigned char bytes[], size_t size, void **saved)
{
    (void)u;
    return unit_unpack(bytes, size, saved) ? OK : ERROR;
}

/* Functions of the standard that this unit does not support; they ignore their arguments. */
#define NONE(name) \
    UNIT_EXPORT status fmi3##name(void) { return ERROR; }

NONE(EnterEventMode) NONE(EnterConfigurationMode) NONE(ExitConfigurationMode)
NONE(GetFloat32) NONE(GetInt8) NONE(GetUInt8) NONE(GetInt16) NONE(GetUInt16) NONE(GetInt32)
NONE(GetUInt32) NONE(GetInt64) NONE(GetUInt64) NONE(GetString) NONE(GetBinary) NONE(GetClock)
NONE(SetFloat32) NONE(SetInt8) NONE(SetUInt8) NONE(SetInt16) NONE(SetUInt16) NONE(SetInt32)
NONE(SetUInt32) NONE(SetInt64) NONE(SetUInt64) NONE(SetBoolean) NONE(SetString) NONE(SetBinary)
NONE(SetClock) NONE(GetNumberOfVariableDependencies) NONE(GetVariableDependencies)
NONE(GetDirectionalDerivative) NONE(GetAdjointDerivative) NONE(GetIntervalDecimal)
NONE(GetIntervalFraction) NONE(GetShiftDecimal) NONE(GetShiftFraction) NONE(SetIntervalDecimal)
NONE(SetIntervalFraction) NONE(SetShiftDecimal) NONE(SetShiftFraction) NONE(EvaluateDiscreteStates)
NONE(UpdateDiscreteStates) NONE(EnterContinuousTimeMode) NONE(CompletedIntegratorStep) NONE(SetTime)
NONE(SetContinuousStates) NONE(GetContinuousStateDerivatives) NONE(GetEventIndicators)
NONE(GetContinuousStates) NONE(GetNominalsOfContinuousStates) NONE(GetNumberOfEventIndicators)
NONE(GetNumberOfContinuousStates) NONE(GetOutputDerivatives) NONE(ActivateModelPartition)
