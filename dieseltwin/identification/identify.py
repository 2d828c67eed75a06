"""One way to identify, whatever the method: segments in, an `Identification` out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dieseltwin.errors import InputError
from dieseltwin.identification.in_place import InPlace
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import Identification
from dieseltwin.settings.methods import find
from dieseltwin.settings.params import IdentifyConfig

if TYPE_CHECKING:
    from dieseltwin.surrogates.bodies import Bodies
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.surrogates.operators import ActuatorOperators


def identify_segments(
    problems: Sequence[SegmentProblem],
    method: str,
    runs: int,
    seed: int,
    *,
    maps: EmpiricalMaps | None = None,
    bodies: Bodies | None = None,
    operators: ActuatorOperators | None = None,
    config: IdentifyConfig,
) -> Identification:
    """Identify the health parameters of every segment with one method.

    Args:
        problems: segments of one recording.
        method: one of `settings.methods.names()`.
        runs: number of runs R (initialisations, dropout masks and source models) on each segment.
        seed: seed of everything random in the method.
        maps: learned empirical maps, or None for the exact formulae.
        bodies: trained multi-head bodies (few-shot methods).
        operators: trained actuator operators, or None for the exact actuators.
        config: `identify` of params.yaml, which also says from which relative bound on a parameter counts as
            identifiable.

    Returns:
        Estimates of every segment and run, with their pooling.

    Raises:
        InputError: no segment, unknown method, a method whose extra is not installed, or fewer than one run.
    """
    if not problems:
        raise InputError("segments", "none", "one or more", "give a recording that is at least one segment long")
    if runs < 1:
        raise InputError("runs", runs, "1 or more", "ask for at least one run")
    chosen = find(method)
    chosen.check_installed()
    began = time.perf_counter()
    estimates = chosen.run(list(problems), runs, seed, bodies=bodies, operators=operators, maps=maps, config=config)
    seconds = time.perf_counter() - began
    learned = InPlace(maps, operators)
    return Identification(method, tuple(estimates), tuple(problems), seconds, config.identifiable_bound_rel, learned)
