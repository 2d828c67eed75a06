"""What MLflow serves of a version: the engine with its learned maps, driven by a recording's inputs.

This file is copied into the folder of every version and runs there, so it imports nothing of this project but
`dieseltwin` with the extra `networks`, which must be installed where the model is served.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mlflow.exceptions import MlflowException
from mlflow.models import set_model
from mlflow.pyfunc import PythonModel

from dieseltwin.engine import (
    HEALTH,
    INPUT_COLUMNS,
    MEASURED,
    STATES,
    EngineParameters,
    Inputs,
    actuate,
    parameter_batch,
)
from dieseltwin.engine.simulate import settle_first
from dieseltwin.errors import DieselTwinError
from dieseltwin.recordings.reader import recording
from dieseltwin.surrogates.empirical import EmpiricalMaps
from dieseltwin.surrogates.map_compiled import compiled_simulator
from dieseltwin.surrogates.map_simulator import numpy_simulator, rest

MAPS = "maps_improved.pt"
INPUTS = ("time_s", *INPUT_COLUMNS)
OUTPUTS = ("time_s", *STATES, *(name for name in MEASURED if name not in STATES))
PARAMETERS = {**{name: name for name in HEALTH}, "p_amb_pa": "p_amb", "t_amb_k": "T_amb", "t_im_k": "T_im"}
"""Parameter of a request -> parameter of the engine."""


class Champion(PythonModel):
    """A simulation a request: inputs in, states and sensors out, from rest at the first row."""

    def load_context(self, context: Any) -> None:
        """Read the maps; the simulator is compiled now (a minute, once a machine) unless `compiled` is false."""
        self.maps = EmpiricalMaps.load(Path(context.artifacts["networks"]) / MAPS)
        if not context.model_config.get("compiled", True):
            self.simulator = numpy_simulator(self.maps.replacements("numpy"))
            return
        self.simulator = compiled_simulator(self.maps)
        rows = pd.DataFrame([[0.0, 1300.0, 90.0, 20.0, 50.0], [1.0, 1300.0, 90.0, 20.0, 50.0]], columns=list(INPUTS))
        self.predict(context, rows)

    def predict(self, context: Any, model_input: pd.DataFrame, params: dict[str, Any] | None = None) -> pd.DataFrame:
        """Simulate.

        Args:
            context: unused.
            model_input: columns `INPUTS` [s, rpm, mg/cycle, %, %], a row a sample.
            params: `PARAMETERS` [m2, m2, -, W/(m2 K), Pa, K, K]; what isn't given is the laboratory's.

        Returns:
            Columns `OUTPUTS` [s, Pa, Pa, rad/s, -, K, kg/s, K, kg/s], a row a sample.

        Raises:
            MlflowException: input that can't be simulated; the server answers with status 400 and the message.
        """
        try:
            changes = {PARAMETERS[name]: float(value) for name, value in (params or {}).items()}
            return self._simulated(model_input, self.maps.parameters.replace(**changes))
        except DieselTwinError as error:
            raise MlflowException.invalid_parameter_value(str(error)) from error

    def _simulated(self, rows: pd.DataFrame, engine: EngineParameters) -> pd.DataFrame:
        checked = recording(rows[list(INPUTS)], engine, where="request", sensors=(), any_rate=True)
        n_e, u_delta, u_egr, u_vgt = (checked.columns[name] for name in INPUT_COLUMNS)
        inputs = Inputs(checked.time_s, n_e, u_delta, u_egr, u_vgt).clipped(engine)
        start = settle_first(inputs, engine)
        first = (inputs.n_e_rpm[0], inputs.u_delta_mg[0], inputs.u_egr_pct[0], inputs.u_vgt_pct[0])
        settled = rest(self.maps.replacements("numpy"), first, engine, start)
        initial = start if settled is None else settled[:3]  # no engine rests stably everywhere
        found = self.simulator(actuate(inputs, engine), parameter_batch(engine), initial)
        columns = {"time_s": inputs.time_s, **dict(zip(STATES, found.states[0].T, strict=True))}
        columns |= dict(zip(MEASURED, np.asarray(found.measured[0]).T, strict=True))
        return pd.DataFrame({name: columns[name] for name in OUTPUTS})


set_model(Champion())
