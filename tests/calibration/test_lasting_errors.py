"""Errors of maps that a reference tells stand in the repaired machine's file, and act where it is simulated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.calibration import calibrate as module
from dieseltwin.calibration.calibrate import calibrate
from dieseltwin.calibration.coefficients import WEAR
from dieseltwin.calibration.discover import Options, PointsDiscovery, discover_points
from dieseltwin.calibration.lasting_errors import EXHAUST, corrections_left
from dieseltwin.calibration.saved import write_repaired
from dieseltwin.calibration.steady_model import MAP_MODE, ROWS, SENSOR_ERROR, SteadyModel
from dieseltwin.calibration.verdict import document
from dieseltwin.discovery.verdict.explained import disagreement
from dieseltwin.engine.map_corrections import basis
from dieseltwin.engine.terms import CorrectionTerm, corrections_in
from dieseltwin.recordings.steady_points import STATES, beside_reference
from dieseltwin.settings.defaults import default_search
from tests.calibration.simulated import GEOMETRY, TRUTH, made_points, settle

MAP_RMS = 0.02
HOLD_S = 60
AGREE = 1e-3


def drawn(rms: float) -> CorrectionTerm:
    coefficients = rms * np.random.default_rng(4).standard_normal(len(basis().names))
    return CorrectionTerm(coefficients=tuple(coefficients))


@pytest.fixture(scope="module")
def bent() -> PointsDiscovery:
    """Points of an engine whose maps are 2 % off beside those of when it was well."""
    engine = TRUTH.replace(terms=(drawn(MAP_RMS),))
    well = made_points(engine, 50, 0.003, 5, u_flap_pct=100.0)
    now = made_points(engine, 30, 0.003, 6, u_flap_pct=100.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 0)
        search = default_search().points.model_copy(update={"most_effects": 1})
        first = calibrate(beside_reference(now, [well]), TRUTH, GEOMETRY, believed=search)
        return discover_points(first, Options(law_search=False, search=search))


def told(bent: PointsDiscovery) -> np.ndarray:
    """Coefficients of the corrections in the repaired machine."""
    found = corrections_in(bent.engine().terms)
    assert found is not None
    return found


def in_the_file(bent: PointsDiscovery) -> tuple[SteadyModel, dict[str, float]]:
    """The calibrated model with its corrections as functions of the maps' arguments, for any state."""
    model = bent.repaired.model
    term = CorrectionTerm(coefficients=tuple(told(bent)))
    values = {name: value for name, value in bent.repaired.start.items() if not name.startswith(MAP_MODE)}
    return SteadyModel(model.engine.replace(terms=(term,)), extra=model.extra), values


@pytest.mark.thorough
def test_the_file_holds_the_errors_that_were_fitted(bent: PointsDiscovery) -> None:
    assert 0.2 * MAP_RMS < np.sqrt(np.mean(told(bent) ** 2)) < 2.0 * MAP_RMS
    points, here = bent.calibration.points, bent.repaired
    corrected, values = in_the_file(bent)
    values |= {name: value for name, value in here.start.items() if name.startswith(f"{MAP_MODE}{EXHAUST}:")}  # no map
    for name, predicted in corrected.relations(points, points.states(), values).predicted.items():
        fitted = here.model.relations(points, points.states(), here.start).predicted[name]
        np.testing.assert_allclose(predicted, fitted, rtol=AGREE, err_msg=name)


@pytest.mark.thorough
def test_simulate_with_the_repaired_file_is_the_calibrated_model(bent: PointsDiscovery, tmp_path: Path) -> None:
    write_repaired(bent, tmp_path / "repaired.yaml")
    judged = bent.calibration.points.judged
    judged = judged.take(np.arange(judged.size) < 6)
    inputs = pd.DataFrame({name: np.repeat(judged[name], HOLD_S) for name in
                           ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")})  # fmt: skip
    inputs.insert(0, "time_s", np.arange(len(inputs), dtype=float))
    simulated = dt.simulate(inputs, tmp_path / "repaired.yaml").frame[list(STATES)].iloc[HOLD_S - 1 :: HOLD_S]
    model, values = in_the_file(bent)
    own = {name: value for name, value in values.items() if not name.startswith(SENSOR_ERROR)}  # true, not as read
    at_rest = settle(model, judged, own, judged.states())
    np.testing.assert_allclose(simulated.to_numpy(), at_rest, rtol=AGREE)
    bare = settle(SteadyModel(bent.repaired.model.engine), judged, own, judged.states())
    assert np.abs(bare / at_rest - 1.0).max() > 10.0 * AGREE  # what the file would miss without them


@pytest.mark.thorough
def test_health_that_a_law_without_a_name_moves_is_less_well_known(bent: PointsDiscovery) -> None:
    """A law is held as it was found: what the turbine has opened by with it, and hadn't without, is its deviation."""
    here, wear = bent.repaired, WEAR["A_vgtmax"]
    opened = 0.2
    before = replace(here, start={**here.start, wear: here.start.get(wear, 0.0) - opened})
    alone, beside = document(bent), document(replace(bent, before_law=before))
    own = here.estimate.std()
    for name, now in beside.health.items():
        then = alone.health[name]
        assert now.since_reference is not None and then.since_reference is not None
        moved = opened if name == "A_vgtmax" else 0.0
        assert now.since_reference.value == then.since_reference.value
        assert now.since_reference.std == pytest.approx(np.hypot(own[WEAR[name]], moved))
    (told,) = (doubt for doubt in beside.warnings if doubt.code == "health_or_law")
    assert "A_vgtmax" in told.text and "A_egrmax" not in told.text
    assert "health_or_law" not in {doubt.code for doubt in alone.warnings}


@pytest.mark.thorough
def test_health_holds_what_an_effect_would_change_that_goes_unseen(bent: PointsDiscovery) -> None:
    """Half of an injector's drift may be said to be health; what explains nothing may be there, too, but not much."""
    found = bent.rounds[-1].found
    lead = min(found.singles, key=lambda fit: fit.objective)
    moved = np.abs(lead.parameters - found.null.fit.parameters)

    def deviation(gain: float) -> np.ndarray:
        """Beside the leading effect, had it explained so much."""
        other = replace(lead, objective=found.null.fit.objective - gain)
        return disagreement(replace(found, singles=[other]), found.null)

    assert found.kind == "healthy" and (moved > 0.0).any()
    assert deviation(60.0) == pytest.approx(moved)
    assert (deviation(-20.0) < 1e-3 * moved.max()).all()
    steps = np.array([deviation(gain) for gain in (0.0, 5.0, 10.0, 15.0)])
    assert (np.diff(steps, axis=0) > 0.0)[:, moved > 0.0].all()
    own = bent.repaired.estimate.std()
    for name, health in document(bent).health.items():
        assert health.since_reference is not None and health.since_reference.std is not None
        assert health.since_reference.std >= own[WEAR[name]]


def test_what_points_leave_without_a_reference_is_in_the_repaired_machine() -> None:
    """Of maps that are 2 % off, all else known, most is told; where nothing is left, there is no correction."""
    engine, believed = TRUTH.replace(terms=(drawn(MAP_RMS),)), default_search().points
    points, model, values = made_points(engine, 80, 0.001), SteadyModel(TRUTH), {"h_tot": TRUTH.h_tot}
    smooth = corrections_left(points, model, values, believed, dict.fromkeys(ROWS, 0.02))
    mended = SteadyModel(TRUTH.replace(terms=(CorrectionTerm(coefficients=tuple(smooth)),)))
    left = [
        np.std(m.relations(points, points.states(), values).residual[0], axis=0)[: len(ROWS)] for m in (model, mended)
    ]
    for row in ("cylinder_flow", "turbine_flow", "turbo_power"):
        k = ROWS.index(row)
        assert left[1][k] < 0.6 * left[0][k], (row, left)
    nothing = corrections_left(points, model, values, believed, dict.fromkeys(ROWS, 1e-5))
    assert np.max(np.abs(nothing)) < 1e-3 * np.max(np.abs(smooth))
