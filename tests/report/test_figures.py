"""Figures: what they must carry (labels with units, legends), what they must show, and that they are repeatable."""

from __future__ import annotations

import re
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
import stored_results as synthetic
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from dieseltwin.report import quantities
from dieseltwin.report.charts import SMALLEST_RATIO, bound_ratio, identifiability_map
from dieseltwin.report.results import PARAMETERS, Results, method_from_document
from dieseltwin.report.style import TRUTH, ReportFigure, method_style
from dieseltwin.report.timeseries import RESIDUAL_LIMIT, states, trajectories
from dieseltwin.report.violins import swarm, violins
from dieseltwin.settings.methods import in_order

# a label ends in a unit in brackets, e.g. "[kPa]", "[–]", "[% of value]", "[s], logarithmic"; categories have none
UNIT = re.compile(r"\[[^\]]+\](, logarithmic)?$")
CATEGORIES = {"parameter", "method", "output"}
EXPECTED = {
    "identifiability", "violins", "violins_close", "bound_ratio", "states", "flows", "empirical", "run_times",
    "pretraining", "residuals_classical", "residuals_few_shot_newton", "residuals_few_shot_adam",
    "convergence_few_shot_adam",
}  # fmt: skip


def data_axes(figure: ReportFigure) -> list[Axes]:
    return [axes for axes in figure.figure.axes if axes.get_label() != "<colorbar>"]


def texts(axes: Axes) -> str:
    return "\n".join(text.get_text() for text in axes.texts)


def test_every_figure_of_a_full_result_is_there(figures: dict[str, ReportFigure]) -> None:
    assert set(figures) == EXPECTED


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_axes_say_quantity_and_unit(figures: dict[str, ReportFigure], name: str) -> None:
    for axes in data_axes(figures[name]):
        sharing = {
            "x": axes.get_shared_x_axes().get_siblings(axes),
            "y": axes.get_shared_y_axes().get_siblings(axes),
        }
        for which, siblings in sharing.items():
            labels = {getattr(other, f"get_{which}label")() for other in siblings} - {""}
            assert labels, f"{name}: nothing says what the {which} axis is"
            assert all(text in CATEGORIES or UNIT.search(text) for text in labels), (
                f"{name}: {which} labels {labels}"
            )


@pytest.mark.parametrize("name", sorted(EXPECTED - {"identifiability"}))
def test_figures_have_legends(figures: dict[str, ReportFigure], name: str) -> None:
    figure = figures[name].figure
    legends = list(figure.legends) + [axes.get_legend() for axes in figure.axes if axes.get_legend()]
    assert legends
    assert all(text.get_text() for legend in legends for text in legend.get_texts())


def test_captions_and_titles_are_sentences(figures: dict[str, ReportFigure]) -> None:
    for figure in figures.values():
        assert figure.title and figure.caption.endswith("."), figure.name
        assert len(figure.caption.split()) > 15, figure.name


def test_methods_keep_their_colour_and_differ(figures: dict[str, ReportFigure]) -> None:
    looks = [method.style for method in in_order()]
    assert len({look.colour for look in looks}) == len({look.marker for look in looks}) == len(looks)
    legend = figures["violins"].figure.legends[0]
    shown = {t.get_text(): h for t, h in zip(legend.get_texts(), legend.legend_handles, strict=True)}
    for method in synthetic.METHODS:
        assert shown[method].get_color() == method_style(method).colour
    assert method_style("somebody's own").colour not in {look.colour for look in looks} | {TRUTH}
    assert method_style("somebody's own") == method_style("somebody's own")


def test_violins_show_every_run_band_and_truth(results: Results, figures: dict[str, ReportFigure]) -> None:
    panels = data_axes(figures["violins"])
    assert len(panels) == len(PARAMETERS)
    newton = next(m for m in results.methods if m.method == "few-shot-newton")
    for axes, parameter in zip(panels, PARAMETERS, strict=True):
        low, high = axes.get_ylim()
        assert low < 0.925 and high > 1.075
        levels = {float(line.get_ydata()[0]) for line in axes.lines if len(set(line.get_ydata())) == 1}
        assert {1.0, 0.925, 1.075} <= levels
        colour = matplotlib.colors.to_rgb(method_style("few-shot-newton").colour)
        dots = [
            c
            for c in axes.collections
            if len(c.get_offsets()) == 30 and tuple(c.get_facecolor()[0][:3]) == colour
        ]
        first = newton.runs[(newton.runs["segment"] == 0) & (newton.runs["parameter"] == parameter)]["value"]
        expected = np.sort(first.to_numpy() / synthetic.TRUTH[parameter])
        assert any(np.allclose(np.sort(c.get_offsets()[:, 1]), expected) for c in dots)


def test_segments_without_information_are_marked(results: Results, figures: dict[str, ReportFigure]) -> None:
    for name in ("violins", "violins_close"):
        panels = data_axes(figures[name])
        assert "not identifiable here" in texts(panels[PARAMETERS.index("A_egrmax")])
        assert "not identifiable here" not in texts(panels[PARAMETERS.index("A_vgtmax")])
    axes = data_axes(figures["identifiability"])[0]
    hatched = [p for p in axes.patches if isinstance(p, Patch) and p.get_hatch()]
    flags = [not s.parameters[p].identifiable for s in results.segments for p in PARAMETERS]
    assert len(hatched) == sum(flags) > 0
    # no mark of an unidentifiable segment in the chart against the bound
    panel = data_axes(figures["bound_ratio"])[PARAMETERS.index("A_egrmax")]
    marks = [
        float(line.get_xdata()[0]) for line in panel.lines if line.get_marker() not in ("None", None, "")
    ]
    assert marks and not any(synthetic.SHUT - 0.5 < x < synthetic.SHUT + 0.5 for x in marks)


def test_identifiability_map_prints_the_bounds(results: Results, figures: dict[str, ReportFigure]) -> None:
    axes = data_axes(figures["identifiability"])[0]
    estimate = results.segments[0].parameters["A_vgtmax"]
    assert f"{quantities.significant(100 * estimate.bound / estimate.mean, 2)} %" in texts(axes)


def test_bound_chart_puts_error_over_bound(results: Results) -> None:
    axes = data_axes(bound_ratio(results))[PARAMETERS.index("h_tot")]
    method = results.methods[0]
    values = method.runs[(method.runs["segment"] == 0) & (method.runs["parameter"] == "h_tot")]["value"]
    ratio = (
        float(np.sqrt(np.mean((values - synthetic.TRUTH["h_tot"]) ** 2)))
        / method.segments[0].parameters["h_tot"].bound
    )
    drawn = [float(line.get_ydata()[0]) for line in axes.lines if len(line.get_ydata()) == 1]
    assert any(value == pytest.approx(max(ratio, SMALLEST_RATIO)) for value in drawn)


def test_a_std_below_the_bound_is_called_too_sure(results: Results) -> None:
    assert "too narrow" not in bound_ratio(results).caption
    document = synthetic.document("classical", segments=2)
    entry = document["segments"][1]["parameters"]["eta_sc"]
    entry["std"] = 0.4 * entry["bound"]
    sure = Results(methods=(method_from_document(document),))
    assert "classical states well below the bound for eta_sc (1–2 min)" in bound_ratio(sure).caption


def test_pressures_in_kpa(results: Results, figures: dict[str, ReportFigure]) -> None:
    axes = next(a for a in data_axes(figures["states"]) if "p_{im}" in a.get_ylabel())
    assert axes.get_ylabel() == "$p_{im}$ [kPa]"
    truth = next(line for line in axes.lines if line.get_color() == TRUTH)
    assert results.truth_states is not None
    assert np.allclose(truth.get_ydata(), results.truth_states["p_im_pa"] / 1000)


def test_lines_break_between_segments(results: Results) -> None:
    figure = states(replace(results, truth_states=None, measured=None))
    assert figure is not None
    line = next(
        line for line in figure.figure.axes[0].lines if line.get_color() == method_style("classical").colour
    )
    assert np.isnan(line.get_ydata()).sum() == len(results.segments) - 1


def test_a_gap_in_the_recording_breaks_the_line(results: Results) -> None:
    method = results.methods[0]
    assert method.states is not None
    one = method.states[method.states["segment"] == 0]
    gap = replace(method, states=one[(one["time_s"] < 20) | (one["time_s"] > 30)])
    figure = trajectories(Results(methods=(gap,)), ("p_im_pa",), "x", "x", "x")
    assert figure is not None
    assert np.isnan(figure.figure.axes[0].lines[0].get_ydata()).sum() == 1


def test_residuals_are_in_standard_deviations(figures: dict[str, ReportFigure]) -> None:
    axes = data_axes(figures["residuals_classical"])
    values = np.concatenate([line.get_ydata() for line in axes[0].lines if line.get_marker() == "."])
    assert 0.9 < values.std() < 1.1
    assert np.abs(values).max() <= RESIDUAL_LIMIT


def test_files_are_repeatable(results: Results) -> None:
    assert identifiability_map(results).encode() == identifiability_map(results).encode()
    picture = replace(bound_ratio(results), kind="png")
    assert picture.encode() == picture.encode()


def test_drawing_leaves_global_settings_alone(results: Results) -> None:
    before = dict(matplotlib.rcParams)
    identifiability_map(results)
    assert dict(matplotlib.rcParams) == before


def test_swarm_separates_equal_dots_and_stays_inside() -> None:
    values = np.array([1.0, 1.0, 1.0, 1.2])
    places = swarm(values, 0.3, 0.01)
    assert len(set(places[:3])) == 3 and places[3] == 0.0
    assert np.abs(swarm(np.ones(200), 0.3, 0.01)).max() <= 0.3


def test_many_segments_stay_readable() -> None:
    root = {m: synthetic.document(m, segments=30) for m in ("classical",)}
    many = Results(methods=tuple(method_from_document(d) for d in root.values()), truth=synthetic.TRUTH)
    axes = data_axes(violins(many))[-1]
    assert len(axes.get_xticks()) <= 24
