"""The later part of a recording is foretold by fits that haven't seen it, a law's own numbers among them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dieseltwin.discovery.laws.grammar import Factor, Form
from dieseltwin.discovery.laws.twin import LawTwin, Placed
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.twins.interface import rows_of, single
from dieseltwin.discovery.verdict.held_out import held_out_scores, held_windows
from dieseltwin.recordings.noise import Noise
from tests.discovery.toy import Toy, null_fit

SIGMA = 0.02
DRAIN = Placed(Form("balance", (Factor("power", ("x",), (1.0,), 1.0, ("-",)),)), -0.1)


def _recorded(late: float) -> Toy:
    """A vessel that drains by 0.1 x, and in the part that is held out by `late` times as much."""
    twin = Toy()
    law = LawTwin(twin, [DRAIN])
    runs = []
    for drain in (0.1, 0.1 * late):
        lanes = single(np.array([1.0, drain]), np.ones((twin.starts.size, 1)))
        runs.append(law.simulate(lanes)[0])
    held = rows_of(twin, held_windows(twin))
    clean = np.where(held[:, None], runs[1], runs[0])
    twin.measured = clean + np.random.default_rng(1).normal(0.0, SIGMA, clean.shape)
    return twin


@pytest.mark.parametrize("late", [1.0, 2.0])
def test_a_laws_numbers_are_those_of_the_part_before(late: float) -> None:
    twin = _recorded(late)
    noise = Noise(np.full(2, SIGMA), np.zeros(2))
    whitening = Whitening.of(twin.measured, noise, twin.starts)
    null, law = null_fit(twin, whitening), LawTwin(twin, [DRAIN])
    at = null_fit(law, whitening)
    found: Any = SimpleNamespace(twin=twin, null=null, kind="law")
    before, after = held_out_scores(found, at)

    assert (at.fit.parameters[1] > 0.105) == (late > 1.0)  # by all of the recording it is another
    held = rows_of(twin, held_windows(twin))[:, None]
    lanes = single(np.array([1.0, 0.1]), at.fit.local)
    rest = np.where(held, twin.measured - law.simulate(lanes)[0], 0.0)
    there = at.metric.without_local(rest[None])[0]
    logs = whitening.log_normaliser(whitening.present & held)
    foretold = (0.5 * there @ there + logs) / held.sum()
    assert after == pytest.approx(foretold, rel=0.05)
    assert after < before
