"""Laws that are looked for under other circumstances than the search was: without a late clock, with other noise."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Literal, cast

import numpy as np
import pytest

from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SensorSet, read
from dieseltwin.discovery.laws.reading_twin import ReadingFault
from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.sensor import Resolved
from dieseltwin.discovery.likelihood.fit import fit_fully
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.options import Options
from dieseltwin.discovery.search import nameless
from dieseltwin.discovery.search import run as search_run
from dieseltwin.discovery.search.preparation import prepare
from dieseltwin.discovery.search.settled import evidence_of
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.weather import with_reading_in_time
from dieseltwin.discovery.time_limit import OutOfTimeError, time_limit
from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin
from dieseltwin.discovery.twins.interface import Twin
from dieseltwin.engine import we2011
from dieseltwin.recordings.reader import recording


def _twin() -> LoggedTwin:
    """A minute of a healthy engine with the published maps and perfect sensors."""
    driving = draw_driving("random", 60.0, we2011.PARAMETERS.model_dump(), np.random.default_rng(3))
    run = run_plant(driving, we2011.PARAMETERS.model_dump(), ())
    frame = read(run, driving, (), SensorSet.perfect(), 6, np.random.default_rng(4))
    return LoggedTwin(recording(frame), we2011.PARAMETERS)


def test_a_reading_that_lags_is_looked_for_without_its_clock() -> None:
    """A slow sensor is late, too: beside a clock that was found off, a part of the lag is missing."""
    name = "time_shift:t_em_k"
    twin = _twin()
    late = twin.under({name: 0.7, "p_amb_pa": 1.0e5}, frozenset({name}))

    def found(kind: Literal["lag", "gain"], at: Twin) -> Search:
        return cast(Search, SimpleNamespace(twin=at, law=SimpleNamespace(faults=(ReadingFault("t_em_k", kind, 1.0),))))

    other = with_reading_in_time(found("lag", late))
    assert isinstance(other, LoggedTwin) and not other.opened and other.values == {"p_amb_pa": 1.0e5}
    assert with_reading_in_time(found("gain", late)) is None
    assert with_reading_in_time(found("lag", cast(Twin, twin))) is None


def test_a_law_stays_where_the_time_ends_behind_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def out_of_time(found: Search) -> Search:
        raise OutOfTimeError

    def with_law(found: Search) -> Search:
        found.law, found.stage = cast(Law, "the law"), search_run.STAGES[-1]
        return found

    begun = prepare(cast(Twin, _twin()), Options().settings())
    monkeypatch.setattr(search_run, "_explain", lambda found, **_: setattr(found, "kind", "law"))
    monkeypatch.setattr(search_run, "_in_own_weather", lambda found: found)
    monkeypatch.setattr(search_run, "_with_law", with_law)
    monkeypatch.setattr(search_run, "_with_reading_in_time", out_of_time)
    found = search_run.carry_on(begun)
    assert found.law == "the law" and found.unfinished == ("a law",) and found.earlier == []


def test_evidences_of_laws_hold_what_normalises_the_noise() -> None:
    """Twice the noise explains the same misfit with a quarter of the squares: that is no better law."""
    twin = cast(Twin, _twin())
    found = prepare(twin, Options().settings())
    loose = found.anew()
    noise = replace(found.noise, sigma=2.0 * found.noise.sigma)
    loose.whitening = Whitening.of(twin.measured, noise, twin.starts)
    loose.null = fit_fully(twin, loose.whitening, found.null.fit)
    assert evidence_of(loose.null) < evidence_of(found.null) and search_run._better_law(found, loose) is found


def test_a_law_that_explains_too_little_is_not_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """A report takes as many simulations as the search; of a law from a time on that isn't ahead nobody reads it."""
    reported: list[float] = []

    def resolved(score: float) -> Resolved:
        def report() -> Law:
            reported.append(score)
            return cast(Law, SimpleNamespace(score=score))

        return Resolved(score, report)

    found = cast(Search, SimpleNamespace(twin=None, null=None, law=None, more_is_missing=lambda: True))
    laws = [resolved(30.0), resolved(20.0), resolved(50.0)]
    monkeypatch.setattr(nameless, "beyond_law", lambda found, law: ([], []))
    nameless.take_law(found, laws)
    assert reported == [30.0, 50.0]
    reported.clear()
    nameless.take_law(found, laws, 40.0)
    assert reported == [50.0] and found.law is not None and found.law.score == 50.0
    found.more_is_missing = lambda: False
    nameless.take_law(found, laws, 40.0)
    assert reported == [50.0], "what is known leaves nothing"


@pytest.mark.parametrize("leaves, lost, limited, score, order", [
    (False, False, False, 80.0, [80.0]),
    (True, False, False, 75.0, [80.0, 75.0]),  # by less than an onset must add
    (False, True, False, 40.0, [80.0, 40.0]),  # its report came to nothing
    (False, False, True, 80.0, [40.0, 80.0]),  # time may end before it
])
def test_a_law_from_the_first_row_on_is_reported_where_one_from_later_on_is_not_enough(
    leaves: bool, lost: bool, limited: bool, score: float, order: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    reported: list[float] = []

    def resolved(since_s: float | None, score: float) -> Resolved:
        def report() -> Law | None:
            reported.append(score)
            return None if lost and score == 80.0 else cast(Law, SimpleNamespace(score=score, since_s=since_s))

        return Resolved(score, report)

    found = cast(Search, SimpleNamespace(
        twin=None, null=None, law=None, left=["before"], left_local=[], more_is_missing=lambda: leaves, seconds={},
        settings=SimpleNamespace(variant_gain=10.0, least_share=0.1),
        everything_unnamed=lambda: [SimpleNamespace(gain=50.0)]))  # fmt: skip
    for name, fake in {
        "has_parts": lambda twin: True, "best_onset": lambda *a: 12.0, "beyond_law": lambda found, law: ([], []),
        "scored_since": lambda *a: [SimpleNamespace(gain=90.0)],
        "laws_in_turn": lambda twin, at, terms, tolerances, since_s: iter(
            [resolved(since_s, 40.0), resolved(since_s, 75.0)] if since_s is None else [resolved(since_s, 80.0)]),
    }.items():  # fmt: skip
        monkeypatch.setattr(nameless, name, fake)
    with time_limit(1e6 if limited else None):
        nameless.look_for_law(found)
    assert found.law is not None and found.law.score == score and found.left == [] and reported == order
