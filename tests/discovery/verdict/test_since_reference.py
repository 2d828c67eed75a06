"""What is said of health with a learned engine."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.verdict.since_reference import no_better_than_then
from dieseltwin.engine import we2011
from dieseltwin.learning.belief import HEALTH_PRIOR, prior_belief
from dieseltwin.recordings.reader import recording
from tests.api.simulated import drive


def test_absolute_health_is_known_no_better_than_when_the_reference_was_recorded():
    source, engine = recording(drive(60.0)), we2011.PARAMETERS
    now = 0.9 * np.array(engine.health())
    sharp, wide = np.diag((1e-3 * now) ** 2), np.diag((0.5 * now) ** 2)
    learned = EngineTwin(source, engine, belief=prior_belief(engine, 0.02))
    held = no_better_than_then(sharp, now, learned)
    assert np.sqrt(np.diag(held)) == pytest.approx(HEALTH_PRIOR * now)
    assert np.array_equal(no_better_than_then(wide, now, learned), wide)
    assert np.array_equal(no_better_than_then(sharp, now, EngineTwin(source, engine)), sharp)
