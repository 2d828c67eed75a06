"""Physical tests of learned maps: the published maps pass each of them, a map that is broken fails the right one."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dieseltwin.engine import MAPS, bind, we2011
from dieseltwin.identification import acceptance
from dieseltwin.identification.acceptance import AcceptanceTest, HeldOutDriving
from dieseltwin.paper.datasets import make_validation
from dieseltwin.settings.params import load_params

ENGINE = we2011.PARAMETERS
EXACT = {name: getattr(bind("numpy"), name) for name in MAPS}
LIMITS = load_params(None, "quick").promotion.acceptance

BROKEN: dict[str, dict[str, Callable[..., Any]]] = {
    "an EGR valve that opens when it is shut": {"f_egr": lambda u, c: EXACT["f_egr"](80.0 - u, c)},
    "a VGT that shuts when it opens": {"F_vgt_Pi_t": lambda u, Pi, c: EXACT["F_vgt_Pi_t"](110.0 - u, Pi, c)},
    "a turbine of half the efficiency": {"eta_tm": lambda w, T, Pi, c: 0.5 * EXACT["eta_tm"](w, T, Pi, c)},
    "a compressor of more than all efficiency": {"eta_c": lambda W, Pi, c: 1.5 * EXACT["eta_c"](W, Pi, c)},
    "a compressor that likes pressure": {"Phi_c": lambda T, Pi, w, c: 0.1 + 0.04 * Pi + 1e-6 * w},
    "no number": {"eta_vol": lambda p_im, n_e, c: np.nan * p_im},
}


@pytest.fixture(scope="module")
def driving() -> HeldOutDriving:
    return HeldOutDriving(*make_validation(902, load_params(None, "quick"), duration_s=180.0))


def quick_tests(functions: dict[str, Any], driving: HeldOutDriving) -> dict[str, AcceptanceTest]:
    """All but the simulation of driving."""
    limits = LIMITS.model_copy(update={"driving": None})
    return {test.name: test for test in acceptance.map_tests(functions, ENGINE, driving, limits)}


def test_the_published_maps_pass_by_orders_of_magnitude(driving: HeldOutDriving) -> None:
    tests = acceptance.map_tests(EXACT, ENGINE, driving, LIMITS)
    assert [test.name for test in tests] == ["balances", "rest", "ranges", "monotony", "driving"]
    for test in tests:
        assert test.passed and test.figure < 1e-4, test.sentence


@pytest.mark.parametrize(
    ("broken", "failed", "passed", "words"),
    [
        ("an EGR valve that opens when it is shut", {"balances", "rest", "monotony"}, {"ranges"}, "EGR valve"),
        ("a VGT that shuts when it opens", {"balances", "monotony"}, {"ranges"}, "VGT's position"),
        ("a turbine of half the efficiency", {"balances", "rest"}, {"ranges", "monotony"}, "power of the turbo shaft"),
        ("a compressor of more than all efficiency", {"balances", "ranges"}, {"monotony"}, "eta_c is outside 0 to 1"),
        ("a compressor that likes pressure", {"monotony"}, {"ranges"}, "Phi_c over Pi_c"),
        ("no number", {"balances", "rest", "ranges", "monotony"}, set(), "eta_vol"),
    ],
)
def test_a_broken_map_fails_what_it_breaks(
    driving: HeldOutDriving, broken: str, failed: set[str], passed: set[str], words: str
) -> None:
    tests = quick_tests({**EXACT, **BROKEN[broken]}, driving)
    assert all(not tests[name].passed for name in failed), tests
    assert all(tests[name].passed for name in passed), tests
    assert any(words in tests[name].sentence for name in failed)


def test_what_cannot_be_computed_is_failed_and_strict_json(driving: HeldOutDriving) -> None:
    test = quick_tests({**EXACT, **BROKEN["no number"]}, driving)["monotony"]
    assert not test.passed and not np.isfinite(test.figure)
    assert test.to_json()["figure"] is None and test.to_json()["passed"] is False


@pytest.mark.thorough
def test_driving_with_a_map_that_is_off_shows_how_far_it_takes_the_states(driving: HeldOutDriving) -> None:
    off = {**EXACT, "eta_tm": lambda w, T, Pi, c: 0.8 * EXACT["eta_tm"](w, T, Pi, c)}
    test = acceptance.driving_errors(off, driving, 0.03)
    assert not test.passed and 0.05 < test.figure < 0.5
    assert "omega_t" in test.sentence and "3 minutes" in test.sentence


@pytest.mark.thorough
def test_a_known_engine_is_found_and_another_one_is_not(driving: HeldOutDriving) -> None:
    identify = load_params(None, "quick").identify
    found = acceptance.known_engine({}, ENGINE, driving, identify, LIMITS.known_engine)
    assert found.passed, found.sentence
    larger = ENGINE.replace(V_d=1.1 * ENGINE.V_d)
    missed = acceptance.known_engine({}, larger, driving, identify, LIMITS.known_engine)
    assert not missed.passed and "of a known engine" in missed.sentence


def test_a_test_without_a_limit_is_left_out(driving: HeldOutDriving) -> None:
    limits = LIMITS.model_copy(update={name: None for name in ("balances", "rest", "ranges", "driving")})
    assert [test.name for test in acceptance.map_tests(EXACT, ENGINE, driving, limits)] == ["monotony"]


def test_the_printed_maps_have_limits_of_their_own_unless_a_test_is_left_out(driving: HeldOutDriving) -> None:
    exact = SimpleNamespace(replacements=lambda _: EXACT, parameters=ENGINE)
    maps: Any = {"improved": exact, "paper": exact}
    only = dict.fromkeys(("balances", "rest", "ranges", "driving", "known_engine"))
    asked = LIMITS.model_copy(update=only)
    tests = acceptance.acceptance_tests(maps, {}, driving, asked, load_params(None, "quick").identify)
    assert [(test.name, test.limit) for test in tests] == [
        ("monotony/improved", LIMITS.monotony), ("monotony/paper", LIMITS.paper.monotony),
    ]  # fmt: skip
    assert LIMITS.of_maps("paper").driving == LIMITS.paper.driving and LIMITS.of_maps("improved") == LIMITS
