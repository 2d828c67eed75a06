"""Figures and the page of a discovery on a petrol engine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dieseltwin.atomic import write_bytes, write_text
from dieseltwin.petrol.calibrate import SubmodelFit
from dieseltwin.petrol.discover import PetrolDiscovery
from dieseltwin.petrol.parameters import FaultFreePiece
from dieseltwin.report import style
from dieseltwin.report.style import ReportFigure

BEFORE, AFTER, LIMIT = "#D55E00", "#0072B2", "#000000"
TITLES = {"cylinder": "cylinder flow: air flow against η_vol(ω_e, p_im)", "throttle": "throttle: air flow against A(α)",
          "boost": "p_ic against p_amb at rest", "cooler": "T_ic against T_amb"}
SHOWN = ("cylinder", "throttle", "boost")
CLIP = 0.25  # of a residual in the figures [-]
SMOOTH_BLOCKS = 15  # running median: structure, not tip-ins
MOST_SHOWN = 8  # effects in the figure of what was weighed


def _running_median(x: np.ndarray, width: int) -> np.ndarray:
    half = width // 2
    padded = np.pad(x, half, mode="reflect")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1))


def _misfits(found: PetrolDiscovery, name: str) -> tuple[np.ndarray, list[tuple[np.ndarray, str, str]]]:
    """Blocks that count, and a balance's misfit there as read and, where something was found, with it taken back."""
    twin = found.twin
    j = twin.channels.index(name)
    kept = np.isfinite(twin.measured[:, j])
    repaired = twin.measured[:, j] - found.after[:, j]
    states = [(twin.measured[:, j], BEFORE if found.document.mismatch else AFTER, "as read")]
    if found.document.mismatch:
        states.append((repaired, AFTER, "repaired"))
    return kept, [(np.clip(values[kept], -CLIP, CLIP), colour, label) for values, colour, label in states]


def _onset(found: PetrolDiscovery) -> float | None:
    """Middle of the first block in which the effect acts [s since the recording's start]."""
    variant = found.search.variant
    return None if variant is None or found.search.kind != "variant" else variant.onset_s


@style.styled
def residuals_over_time(found: PetrolDiscovery) -> ReportFigure:
    """Each balance over time, before and after what was found is taken back."""
    shown = [name for name in SHOWN if name in found.twin.channels]
    figure = Figure(figsize=(9.0, 2.2 * len(shown)))
    axes: Sequence[Axes] = list(figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0])
    onset = _onset(found)
    for panel, name in zip(axes, shown, strict=True):
        kept, states = _misfits(found, name)
        time_s = found.twin.time_s[kept]
        for residual, colour, label in states:
            panel.plot(time_s, 100.0 * residual, ".", ms=1.5, color=colour, alpha=0.2, zorder=1)
            if len(residual) > SMOOTH_BLOCKS:
                panel.plot(time_s, 100.0 * _running_median(residual, SMOOTH_BLOCKS), color=colour, lw=1.3, label=label)
        panel.axhline(0.0, color=LIMIT, lw=0.6)
        panel.set_ylabel("misfit [%]")
        panel.set_title(TITLES[name])
        if onset is not None:
            panel.axvline(onset, color=LIMIT, lw=1.0, ls="--")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    axes[-1].set_xlabel("time since the recording's start [s]")
    caption = ("Misfit of the balances against the calibrated maps: as read, and with the explanation and the levels "
               "fitted beside it taken back. Seconds as points (cut at 25 %), running median over 15 s as lines. "
               "Dashed: the onset.")
    return ReportFigure("residuals_over_time", "The balances over time", caption, figure, "png")


@style.styled
def candidates(found: PetrolDiscovery) -> ReportFigure:
    """Gain of the leading effects, with the threshold."""
    rows = found.candidates[:MOST_SHOWN][::-1]
    figure = Figure(figsize=(8.0, 0.45 * len(rows) + 1.3))
    axes = figure.subplots()
    names = {e.name for e in found.document.effects}
    for row, c in enumerate(rows):
        gain = max(2.0 * (c["log_likelihood_gain"] or 0.0), 0.0)
        axes.barh(row, gain, color=BEFORE if c["name"] in names else style.MEASURED)
        axes.annotate(_size(c["magnitude"] or 0.0, found.twin.hypotheses[c["name"]].unit), (gain, row), xytext=(4, 0),
                      textcoords="offset points", va="center", fontsize=9)
    axes.axvline(found.threshold, color=LIMIT, ls="--", lw=1.0)
    axes.set_yticks(range(len(rows)), [c["name"] for c in rows])
    axes.margins(x=0.15)
    axes.set_xlabel("decrease of -2 log likelihood; dashed: alarm of an effect that is there all along")
    caption = "The leading effects, each refitted by itself, with its onset where it has one."
    return ReportFigure("candidates", "What was weighed", caption, figure)


def _size(value: float, unit: str) -> str:
    return f"{100 * value:+.1f} %" if unit == "-" else f"{value:.3g} {unit}"


@style.styled
def over_pressure(found: PetrolDiscovery) -> ReportFigure:
    """Cylinder and throttle balance over the manifold pressure: gain, leak and offset have other shapes."""
    shown = [name for name in ("cylinder", "throttle") if name in found.twin.channels]
    figure = Figure(figsize=(9.0, 3.6))
    axes = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    onset = _onset(found)
    for panel, name in zip(axes, shown, strict=True):
        kept, states = _misfits(found, name)
        late = np.ones(int(kept.sum()), dtype=bool) if onset is None else found.twin.time_s[kept] >= onset
        for residual, colour, label in states:
            panel.plot(1e-3 * found.twin.blocks.p_im[kept][late], 100.0 * residual[late], ".", ms=2.5, alpha=0.35,
                       color=colour, label=label)
        panel.axhline(0.0, color=LIMIT, lw=0.6)
        panel.set_title(TITLES[name].split(":")[0])
        panel.set_xlabel("p_im [kPa]")
    axes[0].set_ylabel("misfit [%]")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, markerscale=3)
    caption = "Seconds after the onset over p_im. A gain shifts evenly, a leak most at low load."
    return ReportFigure("over_pressure", "Over the operating range", caption, figure, "png")


def all_figures(found: PetrolDiscovery) -> list[ReportFigure]:
    """The page's figures."""
    return [residuals_over_time(found), over_pressure(found), candidates(found)]


def build_petrol_report(found: PetrolDiscovery, path: Path, figures_dir: Path) -> Path:
    """Write one self-contained page and its figures."""
    figures_dir.mkdir(parents=True, exist_ok=True)
    pictures = []
    for figure in all_figures(found):
        content = figure.encode()
        write_bytes(figures_dir / f"{figure.name}.{figure.kind}", content)
        pictures.append({"name": figure.name, "title": figure.title, "caption": figure.caption,
                         "uri": style.data_uri(content, figure.kind)})
    d = found.document
    effects = [{
        "name": e.name, "law": e.law or "–", "probability": f"{100 * e.probability:.1f} %",
        "size": "–" if e.magnitude is None else f"{e.magnitude:.4g} ± {e.std or 0.0:.1g} {e.unit}",
        "equivalent": "; ".join(x for x in (", ".join(e.equivalent_names), e.split_by) if x) or "–",
    } for e in d.effects]
    sites = [] if d.location is None else [
        (s, f"{100 * p:.1f} %") for s, p in
        [(d.location.site, d.location.probability), *((a.site, a.probability) for a in d.location.alternatives)]]
    health = [{"symbol": n, "value": f"{v.value:.4f}" + ("" if v.std is None else f" ± {v.std:.4f}"),
               "before": f"{v.before:.4f}"} for n, v in d.health.items()]
    fit = [{"name": n, "before": _text(b), "after": _text(a)} for n, b, a in (
        ("held-out negative log-likelihood per sample [–]", d.fit.held_out_nll_before, d.fit.held_out_nll_after),
        ("chi-square per sample [–]", d.fit.chi2_per_sample_before, d.fit.chi2_per_sample_after))]
    known = found.twin.hypotheses
    visible = [(n, f"{v:.3g} {known[n].unit}", known[n].site) for n, v in d.minimum_detectable.items()]
    sections = [
        {"id": "balances", "title": "Balances", "words": "", "figures": pictures, "rows": [], "heads": []},
        {"id": "visible", "title": "What could be seen", "words": "Smallest size that this recording shows, had the "
         "effect begun after a tenth of it.", "figures": [], "rows": visible, "heads": ("effect", "from", "place")},
    ]
    environment = Environment(loader=PackageLoader("dieseltwin.report"), autoescape=True, undefined=StrictUndefined,
                              trim_blocks=True)
    page = environment.get_template("petrol.html.j2").render(
        title="Discovery on a petrol engine", about=f"{Path(d.recording.path).name}, {d.recording.duration_s:.0f} s",
        headline=found.sentence, mismatch=d.mismatch, effects=effects, sites=sites, health=health, fit=fit,
        sections=sections, source=found.engine.source,
        provenance=[("recording", d.recording.path), ("SHA-256 of the recording", d.recording.sha256),
                    ("code version", d.provenance.code_version),
                    ("SHA-256 of the parameters", d.provenance.params_sha256)])
    return write_text(path, page)


def _text(value: float | None) -> str:
    return "–" if value is None else f"{value:.4f}"


@style.styled
def fault_free_pieces(pieces: Sequence[FaultFreePiece]) -> ReportFigure:
    """Gain of the strongest effect in each fault-free piece at its time; alarms in another colour."""
    figure = Figure(figsize=(9.0, 2.8))
    panel = figure.subplots()
    for piece in pieces:
        panel.plot([piece.start_s / 60.0, piece.end_s / 60.0], [piece.gain, piece.gain],
                   color=BEFORE if piece.alarm else AFTER, lw=2.5)  # fmt: skip
        panel.text(piece.start_s / 60.0, piece.gain, piece.name, va="bottom", fontsize=8)
    panel.set_xlabel("time [min]")
    panel.set_ylabel("gain [–]")
    caption = "Gain of the strongest effect in each fault-free piece, with maps that did not see it."
    return ReportFigure("pieces", "Fault-free pieces", caption, figure)


def calibration_lines(fits: Sequence[SubmodelFit], pieces: Sequence[FaultFreePiece]) -> list[str]:
    """Fit of each balance on held-out stretches, and the verdicts on held-out fault-free pieces, as lines of text."""
    lines = [f"{'balance':<10}{'steady':>9}{'all':>9}   held-out misfit (robust standard deviation)"]
    for f in fits:
        lines.append(f"{f.name:<10}{100 * f.steady:>7.2f} %{100 * f.all_blocks:>7.2f} %   {f.blocks} blocks of 1 s")
    lines += [f"fault-free piece {p.start_s:.0f}-{p.end_s:.0f} s: {'ALARM' if p.alarm else 'quiet'}, strongest "
              f"{p.name} with a gain of {p.gain:.1f}" for p in pieces]
    alarms = sum(p.alarm for p in pieces)
    return [*lines, f"false alarms on pieces that their maps did not see: {alarms} of {len(pieces)}"]
