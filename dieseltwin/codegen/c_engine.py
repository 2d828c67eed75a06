"""An engine as one file of C without dependencies: the library's equations, translated, and a driver with its RK4."""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files

import numpy as np

from dieseltwin.codegen.c_terms import ACTUATORS, TermsInC
from dieseltwin.codegen.transpile import Equation, Signature, Translation, number, spelled
from dieseltwin.engine import _compiled, _compiled_extended, hooks, model, without_effects
from dieseltwin.engine import quantities as tuples
from dieseltwin.engine.binding import LEAVES, effect_modules, functions_of, hook_source
from dieseltwin.engine.effects import EFFECTS, effects_at
from dieseltwin.engine.extended_terms import LAW_SWEEPS
from dieseltwin.engine.fixed_point import by_secant
from dieseltwin.engine.inputs import DEFAULT_STEP_S, INPUT_COLUMNS, STEP_TOLERANCE, Actuation, Inputs
from dieseltwin.engine.model_constants import CONSTANT_NAMES, DERIVED, PUBLISHED, derived
from dieseltwin.engine.parameters import EngineParameters, constants, described
from dieseltwin.engine.sensor_effects import slot_parts
from dieseltwin.engine.simulate import LOADED_START, SETTLE_S, SETTLE_START, STALLED, quantities_frame
from dieseltwin.engine.terms import Term, effect_terms, law_terms
from dieseltwin.errors import DieselTwinError
from dieseltwin.symbols import BY_COLUMN
from dieseltwin.version import __version__

KNOTS = 4096  # break points of a command that are remembered: those of 65 ms of dead time at 16 microseconds' steps
LAW_SETTLED = 1e-9  # relative change of a signal that ends the rounds between laws and quantities

_TUPLES = (
    tuples.OperatingPoint, tuples.Charge, tuples.Signals, tuples.Gas, tuples.Sweep, tuples.IntakeSide,
    tuples.MapArguments, tuples.Quantities, tuples.DriverQuantities,
)  # fmt: skip
_KNOWN = {
    "with_ambient_pressure": Signature("with_ambient_pressure", (("Constants", "c"), ("double", "pressure")),
                                       "Constants"),
    "with_charge": Signature("with_charge", (("Constants", "c"), ("double", "T_im"), ("double", "eta_sc")),
                             "Constants"),
}  # fmt: skip
_ROOTS = (
    "driven", "intake_side", "cylinder_sweep", "exhaust_to_intake_ratio", "charge_constants", "exhaust_side",
    "driver_quantities", "actuator_update", "play_output", "play_edge", "egr_valve_position", "intake_oxygen_rate",
    "exhaust_oxygen_rate", "cylinder_out_oxygen", "by_secant",
)  # fmt: skip
"""Equations that the driver calls."""

_OF_THE_DRIVER = {
    "time_s": "e->time_s", "p_im_pa": "e->p_im", "p_em_pa": "e->p_em", "omega_t_rad_s": "e->omega_t",
    "u_egr1_pct": "e->u_egr1", "u_egr2_pct": "e->u_egr2", "u_vgt_act_pct": "e->u_vgt", "t_1_k": "e->T_1",
    "x_r": "e->x_r", "x_oim": "e->X_Oim", "x_oem": "e->X_Oem", "lambda": "d.air_fuel_ratio",
    "egr_fraction": "d.egr_fraction", "torque_nm": "d.torque", "p_es_pa": "e->q.p_es", "p_bc_pa": "e->q.p_bc",
    "t_im_k": "e->q.T_im", "w_leak_im_kg_s": "e->q.W_leak_im", "w_leak_em_kg_s": "e->q.W_leak_em",
    "p_friction_w": "e->q.P_f", "t_em_static_k": "e->q.T_em_static",
}  # fmt: skip
"""Columns of `simulate` that aren't a quantity of their symbol's name."""


@lru_cache(maxsize=1)
def _written_equations() -> dict[str, Equation]:
    found = {name: Equation.of(f) for module in (*LEAVES, model, *effect_modules())
             for name, f in functions_of(module).items()}  # fmt: skip
    return found | {"by_secant": Equation.of(by_secant)}


def equations_with(present: tuple[str, ...], signals_at: frozenset[str]) -> dict[str, Equation]:
    """The equations of the model with the effects that are present; what nothing enters is that of the published model.

    Args:
        present: effects inside the right-hand side; signals_at: points where laws enter.
    """
    found = dict(_written_equations())
    for name, hook in functions_of(hooks).items():
        entering = [EFFECTS[effect] for effect in effects_at(name.removeprefix("at_")) if effect in present]
        found[name] = Equation.of(hook)
        if entering:
            text = Equation.of_text(hook_source(hook, entering), {})
            text.node.args = found[name].node.args
            found[name] = text
    for pressure, quantity in (("inlet_pressure", "p_bc"), ("outlet_pressure", "p_es")):
        if quantity not in signals_at and not set(effects_at(quantity)) & set(present):
            found[pressure] = Equation.of(functions_of(without_effects)[pressure])
    return found


def input_columns(engine: EngineParameters) -> tuple[str, ...]:
    """Columns of the inputs that the engine needs beside time_s."""
    needed = {column for term in effect_terms(engine.terms) if isinstance(term, Term)
              for column in EFFECTS[term.effect].needs}  # fmt: skip
    return (*INPUT_COLUMNS, *sorted(needed))


def output_columns(engine: EngineParameters) -> tuple[str, ...]:
    """The columns that `simulate` gives for this engine, in its order; no kernel is compiled for it."""
    n_e, u_delta, u_egr, u_vgt, u_flap = (np.full(2, value) for value in (1200.0, 100.0, 20.0, 60.0, 50.0))
    inputs = Inputs(np.array([0.0, 1.0]), n_e, u_delta, u_egr, u_vgt, u_flap_pct=u_flap)
    grid = np.repeat([n_e[:1], u_delta[:1], u_egr[:1], u_vgt[:1]], 3, axis=1)
    still = Actuation(inputs.time_s, np.ones(1, dtype=np.int64), inputs, u_egr, u_egr, u_vgt, u_egr, grid)
    states = np.tile([*SETTLE_START, _compiled.X_R_START, _compiled.T_1_START, _compiled_extended.T_GAS_START], (2, 1))
    names = list(quantities_frame(states if engine.terms else states[:, :5], still, engine))
    at = names.index("lambda")
    return (*names[:at], "x_oim", "x_oem", *names[at:])


def c_source(engine: EngineParameters, name: str, command_line: bool = True) -> str:
    """One file of C that simulates the engine: `cc -O2 -o simulate FILE.c -lm`, or a library without its `main`.

    Args:
        engine: with its terms; name: of the engine, for the heading.
        command_line: with the `main` that reads and writes CSV.

    Raises:
        DieselTwinError: an equation that can't be translated.
    """
    present = TermsInC(engine.terms, Translation({}, {}, {})).state_effects
    structs: dict[str, tuple[str, ...]] = {kind.__name__: kind._fields for kind in _TUPLES}
    structs |= {"Constants": CONSTANT_NAMES, "Magnitudes": present or ("none",), "Inputs": input_columns(engine),
                "Actuators": ACTUATORS}  # fmt: skip
    laws = law_terms(engine.terms)
    equations = equations_with(present, frozenset(law.point for law in laws))
    translation = Translation(equations, structs, _KNOWN)
    for root in _ROOTS:
        translation.need(root)
    terms = TermsInC(engine.terms, translation)
    of_terms = terms.write()
    of_constants = _constants(engine, translation)
    parts = [
        _heading(engine, name),
        "".join(_struct(kind, fields) for kind, fields in structs.items()),
        source_text("primitives.c"),
        _numbers(terms, len(laws), translation.constants),
        *translation.texts,
        of_constants,
        _inputs(engine),
        *of_terms,
        source_text("driver.c").replace(*_split_outputs(engine, terms)),
        *([source_text("main.c")] if command_line else []),
    ]
    return "\n".join(parts)


def source_text(name: str) -> str:
    """One of the files of C that no engine changes."""
    return files("dieseltwin.codegen").joinpath(f"c/{name}").read_text(encoding="utf-8")


def _split_outputs(engine: EngineParameters, terms: TermsInC) -> tuple[str, str]:
    """What in the driver the outputs take the place of, and the outputs: they need the engine's type."""
    mark = "static void command_start("
    return mark, _outputs(engine, terms) + "\n" + mark


def _heading(engine: EngineParameters, name: str) -> str:
    lines = [
        f"Mean-value model of a diesel engine's gas path: {name}, written by dieseltwin {__version__}.", "",
        "Wahlstrom & Eriksson (2011), numbers A.x as in the appendix of Nath et al.; SI units unless a name says",
        "otherwise. Made from the equations of the library: change them there, parameters here or by argument.", "",
        "    cc -O2 -o simulate THIS_FILE.c -lm && ./simulate INPUTS.csv OUT.csv",
    ]  # fmt: skip
    if engine.terms:
        lines += ["", "Beyond the published model:"]
        lines += [f"    {' '.join(_told(term).split())}" for term in engine.terms]
    body = "\n".join(f" * {line}".rstrip() for line in lines).replace("*/", "* /")
    head = "#include <math.h>\n#include <stdio.h>\n#include <stdlib.h>\n#include <string.h>\n"
    return f"/*\n{body}\n */\n{head}"


def _told(term: object) -> str:
    named = {"effect", "magnitude", "point", "text", "sensor", "fault", "actuator", "onset_s", "until_s", "grown_s",
             "gone_s", "region"}
    values = {k: v for k, v in dict(term).items() if k in named and v not in (None, "", ())}  # type: ignore[call-overload]
    return ", ".join(f"{key} {value}" for key, value in values.items()) or "learned corrections of the maps"


def _struct(kind: str, fields: tuple[str, ...]) -> str:
    lines, line = [], "    double"
    for name in fields:
        if len(line) + len(name) > 110:
            lines.append(line.rstrip(",") + ";")
            line = "    double"
        line += f" {spelled(name)},"
    lines.append(line.rstrip(",") + ";")
    return "typedef struct {\n" + "\n".join(lines) + f"\n}} {kind};\n\n"


def _numbers(terms: TermsInC, laws: int, named: dict[str, str]) -> str:
    kernel = {name: getattr(_compiled, name) for name in (
        "P_IM_LOW", "P_IM_HIGH", "P_EM_LOW", "P_EM_HIGH", "OMEGA_LOW", "OMEGA_HIGH", "X_R_START", "T_1_START", "X_OC",
    )}  # fmt: skip
    driver = {
        **kernel, "T_GAS_START": _compiled_extended.T_GAS_START, "LONGEST_STEP_S": DEFAULT_STEP_S,
        "STEP_TOLERANCE": STEP_TOLERANCE, "SETTLE_S": SETTLE_S, "STALLED": STALLED,
        **({"LAW_SETTLED": LAW_SETTLED} if laws else {}),
        "LONGEST_DEAD_TIME_S": terms.longest_dead_time_s,
    }  # fmt: skip
    values = {name: number(value) for name, value in driver.items()} | named
    whole = {
        "KNOTS": KNOTS, "LAWS": laws, "LAW_ROUNDS": LAW_SWEEPS, "SIGNALS": len(tuples.Signals._fields),
        "READINGS": max(1, len(terms.readings)), "SAMPLE_SWEEPS": _compiled.SAMPLE_SWEEPS + 1,
        "START_SWEEPS": _compiled.START_SWEEPS, "OXYGEN_REST_SWEEPS": _compiled.OXYGEN_REST_SWEEPS,
    }  # fmt: skip
    light, loaded = (", ".join(number(value) for value in start) for start in (SETTLE_START, LOADED_START))
    return "\n".join([
        *(f"#define {name} {value}" for name, value in whole.items()), "",
        *(f"static const double {name} = {value};" for name, value in values.items()),
        f"static const double SETTLE_STARTS[2][3] = {{{{{light}}}, {{{loaded}}}}};\n",
    ])  # fmt: skip


def _constants(engine: EngineParameters, translation: Translation) -> str:
    values = constants(engine)._asdict()
    words = described()
    given = "\n".join(f"        .{name} = {number(values[name])}, /* {words[name]} */" for name in PUBLISHED)
    entries = translation.entries(Equation.of(derived), "v", "Constants")
    if set(entries) != set(DERIVED):
        raise DieselTwinError(f"derived constants {sorted(set(entries) ^ set(DERIVED))} can't be written as C")
    follow = "\n".join(f"    v.{name} = {text};" for name, text in entries.items())
    names = ",\n".join(f'    "{name}"' for name in PUBLISHED)
    return (
        "/* The engine's parameters. */\n"
        f"static Constants engine_constants(void)\n{{\n    return (Constants){{\n{given}\n"
        f"    }};\n}}\n\n/* Factors of parameters alone. */\nstatic Constants derived(Constants v)\n{{\n{follow}\n"
        f"    return v;\n}}\n\nenum {{ N_PARAMETERS = {len(PUBLISHED)} }};\n"
        f"static const char *const PARAMETER_NAMES[N_PARAMETERS] = {{\n{names}\n}};\n"
    )


def _inputs(engine: EngineParameters) -> str:
    columns = input_columns(engine)
    names = ", ".join(f'"{name}"' for name in columns)
    reads = ", ".join(f"values[{j}]" for j in range(len(columns)))
    clips = "\n".join(f"    u.{c} = minimum(maximum(u.{c}, {number(low)}), {number(high)});"
                      for c, (low, high) in engine.input_ranges.items())  # fmt: skip
    return (
        f"#define N_INPUTS {len(columns)}\n#define INPUT_NAMES {names}\n\n"
        f"static inline Inputs inputs_of(const double *values)\n{{\n    return (Inputs){{{reads}}};\n}}\n\n"
        "/* The inputs within the engine's ranges. */\n"
        f"static Inputs clipped(Inputs u)\n{{\n{clips}\n    return u;\n}}\n"
    )


def _outputs(engine: EngineParameters, terms: TermsInC) -> str:
    columns = output_columns(engine)
    true_values = {column: _expression(column, engine) for column in columns}
    names = ",\n".join(f'    "{name}"' for name in columns)
    rows = "\n".join(f"    out[{j}] = {terms.reading_of(column, true_values[column])};"
                     for j, column in enumerate(columns))  # fmt: skip
    lags = [(k, slot_parts(slot)[0]) for k, slot in enumerate(terms.readings) if slot_parts(slot)[1] == "lag"]
    values = "\n".join(f"    out[{k}] = {true_values[column]};" for k, column in lags)
    runs = "\n".join(
        f"    e->reading[{k}] = amount[{k}] > 0.0 ? actuator_update(e->reading[{k}], before[{k}], now[{k}], dt, "
        f"amount[{k}]) : now[{k}];" for k, _ in lags
    )  # fmt: skip
    return f"""enum {{ N_OUTPUTS = {len(columns)} }};
static const char *const OUTPUT_NAMES[N_OUTPUTS] = {{
{names}
}};

/* A parameter by its place in PARAMETER_NAMES; changes act from `engine_start` on. */
static double *engine_parameter(Engine *e, int place)
{{
    return (double *)&e->c + place;
}}

/* All columns at time_s, faults of sensors included. */
static void engine_outputs(const Engine *e, double out[N_OUTPUTS])
{{
    const DriverQuantities d = driver_quantities(e->q, e->inputs.n_e_rpm, e->p_im, e->p_em, e->c);
{rows}
}}

/* True values of what sensors with a lag read. */
static void reading_values(const Engine *e, double *out)
{{
    (void)e, (void)out;
{values}
}}

static void readings_start(Engine *e)
{{
    reading_values(e, e->reading);
}}

/* Sensors that lag by an amount [s], over dt [s] in which their true values ran from `before` to those now. */
static void readings_run(Engine *e, const double *before, const double *amount, double dt)
{{
    double now[READINGS];
    reading_values(e, now);
    (void)now, (void)before, (void)amount, (void)dt;
{runs}
}}
"""


def _expression(column: str, engine: EngineParameters) -> str:
    if column in _OF_THE_DRIVER:
        return _OF_THE_DRIVER[column]
    if column in input_columns(engine):
        return f"e->inputs.{column}"
    symbol = BY_COLUMN.get(column)
    if symbol is None or symbol.name not in tuples.Quantities._fields:
        raise DieselTwinError(f"column {column} of `simulate` has no counterpart in C")
    return f"e->q.{symbol.name}"
