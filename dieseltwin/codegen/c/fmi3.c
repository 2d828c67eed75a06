/* FMI 3.0 for co-simulation. What isn't offered stands at the end and returns an error. */

#include "fmi3Functions.h"

typedef struct {
    Component k;
    int running;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Instance;

static fmi3Status complain(Instance *i, const char *what)
{
    if (i && i->log)
        i->log(i->environment, fmi3Error, "logStatusError", what);
    return fmi3Error;
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean on, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference intermediate[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)resources, (void)visible, (void)on, (void)events, (void)early;
    (void)intermediate, (void)n, (void)update;
    if (!token || strcmp(token, IDENTITY))
        return NULL;
    Instance *i = calloc(1, sizeof *i);
    if (!i)
        return NULL;
    i->environment = environment;
    i->log = log;
    component_reset(&i->k);
    return i;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean on, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)on, (void)environment, (void)log;
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean on,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)on, (void)environment, (void)log;
    (void)update, (void)lock, (void)unlock;
    return NULL;
}

void fmi3FreeInstance(fmi3Instance c)
{
    free(c);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ((Instance *)c)->k.time_s = start;
    ((Instance *)c)->k.started = 0;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    Instance *i = c;
    component_update(&i->k);
    i->running = 1;
    return isfinite(i->k.e.p_im + i->k.e.p_em + i->k.e.omega_t) ? fmi3OK : complain(i, "no state at rest with these parameters and inputs");
}

fmi3Status fmi3EnterStepMode(fmi3Instance c)
{
    (void)c;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance c)
{
    (void)c;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance c)
{
    Instance *i = c;
    component_reset(&i->k);
    i->running = 0;
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[], size_t count)
{
    Instance *i = c;
    if (count != n)
        return complain(i, "fmi3GetFloat64: all variables are scalars");
    for (size_t j = 0; j < n; j++)
        if (component_get(&i->k, vr[j], &values[j]))
            return complain(i, "fmi3GetFloat64: no such variable");
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[],
                          size_t count)
{
    Instance *i = c;
    if (count != n)
        return complain(i, "fmi3SetFloat64: all variables are scalars");
    for (size_t j = 0; j < n; j++)
        if (component_set(&i->k, vr[j], values[j], i->running))
            return complain(i, "fmi3SetFloat64: no such variable, no finite number, or a parameter after the initialization");
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_set_state,
                      fmi3Boolean *event_needed, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last_time)
{
    Instance *i = c;
    (void)no_set_state;
    *event_needed = *terminate = *early = fmi3False;
    *last_time = time;
    if (component_step(&i->k, step))
        return complain(i, "fmi3DoStep: a step that is no positive time, or states that are not finite");
    *last_time = time + step;
    return fmi3OK;
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
    if (!*state)
        *state = malloc(sizeof(Instance));
    if (!*state)
        return complain(c, "fmi3GetFMUState: no memory");
    memcpy(*state, c, sizeof(Instance));
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
    memcpy(c, state, sizeof(Instance));
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi3OK;
}
