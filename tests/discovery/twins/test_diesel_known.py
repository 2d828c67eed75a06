"""Terms of the engine file with times of their own, beside the same effect under trial: their sizes add up."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.discovery.likelihood.fit import Candidate, first_fit
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.engine import we2011
from dieseltwin.engine.terms import Term
from dieseltwin.recordings.reader import recording
from tests.api.simulated import drive

EFFECTS = {"boost_leak": 2e-5, "p_em_gain": 0.03, "vgt_offset": 3.0}


def _simulated(name: str, under_trial: float, *times: dict[str, float]) -> np.ndarray:
    """Readings with terms of one size and these times in the engine, and a share of that size under trial."""
    terms = tuple(Term(effect=name, magnitude=EFFECTS[name], **own) for own in times)  # type: ignore[arg-type]
    twin = EngineTwin(recording(drive(40.0)), we2011.PARAMETERS.replace(terms=terms))
    return twin.simulate(first_fit(twin, Candidate((name,)), [under_trial * EFFECTS[name]]).lanes())[0]


@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_tried_adds_to_a_term_with_times(name: str) -> None:
    """All along by the term and by the trial, or by two terms beside each other: the same."""
    whole = _simulated(name, 1.0)
    np.testing.assert_allclose(_simulated(name, 0.0, {"until_s": 20.0}, {"onset_s": 20.0}), whole, rtol=1e-9)
    early = _simulated(name, 0.0, {"until_s": 20.0})
    np.testing.assert_allclose(_simulated(name, -1.0, {}, {"until_s": 20.0}), early, rtol=1e-9)
    assert np.abs(early - whole).max() > 1e-4 * np.abs(whole).max()
