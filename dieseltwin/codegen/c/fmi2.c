/* FMI 2.0 for co-simulation. What isn't offered stands at the end and returns an error. */

#include "fmi2Functions.h"

typedef struct {
    Component k;
    int running;
    const fmi2CallbackFunctions *callbacks;
    char name[128];
} Instance;

static fmi2Status complain(Instance *i, const char *what)
{
    if (i && i->callbacks && i->callbacks->logger)
        i->callbacks->logger(i->callbacks->componentEnvironment, i->name, fmi2Error, "logStatusError", "%s", what);
    return fmi2Error;
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean on)
{
    (void)resources, (void)visible, (void)on;
    if (type != fmi2CoSimulation || !guid || strcmp(guid, IDENTITY))
        return NULL;
    Instance *i = calloc(1, sizeof *i);
    if (!i)
        return NULL;
    i->callbacks = callbacks;
    snprintf(i->name, sizeof i->name, "%s", name ? name : "");
    component_reset(&i->k);
    return i;
}

void fmi2FreeInstance(fmi2Component c)
{
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ((Instance *)c)->k.time_s = start;
    ((Instance *)c)->k.started = 0;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *i = c;
    component_update(&i->k);
    i->running = 1;
    return isfinite(i->k.e.p_im + i->k.e.p_em + i->k.e.omega_t) ? fmi2OK : complain(i, "no state at rest with these parameters and inputs");
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    Instance *i = c;
    component_reset(&i->k);
    i->running = 0;
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    Instance *i = c;
    for (size_t j = 0; j < n; j++)
        if (component_get(&i->k, vr[j], &value[j]))
            return complain(i, "fmi2GetReal: no such variable");
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    Instance *i = c;
    for (size_t j = 0; j < n; j++)
        if (component_set(&i->k, vr[j], value[j], i->running))
            return complain(i, "fmi2SetReal: no such variable, no finite number, or a parameter after the initialization");
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
                                       const fmi2Real value[])
{
    Instance *i = c;
    for (size_t j = 0; j < n; j++) {
        if (vr[j] < VR_INPUT || vr[j] >= VR_INPUT + N_INPUTS || order[j] != 1 || !isfinite(value[j]))
            return complain(i, "fmi2SetRealInputDerivatives: first derivatives of inputs alone");
        i->k.slopes[vr[j] - VR_INPUT] = value[j];
    }
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_set_state)
{
    Instance *i = c;
    (void)time, (void)no_set_state;
    return component_step(&i->k, step) ? complain(i, "fmi2DoStep: a step that is no positive time, or states that are not finite") : fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!*state)
        *state = malloc(sizeof(Instance));
    if (!*state)
        return complain(c, "fmi2GetFMUstate: no memory");
    memcpy(*state, c, sizeof(Instance));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    memcpy(c, state, sizeof(Instance));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}
