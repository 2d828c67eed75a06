"""How wrong the physics residual of the right trajectory is: calibrated on the laboratory twin, never on field data.

Even the true states leave a residual on a basis: the basis cannot follow them (defect, see `defects`), and learned maps
are not the formulae. The laboratory engine is simulated over the segment's own inputs, its clean states are projected
on the heads, and the residual that remains at laboratory parameters is the process noise of each equation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dieseltwin.arrays import MAD_TO_STD
from dieseltwin.engine import HEALTH, Actuation, EngineParameters, parameter_batch, simulate_states
from dieseltwin.engine.simulate import settle_first
from dieseltwin.identification.few_shot.defects import Defects, Windows, defects_of, simulate_windows
from dieseltwin.identification.few_shot.heads import Heads, Trajectory
from dieseltwin.identification.few_shot.residuals import DrivenInputs, PointModel
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.settings import NewtonConfig

NEIGHBOURS = 1
"""Samples on each side whose defect counts for a point: the basis smears a kink over its neighbours."""


@dataclass(frozen=True)
class Setting:
    """Everything about one segment that its runs share.

    Attributes:
        problem: the segment.
        actuation: at the step of the windows' simulation.
        heads, inputs, windows: of the segment.
        exact: the model that the simulator integrates.
    """

    problem: SegmentProblem
    actuation: Actuation
    heads: Heads
    inputs: DrivenInputs
    windows: Windows
    exact: PointModel


@dataclass(frozen=True)
class ProcessNoise:
    """Standard deviation of the physics residuals of one segment.

    Attributes:
        floor: (3,) level of every point [Pa/s, Pa/s, rad/s2].
        defect_share: share of the local defect that is believed to remain after its correction [-].
    """

    floor: Tensor
    defect_share: float

    def at(self, rate_defect: Tensor) -> Tensor:
        """Standard deviation at each point, given the defect there, (R, n, 3) [Pa/s, Pa/s, rad/s2].

        Points that the basis does not resolve get a proportionally larger noise: the correction is right to some tens
        of per cent of itself only, because it belongs to the last estimate.
        """
        size = rate_defect.abs().transpose(1, 2)
        local = torch.nn.functional.max_pool1d(size, 2 * NEIGHBOURS + 1, 1, NEIGHBOURS).transpose(1, 2)
        return (self.floor**2 + (self.defect_share * local) ** 2).sqrt()


def laboratory_states(actuation: Actuation, parameters: EngineParameters) -> Tensor:
    """Clean states of the laboratory engine over a segment's inputs, at rest at its first sample; (1, n, 3)."""
    initial = settle_first(actuation.inputs, parameters)
    states = simulate_states(actuation, parameter_batch(parameters), initial).states[..., :3]
    return torch.from_numpy(np.ascontiguousarray(states))


def calibrate(setting: Setting, model: PointModel, settings: NewtonConfig) -> ProcessNoise:
    """Calibrate the process noise of one segment on the laboratory twin.

    Args:
        setting: the segment; its parameters are the laboratory's.
        model: the model of the estimator, learned maps included; one lane or R lanes of members.
        settings: `defect_share`, see `ProcessNoise`; `floor_share`: of the median defect that the floor doesn't fall
            below [-]: the equations must not become a hard constraint while the defect still belongs to another
            estimate; `noticed_share`: a residual that, kept up for the whole segment, would move a state by less than
            this share of the standard error of its mean reading is too small to be noticed [-]. Nothing is gained by
            forbidding it, and at idle, where the basis misses next to nothing, no step could follow equations that
            hard.

    Returns:
        The process noise.
    """
    parameters, heads, inputs = setting.problem.parameters, setting.heads, setting.inputs
    states = laboratory_states(setting.actuation, parameters)
    health = torch.log(torch.tensor([[float(getattr(parameters, name)) for name in HEALTH]], dtype=torch.float64))
    path = heads.trajectory(heads.project(states))
    found = _defects(setting, path, health)
    lanes = model.lanes
    point = model(path.states.expand(lanes, -1, -1), health.expand(lanes, -1), inputs, derivatives=False)
    remaining = path.rates - point.rates - found.rate
    # by medians: transients must not set the level of all points
    level = MAD_TO_STD * remaining.abs().flatten(0, 1).median(0).values
    resolved = MAD_TO_STD * found.rate.abs().flatten(0, 1).median(0).values
    sigma = torch.from_numpy(setting.problem.sigma[:3])
    noticed = settings.noticed_share * _restoring(setting.exact, inputs, states, health) * sigma / len(states[0]) ** 0.5
    floor = (level**2 + (settings.floor_share * resolved) ** 2 + noticed**2).sqrt()
    return ProcessNoise(floor, settings.defect_share)


def _restoring(exact: PointModel, inputs: DrivenInputs, states: Tensor, health: Tensor) -> Tensor:
    """(3,) median size of the rate that drives each state back, per unit of the state [1/s]."""
    slopes = exact(states, health, inputs).slopes
    if slopes is None:
        raise ValueError("the model returned no derivatives")
    return torch.diagonal(slopes[0, :3, :3]).abs().median(0).values


def _defects(setting: Setting, path: Trajectory, log_health: Tensor) -> Defects:
    """Defects as the estimator finds them: from windows that start on the projected trajectory."""
    health = torch.exp(log_health).numpy()
    fine, forcing = simulate_windows(setting.windows, setting.problem.parameters, health, path.states.numpy())
    return defects_of(setting.heads, setting.inputs, setting.exact, log_health, fine, forcing, path.states)
