"""A simulated engine over time, the readings beside it where there are any."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from dieseltwin.report import quantities, style
from dieseltwin.sensors import MEASURED

SHOWN = (*MEASURED, "w_af_kg_s", "torque_nm")
WIDTH_IN, PANEL_IN = 9.0, 1.5
SIMULATED = "#0072B2"


@style.styled
def beside_readings(simulated: pd.DataFrame, readings: Mapping[str, np.ndarray]) -> style.ReportFigure:
    """One panel a quantity of `SHOWN`; of another machine one a reading.

    Args:
        simulated: columns [SI], time_s among them.
        readings: column -> (n,) [SI] at the same times.
    """
    columns = [name for name in SHOWN if name in simulated] or [name for name in readings if name in simulated]
    figure = Figure(figsize=(WIDTH_IN, PANEL_IN * len(columns) + 0.6))
    panels = np.atleast_1d(figure.subplots(len(columns), 1, sharex=True))
    time_min = simulated["time_s"].to_numpy() / 60.0
    for axes, name in zip(panels, columns, strict=True):
        if name in readings and np.isfinite(readings[name]).any():
            axes.plot(time_min, quantities.shown(name, readings[name]), ".", color=style.MEASURED, markersize=2.2,
                      label="read")  # fmt: skip
        axes.plot(time_min, quantities.shown(name, simulated[name]), color=SIMULATED, linewidth=1.1, label="simulated")
        axes.set_ylabel(quantities.axis_label(name))
    panels[-1].set_xlabel("time [min]")
    panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    return style.ReportFigure("readings", "Simulated", "Simulated quantities over time, readings beside them.", figure,
                              kind="png")  # fmt: skip
