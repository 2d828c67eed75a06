"""What an estimate was made with in place of formulae: learned empirical maps, actuator operators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from dieseltwin.engine import Actuation, EngineParameters, actuate, bind, constants
from dieseltwin.engine.binding import Model
from dieseltwin.engine.egr import egr_valve_position
from dieseltwin.identification.problem import SegmentProblem

if TYPE_CHECKING:
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.surrogates.operators import ActuatorOperators


def told_actuation(
    actuation: Actuation, operators: ActuatorOperators | None, parameters: EngineParameters
) -> Actuation:
    """The same with the actuator states [%] that the operators tell of the commands, at the samples alone."""
    if operators is None:
        return actuation
    told = operators.predict(actuation.inputs)
    u_egr = egr_valve_position(told.u_egr1, told.u_egr2, constants(parameters))
    grid = actuation.grid.copy()
    grid[2:, actuation.sample_columns] = u_egr, told.u_vgt
    return replace(actuation, u_egr1=told.u_egr1, u_egr2=told.u_egr2, u_vgt=told.u_vgt, u_egr=u_egr, grid=grid)


@dataclass(frozen=True)
class InPlace:
    """Learned parts that stood in place of formulae.

    Attributes:
        maps: empirical maps; None: the exact formulae. An engine with terms is shown with its formulae.
        operators: of the actuators; None: the exact actuators.
    """

    maps: EmpiricalMaps | None = None
    operators: ActuatorOperators | None = None

    def actuation(self, problem: SegmentProblem) -> Actuation:
        """Inputs and actuator states of a segment, as the estimate had them."""
        return told_actuation(actuate(problem.inputs, problem.parameters), self.operators, problem.parameters)

    def model(self, members: Sequence[int] | None = None) -> Model | None:
        """The equations over numpy arrays; None for the exact formulae.

        Args:
            members: a member of the maps, or dropout realisation, for each of K lanes; None: the nominal maps.
        """
        return None if self.maps is None else bind("numpy", self.maps.replacements("numpy", members))
