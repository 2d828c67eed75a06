"""The report of one discovery: one self-contained page, headed by one sentence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from dieseltwin.atomic import write_bytes, write_text
from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.report import discovery_figures, discovery_residuals, over_recordings, quantities, style
from dieseltwin.report.discovery_words import magnitude_words, sentence, site_words, unit_of
from dieseltwin.report.encoding import encode_all
from dieseltwin.report.interactive import discovery_series, still
from dieseltwin.report.law_cards import law_cards
from dieseltwin.report.style import ReportFigure

_EMPTY = "–"
LOUD = 1.3  # rms residual over noise; right names leave 1.0 to 1.1 where maps and sensors keep to their tolerances


@dataclass(frozen=True)
class Section:
    """One section of the page: anchor, heading, a sentence, figures, and a table of text."""

    id: str
    title: str
    figures: tuple[ReportFigure, ...]
    words: str = ""
    heads: tuple[str, ...] = ()
    rows: list[tuple[str, ...]] = field(default_factory=list)


def _kept(*figures: ReportFigure | None) -> tuple[ReportFigure, ...]:
    return tuple(figure for figure in figures if figure is not None)


def discovery_sections(found: Discovery) -> list[Section]:
    """The page's sections with all figures that `found` has data for."""
    doubts: list[tuple[str, ...]] = [
        (doubt.code, doubt.text, ", ".join(doubt.affects) or _EMPTY) for doubt in found.document.warnings
    ]
    sections = [
        Section("doubts", "What is doubtful", (), heads=("kind", "what", "about"), rows=doubts),
        Section("over-recordings", "The recordings", _kept(over_recordings.trends(found))),
        Section("health-parameters", "Health parameters", _kept(discovery_figures.health(found))),
        Section("law-of-it", "Law", _kept(discovery_figures.law_curves(found))),
        Section(
            "evidence", "Evidence",
            _kept(discovery_figures.evidence_time(found), discovery_figures.evidence_maps(found)),
        ),
        Section(
            "residuals", "Residuals",
            _kept(
                discovery_residuals.residual_time(found), discovery_residuals.residual_map(found),
                discovery_residuals.residual_map(found, discovery_figures.MAPS[1]),
            ),
        ),
        Section("held-out", "Held-out score", _kept(discovery_figures.score(found))),
        Section(
            "weighed", "Candidates", _kept(discovery_figures.candidates(found)),
            heads=("effect", "place", "gain", "size", "probability", "why"), rows=candidate_rows(found),
        ),
        Section("visible", "What could be seen", _kept(discovery_figures.minimum_detectable(found))),
    ]  # fmt: skip
    return [section for section in sections if section.figures or section.rows]


def candidate_rows(found: Discovery) -> list[tuple[str, ...]]:
    """Every effect that was weighed as text: name, place, gain, size, probability, why."""
    rows: list[tuple[str, ...]] = []
    for entry in found.curves.candidates:
        name, size, gain = entry["name"], entry["magnitude"], entry["log_likelihood_gain"]
        unit = found.curves.units.get(name) or unit_of(name)
        rows.append(
            (
                name,
                entry["site"],
                _EMPTY if gain is None else f"{gain:.1f}",
                _EMPTY if size is None else magnitude_words(name, size, entry["std"], unit),
                _probability(entry["probability"]),
                entry["reason"],
            )
        )
    return rows


def _probability(value: float | None) -> str:
    if value is None:
        return _EMPTY
    if value > 0.999:
        return "> 99.9 %"
    return "< 0.1 %" if value < 0.001 else f"{100 * value:.1f} %"


def _effects(found: Discovery) -> list[dict[str, str]]:
    rows = []
    for effect in found.document.effects:
        size = _EMPTY
        if effect.magnitude is not None:
            size = magnitude_words(effect.name, effect.magnitude, effect.std, effect.unit)
        equivalent = ", ".join(effect.equivalent_names) or _EMPTY
        if effect.equivalent_names and effect.split_by:
            equivalent += f"; {effect.split_by} would settle it"
        rows.append(
            {
                "name": effect.name,
                "law": effect.law or _EMPTY,
                "size": size,
                "probability": _probability(effect.probability),
                "equivalent": equivalent,
                "valid_for": effect.valid_for or _EMPTY,
            }
        )
    return rows


def _sites(found: Discovery) -> list[tuple[str, str]]:
    location = found.document.location
    if location is None:
        return []
    places = [(location.site, location.probability), *((a.site, a.probability) for a in location.alternatives)]
    return [(f"{site_words(site)} ({site})", _probability(probability)) for site, probability in places]


def _health(found: Discovery) -> list[dict[str, str]]:
    rows = []
    for name, entry in found.document.health.items():
        std = math.nan if entry.std is None else entry.std
        shift = entry.before / entry.value - 1.0 if entry.value else math.nan
        rows.append(
            {
                "symbol": quantities.html_symbol(name),
                "unit": quantities.unit(name),
                "value": quantities.value_with_std(name, entry.value, std, with_unit=False),
                "before": quantities.significant(entry.before * quantities.factor(name), 4),
                "shift": quantities.percent(shift, signed=True),
            }
        )
    return rows


def _fit(found: Discovery) -> list[dict[str, str]]:
    fit = found.document.fit

    def text(value: float | None, digits: int = 4) -> str:
        return _EMPTY if value is None else f"{value:.{digits}f}"

    rows = [
        {
            "name": "held-out negative log-likelihood per sample [–]",
            "before": text(fit.held_out_nll_before),
            "after": text(fit.held_out_nll_after),
        },
        {
            "name": "chi-square per sample [–]",
            "before": text(fit.chi2_per_sample_before, 3),
            "after": text(fit.chi2_per_sample_after, 3),
        },
    ]
    for name, after in fit.rmse_after.items():
        scale, unit = quantities.factor(name), quantities.unit(name)
        before = fit.rmse_before.get(name)
        rows.append(
            {
                "name": f"rms residual of {quantities.html_symbol(name)} [{unit or '–'}]",
                "before": _EMPTY if before is None else quantities.significant(before * scale, 3),
                "after": quantities.significant(after * scale, 3),
            }
        )
    return rows


def left_over(found: Discovery) -> str:
    """A warning about channels in which the repaired fit leaves clearly more than noise; empty where there are none."""
    rmse = found.document.fit.rmse_after
    sigma = dict(zip(found.curves.channels, found.curves.sigma, strict=True))
    loud = {name: rmse[name] / sigma[name] for name in rmse if sigma.get(name) and rmse[name] > LOUD * sigma[name]}
    if not loud:
        return ""
    parts = ", ".join(f"{name} {ratio:.1f} times its noise" for name, ratio in loud.items())
    after = "the repair" if found.document.mismatch else "the fit"
    return (f"After {after} more than noise is left: {parts}. Maps or sensors use their tolerances to the full there, "
            "or what is named imitates something else. Look at the residual maps before you believe it.")  # fmt: skip


def _provenance(found: Discovery) -> list[tuple[str, str]]:
    document = found.document
    rows = [
        ("recording", document.recording.path),
        ("SHA-256 of the recording", document.recording.sha256),
        ("length", f"{document.recording.duration_s:.1f} s"),
        ("sensors used", ", ".join(document.recording.channels)),
        ("p-value of no mismatch", f"{document.p_value:.3g}"),
        ("code version", document.provenance.code_version),
        ("SHA-256 of the parameters", document.provenance.params_sha256),
    ]
    return [(name, value) for name, value in rows if value]


def _plain(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_plain(item)}" for key, item in value.items())
    return ", ".join(map(_plain, value)) if isinstance(value, list | tuple) else str(value)


def _figure(figure: ReportFigure, content: bytes) -> dict[str, str]:
    caption = quantities.with_symbols(figure.caption)
    uri = style.data_uri(content, figure.kind)
    return {"name": figure.name, "title": figure.title, "caption": caption, "uri": uri}


def _page(found: Discovery, sections: Sequence[Section], encoded: Mapping[str, bytes]) -> str:
    environment = Environment(
        loader=PackageLoader("dieseltwin.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    recording = found.document.recording
    name = Path(recording.path).name
    series = discovery_series(found)
    return environment.get_template("discovery.html.j2").render(
        series=series, still=_figure(picture := still(series), picture.encode()), cards=law_cards(found),
        title="What the twin leaves out" if found.document.mismatch else "Nothing left out that could be seen",
        about=f"Recording: {name} · {recording.duration_s:.0f} s · {len(recording.channels)} sensors",
        mismatch=found.document.mismatch,
        headline=quantities.with_symbols(sentence(found.document)),
        caution=quantities.with_symbols(left_over(found)),
        effects=_effects(found),
        sites=_sites(found),
        health=_health(found),
        fit=_fit(found),
        sections=[
            {"id": s.id, "title": s.title, "words": s.words, "heads": s.heads, "rows": s.rows,
             "figures": [_figure(figure, encoded[figure.name]) for figure in s.figures]}
            for s in sections
        ],
        provenance=_provenance(found),
        machine=[(str(key), _plain(value)) for key, value in found.runtime.items()],
    )  # fmt: skip


def build_discovery_report(
    found: Discovery, out_html: str | Path, *, figures_dir: str | Path | None = None
) -> Path:
    """Write the page atomically, and its figures as files beside it.

    Args:
        found: what `discover` returned.
        out_html: the page; its folder is made where missing.
        figures_dir: where to save the figures as SVG too; None for the page alone.

    Returns:
        The path of the page.
    """
    out = Path(out_html)
    sections = discovery_sections(found)
    figures = [figure for section in sections for figure in section.figures]
    encoded = encode_all(figures)  # the dear part: once for both
    out.parent.mkdir(parents=True, exist_ok=True)
    if figures_dir is not None:
        Path(figures_dir).mkdir(parents=True, exist_ok=True)
        for figure in figures:
            write_bytes(Path(figures_dir) / f"{figure.name}.{figure.kind}", encoded[figure.name])
    return write_text(out, _page(found, sections, encoded))
