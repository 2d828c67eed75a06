"""Several recordings that were judged together: health and sizes of each, over their dates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import JudgedRecording
from dieseltwin.discovery.verdict.health_value import HealthValue
from dieseltwin.report import quantities, style
from dieseltwin.report.discovery_words import display_unit, unit_of
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


def _dates(recordings: Sequence[JudgedRecording]) -> list[datetime]:
    """Dates of the recordings; a day apart where they have none."""
    try:
        return [datetime.fromisoformat(item.date) for item in recordings]
    except ValueError:
        return [datetime(2000, 1, 1, tzinfo=UTC) + timedelta(days=k) for k in range(len(recordings))]
