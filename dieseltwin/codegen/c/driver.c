/* ------------------------------------------------------------------------------------------------------------------
   The simulator: states, actuators, RK4. An interval is what lies between two samples of the inputs; they run
   linearly over it and may jump between intervals. Magnitudes of effects are held over an interval.
   ------------------------------------------------------------------------------------------------------------------ */

/* A command behind its play: break points, linear in between. */
typedef struct {
    double t[KNOTS], u[KNOTS];
    int count;
} Command;

typedef struct {
    Constants c;
    double start_s, time_s;                    /* drifts and onsets count from start_s */
    int at_start;                              /* coming to rest, terms act as they do at start_s */
    Inputs inputs;                             /* at time_s */
    double p_im, p_em, omega_t;                /* states */
    double x_r, T_1;                           /* fixed point of the cylinder */
    double T_gas, T_em;                        /* gas that heats the EGR; lagged temperature in the exhaust manifold */
    double u_delta, u_egr1, u_egr2, u_vgt;     /* behind lags */
    double play_egr, play_vgt;                 /* commands behind play */
    Command egr, vgt;
    double X_Oim, X_Oem;                       /* oxygen mass fractions */
    double reading[READINGS];                  /* of sensors that lag */
    double amount[READINGS];                   /* magnitudes of the faults of sensors */
    double law_share[LAWS + 1];                /* where the laws act */
    Signals signals;                           /* of the laws, at the evaluation before */
    Magnitudes m;
    Quantities q;                      /* at time_s */
} Engine;

static void command_start(Command *k, double t, double u)
{
    k->t[0] = t;
    k->u[0] = u;
    k->count = 1;
}

/* `delay`: how far back the command is read [s]. */
static void command_add(Command *k, double t, double u, double delay)
{
    if (k->count == KNOTS) { /* forget what lies further back than any dead time; if all is recent, every second point */
        int first = 0, kept = 0;
        while (first + 2 < k->count && k->t[first + 1] < t - delay)
            first++;
        const int stride = first > KNOTS / 4 ? 1 : 2;
        for (int i = first; i < k->count; i += stride, kept++) {
            k->t[kept] = k->t[i];
            k->u[kept] = k->u[i];
        }
        k->count = kept;
    }
    k->t[k->count] = t;
    k->u[k->count] = u;
    k->count++;
}

/* The commands with the positions of valves that stand still in their place. */
static Inputs standing(Inputs u, Actuators f)
{
    u.u_egr_pct = f.egr_stuck > 0.0 ? f.egr_stuck : u.u_egr_pct;
    u.u_vgt_pct = f.vgt_stuck > 0.0 ? f.vgt_stuck : u.u_vgt_pct;
    return u;
}

/* The command runs from `from` to `to` over dt; *y is the output of the play, `delay` as of `command_add`. */
static void command_run(Command *k, double *y, double t, double dt, double from, double to, double width, double delay)
{
    const double half = 0.5 * width;
    const double now = play_output(*y, from, half);
    if (now != *y)
        command_add(k, t, now, delay);
    const double next = play_output(now, to, half);
    if (next != now) {
        const double share = (play_edge(now, next, half) - from) / (to - from);
        if (share > 0.0 && share < 1.0)
            command_add(k, t + share * dt, now, delay);
    }
    command_add(k, t + dt, next, delay);
    *y = next;
}

/* Index of the last break point at or before t, -1 if there is none. */
static int command_at(const Command *k, double t)
{
    int low = -1, high = k->count;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (k->t[middle] <= t)
            low = middle;
        else
            high = middle;
    }
    return low;
}

static double command_between(const Command *k, int i, double t)
{
    if (i < 0)
        return k->u[0];
    if (i + 1 >= k->count)
        return k->u[k->count - 1];
    const double width = k->t[i + 1] - k->t[i];
    return width > 0.0 ? k->u[i] + (k->u[i + 1] - k->u[i]) * (t - k->t[i]) / width : k->u[i + 1];
}

/* A lag of tau from time a to b behind the command delayed by `delay`, the share `share` of it by `more` besides. */
static double lagged(const Command *k, double state, double a, double b, double delay, double more, double share,
                     double tau)
{
    int early = command_at(k, a - delay), late = command_at(k, a - delay - more);
    while (a < b) {
        while (early + 1 < k->count && k->t[early + 1] + delay <= a)
            early++;
        while (late + 1 < k->count && k->t[late + 1] + delay + more <= a)
            late++;
        double end = b;
        if (early + 1 < k->count)
            end = minimum(end, k->t[early + 1] + delay);
        if (share > 0.0 && late + 1 < k->count)
            end = minimum(end, k->t[late + 1] + delay + more);
        double from = command_between(k, early, a - delay), to = command_between(k, early, end - delay);
        if (share > 0.0) {
            from += share * (command_between(k, late, a - delay - more) - from);
            to += share * (command_between(k, late, end - delay - more) - to);
        }
        state = actuator_update(state, from, to, end - a, tau);
        a = end;
    }
    return state;
}

/* The actuators from time a to b [s since the start], the injected mass running from `from` to `to`. */
static void actuators_run(Engine *e, Actuators f, double a, double b, double from, double to)
{
    const Constants *c = &e->c;
    e->u_egr1 = lagged(&e->egr, e->u_egr1, a, b, c->tau_degr, f.egr_more, f.egr_share, c->tau_egr1);
    e->u_egr2 = lagged(&e->egr, e->u_egr2, a, b, c->tau_degr, f.egr_more, f.egr_share, c->tau_egr2);
    e->u_vgt = lagged(&e->vgt, e->u_vgt, a, b, c->tau_dvgt, f.vgt_more, f.vgt_share, c->tau_vgt);
    e->u_delta = f.u_delta_lag > 0.0 ? actuator_update(e->u_delta, from, to, b - a, f.u_delta_lag) : to;
}

/* Commanded operating point with the given states; n_e [rpm]. */
static OperatingPoint point(const Engine *e, const double x[3], double n_e)
{
    return (OperatingPoint){
        .p_im = x[0], .p_em = x[1], .omega_t = x[2], .x_r = e->x_r, .T_1 = e->T_1, .n_e = n_e, .u_delta = e->u_delta,
        .u_egr = egr_valve_position(e->u_egr1, e->u_egr2, e->c), .u_vgt = e->u_vgt,
    };
}

/* All quantities at an operating point and time t [s since the start]: two sweeps of the cylinder's fixed point. */
static void evaluate(Engine *e, OperatingPoint commanded, Gas gas, double t)
{
    const Constants c = e->c;
    const Magnitudes m = e->m;
    Signals s = e->signals;
#if LAWS
    Signals asked = s, answered = s;
#endif
    for (int round = 0; round < (LAWS ? LAW_ROUNDS : 1); round++) {
        OperatingPoint x = driven(commanded, m, s, c);
        const Signals all = corrected(s, x, e->q, c);
        const IntakeSide i = intake_side(x, gas, m, all, c);
        const Sweep warm = cylinder_sweep(exhaust_to_intake_ratio(x.p_em, x.p_im), i.W_ei, i.W_f, x.x_r, x.T_1,
                                          charge_constants(i, x, m, all, c));
        x.x_r = warm.x_r;
        x.T_1 = warm.T_1;
        e->q = exhaust_side(i, x, gas, m, all, c);
#if LAWS
        const Signals now = law_signals(e->q, commanded, e->at_start ? 0.0 : t, e->law_share, c);
        const double *new = (const double *)&now;
        double *last_s = (double *)&asked, *last_f = (double *)&answered, *at = (double *)&s, change = 0.0;
        for (int p = 0; p < SIGNALS; p++) {
            const double next = round ? by_secant(last_s[p], last_f[p], at[p], new[p]) : new[p];
            change = maximum(change, fabs(next - at[p]) - LAW_SETTLED * fabs(next));
            last_s[p] = at[p];
            last_f[p] = new[p];
            at[p] = next;
        }
        if (change <= 0.0)
            break;
#endif
    }
    (void)t;
    e->signals = s;
    e->x_r = e->q.x_r_next;
    e->T_1 = e->q.T_1_next;
    e->T_gas = e->q.T_em;
}

/* Gas at the start of a step: the lagged temperature where there is thermal inertia. */
static Gas gas_held(const Engine *e, double tau)
{
    return tau > 0.0 ? (Gas){e->T_gas, 0.0, e->T_em} : (Gas){e->T_gas, 1.0, 0.0};
}

/* Gas after `width` [s] of a step in which the static temperature runs linearly from `before` [K]. */
static Gas gas_after(const Engine *e, double tau, double width, double before)
{
    if (tau <= 0.0)
        return (Gas){e->T_gas, 1.0, 0.0};
    return (Gas){
        e->T_gas,
        actuator_update(0.0, 0.0, 1.0, width, tau),
        actuator_update(e->T_em, before, 0.0, width, tau),
    };
}

/* Oxygen over a step of h [s] by Heun's method, between the quantities `a` at its start and those at its end. */
static void oxygen_run(Engine *e, const Quantities *a, double p_im, double p_em, double h)
{
    const Constants c = e->c;
    const Quantities *b = &e->q;
    const double im = e->X_Oim, em = e->X_Oem;
    const double a_im = intake_oxygen_rate(im, em, p_im, a->W_c, a->W_egr, c);
    const double a_em = exhaust_oxygen_rate(em, cylinder_out_oxygen(im, a->W_ei, a->W_f, c), p_em, a->T_em, a->W_eo, c);
    const double next_im = im + h * a_im, next_em = em + h * a_em;
    const double b_im = intake_oxygen_rate(next_im, next_em, e->p_im, b->W_c, b->W_egr, c);
    const double b_em = exhaust_oxygen_rate(next_em, cylinder_out_oxygen(next_im, b->W_ei, b->W_f, c), e->p_em, b->T_em,
                                            b->W_eo, c);
    e->X_Oim += 0.5 * h * (a_im + b_im);
    e->X_Oem += 0.5 * h * (a_em + b_em);
}

static double limited(double x, double low, double high)
{
    return minimum(maximum(x, low), high);
}

/* What acts inside the engine over an interval from t on [s since the start]. */
static void hold_terms(Engine *e, double t, Inputs begin, Inputs end)
{
    const double when = e->at_start ? 0.0 : t;
    e->m = magnitudes(when, begin, end);
    law_shares(e->law_share, when, begin, end);
}

/* Everything at time_s, for inputs that run to `next` over the following dt [s]. */
static void engine_hold(Engine *e, Inputs next, double dt)
{
    const double t = e->time_s - e->start_s;
    const double x[3] = {e->p_im, e->p_em, e->omega_t};
    next = clipped(next);
    hold_terms(e, t, e->inputs, next);
    reading_amounts(e->amount, t, e->inputs, next);
    const double tau = thermal_inertia(e->m);
    for (int sweep = 0; sweep < SAMPLE_SWEEPS; sweep++)
        evaluate(e, point(e, x, e->inputs.n_e_rpm), gas_held(e, tau), t);
    e->T_em = e->q.T_em;
}

/* The engine at time_s [s] under inputs u; states that are NAN come to rest there first. */
static void engine_start(Engine *e, double time_s, Inputs u, double p_im, double p_em, double omega_t);

/* The inputs jump. Every quantity is set anew, the actuators stay where they are. */
static inline void engine_jump(Engine *e, Inputs u)
{
    const double t = e->time_s - e->start_s;
    e->inputs = clipped(u);
    if (actuators(t, e->inputs, e->inputs).u_delta_lag <= 0.0)
        e->u_delta = e->inputs.u_delta_mg;
    engine_hold(e, e->inputs, 0.0);
}

/* The inputs run from `begin` to `end` over dt [s]; sets every quantity at the end. */
static void engine_step(Engine *e, Inputs begin, Inputs end, double dt)
{
    const Constants c = e->c;
    begin = clipped(begin);
    end = clipped(end);
    const double t = e->time_s - e->start_s;
    e->inputs = begin;
    const Actuators f = actuators(e->at_start ? 0.0 : t, begin, end);
    hold_terms(e, t, begin, end);
    const Inputs from = standing(begin, f), to = standing(end, f);
    command_run(&e->egr, &e->play_egr, t, dt, from.u_egr_pct, to.u_egr_pct, f.egr_play,
                c.tau_degr + LONGEST_DEAD_TIME_S + dt);
    command_run(&e->vgt, &e->play_vgt, t, dt, from.u_vgt_pct, to.u_vgt_pct, f.vgt_play,
                c.tau_dvgt + LONGEST_DEAD_TIME_S + dt);
    const double tau = thermal_inertia(e->m);
    const double low[3] = {P_IM_LOW * c.p_amb, P_EM_LOW * c.p_amb, OMEGA_LOW};
    const double high[3] = {P_IM_HIGH * c.p_amb, P_EM_HIGH * c.p_amb, OMEGA_HIGH};
    double readings_before[READINGS], held[READINGS];
    reading_values(e, readings_before);
    reading_amounts(held, t, begin, end);

    const int steps = (int)maximum(ceil(dt / LONGEST_STEP_S - STEP_TOLERANCE), 1.0);
    const double h = dt / steps;
    const double dn = (end.n_e_rpm - begin.n_e_rpm) / steps, du = (end.u_delta_mg - begin.u_delta_mg) / steps;
    Quantities before = e->q;
    double before_p_im = e->p_im, before_p_em = e->p_em;
    if (f.u_delta_lag <= 0.0)
        e->u_delta = begin.u_delta_mg;
    for (int step = 0; step < steps; step++) {
        const double now = t + step * h, n_e = begin.n_e_rpm + step * dn, u = begin.u_delta_mg + step * du;
        const double base[3] = {e->p_im, e->p_em, e->omega_t};
        double x[3], total[3];

        evaluate(e, point(e, base, n_e), gas_held(e, tau), now);
        if (step > 0)
            oxygen_run(e, &before, before_p_im, before_p_em, h);
        before = e->q;
        before_p_im = e->p_im;
        before_p_em = e->p_em;
        const double before_T = e->q.T_em_static;
        const double k1[3] = {e->q.dp_im, e->q.dp_em, e->q.domega_t};
        for (int j = 0; j < 3; j++)
            x[j] = base[j] + 0.5 * h * k1[j];

        actuators_run(e, f, now, now + 0.5 * h, u, u + 0.5 * du);
        evaluate(e, point(e, x, n_e + 0.5 * dn), gas_after(e, tau, 0.5 * h, before_T), now + 0.5 * h);
        const double k2[3] = {e->q.dp_im, e->q.dp_em, e->q.domega_t};
        for (int j = 0; j < 3; j++)
            x[j] = base[j] + 0.5 * h * k2[j];

        evaluate(e, point(e, x, n_e + 0.5 * dn), gas_after(e, tau, 0.5 * h, before_T), now + 0.5 * h);
        const double k3[3] = {e->q.dp_im, e->q.dp_em, e->q.domega_t};
        for (int j = 0; j < 3; j++) {
            x[j] = base[j] + h * k3[j];
            total[j] = k1[j] + 2.0 * (k2[j] + k3[j]);
        }

        actuators_run(e, f, now + 0.5 * h, now + h, u + 0.5 * du, u + du);
        evaluate(e, point(e, x, n_e + dn), gas_after(e, tau, h, before_T), now + h);
        const double k4[3] = {e->q.dp_im, e->q.dp_em, e->q.domega_t};
        for (int j = 0; j < 3; j++)
            x[j] = limited(base[j] + h / 6.0 * (total[j] + k4[j]), low[j], high[j]);
        e->p_im = x[0];
        e->p_em = x[1];
        e->omega_t = x[2];
        e->T_em = e->q.T_em;
    }
    e->time_s += dt;
    e->inputs = end;
    engine_hold(e, end, 0.0);
    oxygen_run(e, &before, before_p_im, before_p_em, h);
    readings_run(e, readings_before, held, dt);
}

static void engine_start(Engine *e, double time_s, Inputs u, double p_im, double p_em, double omega_t)
{
    u = clipped(u);
    e->c = derived(e->c);
    if (isnan(p_im) || isnan(p_em) || isnan(omega_t)) {
        double rest[3] = {0.0, 0.0, 0.0};
        for (int k = 0; k < 2; k++) { /* from light load and from much load: a stalled compressor rests elsewhere */
            engine_start(e, 0.0, u, SETTLE_STARTS[k][0], SETTLE_STARTS[k][1], SETTLE_STARTS[k][2]);
            e->at_start = 1;
            engine_step(e, u, u, SETTLE_S);
            if (k == 0 || e->p_im > (1.0 + STALLED) * rest[0]) {
                rest[0] = e->p_im;
                rest[1] = e->p_em;
                rest[2] = e->omega_t;
            }
        }
        p_im = isnan(p_im) ? rest[0] : p_im;
        p_em = isnan(p_em) ? rest[1] : p_em;
        omega_t = isnan(omega_t) ? rest[2] : omega_t;
    }
    e->start_s = e->time_s = time_s;
    e->at_start = 0;
    e->inputs = u;
    e->p_im = p_im;
    e->p_em = p_em;
    e->omega_t = omega_t;
    e->x_r = X_R_START;
    e->T_1 = T_1_START;
    e->T_gas = e->T_em = T_GAS_START;
    e->u_delta = u.u_delta_mg;
    const Inputs at = standing(u, actuators(0.0, u, u));
    e->u_egr1 = e->u_egr2 = e->play_egr = at.u_egr_pct;
    e->u_vgt = e->play_vgt = at.u_vgt_pct;
    command_start(&e->egr, 0.0, at.u_egr_pct);
    command_start(&e->vgt, 0.0, at.u_vgt_pct);
    e->signals = (Signals){0};
    e->q = (Quantities){.p_bc = e->c.p_amb, .p_es = e->c.p_amb};
    hold_terms(e, 0.0, u, u);
    const double x[3] = {p_im, p_em, omega_t};
    for (int sweep = 0; sweep < START_SWEEPS; sweep++) /* at rest: the gas, too */
        evaluate(e, point(e, x, u.n_e_rpm), (Gas){e->T_gas, 1.0, 0.0}, 0.0);
    e->T_em = e->q.T_em;
    engine_hold(e, u, 0.0);
    e->X_Oim = e->X_Oem = X_OC;
    for (int sweep = 0; sweep < OXYGEN_REST_SWEEPS; sweep++) {
        e->X_Oem = cylinder_out_oxygen(e->X_Oim, e->q.W_ei, e->q.W_f, e->c);
        e->X_Oim = (e->q.W_egr * e->X_Oem + e->q.W_c * X_OC) / (e->q.W_egr + e->q.W_c);
    }
    readings_start(e);
}
