"""The mean-value engine model: equations, parameters and the compiled simulator."""

from dieseltwin.engine.actuation import actuate
from dieseltwin.engine.binding import MAPS, Model, bind
from dieseltwin.engine.engine_files import load_engine
from dieseltwin.engine.inputs import DEFAULT_STEP_S, INPUT_COLUMNS, Actuation, Inputs
from dieseltwin.engine.model_constants import Constants
from dieseltwin.engine.parameters import (
    HEALTH,
    HEALTH_UNITS,
    EngineParameters,
    ParameterBatch,
    constants,
    parameter_batch,
)
from dieseltwin.engine.quantities import Quantities, Sweep
from dieseltwin.engine.simulate import Observations, quantities_frame, settle, simulate, simulate_states
from dieseltwin.sensors import MEASURED
from dieseltwin.symbols import STATES

__all__ = [
    "DEFAULT_STEP_S", "HEALTH", "HEALTH_UNITS", "INPUT_COLUMNS", "MAPS", "MEASURED", "STATES",
    "Actuation", "Constants", "EngineParameters", "Inputs", "Model", "Observations", "ParameterBatch", "Quantities",
    "Sweep", "actuate", "bind", "constants", "load_engine", "parameter_batch", "quantities_frame", "settle", "simulate",
    "simulate_states",
]  # fmt: skip
