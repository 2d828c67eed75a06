"""Several recordings that were judged together: health and sizes of each, over their dates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime

import pandas as pd
from markupsafe import Markup

from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import Discrepancy, JudgedRecording
from dieseltwin.discovery.verdict.health_value import HealthValue
from dieseltwin.report import quantities, style
from dieseltwin.report.circumstance_words import shown_day
from dieseltwin.report.discovery_words import display_unit, magnitude_words, unit_of
from dieseltwin.report.page import Table
from dieseltwin.report.trend import Trend, trend_figure


def trends(found: Discovery) -> style.ReportFigure | None:
    """Health parameters and sizes of what was found, one panel each; None for one recording."""
    recordings = found.document.recordings
    if not recordings:
        return None
    panels = [_size(name, recordings) for name in recordings[0].magnitudes]
    panels += [health_trend(name, [item.health[name] for item in recordings]) for name in recordings[0].health]
    caption = (
        "Size of what was found, freed in every recording, and health parameters of every recording, with 90 % "
        "intervals; dashed: none, and the health when the reference was recorded, or that of the first recording."
    )
    title = "From recording to recording"
    return trend_figure("over_recordings", title, caption, panels, _dates(recordings))


def tables(found: Discovery) -> tuple[Table, ...]:
    """A row for each of several recordings: day, ambient, size of what was found, health; no table for one."""
    recordings = found.document.recordings
    if not recordings:
        return ()
    sizes, levels = list(recordings[0].magnitudes), list(recordings[0].health)
    trends = [health_trend(name, [item.health[name] for item in recordings]) for name in levels]
    heads = ("day", "recording", "min", "kPa", "°C", *(f"{name.replace('_', ' ')}" for name in sizes),
             *(Markup(f"{quantities.label(name)} [%]") for name in levels))  # fmt: skip
    rows = []
    for r, item in enumerate(recordings):
        told = [magnitude_words(name, size.value, size.std, unit_of(name), extra=False)
                for name, size in item.magnitudes.items()]  # fmt: skip
        changes = [_change(trend.values[r], math.nan if trend.std is None else trend.std[r]) for trend in trends]
        rows.append((shown_day(item.date), item.path, f"{item.duration_s / 60.0:.0f}", f"{1e-3 * item.p_amb_pa:.1f}",
                     f"{item.t_amb_k - 273.15:.0f}".replace("-", "−"), *told, *changes))  # fmt: skip
    about = "Health: change since the reference, or since the first recording without one, ± one standard deviation."
    return (Table(heads, rows, words=(0, 1), about=about),)


def frame(document: Discrepancy) -> pd.DataFrame:
    """A row for each of several recordings, SI units in the names; no row for one."""
    rows = []
    for item in document.recordings:
        row: dict[str, object] = {
            "date": item.date, "date_from": item.date_from, "recording": item.path, "duration_s": item.duration_s,
            "p_amb_pa": item.p_amb_pa, "t_amb_k": item.t_amb_k,
        }  # fmt: skip
        for name, level in item.health.items():
            row |= {name: level.value, f"{name}_std": level.std}
            if level.since_reference is not None:
                row |= {f"{name}_since": level.since_reference.value, f"{name}_since_std": level.since_reference.std}
        for name, size in item.magnitudes.items():
            row |= {f"size:{name}": size.value, f"size_std:{name}": size.std}
        rows.append(row)
    return pd.DataFrame(rows)


def _change(value: float, std: float) -> str:
    """A change in per cent with its standard deviation."""
    text = f"{value:+.1f}" if math.isnan(std) else f"{value:+.1f} ± {std:.1f}"
    return text.replace("-", "−")


def health_trend(name: str, values: Sequence[HealthValue]) -> Trend:
    """Change of a health parameter since the reference, else since the first recording [%]."""
    first = values[0].value
    changes, stds = [], []
    for item in values:
        since = item.since_reference
        std = math.nan if item.std is None else item.std / first
        changes.append(100.0 * ((item.value / first if since is None else since.value) - 1.0))
        stds.append(100.0 * (std if since is None else since.std))
    return Trend(f"{quantities.symbol(name)}, change [%]", changes, stds, 0.0)


def _size(name: str, recordings: Sequence[JudgedRecording]) -> Trend:
    unit, factor = display_unit(name, unit_of(name))
    sizes = [item.magnitudes[name] for item in recordings]
    stds = [math.nan if size.std is None else factor * size.std for size in sizes]
    title = f"{name.replace('_', ' ')} [{unit or '–'}]"
    return Trend(title, [factor * size.value for size in sizes], stds, 0.0)


def _dates(recordings: Sequence[JudgedRecording]) -> list[datetime] | None:
    """Dates of the recordings; None where they have none."""
    try:
        return [datetime.fromisoformat(item.date) for item in recordings]
    except ValueError:
        return None
