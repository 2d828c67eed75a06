"""Report of a calibration and of what its points call for: measured against predicted for every submodel."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dieseltwin.atomic import write_text
from dieseltwin.calibration.calibrate import Calibration
from dieseltwin.calibration.coefficients import BELIEFS
from dieseltwin.calibration.discover import PointsDiscovery
from dieseltwin.calibration.steady_model import ROWS, Relations
from dieseltwin.calibration.verdict import document
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.report.discovery_words import magnitude_words, site_words
from dieseltwin.report.style import ReportFigure, data_uri, styled

TRAIN, HELD, LINE = "#0072B2", "#D55E00", "#555555"
TITLES = {
    "cylinder_flow": ("Volumetric efficiency", "flow into the cylinders W_ei", "kg/s", 1.0),
    "turbine_flow": ("Turbine flow", "turbine flow W_t", "kg/s", 1.0),
    "turbo_power": ("Turbocharger power", "compressor power P_c (turbine power predicted)", "kW", 1e-3),
    "compressor_flow": ("Compressor flow", "compressor flow W_c", "kg/s", 1.0),
    "egr_flow": ("EGR valve", "EGR flow W_egr", "kg/s", 1.0),
    "exhaust_temperature": ("Exhaust temperature", "exhaust temperature T_em", "K", 1.0),
}
STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:1080px;margin:2rem auto;padding:0 1rem;color:#222}"
    "table{border-collapse:collapse;margin:1rem 0}td,th{padding:.25rem .7rem;border-bottom:1px solid #ddd;"
    "text-align:right}td:first-child,th:first-child{text-align:left}img{max-width:100%}"
    "figcaption{color:#555}.s{font-size:1.15rem;background:#f3f3f3;padding:.8rem 1rem}"
)


@styled
def parity(relations: Relations, mask: np.ndarray, name: str, words: str) -> ReportFigure:
    """Measured against predicted of the six submodels; the held-out third in another colour."""
    figure = Figure(figsize=(11.0, 6.8))
    panels = figure.subplots(2, 3)
    for axes, row in zip(panels.flat, ROWS, strict=True):
        title, quantity, unit, scale = TITLES[row]
        measured, predicted = relations.measured[row][0] * scale, relations.predicted[row][0] * scale
        _cross(axes, measured, predicted, mask)
        held = relations.residual[0, mask, ROWS.index(row)]
        axes.set_title(f"{title}\n{100 * np.sqrt(np.nanmean(held**2)):.1f} % held out")
        axes.set_xlabel(f"{quantity}, measured [{unit}]" if len(quantity) < 32 else f"P_c from readings [{unit}]")
        axes.set_ylabel(f"predicted [{unit}]")
    panels.flat[0].legend(loc="upper left")
    return ReportFigure(name, "Measured against predicted", words, figure)


def _cross(axes: Axes, measured: np.ndarray, predicted: np.ndarray, mask: np.ndarray) -> None:
    low, high = np.nanmin(measured), np.nanmax(measured)
    axes.plot([low, high], [low, high], color=LINE, linewidth=0.9)
    axes.plot(measured[~mask], predicted[~mask], "o", ms=3.5, color=TRAIN, alpha=0.7, label="fitted")
    axes.plot(measured[mask], predicted[mask], "^", ms=4.2, color=HELD, alpha=0.9, label="held out")


@styled
def residuals(before: Relations, after: Relations, columns: dict[str, np.ndarray], name: str) -> ReportFigure:
    """Error of three submodels over what drives it, before and after the repair."""
    figure = Figure(figsize=(11.0, 3.6))
    panels = figure.subplots(1, 3)
    wanted = [("turbine_flow", "u_flap_pct", "flap position [%]"), ("turbo_power", "u_flap_pct", "flap position [%]"),
              ("compressor_flow", "omega_t_rad_s", "turbo speed reading [rad/s]")]  # fmt: skip
    for axes, (row, column, label) in zip(panels, wanted, strict=True):
        x = columns.get(column, columns["n_e_rpm"])
        index = ROWS.index(row)
        axes.plot(x, 100 * before.residual[0, :, index], "o", ms=3, color="#b8b8b8", label="without the terms")
        axes.plot(x, 100 * after.residual[0, :, index], "o", ms=3, color=TRAIN, label="with them")
        axes.axhline(0.0, color=LINE, linewidth=0.8)
        axes.set_title(TITLES[row][0])
        axes.set_xlabel(label if column in columns else "engine speed [rpm]")
        axes.set_ylabel("measured over predicted [%]")
    panels[0].legend()
    return ReportFigure(name, "What the terms explain", "Error of a submodel at each point (100 times the logarithm of "
                        "measured over predicted), before and after the repair.", figure)  # fmt: skip


@styled
def implied_figure(columns: dict[str, np.ndarray], implied: pd.DataFrame, name: str) -> ReportFigure:
    """Implied quantities with their standard deviations over the exhaust or air flow."""
    figure = Figure(figsize=(11.0, 6.8))
    panels = figure.subplots(2, 2)
    flow = columns["w_c_kg_s"]
    for axes, (column, label, scale) in zip(panels.flat, (
        ("p_es_pa", "after the turbine p_es [kPa]", 1e-3), ("p_bc_pa", "before the compressor p_bc [kPa]", 1e-3),
        ("t_im_k", "intake manifold T_im [K]", 1.0), ("t_c_k", "behind the compressor T_c [K]", 1.0),
    ), strict=True):  # fmt: skip
        points = axes.scatter(flow, implied[column] * scale, c=columns["n_e_rpm"], s=14, cmap="viridis", zorder=3)
        axes.errorbar(flow, implied[column] * scale, implied[f"{column}_std"] * scale, fmt="none", ecolor="#c8c8c8",
                      elinewidth=0.8)
        axes.set_xlabel("air flow W_c [kg/s]")
        axes.set_ylabel(label)
    figure.colorbar(points, ax=panels, label="engine speed [rpm]")
    return ReportFigure(name, "What nobody measured", "Implied quantities with one standard deviation.", figure)


def calibration_figure(calibration: Calibration) -> ReportFigure:
    """Measured against predicted, the held-out third in another colour."""
    points = calibration.points
    relations = calibration.model.relations(points, points.states(), calibration.trained)
    return parity(relations, calibration.held_out, "submodels", "Coefficients of two thirds of the points; the third "
                  "that they never saw in orange.")


def calibration_report(calibration: Calibration, path: Path) -> list[Path]:
    """Report of `dieseltwin calibrate`: page and figures beside it; returns what was written."""
    points = calibration.points
    figure = calibration_figure(calibration)
    table = _table(
        ("submodel", "fit [%]", "held out [%]", "median [%]", "R2 held out", "tolerance [%]"),
        [(TITLES.get(n, (n,))[0], f"{f.train:.2f}", f"{f.held_out:.2f}", f"{f.median_held_out:.2f}",
          f"{f.coefficient_of_determination:.4f}", f"{100 * f.tolerance:.2f}") for n, f in calibration.fits.items()],
    )
    numbers = _table(
        ("coefficient", "submodel", "value", "std", "unit", "belief before", "verdict"),
        [(c.name, c.submodel, f"{c.value:.5g}", f"{c.std:.2g}", c.unit, f"{c.prior_mean:.4g} ± {c.prior_std:.2g}",
          c.verdict + (" (at its limit)" if c.at_bound else "")) for c in calibration.coefficients],
    )
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in calibration.notes)
    body = (
        f"<p>{points.size} points ({html.escape(points.origin)}), {int(calibration.held_out.sum())} of them held out "
        "for the figures; the saved engine uses all. Neighbouring points err alike: their information was divided by "
        f"{calibration.estimate.inflation:.1f}.</p>{table}{_picture(figure)}"
        f"<h2>What could not be told, and what was assumed</h2><ul>{notes}</ul><h2>Coefficients</h2>{numbers}"
    )
    return _write("Calibration", body, path, [figure])


def sentence(result: PointsDiscovery) -> str:
    """Where, what, how large, how much the held-out fit improved, and what could not be told apart."""
    points = result.calibration.points.judged
    if not result.mismatch:
        return (f"The {points.size} points call for nothing beyond the mean-value model "
                f"(held-out negative log-likelihood {result.nll_before:.2f} per point).")
    said = document(result)
    parts = []
    for effect in said.effects:
        if not effect.named:
            parts.append(f"what has no name: {effect.law}")
            continue
        words = magnitude_words(effect.name, float(effect.magnitude or 0.0), effect.std, effect.unit)
        phrase = EFFECTS[effect.name].phrase.format(m=words)
        site = result.rounds[0].found.twin.hypotheses[effect.name].site
        told = f" (not told apart from {', '.join(effect.equivalent_names)})" if effect.equivalent_names else ""
        parts.append(f"{phrase} in {site_words(site)}{told}")
    before, after = result.fits_before, result.fits_after
    moved = sorted(before, key=lambda row: after[row].held_out - before[row].held_out)[:2]
    figures = ", ".join(f"{TITLES[r][0].lower()} {before[r].held_out:.1f} -> {after[r].held_out:.1f} %" for r in moved)
    text = (f"The points show {'; '.join(parts)}. Held-out third: {figures}, negative log-likelihood "
            f"{result.nll_before:.1f} -> {result.nll_after:.1f} per point.")
    if result.more_is_missing:
        text += " More is missing than has a name."
    return text


def before_after_figure(result: PointsDiscovery) -> ReportFigure:
    """Errors of the submodels without and with what was found."""
    points = result.calibration.points.judged
    before, after = (here.model.relations(points, points.states(), here.start)
                     for here in (result.calibration, result.repaired))  # fmt: skip
    return residuals(before, after, dict(points.columns), "before_after")


def repaired_figure(result: PointsDiscovery) -> ReportFigure:
    """Measured against predicted with what was found."""
    points = result.calibration.points
    relations = result.repaired.model.relations(points, points.states(), result.repaired.start)
    return parity(relations, result.calibration.held_out, "submodels_repaired",
                  "With the terms found, fitted to all points; the figures in the table are of coefficients that never "
                  "saw the held-out third.")  # fmt: skip


def discovery_report(result: PointsDiscovery, implied: pd.DataFrame, words: str, path: Path) -> list[Path]:
    """Report of `dieseltwin discover` on points."""
    columns = dict(result.calibration.points.judged.columns)
    figures = [before_after_figure(result), repaired_figure(result), implied_figure(columns, implied, "implied")]
    fits = _table(
        ("submodel", "held out before [%]", "held out after [%]", "median after [%]"),
        [(TITLES[r][0], f"{result.fits_before[r].held_out:.2f}", f"{result.fits_after[r].held_out:.2f}",
          f"{result.fits_after[r].median_held_out:.2f}") for r in ROWS],
    )
    found = _table(
        ("found", "site", "magnitude", "std", "unit"),
        [(name, result.rounds[0].found.twin.hypotheses[name].site, f"{m:.4g}", f"{s:.2g}",
          result.rounds[0].found.twin.hypotheses[name].unit) for name, (m, s) in result.effects.items()],
    )
    tried = _table(
        ("round", "name", "gain in 2 log-likelihood", "taken"),
        [(str(k), fit.candidate.names[0], f"{item.found.gain(fit):.1f}",
          "yes" if item.taken and fit.candidate.names[0] in item.names else "no")
         for k, item in enumerate(result.rounds, 1) for fit in item.found.singles[:6]],
    )
    beliefs = _table(
        ("belief", "value", "std", "unit", "source"),
        [(c.name, f"{c.mean:.4g}", f"{c.std:.2g}", c.unit, c.source) for c in BELIEFS],
    )
    ways = _table(("formulation of the unmeasured places",), [(name,) for name in result.formulations])
    body = (
        f"<p class=s>{html.escape(words)}</p>{fits}{found}{_picture(figures[0])}<h2>Names tried</h2>{tried}"
        f"{_picture(figures[1])}<h2>What nobody measured</h2>{_picture(figures[2])}<p>Where the points can't tell, "
        f"stated beliefs decide; the tables hold them, and intervals hold what the formulations disagree about.</p>"
        f"{ways}{beliefs}"
    )
    return _write("What this engine has that the mean-value model lacks", body, path, figures)


def _picture(figure: ReportFigure) -> str:
    return (f"<figure><img alt='{html.escape(figure.title)}' src='{data_uri(figure.encode(), 'svg')}'>"
            f"<figcaption>{html.escape(figure.caption)}</figcaption></figure>")


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    top = "".join(f"<th>{html.escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows)
    return f"<table><tr>{top}</tr>{body}</table>"


def _write(title: str, body: str, path: Path, figures: Sequence[ReportFigure]) -> list[Path]:
    page = (f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(title)}</title>"
            f"<style>{STYLE}</style><h1>{html.escape(title)}</h1>{body}</html>\n")
    folder = path.parent / (path.stem + "_figures")
    return [write_text(path, page), *(figure.save(folder) for figure in figures)]
