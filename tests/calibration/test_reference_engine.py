"""Beside a reference what came since is sought about the engine of the reference, which no fault bends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.calibration import calibrate as module
from dieseltwin.calibration.calibrate import Calibration, calibrate
from dieseltwin.calibration.coefficients import WEAR, wear_coefficients
from dieseltwin.calibration.discover import Options, discover_points
from dieseltwin.calibration.reference_engine import about_reference, told_by_reference
from dieseltwin.calibration.steady_model import CHARGE_OFFSET, MAP_MODE, SENSOR_ERROR, SteadyModel
from dieseltwin.calibration.steady_twin import CHARGE, SteadyTwin, hypotheses_of
from dieseltwin.calibration.verdict import document
from dieseltwin.recordings.steady_points import COOLANT_K, STATES, USUAL_CHARGE, SteadyPoints, beside_reference
from dieseltwin.settings.defaults import default_search
from tests.calibration.simulated import GEOMETRY, TRUTH, made_points

BLOW_BY = 0.035
SEARCH = default_search().points.model_copy(update={"most_effects": 1})


@pytest.fixture(scope="module")
def blowing() -> Calibration:
    """Points with blow-by beside those of when the engine was well, 0.2 % noise on every reading."""
    well = made_points(TRUTH, 60, 0.002, 5, u_flap_pct=100.0)
    now = made_points(TRUTH, 50, 0.002, 6, {"blow_by": BLOW_BY}, u_flap_pct=100.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 0)
        return calibrate(beside_reference(now, [well]), TRUTH, GEOMETRY, believed=SEARCH)


def test_a_fault_bends_the_joint_fit_and_not_what_the_reference_tells(blowing: Calibration) -> None:
    told = told_by_reference(blowing)
    lasting = [c for c in blowing.estimate.coefficients if c.name not in WEAR.values()]
    assert set(told) == {c.name for c in lasting}

    def off(values: dict[str, float]) -> float:
        """Coefficients of the engine beside the truth, in standard deviations of their belief, all together."""
        own = [c for c in lasting if not c.name.startswith((MAP_MODE, SENSOR_ERROR))]
        return float(np.sqrt(sum(((values[c.name] - c.mean) / c.std) ** 2 for c in own)))

    assert off(dict(told)) < off(blowing.estimate.values())


def test_wear_is_simulated_and_believed_about_nought(blowing: Calibration) -> None:
    there = about_reference(blowing, told_by_reference(blowing))
    twin = SteadyTwin(there, SEARCH)
    assert {p.name for p in twin.parameters} == set(WEAR.values())
    assert all(p.value == 0.0 for p in twin.parameters)
    assert [p.first for p in twin.parameters] == [there.start[p.name] for p in twin.parameters]


def test_without_a_reference_nothing_is_told(blowing: Calibration) -> None:
    assert about_reference(blowing, {}) is blowing


@pytest.mark.thorough
def test_the_fault_is_named(blowing: Calibration) -> None:
    found = discover_points(blowing, Options(law_search=False, search=SEARCH))
    assert tuple(found.effects) == ("blow_by",)
    magnitude, std = found.effects["blow_by"]
    assert magnitude == pytest.approx(BLOW_BY, abs=3.0 * std)


def test_the_charge_of_another_day_follows_the_weather(blowing: Calibration) -> None:
    """Points of a cold day beside a reference of a warm one were a meter that reads too much."""
    day = np.where(blowing.points["judged"] > 0.5, 285.0, 300.0)
    other = replace(blowing, points=blowing.points.with_columns(t_amb_k=day))
    labels = {}
    for name, calibration in (("same", blowing), ("other", other)):
        there = about_reference(calibration, told_by_reference(calibration))
        twin = SteadyTwin(there, SEARCH)
        labels[name] = {n.label: n.response for n in twin.nuisances(twin.plain_lane())}
    assert CHARGE not in labels["same"]
    response = labels["other"][CHARGE]
    cylinder = twin.channels.index("cylinder_flow")
    assert np.abs(response[twin._acts > 0.5, cylinder]).min() > 0.5 and not response[twin._acts < 0.5].any()


def test_a_charge_that_is_read_fills_the_cylinders_as_it_is() -> None:
    """It was taken to be as warm everywhere: a cold day was air that the meter reads too much, or a filling."""
    table = made_points(TRUTH, 30, 0.0, 5, u_flap_pct=100.0)
    read = table.with_columns(t_im_k=np.where(np.arange(table.size) % 2, TRUTH.T_im, TRUTH.T_im - 15.0))
    known = read.with_columns(t_im_k=np.where(np.arange(table.size) == 3, np.nan, read["t_im_k"]))
    model = SteadyModel(TRUTH, extra=("t_im_k",))

    def filled(points: SteadyPoints, of: SteadyModel) -> np.ndarray:
        return np.asarray(of.relations(points, points.states(), {}).quantities["W_ei"][0])

    before = filled(table, SteadyModel(TRUTH))
    assert filled(read, model)[1::2] == pytest.approx(before[1::2])
    assert filled(read, model)[::2] == pytest.approx(before[::2] * TRUTH.T_im / (TRUTH.T_im - 15.0))
    assert before[3] < filled(known, model)[3] < 1.05 * before[3]  # as warm as the others mostly are


def test_the_usual_charge_is_that_of_the_reference_in_the_weather_of_the_day() -> None:
    """The engine file's charge of 300 K stood beside the readings: a cold day was a cooler that is better or worse."""
    both = beside_reference(made_points(TRUTH, 20, 0.0, 6, u_flap_pct=100.0),
                            [made_points(TRUTH, 30, 0.0, 5, u_flap_pct=100.0)])  # fmt: skip
    T_amb = np.where(both["judged"] > 0.5, 283.0, 301.0)
    share = both["w_egr_kg_s"] / (both["w_c_kg_s"] + both["w_egr_kg_s"])
    cooled = 4.0 + 0.05 * T_amb * ((both["p_im_pa"] / both["p_amb_pa"]) ** 0.286 - 1.0)
    of_egr = COOLANT_K + 0.1 * (both["t_em_k"] - COOLANT_K) - T_amb
    usual = T_amb + (1.0 - share) * cooled + share * of_egr
    worse = np.where(both["judged"] > 0.5, 8.0, 0.0)
    points = both.with_columns(t_amb_k=T_amb, t_im_k=usual + worse)
    assert points.usual_charge == pytest.approx(usual)
    assert points.judged.usual_charge is None  # judged points alone don't know: they were held against one temperature
    assert points.with_usual_charge().judged.usual_charge == pytest.approx(usual[points["judged"] > 0.5])
    few = points.with_columns(t_im_k=np.where(np.arange(points.size) < 5, points["t_im_k"], np.nan))
    assert few.usual_charge is None


def test_an_offset_of_the_charges_sensor_is_no_warmer_charge() -> None:
    """It acts in the judged points alone, and the cylinders fill with the charge as it is."""
    well, judged = (made_points(TRUTH, count, 0.0, seed, u_flap_pct=100.0) for count, seed in ((30, 5), (20, 6)))
    both = beside_reference(judged, [well])
    read = TRUTH.T_im + np.where(both["judged"] > 0.5, 8.0, 0.0)
    points = both.with_columns(t_im_k=read, **{USUAL_CHARGE: np.full(both.size, TRUTH.T_im)})
    model = SteadyModel(TRUTH, extra=("t_im_k",))
    found = {size: model.relations(points, points.states(), {CHARGE_OFFSET: size}) for size in (0.0, 8.0)}
    rows = [model.rows.index(row) for row in ("T_im", "cylinder_flow")]
    assert np.abs(found[0.0].residual[0, :30, rows]).max() < 1e-3 < np.abs(found[0.0].residual[0, 30:, rows]).min()
    assert np.abs(found[8.0].residual[0, :, rows]).max() < 1e-3
    assert CHARGE_OFFSET in hypotheses_of(points, STATES) and CHARGE_OFFSET not in hypotheses_of(both, STATES)


def test_health_wears_by_what_is_believed_of_each() -> None:
    """A gain of T_em took the place of an efficiency beside a cycle that had lost 7 %."""
    std = {c.name: c.std for c in wear_coefficients()}
    assert std[WEAR["eta_sc"]] < 0.5 * min(std[WEAR[name]] for name in ("A_egrmax", "A_vgtmax", "h_tot"))


@pytest.mark.thorough
def test_a_back_pressure_is_smaller_beside_the_engines_own_pipes() -> None:
    own, more = 1.1e5, 1.0e5
    well = made_points(TRUTH, 60, 0.004, 5, {"back_pressure": own}, u_flap_pct=100.0)
    judged = made_points(TRUTH, 40, 0.004, 6, {"back_pressure": own + more}, u_flap_pct=100.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 0)
        points = default_search().points
        found = discover_points(calibrate(beside_reference(judged, [well]), GEOMETRY, believed=points),
                                Options(law_search=False, search=points))
    magnitude, std = found.effects["back_pressure"]
    assert found.beside_pipes is not None and found.beside_pipes < magnitude
    assert std > magnitude - found.beside_pipes and abs(magnitude - more) < 2.0 * std
    assert any("usual pipes" in doubt.text for doubt in document(found).warnings)
