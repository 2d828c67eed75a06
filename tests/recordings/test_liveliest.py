"""Of a long recording the liveliest stretches are judged, spread over all of it."""

from __future__ import annotations

import numpy as np

from dieseltwin.recordings.liveliest import STRETCH_S, liveliest
from dieseltwin.recordings.reader import Recording


def _long(hours: float, idle_s: slice) -> Recording:
    """Every input a sine of 40 s at 1 Hz; at rest between two times, switched off for ten minutes after an hour."""
    time = np.arange(0.0, 3600.0 * hours, 1.0)
    swing = np.sin(2.0 * np.pi * time / 40.0)
    swing[idle_s] = 0.0
    n_e = 1300.0 + 200.0 * swing
    n_e[3600:4200] = 0.0
    columns = {"time_s": time, "n_e_rpm": n_e, "u_delta_mg": 100.0 + 50.0 * swing, "u_egr_pct": 30.0 + 20.0 * swing,
               "u_vgt_pct": 50.0 + 20.0 * swing}  # fmt: skip
    return Recording(time, columns, 101325.0, 298.15)


def test_lively_stretches_of_the_whole_length_are_kept() -> None:
    whole = _long(3.0, slice(0, 900))
    kept = liveliest(whole, 20.0)
    assert abs(kept.running_s / 60.0 - 20.0) < 1.0 and len(kept.columns["n_e_rpm"]) == kept.time_s.size
    pieces = kept.pieces()
    assert 8 <= len(pieces) <= 10  # neighbours may meet
    assert all(kept.time_s[p.stop - 1] - kept.time_s[p.start] >= STRETCH_S - 2.0 for p in pieces)
    shares = np.histogram([kept.time_s[p.start] for p in pieces], bins=np.linspace(0.0, 10800.0, 4))[0]
    assert np.all(shares >= 2)  # something that begins in any hour is seen
    assert kept.time_s[0] >= 800.0  # not the engine at rest
    rows = np.searchsorted(whole.time_s, kept.time_s)
    assert all(np.array_equal(kept.columns[name], whole.columns[name][rows]) for name in whole.columns)


def test_a_recording_that_is_hardly_longer_stays_whole() -> None:
    short = _long(0.4, slice(0, 0))
    assert liveliest(short, 20.0) is short
