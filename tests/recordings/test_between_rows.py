"""What a channel may have done between two rows, judged by the channel itself."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.recordings.between_rows import unseen


def test_a_straight_line_hides_nothing_and_a_step_half_of_its_size_in_all() -> None:
    np.testing.assert_allclose(unseen(np.arange(20.0)), 0.0, atol=1e-12)
    jump = np.repeat([0.0, 1.0], 10)
    found = unseen(jump)
    assert np.sum(found**2) == pytest.approx(0.5**2) and found.argmax() == 9 and not found[:8].any()


def test_the_channel_itself_says_how_much_lies_between_its_rows() -> None:
    time = np.arange(400.0)
    smooth, rough = np.sin(0.1 * time), np.random.default_rng(5).standard_normal(400)
    middle = np.sin(0.1 * (time[:-1] + 0.5)) - 0.5 * (smooth[:-1] + smooth[1:])
    assert unseen(smooth).std() < 2.0 * middle.std()
    assert np.sqrt(np.mean(unseen(rough) ** 2)) == pytest.approx(np.sqrt(1.5), rel=0.2)
