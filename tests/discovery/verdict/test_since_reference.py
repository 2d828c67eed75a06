"""What is said of health with a learned engine."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.discovery.verdict.since_reference import no_better_than_then
from dieseltwin.engine import we2011


def test_absolute_health_is_known_no_better_than_when_the_reference_was_recorded():
    now, then = 0.9 * np.array(we2011.PARAMETERS.health()), np.array([0.017, 0.014, 0.004, 0.011])
    sharp, wide = np.diag((1e-3 * now) ** 2), np.diag((0.5 * now) ** 2)
    assert np.sqrt(np.diag(no_better_than_then(sharp, now, then))) == pytest.approx(then * now)
    assert np.array_equal(no_better_than_then(wide, now, then), wide)
    assert np.array_equal(no_better_than_then(sharp, now, None), sharp)
