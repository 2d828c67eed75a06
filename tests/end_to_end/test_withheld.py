"""A name that is wrong but fits: friction of the shaft's bearings, seven tolerances, whose name is withheld."""

from __future__ import annotations

import pytest

from dieseltwin.challenge.cases import build_case, make_plans
from dieseltwin.discovery.discover import discover
from dieseltwin.discovery.options import Options
from dieseltwin.discovery.verdict.document import NONE_OF_THESE
from dieseltwin.engine import we2011
from dieseltwin.recordings.reader import recording

SEED, CASES, NUMBER = 460165652, 150, 39


@pytest.mark.thorough
def test_a_name_that_leaves_nothing_gives_way_to_a_term_that_explains_more():
    """The compressor's loss that was named leaves 5 about itself, as maps take up the rest, but is behind by 28."""
    plan = make_plans(CASES, SEED)[NUMBER - 1]
    case = build_case(plan, SEED, we2011.PARAMETERS.model_dump())
    options = Options(withhold=plan.withhold, law_search=False)
    document = discover(recording(case.recording), we2011.PARAMETERS, options).document
    assert [effect.name for effect in document.effects] == [NONE_OF_THESE]
    assert document.location is not None and document.location.site == "shaft_power"
