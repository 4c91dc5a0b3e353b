/* The functions of FMI 2.0 for co-simulation (https://fmi-standard.org, version 2.0.4, section 2
 * and 4).
 *
 * SPDX-License-Identifier: MIT
 */
#include <string.h>

#include "unit.h"

typedef enum { OK = 0, WARNING, DISCARD, ERROR, FATAL } status;
typedef uint32_t reference;
typedef void (*log_message)(void *environment, const char *name, status of, const char *category,
                            const char *message, ...);
typedef struct {
    log_message log;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, status);
    void *environment;
} callbacks;

static void tell(void *of, bool failed, const char *message)
{
    const unit *u = of;
    log_message callback;
    (void)memcpy(&callback, &u->callback, sizeof callback);
    if (callback != NULL) {
        callback(u->environment, u->name, failed ? ERROR : OK, failed ? "logStatusError" : "logAll",
                 "%s", message);
    }
}

UNIT_EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
UNIT_EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

UNIT_EXPORT status fmi2SetDebugLogging(void *u, int on, size_t count, const char *const names[])
{
    (void)u, (void)on, (void)count, (void)names;
    return OK;
}

UNIT_EXPORT void *fmi2Instantiate(const char *name, int type, const char *token,
                                  const char *resources, const callbacks *functions, int visible,
                                  int logging)
{
    void *kept = NULL;
    (void)resources, (void)visible, (void)logging;
    if (functions != NULL) {
        (void)memcpy(&kept, &functions->log, sizeof kept);
    }
    unit *u = type == 1 ? unit_new(name, token, tell, functions != NULL ? functions->environment : NULL,
                                   kept)
                        : NULL;
    if (u == NULL && functions != NULL && functions->log != NULL) {
        functions->log(functions->environment, name, ERROR, "logStatusError",
                       "no memory, not for co-simulation, or the GUID is that of another unit");
    }
    return u;
}

UNIT_EXPORT void fmi2FreeInstance(void *u) { unit_free(u); }

UNIT_EXPORT status fmi2SetupExperiment(unit *u, int tolerance, double size, double start, int stops,
                                       double stop)
{
    (void)tolerance, (void)size, (void)stops, (void)stop;
    return unit_begin(u, UNIT_NEW, start, "fmi2SetupExperiment") ? OK : ERROR;
}

UNIT_EXPORT status fmi2EnterInitializationMode(unit *u)
{
    return unit_move(u, UNIT_NEW, UNIT_INITIALISING, "fmi2EnterInitializationMode") ? OK : ERROR;
}

UNIT_EXPORT status fmi2ExitInitializationMode(unit *u)
{
    return unit_move(u, UNIT_INITIALISING, UNIT_STEPPING, "fmi2ExitInitializationMode") ? OK : ERROR;
}

UNIT_EXPORT status fmi2Terminate(unit *u)
{
    return unit_move(u, UNIT_STEPPING, UNIT_ENDED, "fmi2Terminate") ? OK : ERROR;
}

UNIT_EXPORT status fmi2Reset(unit *u)
{
    unit_reset(u);
    return OK;
}

UNIT_EXPORT status fmi2GetReal(unit *u, const reference of[], size_t count, double values[])
{
    return unit_get_all(u, of, count, values) ? OK : ERROR;
}

UNIT_EXPORT status fmi2SetReal(unit *u, const reference of[], size_t count, const double values[])
{
    return unit_set_all(u, of, count, values) ? OK : ERROR;
}

UNIT_EXPORT status fmi2GetBoolean(unit *u, const reference of[], size_t count, int values[])
{
    bool good = true;
    for (size_t k = 0; good && k < count; k++) {
        double value = 0.0;
        good = unit_get(u, of[k], &value);
        values[k] = value > 0.5 ? 1 : 0;
    }
    return good ? OK : ERROR;
}

UNIT_EXPORT status fmi2DoStep(unit *u, double time, double step, int kept)
{
    (void)kept;
    return unit_step(u, time, step) ? OK : ERROR;
}

UNIT_EXPORT status fmi2GetFMUstate(const unit *u, void **saved)
{
    return unit_save(u, saved) ? OK : ERROR;
}

UNIT_EXPORT status fmi2SetFMUstate(unit *u, const void *saved)
{
    return unit_restore(u, saved) ? OK : ERROR;
}

UNIT_EXPORT status fmi2FreeFMUstate(void *u, void **saved)
{
    (void)u;
    unit_forget(saved);
    return OK;
}

UNIT_EXPORT status fmi2SerializedFMUstateSize(void *u, const void *saved, size_t *size)
{
    (void)u, (void)saved;
    *size = (size_t)UNIT_SAVED;
    return OK;
}

UNIT_EXPORT status fmi2SerializeFMUstate(void *u, const void *saved, char bytes[], size_t size)
{
    (void)u;
    return unit_pack(saved, bytes, size) ? OK : ERROR;
}

UNIT_EXPORT status fmi2DeSerializeFMUstate(void *u, const char bytes[], size_t size, void **saved)
{
    (void)u;
    return unit_unpack(bytes, size, saved) ? OK : ERROR;
}

/* Functions of the standard that this unit does not support; they ignore their arguments. */
#define NONE(name) \
    UNIT_EXPORT status fmi2##name(void) { return ERROR; }

NONE(GetInteger) NONE(GetString) NONE(SetInteger) NONE(SetBoolean) NONE(SetString)
NONE(GetDirectionalDerivative) NONE(SetRealInputDerivatives) NONE(GetRealOutputDerivatives)
NONE(CancelStep) NONE(GetStatus) NONE(GetRealStatus) NONE(GetIntegerStatus) NONE(GetBooleanStatus)
NONE(GetStringStatus)
