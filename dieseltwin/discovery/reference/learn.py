"""What recordings of a healthy engine say about its health, its maps and its sensors, all at once.

The unknowns are the coordinates of `learning.belief`. The maximum a posteriori of all recordings together is found by
Gauss-Newton with the metric of discovery: initial states of the windows are free, the corrections are simulated with
their own arguments, and convergence is judged by sensitivities taken there, since errors of 2-5 % bend. What remains
of each recording is its information about that point (Laplace). Information of several recordings adds. Where the
readings ask for errors of the maps beyond those that are believed (`reference.further`), all is fitted anew with the
belief that they ask for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dieseltwin.discovery.reference.evidence import Learned, combined
from dieseltwin.discovery.reference.faults import main_faults
from dieseltwin.discovery.reference.further import further_errors, gain_of
from dieseltwin.discovery.reference.joint import ROUNDS, Joint
from dieseltwin.discovery.reference.standing_part import parts_of
from dieseltwin.engine import EngineParameters
from dieseltwin.learning.belief import NOTHING_FURTHER, Belief, prior_belief, with_further
from dieseltwin.learning.domain import domain_of
from dieseltwin.learning.faults import FaultBeside
from dieseltwin.learning.files import LearnedEngine
from dieseltwin.learning.weather import (
    EXPONENTS,
    Exponent,
    OfType,
    as_sure_as_the_weather,
    beside_exponents,
    of_own_weather,
)
from dieseltwin.recordings.reader import Recording
from dieseltwin.recordings.shared_rows import distinct
from dieseltwin.settings.defaults import default_learn, default_search
from dieseltwin.settings.discovery import LearnConfig
from dieseltwin.settings.search import CircumstanceSettings

_NEAR = 0.02  # of -2 log posterior that a step promises, when the noise is estimated from what is left
_LOOKS = 2  # for further errors of the maps: far from them the readings' information is another
_SIFTED = 3  # times that windows are looked at for what doesn't act linearly, where the fit doesn't come to rest


def learn_engine(
    recordings: Sequence[Recording], base: EngineParameters, map_rms: float, known: LearnedEngine | None = None,
    settings: LearnConfig | None = None, prior: Belief | None = None, of_type: OfType | None = None,
) -> tuple[LearnedEngine, Learned]:  # fmt: skip
    """What is known of an engine from recordings, and from those that it was learned from before.

    Args:
        recordings: of the engine, known to be well; one that is given twice counts once.
        base: the engine before anything was learned.
        map_rms: size of the maps' smooth relative errors [-].
        known: what was learned before; its own base and size of errors then count, whatever the other two say.
        settings: None takes those of params.yaml.
        prior: what engines of the same type say of its maps; None takes what was believed at first.
        of_type: what these say of its compressor, and in which weather they say it of its maps.

    Raises:
        InputError: no usable sensor, or no stretch with the engine running.
    """
    if known is not None:
        base, map_rms, recordings = known.base, known.map_rms, [*known.recordings, *recordings]
        if prior is None:
            prior, of_type = known.prior, known.of_type
    together = distinct(recordings)
    engine = of_own_weather(base, together, of_type=of_type)
    found = learn(together, engine, map_rms, settings, prior, {} if of_type is None else of_type.exponents)
    misfits = {item.sha256: part.misfit for item, part in zip(together, found.evidence, strict=True)}
    domain = domain_of(found.belief, map_rms * found.further.size, base)
    return LearnedEngine(
        base, found.belief, map_rms, together, domain, misfits, prior, found.further, found.clocks, found.converged,
        faults=found.faults, exponents=found.exponents, of_type=of_type,
    ), found  # fmt: skip


def learn(
    recordings: Sequence[Recording], engine: EngineParameters, map_rms: float,
    settings: LearnConfig | None = None, prior: Belief | None = None, of_type: Mapping[str, Exponent] | None = None,
) -> Learned:  # fmt: skip
    """What recordings of a healthy engine say, the same to the last bit in whatever order they come.

    Args:
        recordings: of the engine, known to be well, no two alike.
        engine: what is believed of it but for its health, maps and sensors; its terms are part of it.
        map_rms: size of the maps' smooth relative errors [-].
        settings: None takes those of params.yaml.
        prior: what is believed before; None takes `learning.belief.prior_belief`.
        of_type: exponents of the compressor by name, that engines of its type show.

    Raises:
        InputError: no usable sensor, or no stretch with the engine running.
    """
    settings = settings or default_learn()
    prior = prior_belief(engine, map_rms) if prior is None else prior
    joint, exponents = _begun(sorted(recordings, key=lambda r: r.sha256), engine, prior, map_rms, of_type or {})
    usual, further = prior, NOTHING_FURTHER
    beside: tuple[FaultBeside, ...] = ()
    for _ in range(_LOOKS):
        said = joint.of_all_functions()
        asked = further_errors(usual, map_rms, *said, joint.by_an_effect)
        if asked == further:
            break
        if not beside:  # once maps may be off by more, they take a fault up
            beside = main_faults(joint, settings.suspicious_gain, gain_of(asked, usual, map_rms, *said))
        prior, further = with_further(usual, map_rms, asked), asked
        joint.begin(prior)  # the usual maps' fit lies where steps stop short of a minimum
        joint.fit(ROUNDS, _NEAR)
        joint.whiten_anew()
    converged = joint.fit(ROUNDS)
    rng = np.random.default_rng(settings.seed)
    for _ in range(_SIFTED):
        if not joint.leave_crooked_out(rng) and converged:
            break
        converged = joint.fit(ROUNDS)
        if converged:
            break
    evidence = joint.evidence()
    # long references show what is smaller than anybody wants to know of: no word of that, as `discover` has none
    least = default_search().driving.alarm_size
    suspicions = tuple(item for item in joint.suspicions(settings.suspicious_gain) if item.tolerances >= least)
    return Learned(combined(prior, evidence), evidence, converged, further, suspicions, joint.clocks(), joint.strange(),
                   beside or main_faults(joint, settings.suspicious_gain), exponents)  # fmt: skip


def _begun(
    recordings: Sequence[Recording], engine: EngineParameters, prior: Belief, map_rms: float,
    of_type: Mapping[str, Exponent],
) -> tuple[Joint, Mapping[str, Exponent]]:  # fmt: skip
    """The fit of usual maps, and what it shows of the compressor's exponents where recordings are in different weather.

    Each recording has exponents of its own at first. A map shifted along the flow is others on warm days and on cold
    ones; all are fitted anew about those that the recordings together show, or the map stays shifted. Whether inputs
    moved between the rows stays as it was told at first: nothing of the compressor says it.
    """
    def fitted(
        engine: EngineParameters, beliefs: CircumstanceSettings, between_rows: Sequence[bool | None]
    ) -> Joint:
        joint = Joint(parts_of(recordings, engine, prior, map_rms, beliefs, between_rows), prior)
        joint.fit(ROUNDS, _NEAR)
        joint.whiten_anew()
        return joint

    beliefs = beside_exponents(default_search().circumstances, of_type)
    joint = fitted(engine, beliefs, [None] * len(recordings))
    believed = {name: Exponent(getattr(engine, name), getattr(beliefs, name)) for name in EXPONENTS}
    shown = as_sure_as_the_weather(joint.exponents(believed), recordings, engine, beliefs)
    if shown:
        said = {name: item.value for name, item in shown.items()}
        moved = [part.twin.between_rows for part in joint.parts]
        joint = fitted(engine.replace(**said), beside_exponents(beliefs, shown), moved)
    return joint, {**of_type, **shown}
