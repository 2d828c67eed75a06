"""Hybrid PINN, every network from scratch: the paper's `baseline`.

Source: paper, section "A hybrid model using DeepONet and PINN for the engine problem": four networks, the unknowns and
the self-adaptive weights are trained together; then the weights rest and the others go on (two phases). 80,000 epochs
(table of computational times). The paper trains it on the first minute only; here any segment that is given is trained.

Not printed, and chosen in `params.yaml`: the end of the first phase, learning rates, the networks' start.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import SegmentEstimate
from dieseltwin.identification.shooting import by_grid
from dieseltwin.paper.loops.pinn_training import estimates_of, make_lanes, settings_of, train_lanes

if TYPE_CHECKING:
    from dieseltwin.settings.params import IdentifyConfig
    from dieseltwin.surrogates.bodies import Bodies
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.surrogates.operators import ActuatorOperators

METHOD = "baseline"


def estimate(
    problems: Sequence[SegmentProblem],
    runs: int,
    seed: int,
    *,
    bodies: Bodies | None = None,
    operators: ActuatorOperators | None = None,
    maps: EmpiricalMaps | None = None,
    config: IdentifyConfig,
) -> list[SegmentEstimate]:
    """Estimate the health parameters of each segment with the hybrid PINN.

    Args:
        problems: segments; `problem.parameters` gives the known parameters and the start (laboratory values).
        runs: runs R of each segment: other networks, weights, unknowns, map members, noise draws.
        seed: seed of all draws; a run's draws depend on (seed, segment, run) alone, not on the batch it runs in.
        bodies: not used; every layer is trained.
        operators: trained actuator operators, or None for the exact actuators.
        maps: learned empirical maps, dropout on, or None for the exact formulae.
        config: `identify` of params.yaml.

    Returns:
        One estimate for each segment, in order; standard deviations are left to the spread of the members.
    """
    settings = settings_of(config, METHOD)
    results: dict[int, SegmentEstimate] = {}
    for group in by_grid(problems):
        began = time.perf_counter()
        lanes = make_lanes(problems, group, runs, seed, config.start)
        found = train_lanes(lanes, operators, maps, settings)
        share, below = settings.average_share, config.identifiable_bound_rel
        made = estimates_of([problems[i] for i in group], found, runs, began, METHOD, share, below)
        results |= dict(zip(group, made, strict=True))
    return [results[i] for i in range(len(problems))]
