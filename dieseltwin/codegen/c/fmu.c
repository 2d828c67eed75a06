/* ------------------------------------------------------------------------------------------------------------------
   The engine as a component of a co-simulation: variables by number, the same for FMI 2 and FMI 3.
   ------------------------------------------------------------------------------------------------------------------ */

enum { VR_TIME = 0, VR_INPUT = 1, VR_PARAMETER = 100, VR_START = 900, VR_OUTPUT = 1000 };
enum { N_STARTS = 3 };

typedef struct {
    Engine e;
    double inputs[N_INPUTS], slopes[N_INPUTS]; /* now, and what they change by in a second of the next step */
    double starts[N_STARTS];                   /* p_im, p_em [Pa], omega_t [rad/s] at the start; 0: at rest */
    double time_s;
    int started, stale;                        /* states are set; inputs have changed since the outputs were computed */
} Component;

static void component_reset(Component *k)
{
    static const double inputs[N_INPUTS] = {INPUT_STARTS};
    (void)OUTPUT_NAMES, (void)PARAMETER_NAMES; /* they stand in the description */
    memset(k, 0, sizeof *k);
    k->e.c = engine_constants();
    memcpy(k->inputs, inputs, sizeof inputs);
}

/* Everything that follows from what was set. */
static void component_update(Component *k)
{
    const double *s = k->starts;
    if (!k->started)
        engine_start(&k->e, k->time_s, inputs_of(k->inputs), s[0] > 0.0 ? s[0] : NAN, s[1] > 0.0 ? s[1] : NAN,
                     s[2] > 0.0 ? s[2] : NAN);
    else if (k->stale)
        engine_jump(&k->e, inputs_of(k->inputs));
    k->started = 1;
    k->stale = 0;
}

/* 0 if there is such a variable. */
static int component_get(Component *k, unsigned number, double *value)
{
    if (number == VR_TIME)
        *value = k->started ? k->e.time_s : k->time_s;
    else if (number >= VR_INPUT && number < VR_INPUT + N_INPUTS)
        *value = k->inputs[number - VR_INPUT];
    else if (number >= VR_PARAMETER && number < VR_PARAMETER + N_PARAMETERS)
        *value = *engine_parameter(&k->e, (int)(number - VR_PARAMETER));
    else if (number >= VR_START && number < VR_START + N_STARTS)
        *value = k->starts[number - VR_START];
    else if (number >= VR_OUTPUT && number < VR_OUTPUT + N_OUTPUTS) {
        double values[N_OUTPUTS];
        component_update(k);
        engine_outputs(&k->e, values);
        *value = values[number - VR_OUTPUT];
    } else
        return 1;
    return 0;
}

/* 0 if there is such a variable and it may be set now; `running`: after the initialization. */
static int component_set(Component *k, unsigned number, double value, int running)
{
    if (!isfinite(value))
        return 1;
    if (number >= VR_INPUT && number < VR_INPUT + N_INPUTS) {
        k->inputs[number - VR_INPUT] = value;
        k->stale = 1;
        if (!running)
            k->started = 0;
        return 0;
    }
    if (running)
        return 1;
    k->started = 0;
    if (number >= VR_PARAMETER && number < VR_PARAMETER + N_PARAMETERS)
        *engine_parameter(&k->e, (int)(number - VR_PARAMETER)) = value;
    else if (number >= VR_START && number < VR_START + N_STARTS)
        k->starts[number - VR_START] = value;
    else
        return 1;
    return 0;
}

/* 0 if all went well. */
static int component_step(Component *k, double dt)
{
    double end[N_INPUTS];
    if (!(dt > 0.0))
        return 1;
    component_update(k);
    for (int j = 0; j < N_INPUTS; j++) {
        end[j] = k->inputs[j] + dt * k->slopes[j];
        k->slopes[j] = 0.0;
    }
    engine_step(&k->e, inputs_of(k->inputs), inputs_of(end), dt);
    memcpy(k->inputs, end, sizeof end);
    return !isfinite(k->e.p_im + k->e.p_em + k->e.omega_t);
}
