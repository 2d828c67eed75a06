"""What a scorer asks of the tool: held-out likelihood of an engine, the oracle's fit, separability at the truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, first_fit, fit_fully, settle_local
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.score import effects_beside, score, secant_sizes
from dieseltwin.discovery.search.preparation import split_growing, tolerance_responses
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.engine import HEALTH, EngineParameters
from dieseltwin.engine.limited import Limited
from dieseltwin.engine.map_corrections import basis, look_up
from dieseltwin.engine.terms import Term, with_corrections
from dieseltwin.recordings.noise import Noise, estimate_noise
from dieseltwin.recordings.reader import Recording
from dieseltwin.settings.defaults import default_search

MAPS_MET = 5e-4
"""Standard deviation of what is left of a plant's maps in `with_plant_maps` [-]."""

_RIDGE = 1e-6  # functions that a plant's range doesn't reach stay at nothing


def _settled(twin: EngineTwin, noise: Noise, fit: Fit) -> Linearisation:
    """Initial states fitted at fixed parameters."""
    at = Linearisation(twin, Whitening.of(twin.measured, noise, twin.starts), fit)
    cut = split_growing(at)
    if cut is not None:
        at = Linearisation(twin, Whitening.of(twin.measured, noise, twin.starts), cut)
    return settle_local(at, rounds=4)


def _schedules(twin: EngineTwin, terms: Iterable[Term]) -> dict[str, np.ndarray]:
    """Share of its magnitude that each term has at the twin's samples, (n,); those that always act aren't named."""
    conditions = dict(twin.conditions)
    return {
        t.effect: Limited.factor(t, twin.recording_time_s, twin.start_s, conditions) for t in terms if not t.always
    }


def held_out_nll(engine: EngineParameters, recording: Recording) -> float:
    """Negative log-likelihood per sample of a recording under an engine whose parameters stay as they are.

    Only the turbo speeds at the windows' starts are fitted. The noise is estimated from the recording itself, so that
    all engines are scored alike.

    Raises:
        InputError: a recording that can't be used.
    """
    twin = EngineTwin(recording, engine)
    at = _settled(twin, estimate_noise(twin.measured), first_fit(twin))
    residual = np.nan_to_num(at.residual)
    whitened = at.metric.without_local(residual[None])[0]
    logs = at.whitening.log_normaliser(at.whitening.present)
    return float((0.5 * whitened @ whitened + logs) / twin.time_s.size)


def fit_oracle(
    recording: Recording, engine: EngineParameters, terms: tuple[Term, ...], map_tolerance: float | None = None
) -> EngineParameters:
    """Health parameters and magnitudes refitted by someone who knows the effects' form, started at the truth.

    Args:
        recording: the one that the tool saw.
        engine: with the true health parameters.
        terms: true effects with onset and region.
        map_tolerance: standard deviation of the maps' smooth relative errors [-].

    Returns:
        The engine with the refitted values, terms included.
    """
    twin = EngineTwin(recording, engine, map_tolerance=map_tolerance)
    candidate = Candidate(tuple(t.effect for t in terms), _schedules(twin, terms))
    noise = estimate_noise(twin.measured)
    rough = _settled(twin, noise, first_fit(twin, candidate, [t.magnitude for t in terms]))
    noise = estimate_noise(twin.measured, explained=rough.simulated)
    whitening = Whitening.of(twin.measured, noise, twin.starts)
    nuisance = tolerance_responses(twin, rough, default_search().driving)
    at = fit_fully(twin, whitening, rough.fit, nuisance, rounds=6)
    values = {name: float(value) for name, value in zip(HEALTH, at.fit.parameters, strict=True)}
    refitted = tuple(
        t.model_copy(update={"magnitude": float(m)}) for t, m in zip(terms, at.fit.magnitudes, strict=True)
    )
    return engine.replace(**values, terms=(*engine.terms, *refitted))


def with_plant_maps(engine: EngineParameters, maps: MapErrors) -> EngineParameters:
    """The engine with a plant's map errors among its terms, as corrections of the twin's maps.

    The twin's basis meets them within some hundredths of their size, at the nodes of the plant's tables.
    """
    functions = basis()
    coefficients = np.zeros(len(functions.maps))
    for m in range(len(maps.tables)):
        ends = [np.linspace(maps.low[m, k], maps.high[m, k], maps.tables.shape[1 + k]) for k in range(2)]
        x, y = (nodes.ravel() for nodes in np.meshgrid(*ends, indexing="ij"))
        at = functions.grids == m
        values = look_up(functions.tables[at], m, x, y)
        gram = values @ values.T + _RIDGE * np.eye(len(values))
        coefficients[at] = np.linalg.solve(gram, values @ maps.tables[m].ravel())
    return engine.replace(terms=with_corrections(engine.terms, coefficients))


def separability(
    recording: Recording, engine: EngineParameters, term: Term, map_tolerance: float | None = None
) -> dict[str, float]:
    """D of every other catalogue effect at the truth: what it would leave of the true effect's evidence.

    D = lambda (1 - cos^2), lambda the expected gain of the true effect, cos between the two responses after health
    parameters, initial states and tolerances are taken out (docs/discovery.md). The true effect acts when and where
    its onset and region let it; another effect may act all along or just then, whatever leaves less.
    """
    twin = EngineTwin(recording, engine, map_tolerance=map_tolerance)
    schedules = _schedules(twin, [term])
    noise = estimate_noise(twin.measured)
    rough = _settled(twin, noise, first_fit(twin, Candidate((term.effect,), schedules), [term.magnitude]))
    noise = estimate_noise(twin.measured, explained=rough.simulated)
    whitening = Whitening.of(twin.measured, noise, twin.starts)
    bare = Linearisation(twin, whitening, first_fit(twin))
    tolerances = tolerance_responses(twin, bare, default_search().driving)
    at = Linearisation(twin, whitening, bare.fit, None, tolerances)
    wanted = secant_sizes(twin, [name for name in twin.hypotheses if name != term.effect])
    tried = [(term.effect, term.magnitude), *wanted]
    lanes = at.fit.lanes()
    responses = effects_beside(twin, replace(lanes, schedules=schedules), at.simulated, tried)
    if schedules:
        beside = dict.fromkeys((name for name, _ in wanted), schedules[term.effect])
        alike = effects_beside(twin, replace(lanes, schedules=beside), at.simulated, wanted)
        tried, responses = [*tried, *wanted], np.concatenate([responses, alike])
    items = score(at, tried, responses)
    truth, others = items[0], items[1:]
    strength = float(truth.projected @ truth.projected) * term.magnitude**2
    distances: dict[str, float] = {}
    for item in others:
        inner = float(truth.projected @ item.projected)
        size = float(item.projected @ item.projected) * float(truth.projected @ truth.projected)
        sided = twin.hypotheses[item.name].sign > 0.0 and inner * np.sign(term.magnitude) < 0.0
        cosine2 = 0.0 if size <= 0 or sided else inner * inner / size
        distances[item.name] = min(distances.get(item.name, np.inf), strength * (1.0 - cosine2))
    return distances

