"""Among several recordings the one that isn't of the same engine is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.discovery.verdict.odd_recordings import odd_recordings, rows_of_each
from tests.report import synthetic_discovery as synthetic


@pytest.mark.parametrize(("off", "said"), [(1.0, False), (1.6, False), (5.0, True)])
def test_a_recording_that_is_explained_far_worse_than_the_others_is_said(off: float, said: bool) -> None:
    """One of another engine among two of this one was a loss of compressor flow of 9 %, and nothing said which."""
    found = synthetic.discovery()
    n, rng = found.curves.time_s.size, np.random.default_rng(5)
    thirds = [slice(0, n // 3), slice(n // 3, 2 * n // 3), slice(2 * n // 3, n)]
    time_s = found.curves.time_s - found.curves.time_s[0]
    apart = np.concatenate([time_s[rows] + r for r, rows in enumerate(thirds)])
    recordings = [
        {"path": f"{k}.csv", "sha256": 64 * "0", "duration_s": float(np.ptp(time_s[rows])), "date": f"2026-0{k + 1}-15",
         "date_from": "file name", "p_amb_pa": 1e5, "t_amb_k": 298.0, "health": synthetic.content()["health"]}
        for k, rows in enumerate(thirds)
    ]  # fmt: skip
    noise = rng.standard_normal(found.curves.measured.shape)
    noise[thirds[1]] *= off
    curves = replace(found.curves, time_s=apart, after=found.curves.measured + noise * found.curves.sigma)
    document = synthetic.document(recordings=recordings)
    assert rows_of_each(apart, document.recordings) == thirds
    notes = odd_recordings(replace(found, curves=curves, document=document))
    assert bool(notes) is said
    if said:
        (note,) = notes
        assert "1.csv is explained far worse than the others (5.0 times the noise is left, 1.0 in" in note
    assert odd_recordings(found) == []
