"""What of a recording is known already."""

from __future__ import annotations

import numpy as np

from dieseltwin.recordings.shared_rows import MOST_SHARED, share_known


def test_a_copy_with_fewer_digits_is_the_same_driving() -> None:
    rng = np.random.default_rng(7)
    scale = np.array([1e5, 30.0, 1500.0, 0.05])
    rows, others = (scale * (1.0 + 0.2 * rng.standard_normal((600, 4))) for _ in range(2))
    fewer = np.array([[float(f"{value:.5g}") for value in row] for row in rows[100:300]])
    assert share_known(rows[100:300], [rows]) == 1.0
    assert share_known(fewer, [others, rows]) > 0.5
    assert share_known(others, [rows]) < MOST_SHARED / 10.0


def test_rows_of_a_standing_engine_count_once_and_missing_readings_are_alike() -> None:
    still = np.array([[0.0, np.nan, 101.3]] * 50 + [[-0.0, np.nan, 101.3]] * 50)
    driven = np.stack([np.linspace(800.0, 2000.0, 300), np.linspace(1.0, 9.0, 300), np.full(300, 101.3)], axis=1)
    assert share_known(np.vstack([still, driven]), [still]) == 1.0 / 301.0
    assert share_known(still, [driven]) == 0.0
