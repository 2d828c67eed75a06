"""A made-up petrol engine through `calibrate` and `discover`: a leak and a sensor are found, a healthy one let be."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dieseltwin.challenge.petrol_plant import ONSET_S, drive
from dieseltwin.cli.app import main
from tests.end_to_end.conftest import Answer, Ask
from tests.pages import check_page, groups_of

CALIBRATION_S, RECORDING_S = 900.0, 400.0
FAULTS: dict[str, dict[str, float]] = {"leak": {"leak_m2": 1.5e-5}, "sensor": {"W_af_kg_s": 0.10}, "healthy": {}}


@pytest.fixture(scope="session")
def answer(ask: Ask, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Answer]:
    """What the command says of a recording, with an engine file that the command calibrated."""
    folder = tmp_path_factory.mktemp("petrol")
    engine = folder / "engine.yaml"
    drive(CALIBRATION_S, 1).to_csv(folder / "calibration.csv", index=False)
    assert main(["calibrate", str(folder / "calibration.csv"), "--base", "liu_petrol", "--out", str(engine)]) == 0
    answers: dict[str, Answer] = {}

    def of(name: str) -> Answer:
        if name not in answers:
            path: Path = folder / f"{name}.csv"
            drive(RECORDING_S, 2, **FAULTS[name]).to_csv(path, index=False)
            answers[name] = ask(path, "--engine", engine)
        return answers[name]

    return of


@pytest.mark.parametrize(
    ("name", "effect", "site", "magnitude", "std", "after"),
    [
        # how the seconds weigh lies on an edge here: 1e-13 of the readings decides between -3.01 and -2.58
        ("leak", "intake_leak", "intake_mass_balance", 1.5e-5, 1.5e-7, -2.8),
        ("sensor", "w_af_gain", "sensor:w_af_kg_s", 0.10, 0.0016, -16.38),
    ],
)
def test_a_fault_is_named_sized_and_dated(
    answer: Callable[[str], Answer], name: str, effect: str, site: str, magnitude: float, std: float, after: float
) -> None:
    document = answer(name).document
    assert document.mismatch and document.location is not None and document.location.site == site
    assert document.location.onset_s == pytest.approx(ONSET_S, abs=2.0)
    assert document.effects[0].names == (effect,)
    assert document.effects[0].magnitude == pytest.approx(magnitude, rel=0.03)
    assert document.effects[0].std == pytest.approx(std, rel=0.5)
    assert document.fit.held_out_nll_after == pytest.approx(after, abs=0.3)
    assert document.fit.held_out_nll_before is not None and document.fit.held_out_nll_before > after + 3.0


def test_a_healthy_engine_is_let_be(answer: Callable[[str], Answer]) -> None:
    document = answer("healthy").document
    assert not document.mismatch and document.effects == () and document.location is None
    assert document.minimum_detectable["intake_leak"] < 2e-6
    assert document.minimum_detectable["w_af_gain"] == pytest.approx(0.02, abs=0.01)


def test_the_verdict_is_whole(answer: Callable[[str], Answer]) -> None:
    folder = answer("leak").folder
    assert {path.name for path in folder.iterdir()} >= {
        "discrepancy.json", "details.json", "report.html", "figures", "engine.yaml", "runtime.json",
    }  # fmt: skip
    check_page(folder / "report.html", "Wleak=ApupRaTupΨ(pdownpup)")
    over_time, over_pressure = groups_of(folder / "report.html")
    assert over_time["marks"][0]["at"] == pytest.approx(ONSET_S, abs=2.0) and not over_pressure["linked"]
    assert (over_time["panels"][0]["axis"], over_pressure["panels"][0]["axis"]) == ("time", "p_im")
