"""Multi-stage transfer learning: `baseline` on the first segment, its networks and unknowns carried to the others.

Source: paper, section "Multi-stage Transfer learning". A segment behind the first starts from the networks and unknowns
that `baseline` found on the first one, each member from another source model, with fresh self-adaptive weights. Stage I
(to epoch 20,000) trains everything, Stage II (to 30,000) the last layers, unknowns and weights, Stage III (to 35,000)
the last layers and unknowns.

Not printed, and chosen in `params.yaml`: the piecewise constant learning rates. Adam's moments are kept across stages.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import SegmentEstimate
from dieseltwin.identification.shooting import by_grid
from dieseltwin.paper.loops import baseline
from dieseltwin.paper.loops.pinn_training import PinnTrained, estimates_of, make_lanes, settings_of, train_lanes

if TYPE_CHECKING:
    from dieseltwin.settings.params import IdentifyConfig
    from dieseltwin.surrogates.bodies import Bodies
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.surrogates.operators import ActuatorOperators

METHOD = "multi-stage"


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
    """Estimate the health parameters of each segment, the first from scratch, the others from its models.

    Args:
        problems: segments of one recording, the first one is the source.
        runs: runs R of each segment; run r starts from source model r.
        seed: seed of all draws, as `baseline.estimate`.
        bodies: not used.
        operators: trained actuator operators, or None for the exact actuators.
        maps: learned empirical maps, dropout on, or None for the exact formulae.
        config: `identify` of params.yaml, whose settings of `baseline` rule the first segment.

    Returns:
        One estimate for each segment, in order; standard deviations are left to the spread of the members.
    """
    settings_of(config, METHOD)  # what is wrong is said before the first segment is trained
    of_first = settings_of(config, baseline.METHOD)
    began = time.perf_counter()
    source = train_lanes(make_lanes(problems, [0], runs, seed, config.start), operators, maps, of_first)
    below = config.identifiable_bound_rel
    first = estimates_of(problems[:1], source, runs, began, METHOD, of_first.average_share, below)
    return first + later_segments(problems, source_models(source, runs), runs, seed, config, operators, maps)


def later_segments(
    problems: Sequence[SegmentProblem],
    taken: tuple[Tensor, Tensor],
    runs: int,
    seed: int,
    config: IdentifyConfig,
    operators: ActuatorOperators | None = None,
    maps: EmpiricalMaps | None = None,
    first_run: int = 0,
) -> list[SegmentEstimate]:
    """Estimate the segments behind the first from source models.

    Args:
        problems: all segments of the recording.
        taken: network weights (R, size) and masked unknowns (R, 4) of `source_models`.
        runs, seed, config, operators, maps: as `estimate`.
        first_run: number of the first run, as `few_shot_adam.estimate`.

    Returns:
        One estimate for each segment but the first, in order.
    """
    settings = settings_of(config, METHOD)
    results: dict[int, SegmentEstimate] = {}
    for whole in by_grid(problems):
        group = [i for i in whole if i > 0]
        if not group:
            continue
        began = time.perf_counter()
        lanes = make_lanes(problems, group, runs, seed, config.start, first_run)
        sources = (taken[0].repeat(len(group), 1), taken[1].repeat(len(group), 1))
        found = train_lanes(lanes, operators, maps, settings, sources)
        share, below = settings.average_share, config.identifiable_bound_rel
        made = estimates_of([problems[i] for i in group], found, runs, began, METHOD, share, below)
        results |= dict(zip(group, made, strict=True))
    return [results[i] for i in range(1, len(problems))]


def source_models(source: PinnTrained, runs: int) -> tuple[Tensor, Tensor]:
    """Source model of each run.

    Args:
        source: `baseline` on the first segment, R' runs.
        runs: runs R of a later segment.

    Returns:
        Network weights (R, size) and masked unknowns (R, 4): run r takes source r, or another one where it diverged;
        where all diverged there is nothing better, and the runs will be reported as not converged.
    """
    health = np.isfinite(source.trained.health[:, -1]).all(axis=1) & np.isfinite(source.trained.loss[:, -1])
    finite = torch.isfinite(source.weights).all(1).numpy() & health
    usable = np.flatnonzero(finite) if finite.any() else np.arange(len(finite))
    count = len(finite)
    chosen = [r % count if finite[r % count] else usable[r % len(usable)] for r in range(runs)]
    return source.weights[chosen], source.masked[chosen]
