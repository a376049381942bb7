/* The functions of FMI 2.0 (-DFMI=2) or FMI 3.0 (-DFMI=3) for co-simulation, see fmi_shell.h. */
#include "fmi_shell.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { CREATED, INITIALISING, STEPPING };

#if FMI == 2
typedef void (*log_message)(void *, const char *, int, const char *, const char *, ...);
#else
typedef void (*log_message)(void *, int, const char *, const char *);
#endif

typedef struct {
    unsigned char *block;
    char *name, *resources;
    log_message log;
    void *environment;
    int is_open, state;
} instance;

static int fail(instance *m, int status, const char *text)
{
    if (m->log != NULL) {
#if FMI == 2
        m->log(m->environment, m->name, status, "logStatusError", "%s", text);
#else
        m->log(m->environment, status, "logStatusError", text);
#endif
    }
    return status;
}

static char *copy_of(const char *text)
{
    const size_t n = text != NULL ? strlen(text) + 1 : 1;
    char *copy = calloc(n, 1);
    if (copy != NULL && text != NULL)
        memcpy(copy, text, n);
    return copy;
}

static void release(instance *m)
{
    if (m->is_open)
        model_close(m->block);
    free(m->block);
    free(m->name);
    free(m->resources);
    free(m);
}

static instance *make(const char *name, const char *token, const char *resources, log_message log, void *environment)
{
    instance *m = calloc(1, sizeof *m);
    if (m == NULL)
        return NULL;
    m->log = log;
    m->environment = environment;
    m->name = copy_of(name);
    m->resources = copy_of(resources);
    m->block = calloc(1, fmi_block_bytes);
    if (m->name == NULL || m->resources == NULL || m->block == NULL || token == NULL || strcmp(token, fmi_token) != 0) {
        fail(m, ERROR, token != NULL && strcmp(token, fmi_token) != 0 ? "wrong token" : "no memory");
        release(m);
        return NULL;
    }
    memcpy(m->block, fmi_start_block, fmi_block_bytes);
    return m;
}

static int enter_initialisation(instance *m)
{
    m->state = INITIALISING;
    return OK;
}

static int open_model(instance *m)
{
    char reason[FMI_REASON] = "";
    if (m->is_open)
        return OK;
    if (model_open(m->block, m->resources, reason) != 0)
        return fail(m, ERROR, reason);
    m->is_open = 1;
    return OK;
}

static int leave_initialisation(instance *m)
{
    const int status = open_model(m);
    m->state = STEPPING;
    return status;
}

static int reset(instance *m)
{
    if (m->is_open)
        model_close(m->block);
    m->is_open = 0;
    m->state = CREATED;
    memcpy(m->block, fmi_start_block, fmi_block_bytes);
    return OK;
}

static int step(instance *m, double t_s, double step_s)
{
    char reason[FMI_REASON] = "";
    if (m->state != STEPPING)
        return fail(m, ERROR, "is not initialised");
    if (model_step(m->block, t_s, step_s, reason) != 0)
        return fail(m, ERROR, reason);
    return OK;
}

/* Each function that sets or gets: the elements of all variables, one after the other. */
#define ELEMENTS(set, CTYPE, CONVERT)                                                                                  \
    const CTYPE *const end = values + n_values;                                                                        \
    for (size_t i = 0; i < n; i++) {                                                                                   \
        if (references[i] >= fmi_n_variables)                                                                          \
            return fail(m, ERROR, "no such variable");                                                                 \
        const fmi_variable v = fmi_variables[references[i]];                                                           \
        if (end - values < (ptrdiff_t)v.count || (set && !v.is_set))                                                   \
            return fail(m, ERROR, set ? "cannot be set" : "too few values");                                           \
        for (uint32_t k = 0; k < v.count; k++, values++)                                                               \
            CONVERT                                                                                                    \
    }                                                                                                                  \
    return OK;

#define AT(TYPE) (((TYPE *)(void *)(m->block + v.offset))[k])

static int set_real(instance *m, const uint32_t references[], size_t n, const double values[], size_t n_values)
{
    ELEMENTS(1, double, {
        if (v.type != FMI_F8)
            return fail(m, ERROR, "is no real variable");
        AT(double) = *values;
    })
}

static int get_real(instance *m, const uint32_t references[], size_t n, double values[], size_t n_values)
{
    if (m->state == INITIALISING && open_model(m) != OK)
        return ERROR;
    ELEMENTS(0, double, {
        if (v.type != FMI_F8)
            return fail(m, ERROR, "is no real variable");
        *values = AT(double);
    })
}

#define WHOLE(NAME, CTYPE)                                                                                             \
    static int set_##NAME(instance *m, const uint32_t references[], size_t n, const CTYPE values[], size_t n_values)   \
    {                                                                                                                  \
        ELEMENTS(1, CTYPE, {                                                                                           \
            if (v.type == FMI_I4)                                                                                      \
                AT(int32_t) = (int32_t)*values;                                                                        \
            else if (v.type == FMI_I8)                                                                                 \
                AT(int64_t) = (int64_t)*values;                                                                        \
            else if (v.type == FMI_U1)                                                                                 \
                AT(uint8_t) = (uint8_t)*values;                                                                        \
            else                                                                                                       \
                return fail(m, ERROR, "is no integer variable");                                                       \
        })                                                                                                             \
    }                                                                                                                  \
    static int get_##NAME(instance *m, const uint32_t references[], size_t n, CTYPE values[], size_t n_values)         \
    {                                                                                                                  \
        if (m->state == INITIALISING && open_model(m) != OK)                                                           \
            return ERROR;                                                                                              \
        ELEMENTS(0, CTYPE, {                                                                                           \
            if (v.type == FMI_I4)                                                                                      \
                *values = (CTYPE)AT(int32_t);                                                                          \
            else if (v.type == FMI_I8)                                                                                 \
                *values = (CTYPE)AT(int64_t);                                                                          \
            else if (v.type == FMI_U1)                                                                                 \
                *values = (CTYPE)AT(uint8_t);                                                                          \
            else                                                                                                       \
                return fail(m, ERROR, "is no integer variable");                                                       \
        })                                                                                                             \
    }

WHOLE(i4, int32_t)

/* A function of the standard that this FMU has no use for. */
#define ABSENT(NAME)                                                                                                   \
    EXPORT int NAME(void *m)                                                                                           \
    {                                                                                                                  \
        return fail(m, ERROR, #NAME " is not supported");                                                              \
    }

#if FMI == 2

typedef struct {
    log_message log;
    void *allocate, *free, *step_finished, *environment;
} callbacks;

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT void *fmi2Instantiate(const char *name, int type, const char *token, const char *resources, const callbacks *c,
                             int visible, int logging)
{
    (void)visible, (void)logging;
    if (type != 1)
        return NULL; /* co-simulation only */
    return make(name, token, resources, c != NULL ? c->log : NULL, c != NULL ? c->environment : NULL);
}

EXPORT void fmi2FreeInstance(void *m)
{
    if (m != NULL)
        release(m);
}

EXPORT int fmi2SetDebugLogging(void *m, int on, size_t n, const char *const categories[])
{
    (void)m, (void)on, (void)n, (void)categories;
    return OK;
}

EXPORT int fmi2SetupExperiment(void *m, int has_tolerance, double tolerance, double start_s, int has_stop, double stop_s)
{
    (void)m, (void)has_tolerance, (void)tolerance, (void)start_s, (void)has_stop, (void)stop_s;
    return OK;
}

EXPORT int fmi2EnterInitializationMode(void *m) { return enter_initialisation(m); }
EXPORT int fmi2ExitInitializationMode(void *m) { return leave_initialisation(m); }
EXPORT int fmi2Terminate(void *m) { return (void)m, OK; }
EXPORT int fmi2Reset(void *m) { return reset(m); }

EXPORT int fmi2SetReal(void *m, const uint32_t r[], size_t n, const double v[]) { return set_real(m, r, n, v, n); }
EXPORT int fmi2GetReal(void *m, const uint32_t r[], size_t n, double v[]) { return get_real(m, r, n, v, n); }
EXPORT int fmi2SetInteger(void *m, const uint32_t r[], size_t n, const int v[]) { return set_i4(m, r, n, v, n); }
EXPORT int fmi2GetInteger(void *m, const uint32_t r[], size_t n, int v[]) { return get_i4(m, r, n, v, n); }
EXPORT int fmi2SetBoolean(void *m, const uint32_t r[], size_t n, const int v[]) { return set_i4(m, r, n, v, n); }
EXPORT int fmi2GetBoolean(void *m, const uint32_t r[], size_t n, int v[]) { return get_i4(m, r, n, v, n); }

EXPORT int fmi2DoStep(void *m, double t_s, double step_s, int no_return)
{
    (void)no_return;
    return step(m, t_s, step_s);
}

ABSENT(fmi2SetString)
ABSENT(fmi2GetString)
ABSENT(fmi2GetFMUstate)
ABSENT(fmi2SetFMUstate)
ABSENT(fmi2FreeFMUstate)
ABSENT(fmi2SerializedFMUstateSize)
ABSENT(fmi2SerializeFMUstate)
ABSENT(fmi2DeSerializeFMUstate)
ABSENT(fmi2GetDirectionalDerivative)
ABSENT(fmi2SetRealInputDerivatives)
ABSENT(fmi2GetRealOutputDerivatives)
ABSENT(fmi2CancelStep)
ABSENT(fmi2GetStatus)
ABSENT(fmi2GetRealStatus)
ABSENT(fmi2GetIntegerStatus)
ABSENT(fmi2GetBooleanStatus)
ABSENT(fmi2GetStringStatus)

#else

WHOLE(i8, int64_t)
WHOLE(u1, uint8_t)

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                         bool logging, bool event_mode, bool early_return,
                                         const uint32_t intermediate[], size_t n_intermediate, void *environment,
                                         log_message log, void *update)
{
    (void)visible, (void)logging, (void)event_mode, (void)early_return, (void)intermediate, (void)n_intermediate;
    (void)update;
    return make(name, token, resources, log, environment);
}

EXPORT void *fmi3InstantiateModelExchange(void) { return NULL; }
EXPORT void *fmi3InstantiateScheduledExecution(void) { return NULL; }

EXPORT void fmi3FreeInstance(void *m)
{
    if (m != NULL)
        release(m);
}

EXPORT int fmi3SetDebugLogging(void *m, bool on, size_t n, const char *const categories[])
{
    (void)m, (void)on, (void)n, (void)categories;
    return OK;
}

EXPORT int fmi3EnterInitializationMode(void *m, bool has_tolerance, double tolerance, double start_s, bool has_stop,
                                       double stop_s)
{
    (void)has_tolerance, (void)tolerance, (void)start_s, (void)has_stop, (void)stop_s;
    return enter_initialisation(m);
}

EXPORT int fmi3ExitInitializationMode(void *m) { return leave_initialisation(m); }
EXPORT int fmi3Terminate(void *m) { return (void)m, OK; }
EXPORT int fmi3Reset(void *m) { return reset(m); }

#define ACCESS(NAME, CTYPE, function)                                                                                  \
    EXPORT int fmi3Set##NAME(void *m, const uint32_t r[], size_t n, const CTYPE v[], size_t n_values)                  \
    {                                                                                                                  \
        return set_##function(m, r, n, v, n_values);                                                                   \
    }                                                                                                                  \
    EXPORT int fmi3Get##NAME(void *m, const uint32_t r[], size_t n, CTYPE v[], size_t n_values)                        \
    {                                                                                                                  \
        return get_##function(m, r, n, v, n_values);                                                                   \
    }

ACCESS(Float64, double, real)
ACCESS(Int32, int32_t, i4)
ACCESS(Int64, int64_t, i8)
ACCESS(UInt8, uint8_t, u1)

EXPORT int fmi3DoStep(void *m, double t_s, double step_s, bool no_return, bool *event, bool *ends, bool *early,
                      double *last_s)
{
    (void)no_return;
    *event = *ends = *early = false;
    *last_s = t_s + step_s;
    return step(m, t_s, step_s);
}

#define ABSENT_PAIR(NAME) ABSENT(fmi3Set##NAME) ABSENT(fmi3Get##NAME)

ABSENT_PAIR(Float32)
ABSENT_PAIR(Int8)
ABSENT_PAIR(Int16)
ABSENT_PAIR(UInt16)
ABSENT_PAIR(UInt32)
ABSENT_PAIR(UInt64)
ABSENT_PAIR(Boolean)
ABSENT_PAIR(String)
ABSENT_PAIR(Binary)
ABSENT_PAIR(Clock)
ABSENT_PAIR(FMUState)
ABSENT_PAIR(IntervalDecimal)
ABSENT_PAIR(IntervalFraction)
ABSENT_PAIR(ShiftDecimal)
ABSENT_PAIR(ShiftFraction)
ABSENT(fmi3EnterEventMode)
ABSENT(fmi3GetNumberOfVariableDependencies)
ABSENT(fmi3GetVariableDependencies)
ABSENT(fmi3FreeFMUState)
ABSENT(fmi3SerializedFMUStateSize)
ABSENT(fmi3SerializeFMUState)
ABSENT(fmi3DeserializeFMUState)
ABSENT(fmi3GetDirectionalDerivative)
ABSENT(fmi3GetAdjointDerivative)
ABSENT(fmi3EnterConfigurationMode)
ABSENT(fmi3ExitConfigurationMode)
ABSENT(fmi3EvaluateDiscreteStates)
ABSENT(fmi3UpdateDiscreteStates)
ABSENT(fmi3EnterContinuousTimeMode)
ABSENT(fmi3CompletedIntegratorStep)
ABSENT(fmi3SetTime)
ABSENT(fmi3SetContinuousStates)
ABSENT(fmi3GetContinuousStates)
ABSENT(fmi3GetContinuousStateDerivatives)
ABSENT(fmi3GetEventIndicators)
ABSENT(fmi3GetNominalsOfContinuousStates)
ABSENT(fmi3GetNumberOfEventIndicators)
ABSENT(fmi3GetNumberOfContinuousStates)
ABSENT(fmi3EnterStepMode)
ABSENT(fmi3GetOutputDerivatives)
ABSENT(fmi3ActivateModelPartition)

#endif
