"""The page of a discovery on settled points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from dieseltwin.calibration.coefficients import BELIEFS
from dieseltwin.calibration.discover import PointsDiscovery
from dieseltwin.calibration.steady_model import ROWS, Relations, law_variables
from dieseltwin.calibration.verdict import document, shares
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.discovery.verdict.reasons import candidate_rows
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.terms import LawTerm, OneTerm, SensorTerm, Term
from dieseltwin.recordings.steady_points import JUDGED
from dieseltwin.report import findings, quantities
from dieseltwin.report.calibration import TITLES, parity
from dieseltwin.report.discovery_words import magnitude_words, site_words
from dieseltwin.report.interactive import Line, Panel, Series, over, still
from dieseltwin.report.law_cards import law_cards
from dieseltwin.report.page import Page, Section, Table
from dieseltwin.report.style import AFTER, BEFORE, ReportFigure, styled
from dieseltwin.sensors import SENSORS

IMPLIED = (("p_es_pa", "behind the turbine p_es", "kPa", 1e-3), ("p_bc_pa", "before the compressor p_bc", "kPa", 1e-3),
           ("t_im_k", "intake manifold T_im", "K", 1.0), ("t_c_k", "behind the compressor T_c", "K", 1.0))  # fmt: skip
LIGHT = "#b8b8b8"
MOST_MOVED = 3  # submodels that are drawn over a law's argument
ERRORS = ("100 times the logarithm of measured over predicted at each point, without and with what was found, all "
          "coefficients fitted to all points.")  # fmt: skip
MAPS_BEND = (" The maps are fitted to these very points and can take up a fault that acts in all of them: beside "
             "points from when the engine was well (--reference) a far smaller one shows.")
BELIEVED = ("Where the points can't tell, stated beliefs decide; the tables hold them, and intervals hold what the "
            "formulations disagree about.")  # fmt: skip


def sentence(result: PointsDiscovery) -> str:
    """Where, what, how large, how much the held-out fit improved, and what could not be told apart."""
    points = result.calibration.points.judged
    if not result.mismatch:
        alone = "" if JUDGED in result.calibration.points else MAPS_BEND
        return (f"The {points.size} points call for nothing beyond the mean-value model "
                f"(held-out negative log-likelihood {result.nll_before:.2f} per point).{alone}")
    said = document(result)
    parts = []
    for effect in said.effects:
        if not effect.named:
            parts.append(f"what has no name: {effect.law}")
            continue
        words = magnitude_words(effect.name, float(effect.magnitude or 0.0), effect.std, effect.unit)
        phrase = EFFECTS[effect.name].phrase.format(m=words)
        site = result.rounds[0].found.twin.hypotheses[effect.name].site
        split = f"; {effect.split_by} would" if effect.split_by else ""
        told = f" (not told apart from {', '.join(effect.equivalent_names)}{split})" if effect.equivalent_names else ""
        since = "" if effect.since_row is None else f" since data row {effect.since_row}"
        parts.append(f"{phrase} in {site_words(site)}{since}{told}")
    before, after = result.fits_before, result.fits_after
    moved = sorted(before, key=lambda row: after[row].held_out - before[row].held_out)[:2]
    figures = ", ".join(f"{TITLES[r][0].lower()} {before[r].held_out:.1f} -> {after[r].held_out:.1f} %" for r in moved)
    share = said.fit.share_explained
    whole = "" if share is None else f" This explains {findings.share_words(share)} of the misfit beyond tolerances."
    # each name was held against the points without the few that differ most (`calibration.held_out`)
    higher = bool(result.effects) and result.nll_after >= result.nll_before
    few = ", lower but for the few points that differ most" if higher else ""
    text = (f"The points show {'; '.join(parts)}.{whole} Held-out third: {figures}, negative log-likelihood "
            f"{result.nll_before:.1f} -> {result.nll_after:.1f} per point{few}.")
    if result.more_is_missing:
        text += " More is missing than has a name."
    return text


def name_words(name: str) -> str:
    """A name as printed: that of a reading's error, "t_em_k:offset", in words; others as they are."""
    column, _, kind = name.partition(":")
    sensor = next((sensor for sensor in SENSORS if sensor.column == column), None)
    if sensor is None or kind not in ("gain", "offset"):
        return name
    return f"{'a gain error' if kind == 'gain' else 'an offset'} of the {sensor.name} reading"


def _relations(result: PointsDiscovery) -> tuple[Relations, Relations]:
    """At the judged points, without and with what was found."""
    points = result.points.judged
    states = points.states()
    before, after = (here.model.relations(points, states, here.start) for here in (result.calibration, result.repaired))
    return before, after


def _errors(result: PointsDiscovery, row: str, both: tuple[Relations, Relations]) -> list[Line]:
    """Error of a submodel at each point [%]."""
    before, after = (100.0 * relations.residual[0, :, ROWS.index(row)] for relations in both)
    if not result.mismatch:
        return [Line("error", AFTER, after, dots=True)]
    return [Line("without", BEFORE, before, dots=True), Line("with it", AFTER, after, dots=True)]


def over_points(result: PointsDiscovery) -> Series:
    """Error of every submodel over the number of the point."""
    points, both = result.calibration.points.judged, _relations(result)
    panels = tuple(over(f"{TITLES[row][0]}, error", "%", ("row of the file", ""), points.row.astype(np.float64),
                        _errors(result, row, both)) for row in ROWS)  # fmt: skip
    series = Series(panels)
    return replace(series, drawn=still(series, ("errors", "Errors point by point", ERRORS)))


def over_arguments(result: PointsDiscovery) -> Series | None:
    """Errors of the submodels that moved most over the argument of each law that was found; None without any."""
    points, both = result.points.judged, _relations(result)
    variables = law_variables(points, {name: np.asarray(v[0]) for name, v in both[1].quantities.items()})
    variables = {**variables, **points.columns}
    moved = np.nansum(both[0].residual[0] ** 2 - both[1].residual[0] ** 2, axis=0)[: len(ROWS)]
    rows = [ROWS[i] for i in np.argsort(-moved)[:MOST_MOVED]]
    panels: list[Panel] = []
    for name in dict.fromkeys(a for term in result.terms() for a in _arguments(term)):
        x = _argument(name, variables)
        if x is None:
            continue
        axis = f"{quantities.words(name)} ({name})" if quantities.known(name) else name
        unit = quantities.unit(name) or ("%" if name.endswith("_pct") else "")
        panels += [over(f"{TITLES[row][0]}, error", "%", (axis, unit), quantities.shown(name, x),
                        _errors(result, row, both)) for row in rows]  # fmt: skip
    if not panels:
        return None
    series = Series(tuple(panels), linked=False)
    return replace(series, drawn=still(series, ("before_after", "What the terms explain", ERRORS)))


def _arguments(term: OneTerm) -> tuple[str, ...]:
    """What a found term depends on: an input that it needs, else its main argument."""
    if isinstance(term, Term):
        effect = EFFECTS[term.effect]
        return effect.needs or ((effect.curve.over,) if effect.curve is not None else ())
    if isinstance(term, SensorTerm):
        return (term.sensor,)
    if isinstance(term, LawTerm):
        names = [*(name for name, *_ in term.factors), *(name for group in term.groups for name in group.variables)]
        return tuple(dict.fromkeys(names))
    return ()


def _argument(name: str, variables: Mapping[str, Array]) -> Array | None:
    upper, _, lower = name.partition("/")
    if upper not in variables or (lower and lower not in variables):
        return None
    return np.ravel(variables[upper] / variables[lower] if lower else variables[upper])


def submodels(result: PointsDiscovery) -> Series:
    """Measured against predicted with what was found."""
    points = result.points
    relations = result.repaired.model.relations(points, points.states(), result.repaired.start)
    return parity(relations, result.calibration.held_out, (
        "submodels_repaired", "Measured against predicted", "With the terms found, fitted to all points; the figures "
        "in the table are of coefficients that never saw the held-out third."))  # fmt: skip


@styled
def implied_figure(columns: Mapping[str, Array], implied: pd.DataFrame) -> ReportFigure:
    """Implied quantities with their standard deviations over the exhaust or air flow."""
    figure = Figure(figsize=(11.0, 6.8))
    panels = figure.subplots(2, 2)
    flow = columns["w_c_kg_s"]
    for axes, (column, label, unit, scale) in zip(panels.flat, IMPLIED, strict=True):
        points = axes.scatter(flow, implied[column] * scale, c=columns["n_e_rpm"], s=14, cmap="viridis", zorder=3)
        axes.errorbar(flow, implied[column] * scale, implied[f"{column}_std"] * scale, fmt="none", ecolor="#c8c8c8",
                      elinewidth=0.8)
        axes.set_xlabel("air flow W_c [kg/s]")
        axes.set_ylabel(f"{label} [{unit}]")
    figure.colorbar(points, ax=panels, label="engine speed [rpm]")
    return ReportFigure("implied", "What nobody measured", "Implied quantities with one standard deviation.", figure)


def implied_series(columns: Mapping[str, Array], implied: pd.DataFrame) -> Series:
    """The same to look into."""
    panels = []
    for column, label, unit, scale in IMPLIED:
        value, std = (scale * implied[name].to_numpy(dtype=np.float64) for name in (column, f"{column}_std"))
        lines = (Line("implied", AFTER, value, dots=True), Line("less a std", LIGHT, value - std, dots=True),
                 Line("and a std", LIGHT, value + std, dots=True))  # fmt: skip
        panels.append(over(label, unit, ("air flow W_c", "kg/s"), columns["w_c_kg_s"], lines))
    return Series(tuple(panels), linked=False, drawn=implied_figure(columns, implied))


def points_page(result: PointsDiscovery, said: Discrepancy, words: str, implied: pd.DataFrame) -> Page:
    """What the page says.

    Args:
        result: every round and both calibrations.
        said, words: the verdict.
        implied: what nobody measured, a row a point.
    """
    points, first = result.calibration.points.judged, result.rounds[0].found
    units = {name: hypothesis.unit for name, hypothesis in first.twin.hypotheses.items()}
    fits = Table(
        ("submodel", "held out before [%]", "held out after [%]", "median after [%]"),
        [(TITLES[r][0], f"{result.fits_before[r].held_out:.2f}", f"{result.fits_after[r].held_out:.2f}",
          f"{result.fits_after[r].median_held_out:.2f}") for r in ROWS],
    )
    rounds = Table(
        ("round", "name", "gain in 2 log-likelihood", "taken"),
        [(str(k), name_words(name) + since, f"{item.found.gain(fit):.1f}", "yes" if taken else "no")
         for k, item in enumerate(result.rounds, 1) for name, since, fit, taken in item.tried(6)], words=(0, 1, 3),
    )
    beliefs = Table(
        ("belief", "value", "std", "unit", "source"),
        [(c.name, f"{c.mean:.4g}", f"{c.std:.2g}", c.unit, c.source) for c in BELIEFS], words=(0, 3, 4), long=(4,),
    )
    ways = Table(("formulation of the unmeasured places",), [(name,) for name in result.formulations])
    sections = (
        Section("points", "Point by point", series=over_points(result)),
        Section("law-of-it", "Over what the law depends on", series=over_arguments(result)),
        Section("held-out", "Held-out third", series=submodels(result), tables=(fits,)),
        Section("implied", "What nobody measured", words=BELIEVED,
                series=implied_series(points.columns, implied), tables=(ways, beliefs)),
        Section("doubts", "What is doubtful", tables=(findings.doubts(said),)),
        Section("weighed", "Candidates", tables=(findings.weighed(candidate_rows(first), units), rounds)),
        Section("visible", "What could be seen", tables=(findings.visible(said, units),)),
    )
    return Page(
        title=findings.heading(said), about=f"{said.recording.path} · {points.size} settled points · "
        f"{len(said.recording.channels)} sensors", headline=quantities.with_symbols(words),
        alarm=said.mismatch, findings=findings.findings(said, shares(result), timed=False),
        cards=law_cards(said, judged="These points"),
        tables=(findings.places(said), findings.levels(said, "health parameter"), findings.fit(said)),
        sections=sections, provenance=findings.provenance(said),
    )  # fmt: skip
