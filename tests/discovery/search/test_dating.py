"""An onset is dated once more with all readings, and has a range of dates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.courses import at_times
from dieseltwin.discovery.search.dating import _with_course, date_edges, objectives, without_effect
from dieseltwin.discovery.search.preparation import recentred
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.variants import Variant
from dieseltwin.discovery.twins.interface import rows_of
from dieseltwin.discovery.verdict.findings import location
from tests.discovery.toy import SETTINGS, Toy

ONSET_S = 100.0


class Coming(Toy):
    """Effects may go again."""

    courses = True


@pytest.fixture(scope="module")
def found() -> Search:
    toy = Toy(windows=30)
    acts = (toy.time_s >= ONSET_S).astype(float)
    return search.run(toy.record(gain=0.95, leak=(0.06, acts)), SETTINGS, laws=False)


def _best(found: Search) -> tuple[Linearisation, Variant]:
    assert found.best is not None and found.variant is not None
    return found.best, found.variant


def test_dates_are_weighed_as_refits_weigh_them(found: Search) -> None:
    """One simulation and one linear step each is as good as a refit, where it matters: near the best."""
    best, variant = _best(found)
    begun = float(variant.onset_s or 0.0)
    steps = (-8.0, -3.0, -1.0, 0.0, 1.0, 3.0, 8.0)
    dated = [at_times(found.twin, variant, begun + step, None, False) for step in steps]
    quick = objectives(best, dated, without_effect(best))
    refitted = np.array([recentred(found, _with_course(best.fit, other)).fit.objective for other in dated])
    assert quick - quick[3] == pytest.approx(refitted - refitted[3], rel=0.1, abs=0.5)


def test_the_range_holds_the_onset_and_is_in_the_document(found: Search) -> None:
    assert found.onset_range_s is not None and found.until_range_s is None
    low, high = found.onset_range_s
    assert low <= ONSET_S <= high and low <= float(_best(found)[1].onset_s or 0.0) <= high
    assert 0.0 < high - low < 20.0
    where = location(found, found.twin, np.zeros(found.twin.time_s.size))  # type: ignore[arg-type]
    assert where.onset_range_s == (pytest.approx(low), pytest.approx(high))


def test_a_weaker_effect_has_a_wider_range(found: Search) -> None:
    toy = Toy(windows=30)
    acts = (toy.time_s >= ONSET_S).astype(float)
    weak = search.run(toy.record(gain=0.95, leak=(0.025, acts)), SETTINGS, laws=False)
    widths = [b - a for a, b in (each.onset_range_s or (0.0, 0.0) for each in (found, weak))]
    assert widths[1] > widths[0] > 0.0


def _without_windows_at_the_onset(found: Search) -> Search:
    """The search as it would be with the windows at the onset left out, which then states a date behind them."""
    best, variant = _best(found)
    begins = found.twin.time_s[found.twin.starts]
    out = (begins > ONSET_S - 6.0) & (begins < ONSET_S + 11.0)
    rows = rows_of(found.twin, out)
    hidden = np.where(rows[:, None], found.twin.measured, np.nan)
    other = replace(found, variants=list(found.variants), left_out=out, hidden=hidden)
    here = Toy(windows=30)
    here.measured = np.where(rows[:, None], np.nan, found.twin.measured)
    other.twin = here
    other.whitening = type(found.whitening).of(here.measured, found.noise, here.starts, found.scatter)
    late = at_times(here, variant, float(here.time_s[np.flatnonzero(rows)[-1] + 1]), None, False)
    other.variant, other.best = late, recentred(other, _with_course(best.fit, late))
    other.variants[0] = (late, found.variants[0][1])
    return other


def test_windows_that_were_left_out_date_an_onset_among_them(found: Search) -> None:
    other = _without_windows_at_the_onset(found)
    stated = float(other.variant.onset_s or 0.0)  # type: ignore[union-attr]
    assert stated > ONSET_S + 5.0
    date_edges(other)
    best, variant = _best(other)
    assert variant.onset_s == pytest.approx(found.variant.onset_s, abs=1.5)  # type: ignore[union-attr]
    assert other.onset_range_s is not None and other.onset_range_s[1] < stated
    assert np.array_equal(best.fit.candidate.schedules["leak"], variant.schedule)
    assert other.variants[0][0] is variant and np.isnan(other.twin.measured).any()
    assert float(best.fit.magnitudes[0]) == pytest.approx(0.06, rel=0.15)


def test_an_end_has_a_range_too() -> None:
    toy = Coming(windows=30)
    acts = ((toy.time_s >= 80.0) & (toy.time_s < 200.0)).astype(float)
    found = search.run(toy.record(gain=0.95, leak=(0.08, acts)), SETTINGS, laws=False)
    _, variant = _best(found)
    assert variant.until_s is not None
    assert found.until_range_s is not None and found.until_range_s[0] <= 200.0 <= found.until_range_s[1]


def test_a_law_has_a_range_and_what_was_left_out_at_its_end_widens_it() -> None:
    toy = Coming(windows=30)
    toy.record(gain=0.95, leak=(0.06, (toy.time_s >= ONSET_S).astype(float)))
    found = search.run(toy, SETTINGS.asked(("leak", "drag"), 0))
    assert found.kind == "law" and found.law is not None and found.law.since_s == pytest.approx(ONSET_S, abs=1.0)
    assert found.onset_range_s is not None
    low, high = found.onset_range_s
    assert low <= ONSET_S <= high < low + 5.0
    begins = found.twin.time_s[found.twin.starts]
    found.left_out = (begins >= high - 1.0) & (begins < high + 20.0)
    date_edges(found)
    out = begins[~found.left_out & (begins > high)].min()
    assert found.onset_range_s == (low, out)
