"""What a document says, as the tables of a page: findings, places, levels, fit, doubts, candidates, provenance."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence

from markupsafe import Markup

from dieseltwin.discovery.verdict.curves import Candidate
from dieseltwin.discovery.verdict.document import Discrepancy, FoundEffect
from dieseltwin.discovery.verdict.health_value import HealthValue
from dieseltwin.discovery.verdict.left_out import left_out_words
from dieseltwin.discovery.verdict.when import when_words
from dieseltwin.least_squares import Z_90
from dieseltwin.report import quantities
from dieseltwin.report.discovery_words import (
    display_unit,
    magnitude_words,
    over_recordings_words,
    site_words,
)
from dieseltwin.report.page import Table
from dieseltwin.report.quantities import EMPTY
from dieseltwin.report.visible_words import bias_words

Unit = Callable[[str, str | None], tuple[str, float]]
"""Effect and its unit -> the unit that is shown, and the factor to it."""

Shares = Sequence[tuple[Sequence[str], float]]
"""Names, and the share of the misfit that they explain together [-]."""

_SHORT = 30  # letters that stand on one line of a column of words


def as_it_is(name: str, unit: str | None) -> tuple[str, float]:
    """A unit that is shown as the machine's own file has it."""
    del name
    return ("" if unit in (None, "-") else str(unit)), 1.0


def findings(
    document: Discrepancy, shares: Shares | None = None, unit: Unit = display_unit,
    timed: bool | Collection[str] = True,
) -> Table | None:
    """A row for everything that was found; None where nothing was.

    Args:
        document: the verdict.
        shares: of the misfit; None: that of all together.
        unit: how sizes are shown.
        timed: say when; names: the location's times are theirs alone.
    """
    if not document.effects:
        return None
    heads = ("finding", "size ± std", "90 % interval", "probability", "misfit explained",
             *(("when",) if timed else ()), "can't be told from")  # fmt: skip
    always = "from the start"
    when = always if document.location is None else when_words(document.location)
    if document.recordings:
        always = "in all recordings"
        when = over_recordings_words(document) or always
    rows = []
    for effect in document.effects:
        size, interval = _sizes(effect, unit)
        equivalent = ", ".join(effect.equivalent_names) or EMPTY
        if effect.equivalent_names and effect.split_by:
            equivalent += f"; {effect.split_by} would settle it"
        told = (when if timed is True or effect.name in timed else always,) if timed else ()
        times = map(quantities.with_symbols, told)
        rows.append((effect.name, size, interval, quantities.probability(effect.probability),
                     _share(document, effect, shares), *times, equivalent))  # fmt: skip
    sentences = tuple(range(5, len(heads)))  # when, and what it can't be told from
    long = tuple(k for k in sentences if any(len(row[k]) > _SHORT for row in rows))
    return Table(heads, rows, words=(0, *sentences), long=long)


def _sizes(effect: FoundEffect, unit: Unit) -> tuple[str, str]:
    if effect.magnitude is None:
        return EMPTY, EMPTY
    shown, factor = unit(effect.name, effect.unit)
    size = magnitude_words(effect.name, effect.magnitude, effect.std, effect.unit, shown=(shown, factor))
    if effect.std is None or effect.std <= 0.0:
        return size, EMPTY
    places = quantities.decimals_for(effect.std * factor)
    low, high = ((effect.magnitude + side * Z_90 * effect.std) * factor for side in (-1.0, 1.0))
    text = f"{low:.{places}f} to {high:.{places}f}".replace("-", "−")
    return size, f"{text} {shown}".rstrip()


def _share(document: Discrepancy, effect: FoundEffect, shares: Shares | None) -> str:
    whole = document.fit.share_explained
    if shares is None:
        shares = [] if whole is None else [([other.name for other in document.effects], whole)]
    for names, share in shares:
        if effect.name in names:
            return share_words(share) + ("" if len(names) == 1 else " together")
    return EMPTY


def share_words(share: float) -> str:
    """A share [-] in whole per cent; never 100 %."""
    return "> 99 %" if share > 0.99 else f"{100.0 * share:.0f} %".replace("-", "−")


def places(document: Discrepancy) -> Table:
    """Where it may sit."""
    location = document.location
    rows: list[tuple[str, str]] = []
    if location is not None:
        sites = [(location.site, location.probability), *((a.site, a.probability) for a in location.alternatives)]
        rows = [(f"{site_words(site)} ({site})", quantities.probability(value)) for site, value in sites]
    return Table(("place", "probability"), rows)


def _unrepaired(name: str, entry: HealthValue, shift: bool) -> str:
    """The value without the repair [shown unit]; what is near 0 with the decimals of its standard deviation."""
    value = entry.before * quantities.factor(name)
    if shift or entry.std is None:
        return quantities.significant(value, 4).replace("-", "−")
    return f"{value:.{quantities.decimals_for(entry.std * quantities.factor(name))}f}".replace("-", "−")


def levels(document: Discrepancy, head: str, units: Mapping[str, str] | None = None, shift: bool = True) -> Table:
    """Health parameters, levels or a machine's own parameters, with what they would be without the repair.

    Args:
        document: the verdict.
        head: what they are.
        units: of parameters that the nomenclature doesn't know.
        shift: say by how much they would be off; of what is near 0 that says nothing.
    """
    since = any(entry.since_reference is not None for entry in document.health.values())
    heads = (head, "estimate ± std", *(("without the repair",) if document.mismatch else ()),
             *(("shift",) if document.mismatch and shift else ()), *(("since the reference",) if since else ()))
    rows: list[tuple[str | Markup, ...]] = []
    for name, entry in document.health.items():
        std = math.nan if entry.std is None else entry.std
        unit = quantities.unit(name) or (units or {}).get(name, "")
        label = quantities.label(name) + (f" [{unit}]" if unit not in ("", "-") else "")
        row: tuple[str | Markup, ...] = (
            label, quantities.value_with_std(name, entry.value, std, with_unit=False).replace("-", "−"))
        if document.mismatch:
            row += (_unrepaired(name, entry, shift),)
            if shift:
                off = entry.before / entry.value - 1.0 if entry.value else math.nan
                row += (quantities.percent(off, signed=True),)
        if since:
            row += (EMPTY if entry.since_reference is None else entry.since_reference.text.replace("-", "−"),)
        rows.append(row)
    return Table(heads, rows)


def fit(document: Discrepancy, units: Mapping[str, str] | None = None) -> Table:
    """How well the readings are met before and after."""

    def text(value: float | None, digits: int = 4) -> str:
        return EMPTY if value is None else f"{value:.{digits}f}".replace("-", "−")

    found = document.fit
    rows: list[tuple[str | Markup, ...]] = [
        ("held-out negative log-likelihood per sample [–]", text(found.held_out_nll_before),
         text(found.held_out_nll_after)),
        ("chi-square per sample [–]", text(found.chi2_per_sample_before, 3), text(found.chi2_per_sample_after, 3)),
    ]  # fmt: skip
    for name, after in found.rmse_after.items():
        scale, unit = quantities.factor(name), quantities.unit(name) or (units or {}).get(name, "")
        before = found.rmse_before.get(name)
        label = Markup("rms residual of {} [{}]").format(quantities.label(name), unit or EMPTY)
        rows.append((label, EMPTY if before is None else quantities.significant(before * scale, 3),
                     quantities.significant(after * scale, 3)))  # fmt: skip
    return Table(("fit", "before", "after"), rows)


def doubts(document: Discrepancy) -> Table:
    """What is doubtful."""
    rows = [(doubt.code, doubt.text, ", ".join(doubt.affects) or EMPTY) for doubt in document.warnings]
    return Table(("kind", "what", "about"), rows, words=(0, 1, 2), long=(1,))


def weighed(candidates: Sequence[Candidate], units: Mapping[str, str], unit: Unit = display_unit) -> Table:
    """Every effect that was weighed: name, place, gain, size, probability, why.

    Args:
        candidates: strongest first.
        units: name -> unit of its magnitude.
        unit: how sizes are shown.
    """
    rows = []
    for entry in candidates:
        name, size, gain = entry["name"], entry["magnitude"], entry["log_likelihood_gain"]
        shown = unit(name, units.get(name))
        rows.append(
            (
                name,
                entry["site"],
                EMPTY if gain is None else f"{gain:.1f}",
                EMPTY if size is None else magnitude_words(name, size, entry["std"], units.get(name), shown=shown),
                quantities.probability(entry["probability"]),
                entry["reason"],
            )
        )
    return Table(("effect", "place", "gain", "size", "probability", "why"), rows, words=(0, 1, 5), long=(5,))


def visible(document: Discrepancy, units: Mapping[str, str], unit: Unit = display_unit) -> Table:
    """Smallest size of each effect that could have been seen, and what of health it would move, unseen."""
    bias, heads = document.health_bias, ("effect", "seen from")
    rows = [(name, magnitude_words(name, size, None, units.get(name), shown=unit(name, units.get(name)), digits=2),
             ", ".join(bias_words(bias, name)))
            for name, size in document.minimum_detectable.items()]  # fmt: skip
    return Table((*heads, "unseen, it moves"), rows) if bias else Table(heads, [row[:2] for row in rows])


def provenance(document: Discrepancy, *more: tuple[str, str]) -> list[tuple[str, str]]:
    """What made the page."""
    recording = document.recording
    rows = [
        ("recording", recording.path),
        ("SHA-256 of the recording", recording.sha256),
        ("length", f"{recording.duration_s:.1f} s" if recording.duration_s else ""),
        ("sensors used", ", ".join(recording.channels)),
        ("p-value of no mismatch", f"{document.p_value:.3g}" if document.p_value > 0.0 else "below 1e-300"),
        ("not used", "" if document.left_out is None else left_out_words(document.left_out)),
        *more,
        ("code version", document.provenance.code_version),
        ("SHA-256 of the parameters", document.provenance.params_sha256),
    ]
    return [(name, value) for name, value in rows if value]


def heading(document: Discrepancy) -> str:
    """Of the page."""
    return "What the twin leaves out" if document.mismatch else "Nothing left out that could be seen"
