"""The own-engine tier: one machine, one set of sensors, wear since the reference, each recording its own weather."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.challenge.cases import Case, Plan, build_case, maps_of
from dieseltwin.challenge.oracle import MAPS_MET, with_plant_maps
from dieseltwin.challenge.own_engine import WEAR
from dieseltwin.challenge.records import CaseRow
from dieseltwin.challenge.table import lines
from dieseltwin.engine import HEALTH, we2011
from dieseltwin.engine.map_corrections import corrections_of, look_up
from dieseltwin.engine.terms import corrections_in


@pytest.fixture(scope="module")
def case() -> Case:
    plan = Plan(1, "healthy", (), ("boost_leak",), "random")
    laboratory = we2011.PARAMETERS.model_dump()
    return build_case(plan, 3, laboratory, tier="own-engine", duration_s=60.0, reference_min=1.5)


def test_wear_is_what_is_between_reference_and_case(case: Case):
    for name, (low, high) in WEAR.items():
        assert 1.0 + low <= case.answers["since_reference"][name] <= 1.0 + high
        assert abs(case.answers["health"][name] / getattr(we2011.PARAMETERS, name) - 1.0) < 0.35


def test_every_recording_has_its_own_ambient(case: Case):
    days = [frame["p_amb_pa"].iloc[0] for frame in (case.recording, case.held_out, *case.references)]
    assert len(set(days)) == len(days) and np.ptp(days) < 6000.0
    assert [round(frame["time_s"].iloc[-1]) for frame in case.references] == [90]


def test_the_reference_is_other_driving(case: Case):
    assert not np.allclose(case.recording["n_e_rpm"].to_numpy()[:200], case.references[0]["n_e_rpm"].to_numpy()[:200])


def test_the_table_has_a_line_for_the_change_since_the_reference():
    true = dict.fromkeys(HEALTH, 0.9)
    row = CaseRow("case_0001", "healthy", None, "random", (), (), since_true=true,
                  since_said={name: (0.903, 0.003) for name in HEALTH})  # fmt: skip
    found = {line.key: line for line in lines([row])}
    assert "A_egrmax 0.33 %" in found["since"].value and found["since"].passed
    assert "4/4" in found["since_coverage"].value
    assert "since" not in {line.key for line in lines([CaseRow("case_0002", "healthy", None, "random", (), ())])}


@pytest.mark.parametrize(
    ("tier", "off"), [("own-engine", (0, 1, 2, 3, 4, 5)), ("own-engine-ratio", (0, 1, 2, 4, 5, 6))]
)
def test_an_oracle_meets_the_plants_maps(tier: str, off: tuple[int, ...]):
    laboratory = we2011.PARAMETERS.model_dump()
    maps = maps_of({"case": "case_0001", "seed": 3, "tier": tier}, laboratory)
    assert [m for m in range(7) if maps.tables[m].any()] == list(off) and 0.01 < maps.rms < 0.03
    coefficients = corrections_in(with_plant_maps(we2011.PARAMETERS, maps).terms)
    assert coefficients is not None
    tables = corrections_of(np.array(coefficients)).tables
    for m in off:
        ends = [np.linspace(maps.low[m, k], maps.high[m, k], maps.tables.shape[1 + k]) for k in range(2)]
        x, y = (nodes.ravel() for nodes in np.meshgrid(*ends, indexing="ij"))
        left = maps.tables[m].ravel() - look_up(tables[m], m, x, y)
        assert np.sqrt(np.mean(left**2)) < MAPS_MET < 0.1 * np.sqrt(np.mean(maps.tables[m] ** 2))


def test_the_maps_are_drawn_again_from_the_sealed_answers(case: Case):
    maps = maps_of(case.answers, we2011.PARAMETERS.model_dump())
    assert maps.rms == case.answers["map_rms"]["mean"]


def test_rough_maps_are_of_the_same_size_and_turn_faster():
    draws = {}
    for tier in ("own-engine", "own-engine-rough"):
        answers = ({"case": f"case_{k:04d}", "seed": 3, "tier": tier} for k in range(1, 31))
        draws[tier] = np.array([maps_of(item, we2011.PARAMETERS.model_dump()).tables for item in answers])
    size = {tier: np.sqrt(np.mean(tables**2)) for tier, tables in draws.items()}
    slope = {tier: np.sqrt(np.mean(np.diff(tables, axis=2) ** 2)) for tier, tables in draws.items()}
    assert size["own-engine-rough"] == pytest.approx(size["own-engine"], rel=0.1)
    assert slope["own-engine-rough"] == pytest.approx(2.0 * slope["own-engine"], rel=0.15)
