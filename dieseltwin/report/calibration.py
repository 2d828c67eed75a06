"""Report of a calibration: measured against predicted for every submodel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from markupsafe import escape

from dieseltwin.calibration.calibrate import Calibration
from dieseltwin.calibration.steady_model import ROWS, Relations
from dieseltwin.report.interactive import Line, Series, over, still
from dieseltwin.report.page import Page, Section, Table, write_page
from dieseltwin.report.style import AFTER, BEFORE
from dieseltwin.version import __version__

TRAIN, HELD, LINE = AFTER, BEFORE, "#555555"
TITLES = {
    "cylinder_flow": ("Volumetric efficiency", "flow into the cylinders W_ei", "kg/s", 1.0),
    "turbine_flow": ("Turbine flow", "turbine flow W_t", "kg/s", 1.0),
    "turbo_power": ("Turbocharger power", "compressor power P_c", "kW", 1e-3),
    "compressor_flow": ("Compressor flow", "compressor flow W_c", "kg/s", 1.0),
    "egr_flow": ("EGR valve", "EGR flow W_egr", "kg/s", 1.0),
    "exhaust_temperature": ("Exhaust temperature", "exhaust temperature T_em", "K", 1.0),
    "compressor_work": ("Compressor work", "compressor efficiency eta_c", "-", 1.0),
    "T_im": ("Charge temperature", "charge temperature T_im", "K", 1.0),
    "T_c": ("Temperature behind the compressor", "temperature behind the compressor T_c", "K", 1.0),
    "p_es": ("Pressure behind the turbine", "pressure behind the turbine p_es", "kPa", 1e-3),
    "p_bc": ("Pressure before the compressor", "pressure before the compressor p_bc", "kPa", 1e-3),
}
"""Row of `SteadyModel.relations` -> title of its figure, measured quantity, unit, scale."""


def parity(relations: Relations, mask: np.ndarray, told: tuple[str, str, str]) -> Series:
    """Measured against predicted of the six submodels; the held-out third in another colour.

    Args:
        relations: at the n points.
        mask: (n,) the held-out third.
        told: name, title and caption of the figure for paper.
    """
    panels = []
    for row in ROWS:
        title, quantity, unit, scale = TITLES[row]
        measured, predicted = relations.measured[row][0] * scale, relations.predicted[row][0] * scale
        held = relations.residual[0, mask, ROWS.index(row)]
        dots = (("fitted", TRAIN, ~mask), ("held out", HELD, mask))
        lines = (Line("equal", LINE, measured), *(Line(label, colour, np.where(chosen, predicted, np.nan), dots=True)
                                                  for label, colour, chosen in dots))  # fmt: skip
        name = f"{title}, predicted; {100 * np.sqrt(np.nanmean(held**2)):.1f} % off held out"
        panels.append(over(name, unit, (f"{quantity}, measured", unit), measured, lines))
    series = Series(tuple(panels), linked=False)
    return replace(series, drawn=still(series, told))


def submodels(calibration: Calibration) -> Series:
    """Measured against predicted of a calibration."""
    points = calibration.points
    relations = calibration.model.relations(points, points.states(), calibration.trained)
    return parity(relations, calibration.held_out, (
        "submodels", "Measured against predicted", "Coefficients of two thirds of the points; the third that they "
        "never saw in orange."))  # fmt: skip


def calibration_report(calibration: Calibration, path: Path) -> list[Path]:
    """Report of `dieseltwin calibrate`: page and figures beside it; returns what was written."""
    points = calibration.points
    fits = Table(
        ("submodel", "fit [%]", "held out [%]", "median [%]", "R2 held out", "tolerance [%]"),
        [(TITLES.get(n, (n,))[0], f"{f.train:.2f}", f"{f.held_out:.2f}", f"{f.median_held_out:.2f}",
          f"{f.coefficient_of_determination:.4f}", f"{100 * f.tolerance:.2f}") for n, f in calibration.fits.items()],
    )
    numbers = Table(
        ("coefficient", "submodel", "value", "std", "unit", "belief before", "verdict"),
        [(c.name, c.submodel, f"{c.value:.5g}", f"{c.std:.2g}", c.unit, f"{c.prior_mean:.4g} ± {c.prior_std:.2g}",
          c.verdict + (" (at its limit)" if c.at_bound else "")) for c in calibration.coefficients],
        words=(0, 1, 4, 6),
    )
    page = Page(
        title="Calibration", about=f"{points.path.name if points.path else 'points'} · {points.size} points",
        headline=escape(
            f"{points.size} points ({points.origin}), {int(calibration.held_out.sum())} of them held out for the "
            "figures; the saved engine uses all. Neighbouring points err alike: their information was divided by "
            f"{calibration.estimate.inflation:.1f}."),
        alarm=False, tables=(fits,),
        sections=(
            Section("submodels", "Measured against predicted", series=submodels(calibration)),
            Section("notes", "What could not be told, and what was assumed",
                    tables=(Table(("note",), [(note,) for note in calibration.notes], words=(0,), long=(0,)),)),
            Section("coefficients", "Coefficients", tables=(numbers,)),
        ),
        provenance=[("points", str(points.path or "")), ("SHA-256 of the points", points.sha256),
                    ("code version", __version__)],
    )  # fmt: skip
    folder = path.parent / (path.stem + "_figures")
    written = write_page(page, path, folder)
    return [written, *(folder / f"{figure.name}.{figure.kind}" for s in page.sections for figure in s.drawn)]
