"""The error of a found law on unseen driving: nothing for the truth, whatever kind of term says it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from dieseltwin.challenge.laws import error_of, law_error
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.engine import HEALTH, we2011
from dieseltwin.engine.map_corrections import basis
from dieseltwin.engine.terms import ActuatorTerm, CorrectionTerm, LawTerm, SensorTerm, Term
from tests.report import synthetic_discovery as synthetic

ENGINE = we2011.PARAMETERS
HEALTHY = dict(zip(HEALTH, ENGINE.health(), strict=True))


@pytest.fixture(scope="module")
def clean() -> pd.DataFrame:
    drive = draw_driving("random", 60.0, ENGINE.model_dump(), np.random.default_rng(4))
    return pd.DataFrame({**run_plant(drive, ENGINE.model_dump()).columns, **drive.columns()})


@pytest.mark.parametrize(
    ("fault", "term"),
    [
        (Fault("w_egr_gain", 0.08), SensorTerm(sensor="w_egr_kg_s", fault="gain", magnitude=0.08)),
        (Fault("p_im_offset", -5000.0), SensorTerm(sensor="p_im_pa", fault="offset", magnitude=-5000.0)),
        (Fault("vgt_dead_time", 0.3), ActuatorTerm(actuator="vgt", fault="dead_time", magnitude=0.3)),
        (Fault("compressor_flow_loss", 0.05), LawTerm(point="W_c", coefficient=-0.05, unit="-")),
        (Fault("egr_valve_leak", 0.03), LawTerm(point="egr_opening", coefficient=0.03, unit="-")),
        (  # the flow answers the pressure so strongly that plain rounds of a fixed point swing about the solution
            Fault("air_filter_restriction", 45000.0),
            LawTerm(point="p_bc", coefficient=-45000.0 * 0.04 / ENGINE.p_amb, unit="-", factors=(("W_c", 0.2, 2.0),)),
        ),
    ],
)
def test_the_truth_has_no_error(fault: Fault, term: SensorTerm, clean: pd.DataFrame) -> None:
    assert error_of((term,), clean, fault, HEALTHY) < 0.03
    assert error_of((), clean, fault, HEALTHY) == pytest.approx(1.0)


def test_half_the_fault_is_half_wrong(clean: pd.DataFrame) -> None:
    half = SensorTerm(sensor="w_egr_kg_s", fault="gain", magnitude=0.04)
    assert error_of((half,), clean, Fault("w_egr_gain", 0.08), HEALTHY) == pytest.approx(0.5, abs=0.02)


def test_whatever_terms_an_unnamed_answer_carries_are_its_law_but_for_learned_maps(
    tmp_path: Path, clean: pd.DataFrame
) -> None:
    maps = CorrectionTerm(coefficients=(0.02,) * len(basis().names))
    lag = ENGINE.replace(terms=(maps, Term(effect="exhaust_thermal_inertia", magnitude=0.6)))
    fault = Fault("exhaust_thermal_inertia", 0.6)
    (tmp_path / "engine.yaml").write_text(yaml.safe_dump(lag.model_dump(mode="json")))
    unnamed = synthetic.document(effects=[synthetic.UNNAMED])
    unnamed.write(tmp_path / "discrepancy.json")
    error = law_error(tmp_path, clean, fault, HEALTHY)
    assert error is not None and error < 0.05
    beside = [synthetic.UNNAMED, {**synthetic.LEAK, "name": "exhaust_thermal_inertia", "equivalent_names": []}]
    synthetic.document(effects=beside).write(tmp_path / "discrepancy.json")
    assert law_error(tmp_path, clean, fault, HEALTHY) is None
    (tmp_path / "engine.yaml").write_text(yaml.safe_dump(ENGINE.replace(terms=(maps,)).model_dump(mode="json")))
    unnamed.write(tmp_path / "discrepancy.json")
    assert law_error(tmp_path, clean, fault, HEALTHY) is None


def test_a_name_is_no_law(tmp_path: Path, clean: pd.DataFrame) -> None:
    named = ENGINE.replace(terms=(Term(effect="boost_leak", magnitude=1e-5),))
    (tmp_path / "engine.yaml").write_text(yaml.safe_dump(named.model_dump(mode="json")))
    synthetic.document().write(tmp_path / "discrepancy.json")
    assert law_error(tmp_path, clean, Fault("boost_leak", 1e-5), HEALTHY) is None
