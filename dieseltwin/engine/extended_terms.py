"""Terms of an engine in the simulator: schedules, and law terms along a trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dieseltwin.engine._compiled import follow_lanes
from dieseltwin.engine.array_namespace import Array, positive_power
from dieseltwin.engine.binding import Model, numpy_model
from dieseltwin.engine.effects import EFFECTS, GAS_LAG, IMPLICIT, STATE_EFFECTS, Magnitudes
from dieseltwin.engine.extended import Extension, simulate_extended
from dieseltwin.engine.fixed_point import settled, unchanged
from dieseltwin.engine.inputs import Actuation
from dieseltwin.engine.map_corrections import CORRECTED, RANGES, corrections_of, with_corrections_at
from dieseltwin.engine.model import NO_SIGNALS
from dieseltwin.engine.model_constants import Constants
from dieseltwin.engine.observations import Observations
from dieseltwin.engine.parameters import ParameterBatch
from dieseltwin.engine.quantities import POINTS, Gas, OperatingPoint, Quantities, Signals
from dieseltwin.engine.sensor_effects import apply_sensor_effects
from dieseltwin.engine.terms import (
    SENSOR_SLOTS,
    EffectTerm,
    LawTerm,
    Nozzle,
    OneTerm,
    Power,
    amounts,
    corrections_in,
    effect_terms,
    law_terms,
)
from dieseltwin.errors import InputError
from dieseltwin.sensors import MEASURED

LAW_SWEEPS = 8
"""Most rounds of the fixed point between laws and trajectory."""

POINT_SWEEPS = 4
"""Rounds of the fixed point between laws and quantities at given states."""

_UNCHANGED = 1e-15
"""Change of a correction, relative to the largest, that a further round can't make smaller."""

LAW_SETTLED = 1e-4
"""Change of a signal, relative to its size, that ends the rounds."""

GAS_SWEEPS = 4
"""Rounds of the fixed point between the gas temperature and the EGR that it heats, from a cold start."""

Terms = Sequence[OneTerm]


def conditions_of(actuation: Actuation) -> dict[str, np.ndarray]:
    """The input columns over which regions and terms are stated, commanded positions, at the samples, (n,) each."""
    inputs = actuation.inputs
    return {name: np.interp(actuation.time_s, inputs.time_s, values) for name, values in inputs.columns.items()}


def clock_of(actuation: Actuation) -> np.ndarray:
    """Times of the samples on the recording's clock, gaps included [s], (n,)."""
    inputs = actuation.inputs
    return actuation.time_s if inputs.recorded_s is None else np.interp(
        actuation.time_s, inputs.time_s, inputs.recorded_s
    )


def since_start(actuation: Actuation) -> np.ndarray:
    """Times of the samples since the recording's start, gaps included [s], (n,)."""
    return clock_of(actuation) - actuation.inputs.recording_start_s


def acting(
    actuation: Actuation, of: Callable[[np.ndarray, float, Mapping[str, np.ndarray]], np.ndarray]
) -> np.ndarray:
    """What onsets and regions make of terms at the samples, (..., n): they act from row to row of the recording.

    Args:
        actuation: with the inputs.
        of: (times [s], the recording's start [s], conditions at these times) -> (..., number of times).
    """
    start, conditions, clock_s = actuation.inputs.recording_start_s, conditions_of(actuation), clock_of(actuation)
    if actuation.rows is None:
        return of(clock_s, start, conditions)
    first = actuation.row_starts
    at_rows = of(clock_s[first], start, {name: values[first] for name, values in conditions.items()})
    return at_rows[..., actuation.rows]


def extension_of(
    actuation: Actuation, terms: Terms, size: int, restarts: Sequence[int] | np.ndarray = (0,)
) -> Extension:
    """Effect terms and corrections as an extension of `size` lanes; drifts and onsets count from the recording's start.

    Laws are left aside.
    """
    schedule = acting(actuation, partial(amounts, terms, STATE_EFFECTS))
    coefficients = corrections_in(terms)
    return Extension(
        np.ones((len(STATE_EFFECTS), size)), schedule, restarts=restarts,
        corrections=None if coefficients is None else corrections_of(coefficients),
    )  # fmt: skip


def simulate_terms(
    actuation: Actuation,
    batch: ParameterBatch,
    initial: np.ndarray,
    *,
    restarts: np.ndarray | Sequence[int] = (0,),
    sensors: bool = True,
    threads: int | None = None,
) -> Observations:
    """Simulate B parameter sets under their terms, sensor terms on the readings included.

    Args:
        actuation: one for all lanes, made with the same terms (`inputs.actuate`).
        batch: B parameter sets and their terms.
        initial, restarts, threads: as in `simulate_extended`.
        sensors: apply sensor terms to `measured`.

    Returns:
        States (B, n, 6) and measured (B, n, C). Law terms enter as signals that are iterated with the trajectory
        (`LAW_SWEEPS` simulations); between samples they are linear (`simulate.simulate` takes the integration
        steps as samples, where they are as good as continuous).
    """
    extension = extension_of(actuation, batch.terms, batch.size, restarts)
    starts = np.asarray(initial, dtype=np.float64)
    if starts.ndim == 2:
        starts = starts[:, None]
    starts = np.broadcast_to(starts, (batch.size, len(extension.restarts), 3))
    laws = law_terms(batch.terms)
    if len({law.point for law in laws}) > 1:  # a lane has one signal of its own, so each is simulated alone
        parts = [
            _with_laws(actuation, one, extension_of(actuation, batch.terms, 1, restarts), starts[[lane]], threads)
            for lane, one in enumerate(_one_by_one(batch))
        ]
        states, measured = (np.concatenate([getattr(part, name) for part in parts]) for name in ("states", "measured"))
        observed = Observations(states, measured)
    else:
        observed = _with_laws(actuation, batch, extension, starts, threads)
    if sensors:
        observed = _sensed(observed, actuation, batch)
    return observed


def simulate_lanes(
    actuation: Actuation | Sequence[Actuation], batch: ParameterBatch, initial: np.ndarray, threads: int | None = None
) -> Observations:
    """`simulate.simulate_states` for a batch with terms: lanes with the same actuation share their schedules."""
    starts = np.broadcast_to(np.asarray(initial, dtype=np.float64), (batch.size, 3))
    if isinstance(actuation, Actuation) or len(actuation) == 1:
        one = actuation if isinstance(actuation, Actuation) else actuation[0]
        observed = simulate_terms(one, batch, starts, threads=threads)
        return Observations(observed.states[..., :5], observed.measured)
    if len(actuation) != batch.size:
        raise InputError("simulate_states", f"{len(actuation)} actuations", f"1 or {batch.size}", "give one per lane")
    if not law_terms(batch.terms) and all(_is_constant(term) for term in effect_terms(batch.terms)):
        extension = extension_of(actuation[0], batch.terms, batch.size)
        observed = simulate_extended(actuation, batch, extension, starts, threads)
        return Observations(observed.states[..., :5], _sensed(observed, actuation[0], batch).measured)
    n = actuation[0].time_s.size
    states, measured = np.empty((batch.size, n, 5)), np.empty((batch.size, n, len(MEASURED)))
    for key in {id(item): item for item in actuation}:
        lanes = np.array([lane for lane, item in enumerate(actuation) if id(item) == key])
        part = replace(batch, values=batch.values[:, lanes])
        observed = simulate_terms(actuation[lanes[0]], part, starts[lanes], threads=threads)
        states[lanes], measured[lanes] = observed.states[..., :5], observed.measured
    return Observations(states, measured)


def _is_constant(term: EffectTerm) -> bool:
    drifts = term.slot in EFFECTS and EFFECTS[term.slot].drifts
    return bool(term.always) and not drifts


def _one_by_one(batch: ParameterBatch) -> Iterator[ParameterBatch]:
    for lane in range(batch.size):
        yield replace(batch, values=batch.values[:, [lane]])


def _sensed(observed: Observations, actuation: Actuation, batch: ParameterBatch) -> Observations:
    rows = acting(actuation, partial(amounts, batch.terms, SENSOR_SLOTS))
    ones = {name: np.ones(batch.size) for name, row in zip(SENSOR_SLOTS, rows, strict=True) if row.any()}
    schedules = dict(zip(SENSOR_SLOTS, rows, strict=True))
    return replace(
        observed, measured=apply_sensor_effects(observed.measured, actuation.time_s, ones, schedules, MEASURED)
    )


def _with_laws(
    actuation: Actuation, batch: ParameterBatch, extension: Extension, starts: np.ndarray, threads: int | None
) -> Observations:
    """Lanes under laws at one point, or one lane under laws at several."""
    points = _points(batch.terms)
    shape = (batch.size, actuation.time_s.size)

    def simulated(signals: Mapping[str, Array]) -> Observations:
        return simulate_extended(actuation, batch, _entered(extension, signals, shape), starts, threads)

    def answer(signals: Mapping[str, Array]) -> dict[str, Array]:
        _, s = along(simulated(signals).states, actuation, batch.terms, batch.constants(), laws_only=True)
        return {point: getattr(s, point) for point in points}

    return simulated(settled(answer, {}, rounds=LAW_SWEEPS if points else 0, tolerance=LAW_SETTLED))


def _points(terms: Terms) -> list[str]:
    return list(dict.fromkeys(law.point for law in law_terms(terms)))


def _entered(extension: Extension, signals: Mapping[str, Array], shape: tuple[int, int]) -> Extension:
    """The extension with signals of all lanes at one point, or of one lane at several; shape: (lanes, samples)."""
    if not signals:
        return extension
    if shape[0] == 1:
        rows = np.zeros((len(POINTS), shape[1]))
        for point, signal in signals.items():
            rows[POINTS.index(point)] = np.broadcast_to(signal, shape)[0]
        return replace(extension, signals=rows)
    ((point, signal),) = signals.items()
    own = np.ascontiguousarray(np.broadcast_to(signal, shape))
    return replace(extension, lane_point=np.full(shape[0], POINTS.index(point)), lane_signal=own)


def at_rest(actuation: Actuation, batch: ParameterBatch, initial: np.ndarray) -> np.ndarray:
    """States (3,) in which one engine under laws ends at inputs that stand still, from `initial` (3,).

    The laws' signals stand still, too: each round goes on from where the last one ended, with what the laws say there,
    so that all but the first are short ways.
    """
    extension, shape = extension_of(actuation, batch.terms, 1), (1, actuation.time_s.size)
    state = np.asarray(initial, dtype=np.float64)

    def answer(signals: Mapping[str, Array]) -> dict[str, Array]:
        nonlocal state
        entered = _entered(extension, signals, shape)
        states = simulate_extended(actuation, batch, entered, state[None, None], 1).states
        state = states[0, -1, :3].copy()
        _, s = along(states, actuation, batch.terms, batch.constants(), laws_only=True)
        return {point: getattr(s, point)[..., -1:] for point in _points(batch.terms)}

    settled(answer, {}, rounds=LAW_SWEEPS, tolerance=LAW_SETTLED, secant=True)
    return state


def signals_of(
    laws: Sequence[LawTerm], factors: Sequence[Array], variables: Mapping[str, Array], power: Power, nozzle: Nozzle
) -> dict[str, Array]:
    """Point -> signal of the law terms there at given variables; factors: onset and region of each law."""
    values: dict[str, Array] = {}
    for law, factor in zip(laws, factors, strict=True):
        values[law.point] = values.get(law.point, 0.0) + factor * law.signal(variables, power, nozzle)
    return values


def correction_signals(
    tables: np.ndarray, variables: Mapping[str, Array], c: Constants, signals: Mapping[str, Array]
) -> dict[str, Array]:
    """Point -> signal with the maps' corrections added, at variables as of `law_variables` (numpy arrays).

    tables: (G, NODES, NODES) of `corrections_of`.
    """
    states = (variables[name] for name in ("p_im", "p_em", "omega_t", "p_bc", "p_es", "T_em"))
    model = numpy_model()
    at = {**model.map_arguments(*states, c)._asdict(), "W_cc": model.corrected_flow(variables["W_c"], c)}
    shape, known = np.shape(variables["p_im"]), {*RANGES, *CORRECTED.values()}
    arguments = {k: np.broadcast_to(v, shape) for k, v in {**variables, **at}.items() if k in known}
    return with_corrections_at(tables, arguments, signals)


def law_variables(q: Quantities, states: Mapping[str, Array], c: Constants) -> dict[str, Array]:
    """Variables that a law may depend on; states: p_im, p_em, omega_t, x_r, T_1, n_e, u_delta, u_egr, u_vgt, t."""
    p_im, p_em = states["p_im"], states["p_em"]
    return {
        **states, "p_amb": c.p_amb, "T_amb": c.T_amb, "T_im": q.T_im, "T_em": q.T_em, "T_e": q.T_e, "T_c": q.T_c,
        "p_es": q.p_es, "p_bc": q.p_bc, "W_c": q.W_c, "W_t": q.W_t, "W_egr": q.W_egr, "W_ei": q.W_ei, "W_eo": q.W_eo,
        "W_f": q.W_f, "Pi_c": q.Pi_c, "Pi_t": q.Pi_t, "Pi_egr": p_im / p_em, "Pi_e": p_em / p_im,
    }  # fmt: skip


def quantities_under(
    model: Model, states: Mapping[str, Array], gas: Gas, m: Magnitudes, laws: Sequence[LawTerm],
    factors: Sequence[Array], c: Constants, power: Power = positive_power, sweeps: int = POINT_SWEEPS,
    secant: bool = False, corrections: np.ndarray | None = None, entered: Mapping[str, Array] | None = None,
) -> tuple[Quantities, Signals]:  # fmt: skip
    """`quantities_extended` with law terms evaluated on its own quantities.

    Args:
        model: equations of any backend.
        states: p_im, p_em [Pa], omega_t [rad/s], x_r [-], T_1 [K], n_e [rpm], u_delta [mg/cycle], u_egr, u_vgt [% of
            position], t [s since the recording's start].
        gas, m, c: as in `quantities_extended`.
        laws, factors: law terms and where they act.
        power: `positive_power` of the backend.
        sweeps: rounds of the fixed point between laws and quantities.
        secant: as in `fixed_point.settled`.
        corrections: coefficients (K,) of the maps' corrections, for numpy alone; None for none.
        entered: point -> a signal besides.
    """
    x = OperatingPoint(*(states[name] for name in OperatingPoint._fields))
    tables = None if corrections is None else corrections_of(corrections).tables
    given = {} if entered is None else dict(entered)

    def under(signals: Mapping[str, Array]) -> tuple[Quantities, Signals]:
        s = NO_SIGNALS._replace(**signals)
        return model.quantities_extended(x, gas, m, s, c), s

    def said(q: Quantities) -> dict[str, Array]:
        variables = law_variables(q, states, c)
        signals = signals_of(laws, factors, variables, power, model.nozzle_flow_factor)
        for point, signal in given.items():
            signals[point] = signals.get(point, 0.0) + signal
        return signals if tables is None else correction_signals(tables, variables, c, signals)

    if laws or tables is None:
        rounds = sweeps if laws else 0
        return under(settled(lambda signals: said(under(signals)[0]), given, rounds=rounds, secant=secant))
    # Of the arguments, W_c alone isn't known before the quantities are, where nothing restricts the flow: the first
    # guess is right but for the correction over it. What that moves, moves others little: plain rounds end.
    guess = {**states, "p_bc": c.p_amb, "p_es": c.p_amb, "T_em": gas.T, "W_c": np.zeros_like(states["p_im"])}
    signals = correction_signals(tables, guess, c, given)
    for _ in range(sweeps):
        q, s = under(signals)
        new = said(q)
        if unchanged(signals, new, _UNCHANGED):
            return q, s
        signals = new
    return under(signals)


def magnitudes_at(actuation: Actuation, terms: Terms) -> Magnitudes:
    """Magnitudes of the effects in the right-hand side at the samples, (n,) each."""
    return Magnitudes(*acting(actuation, partial(amounts, terms, STATE_EFFECTS)))


def along(
    states: np.ndarray, actuation: Actuation, terms: Terms, c: Constants, laws_only: bool = False,
    entered: Mapping[str, Array] | None = None,
) -> tuple[Quantities, Signals]:  # fmt: skip
    """All quantities along trajectories under terms, and the signals of laws and corrections.

    Args:
        states: (..., n, 6) as of `simulate_extended`; (..., n, 5) without the gas temperature, which is then found
            from the others.
        actuation: with the inputs.
        terms: of the engine.
        c: constants; arrays of shape (B, 1) for several lanes.
        laws_only: leave the maps' corrections out of the signals (not of the quantities).
        entered: point -> a signal besides, part of both.
    """
    n_e, u_delta, u_egr, u_vgt = actuation.at_samples()
    m = magnitudes_at(actuation, terms)
    inertia = getattr(m, GAS_LAG)
    laws = law_terms(terms)
    factors = [acting(actuation, law.factor) for law in laws]
    coefficients = corrections_in(terms)
    under = partial(quantities_under, secant=True, corrections=coefficients, entered=entered)
    p_im, p_em, omega_t, x_r, T_1 = np.moveaxis(states[..., :5], -1, 0)
    named = {
        "p_im": p_im, "p_em": p_em, "omega_t": omega_t, "x_r": x_r, "T_1": T_1,
        "n_e": n_e, "u_delta": u_delta, "u_egr": u_egr, "u_vgt": u_vgt,
        "t": since_start(actuation),
    }  # fmt: skip
    model = numpy_model(restricted=any(np.any(getattr(m, name)) for name in IMPLICIT))
    if states.shape[-1] > 5:
        T_gas = states[..., 5]
    else:
        T_gas = np.full(p_im.shape, 700.0)
        for _ in range(GAS_SWEEPS):
            q, _ = under(model, named, Gas(T_gas, 1.0, 0.0), m, laws, factors, c)
            T_gas = _lagged(q.T_em_static, actuation.time_s, inertia) if inertia.any() else q.T_em
    inert = inertia > 0.0
    gas = Gas(T_gas, np.where(inert, 0.0, 1.0), np.where(inert, T_gas, 0.0))
    q, s = under(model, named, gas, m, laws, factors, c)
    if laws_only and coefficients is not None:
        variables = law_variables(q, named, c)
        s = NO_SIGNALS._replace(**signals_of(laws, factors, variables, positive_power, model.nozzle_flow_factor))
    return q, s


def _lagged(static: np.ndarray, time_s: np.ndarray, tau: np.ndarray) -> np.ndarray:
    flat = np.ascontiguousarray(np.asarray(static).reshape(-1, time_s.size))
    return follow_lanes(time_s, flat, np.ascontiguousarray(np.broadcast_to(tau, flat.shape))).reshape(static.shape)
