"""Pooling, summaries and the schema of identification.json."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from segments import PAPER

from dieseltwin.engine import HEALTH
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import Z_90, Identification, SegmentEstimate, intervals_from_log_std

TRUE = np.array([3e-4, 7e-4, 1.2, 96.0])


def segment(
    relative_std: float, shift: float = 0.0, *, runs: int = 3, identifiable: bool = True, claims: bool = True
) -> SegmentEstimate:
    """An estimate off by `shift`, with a claimed relative standard deviation, from identical runs."""
    values = np.tile(TRUE * (1.0 + shift), (runs, 1))
    std, interval = intervals_from_log_std(values, np.full(values.shape, relative_std))
    if not claims:
        std, interval = np.full_like(std, np.nan), np.full_like(interval, np.nan)
    return SegmentEstimate(
        0.0, 60.0, np.zeros(2), values, std, interval, np.zeros((2, 5)), relative_std * values[0],
        np.full(4, identifiable), np.ones(runs, dtype=bool), 0.1, "classical",
    )  # fmt: skip


def whole(*segments: SegmentEstimate) -> Identification:
    """An identification of given segments."""
    return Identification("classical", segments, (), 1.0, 0.25)


def test_pooling_weights_by_inverse_variance() -> None:
    pooled = whole(segment(0.01, 0.02), segment(0.02, -0.02)).pooled()["eta_sc"]
    expected = np.exp((4.0 * np.log(1.02) + np.log(0.98)) / 5.0) * 1.2
    assert pooled.mean == pytest.approx(expected, rel=1e-9)
    assert pooled.std == pytest.approx(expected / np.sqrt(1e4 + 2500.0), rel=1e-6)
    assert pooled.bound == pytest.approx(pooled.std, rel=1e-6)


def test_unidentifiable_segments_are_left_out_of_the_pool() -> None:
    pooled = whole(segment(0.01), segment(0.5, 3.0, identifiable=False)).pooled()["h_tot"]
    assert pooled.mean == pytest.approx(96.0)
    assert pooled.identifiable


def test_nothing_identifiable_is_said_plainly() -> None:
    document = whole(segment(0.5, identifiable=False)).to_json()
    entry = document["parameters"]["A_egrmax"]
    assert entry["mean"] is None and entry["std"] is None and entry["interval_90"] is None
    assert entry["identifiable"] is False
    assert document["segments"][0]["parameters"]["A_egrmax"]["mean"] is not None
    assert document["runs"][0]["parameters"]["A_egrmax"] is None


def test_identical_runs_keep_the_claimed_uncertainty() -> None:
    summary = segment(0.01).summary()["A_vgtmax"]
    assert summary.std == pytest.approx(0.01 * 7e-4)
    assert summary.interval_90 == pytest.approx((7e-4 * np.exp(-0.01 * Z_90), 7e-4 * np.exp(0.01 * Z_90)))


def test_members_without_a_claim_give_their_spread() -> None:
    rng = np.random.default_rng(0)
    many = segment(0.01, runs=400, claims=False)
    spread = SegmentEstimate(**{**vars(many), "parameters": TRUE * np.exp(0.05 * rng.standard_normal((400, 4)))})
    summary = spread.summary()["eta_sc"]
    assert summary.std == pytest.approx(0.06, rel=0.15)
    assert summary.interval_90[0] == pytest.approx(1.2 * np.exp(-0.05 * Z_90), rel=0.02)
    assert summary.interval_90[1] == pytest.approx(1.2 * np.exp(0.05 * Z_90), rel=0.02)


def test_a_run_that_has_not_converged_is_listed_but_not_averaged() -> None:
    part = segment(0.01)
    values = part.parameters.copy()
    values[2] *= 2.0
    mixed = SegmentEstimate(**{**vars(part), "parameters": values, "converged": np.array([True, True, False])})
    document = whole(mixed).to_json()
    assert document["parameters"]["h_tot"]["mean"] == pytest.approx(96.0)
    assert [run["converged"] for run in document["runs"]] == [True, True, False]
    assert document["runs"][2]["segments"][0]["parameters"]["h_tot"]["value"] == pytest.approx(192.0)


def test_document_follows_the_schema(problem: SegmentProblem) -> None:
    found = identify_segments([problem], "classical", 2, 0, config=PAPER)
    document = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert set(document) == {"schema", "method", "parameters", "segments", "runs"}
    assert document["schema"] == 1 and document["method"] == "classical"
    assert set(document["segments"][0]) == {"t0_s", "t1_s", "parameters"}
    for parameters in (document["parameters"], document["segments"][0]["parameters"]):
        assert list(parameters) == list(HEALTH)
        for entry in parameters.values():
            assert set(entry) == {"mean", "std", "interval_90", "unit", "bound", "identifiable"}
            assert entry["interval_90"][0] < entry["mean"] < entry["interval_90"][1]
    assert len(document["runs"]) == 2
    runtime = json.loads(json.dumps(found.runtime(), allow_nan=False))
    assert runtime["seconds_per_run"] > 0.0 and runtime["runs"] == 2


def test_a_run_that_knows_nothing_says_so() -> None:
    known_nothing = segment(np.inf)
    summary = known_nothing.summary()["A_egrmax"]
    assert summary.std == np.inf
    assert summary.interval_90 is not None and summary.interval_90[1] == np.inf


def test_a_segment_without_a_converged_run_is_not_pooled() -> None:
    stuck = replace(segment(0.01, 0.17), converged=np.zeros(3, dtype=bool))
    pooled = whole(stuck, segment(0.02)).pooled()["A_vgtmax"]
    assert pooled.mean == pytest.approx(7e-4)
    members = replace(segment(0.01, claims=False), converged=np.zeros(3, dtype=bool))
    assert members.summary()["A_vgtmax"].identifiable  # Adam ends with its epochs, not with convergence


@pytest.mark.filterwarnings("error")
def test_a_run_without_a_value_in_one_segment_has_that_of_the_others() -> None:
    some, all_ = segment(0.01, 0.02), segment(0.01)
    values = some.parameters.copy()
    values[1] = np.nan
    converged = np.array([True, False, True])
    found = whole(all_, replace(some, parameters=values, converged=converged))
    runs = found.run_values()
    np.testing.assert_allclose(runs[1], TRUE)
    np.testing.assert_allclose(runs[[0, 2]], np.tile(TRUE * np.sqrt(1.02), (2, 1)), rtol=1e-3)
    document = found.to_json()
    assert document["runs"][1]["segments"][1]["parameters"]["h_tot"]["value"] is None
    assert document["segments"][1]["parameters"]["h_tot"]["mean"] == pytest.approx(1.02 * TRUE[3])
    none = replace(some, parameters=values, converged=np.zeros(3, dtype=bool))
    assert none.used.tolist() == [True, False, True]
