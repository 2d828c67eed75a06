"""`--explain none_of_these` says which name came nearest, and what it lacked."""

from __future__ import annotations

from dieseltwin.discovery.verdict.explain import _none_of_these


def test_none_of_these_says_what_the_best_name_lacks() -> None:
    reason = "log-likelihood gain 138.9, against 557.9 by a term without a name"
    rows = [
        {"name": "egr_valve_leak", "log_likelihood_gain": 67.5, "reason": "another"},
        {"name": "egr_backlash", "log_likelihood_gain": 138.9, "reason": reason},
        {"name": "boost_leak", "log_likelihood_gain": None, "reason": "not refitted"},
    ]
    assert f"the best of them, egr_backlash: {reason}" in _none_of_these({"candidates": rows}, True, True)
    assert "the best of them" not in _none_of_these({"candidates": rows[2:]}, True, True)
    assert "an effect of the catalogue fits" in _none_of_these({"candidates": rows}, False, True)
