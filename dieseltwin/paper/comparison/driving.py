"""Pictures of the driving: one per set, laid out so that an engineer can check it at a glance.

Left the whole set, right some minutes of it, below where the engine was run and how near the limits it came.
"""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dieseltwin.duty_cycles.schedules import full_load_torque
from dieseltwin.report.style import ReportFigure, note, styled
from dieseltwin.settings.params import EcuConfig
from dieseltwin.symbols import label

SET_TITLES: Mapping[str, str] = {
    "set_i": "Set-I: WHSC, WHTC seconds 1-900, random driving",
    "set_ii": "Set-II: minutes 0-1 and 3-5 drive, 1-2 enters idle, 2-3 idles; WHTC seconds 901-1800",
    "set_iii": "Set-III: WHSC, WHTC and random driving, u_egr modified for a wider range",
    "set_iv": "Set-IV: WHSC, WHTC and random driving, u_vgt modified for a wider range",
}

SPEED, FUEL = "#0072B2", "#D55E00"
EGR, VGT = "#009E73", "#CC79A7"
INTAKE, EXHAUST = "#0072B2", "#D55E00"
LIMIT = "#555555"

# enlarged part [s]; Set-I starts with minutes of idle, so the end of its WHTC and the first random driving are shown
SET_WINDOWS_S: Mapping[str, tuple[float, float]] = {"set_i": (2650.0, 2950.0)}
DEFAULT_WINDOW_S = (0.0, 300.0)
CAPTION_WIDTH = 120  # letters a line
SHOWN_LAMBDA = 12.0  # idle and overrun lie far above; what matters is the distance to the smoke limit


class _Line(NamedTuple):
    column: str
    colour: str
    scale: float = 1.0


class _Panel(NamedTuple):
    axis_label: str
    lines: tuple[_Line, ...]
    limit: float | None = None
    limit_label: str = ""
    top: float | None = None


def _panels(ecu: EcuConfig | None) -> tuple[_Panel, ...]:
    turbo = None if ecu is None else ecu.turbo_speed_max_rad_s
    smoke = None if ecu is None else ecu.smoke_lambda_min
    return (
        _Panel(label("n_e"), (_Line("n_e_rpm", SPEED),)),
        _Panel(label("u_delta"), (_Line("u_delta_mg", FUEL),)),
        _Panel("position [%]", (_Line("u_egr_pct", EGR), _Line("u_vgt_pct", VGT))),
        _Panel("pressure [bar]", (_Line("p_em_pa", EXHAUST, 1e-5), _Line("p_im_pa", INTAKE, 1e-5))),
        _Panel(label("omega_t"), (_Line("omega_t_rad_s", SPEED),), turbo, "limit"),
        _Panel(label("lambda"), (_Line("lambda", FUEL),), smoke, "smoke limit", SHOWN_LAMBDA),
    )


@styled
def plot_set(
    frame: pd.DataFrame,
    title: str = "Driving",
    *,
    ecu: EcuConfig | None = None,
    window_s: tuple[float, float] = DEFAULT_WINDOW_S,
) -> Figure:
    """Draw a set of inputs with the engine's response.

    Args:
        frame: recording columns; time_s and the inputs are enough, panels of absent columns say so.
        title: heading of the figure.
        ecu: limits to draw.
        window_s: part shown enlarged on the right [s].
    """
    panels = _panels(ecu)
    figure = Figure(figsize=(13.0, 13.5), layout="constrained")
    figure.suptitle(title, fontsize=13, fontweight="bold")
    figure.supxlabel(fill(caption(frame, ecu), CAPTION_WIDTH), fontsize=10.5, color="#333333")
    grid = figure.add_gridspec(len(panels) + 1, 6, height_ratios=[1.0] * len(panels) + [2.0])
    time = frame["time_s"].to_numpy()
    shown = (time >= window_s[0]) & (time <= window_s[1])
    whole = time[-1] - time[0] <= window_s[1] - window_s[0]
    spans = [(0, 6)] if whole else [(0, 3), (3, 6)]
    for number, panel in enumerate(panels):
        for place, (first, last) in enumerate(spans):
            axes = figure.add_subplot(grid[number, first:last])
            part = frame if place == 0 else frame[shown]
            _draw(axes, part, panel, minutes=place == 0 and not whole, legend=place == 0)
            if number < len(panels) - 1:
                axes.tick_params(labelbottom=False)
            else:
                axes.set_xlabel("time [min]" if place == 0 and not whole else "time [s]")
            if place == 1:
                axes.set_ylabel("")
    _operating_points(figure.add_subplot(grid[-1, :2]), frame)
    _positions(figure.add_subplot(grid[-1, 2:4]), frame)
    _limits(figure.add_subplot(grid[-1, 4:]), frame, ecu)
    return figure


def _draw(axes: Axes, frame: pd.DataFrame, panel: _Panel, *, minutes: bool, legend: bool) -> None:
    time = frame["time_s"].to_numpy() / (60.0 if minutes else 1.0)
    drawn = [line for line in panel.lines if line.column in frame]
    axes.set_ylabel(panel.axis_label)
    if not drawn:
        note(axes, f"{panel.lines[0].column} not in this table")
        return
    for line in drawn:
        name = label(line.column).split(" [")[0]
        axes.plot(time, frame[line.column] * line.scale, color=line.colour, lw=0.5 if minutes else 1.0, label=name)
    if panel.limit is not None:
        axes.axhline(panel.limit, color=LIMIT, lw=0.9, ls="--", label=panel.limit_label)
    axes.set_xlim(time[0], time[-1])
    if panel.top is not None:
        axes.set_ylim(0.0, panel.top)
    else:
        axes.set_ylim(bottom=0.0)
    if legend and (len(drawn) > 1 or panel.limit is not None):
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=3, borderaxespad=0.0)  # above: hides no peak


def _counted(axes: Axes, x: np.ndarray, y: np.ndarray, extent: tuple[float, float, float, float]) -> None:
    """How much of the time was spent where, on a logarithmic grey scale."""
    axes.hexbin(x, y, gridsize=45, bins="log", cmap="Blues", mincnt=1, extent=extent, linewidths=0.1)


def _operating_points(axes: Axes, frame: pd.DataFrame) -> None:
    axes.set_title("Where the engine ran")
    axes.set_xlabel(label("n_e"))
    if "torque_nm" not in frame:
        _counted(axes, frame["n_e_rpm"].to_numpy(), frame["u_delta_mg"].to_numpy(), (550, 1950, 0, 255))
        axes.set_ylabel(label("u_delta"))
        return
    _counted(axes, frame["n_e_rpm"].to_numpy(), frame["torque_nm"].to_numpy(), (550, 1950, -300, 2300))
    speed = np.linspace(600.0, 1900.0, 100)
    axes.plot(speed, full_load_torque(speed), color=LIMIT, lw=1.0, ls="--", label="full load")
    axes.set_ylabel(label("torque_nm"))
    axes.legend(loc="upper left")


def _positions(axes: Axes, frame: pd.DataFrame) -> None:
    axes.set_title("Valve positions")
    _counted(axes, frame["u_egr_pct"].to_numpy(), frame["u_vgt_pct"].to_numpy(), (0, 100, 20, 100))
    axes.set_xlabel(label("u_egr"))
    axes.set_ylabel(label("u_vgt"))


def _limits(axes: Axes, frame: pd.DataFrame, ecu: EcuConfig | None) -> None:
    axes.set_title("EGR and smoke")
    if "lambda" not in frame or "egr_fraction" not in frame:
        note(axes, "no response in this table")
        return
    shown = frame["lambda"].to_numpy() <= SHOWN_LAMBDA
    fraction = 100.0 * frame["egr_fraction"].to_numpy()
    _counted(axes, frame["lambda"].to_numpy()[shown], fraction[shown], (0, SHOWN_LAMBDA, 0, 42))
    axes.set_xlabel(label("lambda"))
    axes.set_ylabel("EGR fraction [%]")
    axes.set_xlim(0.0, SHOWN_LAMBDA)
    axes.set_ylim(0.0, 44.0)
    if ecu is not None:
        axes.axvline(ecu.smoke_lambda_min, color=LIMIT, lw=0.9, ls="--")
        axes.axhline(100.0 * ecu.egr_fraction_max, color=LIMIT, lw=0.9, ls="--", label="limits")
        axes.legend(loc="center right")


def caption(frame: pd.DataFrame, ecu: EcuConfig | None = None) -> str:
    """The set in numbers: length, idle, ranges, and how near the limits it comes."""
    time = frame["time_s"].to_numpy()
    idle = float(np.mean(frame["n_e_rpm"].to_numpy() < 650.0))
    words = [
        f"{(time[-1] - time[0]) / 60.0:.0f} min, {idle:.0%} of it below 650 rpm; "
        f"n_e {frame['n_e_rpm'].min():.0f} to {frame['n_e_rpm'].max():.0f} rpm, "
        f"u_delta {frame['u_delta_mg'].min():.0f} to {frame['u_delta_mg'].max():.0f} mg/cycle."
    ]
    if "lambda" in frame and "egr_fraction" in frame and "omega_t_rad_s" in frame:
        words.append(
            f"Lambda at least {frame['lambda'].min():.2f}, EGR fraction up to {frame['egr_fraction'].max():.0%}, "
            f"turbo up to {frame['omega_t_rad_s'].max():.0f} rad/s."
        )
    if ecu is not None:
        words.append(
            f"Limits: lambda {ecu.smoke_lambda_min:g}, EGR fraction {ecu.egr_fraction_max:.0%}, "
            f"turbo {ecu.turbo_speed_max_rad_s:.0f} rad/s."
        )
    return " ".join(words)


def set_figure(name: str, frame: pd.DataFrame, *, ecu: EcuConfig | None = None) -> ReportFigure:
    """The picture of a set with its caption, for the report and for a file.

    Args:
        name: "set_i" ... "set_iv", or any name for other driving.
        frame: inputs with the response where known (`datasets.drive_set(...).response`, or a recording).
    """
    title = SET_TITLES.get(name, name)
    figure = plot_set(frame, title, ecu=ecu, window_s=SET_WINDOWS_S.get(name, DEFAULT_WINDOW_S))
    return ReportFigure(name, title, caption(frame, ecu), figure, kind="png")
