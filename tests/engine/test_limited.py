"""When a term acts: from, until, growing; counted from the recording's start, also in a part of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from dieseltwin.engine.terms import Term, as_later

TIME_S = np.arange(1000.0, 1010.0)
CONDITIONS = {"n_e_rpm": np.full(10, 1200.0)}


def _share(start_s: float = 1000.0, rows: slice = slice(None), **times: Any) -> list[float]:
    term = Term(effect="boost_leak", magnitude=2e-5, **times)  # type: ignore[arg-type]
    return term.factor(TIME_S[rows], start_s, {name: values[rows] for name, values in CONDITIONS.items()}).tolist()


def test_it_acts_from_its_onset_until_its_end() -> None:
    assert _share(onset_s=3.0, until_s=6.0) == [0, 0, 0, 1, 1, 1, 0, 0, 0, 0]
    assert _share(until_s=2.0) == [1, 1] + 8 * [0]


def test_it_grows_evenly_and_keeps_its_size() -> None:
    assert _share(onset_s=2.0, grown_s=6.0) == [0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1]
    assert _share(grown_s=8.0, rows=slice(4, 7)) == [0.5, 0.625, 0.75]  # a part counts from the recording's start


def test_a_region_halves_its_edges_and_leaves_the_onset_where_it_is() -> None:
    term = Term(effect="boost_leak", magnitude=2e-5, onset_s=4.0, region={"n_e_rpm": (1000.0, 1300.0)})
    speeds = np.where(np.arange(10) < 7, 1200.0, 1400.0)
    assert term.factor(TIME_S, 1000.0, {"n_e_rpm": speeds}).tolist() == [0, 0, 0, 0, 1, 1, 0.5, 0, 0, 0]


def test_a_region_of_settled_points_goes_point_by_point() -> None:
    """They are of no time: the next row is no neighbour."""
    term = Term(effect="boost_leak", magnitude=2e-5, region={"n_e_rpm": (1000.0, 1300.0)})
    speeds = np.array([1200.0, 1400.0, 1100.0, 1400.0])
    assert term.factor(np.zeros(4), 0.0, {"n_e_rpm": speeds}).tolist() == [1, 0, 1, 0]


def test_it_is_gone_in_between() -> None:
    assert _share(onset_s=1.0, until_s=9.0, gone_s=((2.0, 4.0), (6.0, 7.0))) == [0, 1, 0, 0, 1, 1, 0, 1, 1, 0]
    assert _share(gone_s=((2.0, 4.0),), rows=slice(3, 6)) == [0, 1, 1]


@pytest.mark.parametrize("gone_s", [((4.0, 2.0),), ((2.0, 4.0), (3.0, 5.0)), ((0.5, 2.0),), ((8.0, 9.5),)])
def test_spans_out_of_order_are_refused(gone_s: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(ValidationError, match="spans follow each other, between onset_s and until_s"):
        Term(effect="boost_leak", magnitude=2e-5, onset_s=1.0, until_s=9.0, gone_s=gone_s)


@pytest.mark.parametrize("end", ["until_s", "grown_s"])
def test_an_end_before_the_onset_is_refused(end: str) -> None:
    with pytest.raises(ValidationError, match=f"{end} 240 s isn't after onset_s, 300 s"):
        Term(effect="boost_leak", magnitude=2e-5, onset_s=300.0, **{end: 240.0})  # type: ignore[arg-type]


def test_on_a_later_recording_what_began_stays_and_what_went_is_gone() -> None:
    leak = Term(effect="boost_leak", magnitude=2e-5)
    times = ({"onset_s": 3.0}, {"grown_s": 8.0}, {"gone_s": ((2.0, 3.0),)}, {"onset_s": 3.0, "until_s": 6.0})
    assert as_later([leak.model_copy(update=own) for own in times]) == (leak, leak, leak)


def test_a_file_holds_ends_and_growth_only_of_terms_that_have_them() -> None:
    leak = Term(effect="boost_leak", magnitude=2e-5, onset_s=3.0)
    assert not {"until_s", "grown_s", "gone_s"} & set(leak.model_dump())
    assert leak.model_copy(update={"until_s": 6.0}).model_dump(mode="json")["until_s"] == 6.0
