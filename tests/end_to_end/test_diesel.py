"""Simulated engines, from the recording through `discover` to the document: found, sized, repaired, or let be.

The plant is the benchmark's, with maps off by 0.3 %. Figures are those of the program as it was when this was written;
they move by less than half of their standard deviation as long as the method is the same.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from dieseltwin.cli.app import main
from dieseltwin.discovery.discover import discover
from dieseltwin.discovery.options import Options
from dieseltwin.discovery.verdict.document import NONE_OF_THESE, Discrepancy
from dieseltwin.engine import load_engine, we2011
from dieseltwin.engine.terms import LawTerm
from dieseltwin.recordings.reader import read_recording
from dieseltwin.recordings.reader import recording as reading
from dieseltwin.report.discovery_words import sentence
from tests.end_to_end.conftest import Answer, Ask
from tests.end_to_end.engines import HEALTH, MACHINES, as_logged, recorded

SENSORS = ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k", "w_c_kg_s")


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The file of one of the four engines."""
    folder = tmp_path_factory.mktemp("engines")

    def write(name: str) -> Path:
        path = folder / f"{name}.csv"
        if not path.is_file():
            recorded(MACHINES[name]).to_csv(path, index=False)
        return path

    return write


@pytest.fixture(scope="session")
def answer(recording: Callable[[str], Path], ask: Ask) -> Callable[[str], Answer]:
    """What the command says of one of the four engines."""
    answers: dict[str, Answer] = {}

    def of(name: str) -> Answer:
        if name not in answers:
            withhold = MACHINES[name].withhold
            answers[name] = ask(recording(name), *(("--withhold", ",".join(withhold)) if withhold else ()))
        return answers[name]

    return of


def _health_off(document: Discrepancy, before: bool = False) -> dict[str, float]:
    """Relative error of each health parameter."""
    true = {name: share * getattr(we2011.PARAMETERS, name) for name, share in HEALTH.items()}
    return {
        name: (value.before if before else value.value) / true[name] - 1.0 for name, value in document.health.items()
    }


@pytest.mark.parametrize(
    ("name", "effect", "site", "magnitude", "std", "p_value"),
    [
        ("leak", "boost_leak", "intake_mass_balance", 3.796e-5, 2.11e-6, 1e-20),
        ("sensor", "p_em_gain", "sensor:p_em_pa", 0.0432, 0.0068, 1e-6),
    ],
)
def test_a_fault_is_named_and_sized(
    answer: Callable[[str], Answer], name: str, effect: str, site: str, magnitude: float, std: float, p_value: float
) -> None:
    document = answer(name).document
    assert document.mismatch and document.p_value < p_value
    assert document.location is not None and document.location.site == site and document.location.onset_s is None
    assert document.location.probability > 0.95
    (found,) = document.effects
    assert found.names == (effect,) and found.probability > 0.95
    assert found.magnitude == pytest.approx(magnitude, abs=0.5 * std)
    assert found.magnitude == pytest.approx(MACHINES[name].faults[0].magnitude, abs=3.0 * std)
    assert found.std == pytest.approx(std, rel=0.2)
    assert document.minimum_detectable[effect] < abs(magnitude)


def test_a_leak_explains_what_the_health_parameters_hid(answer: Callable[[str], Answer]) -> None:
    document = answer("leak").document
    before, after = _health_off(document, before=True), _health_off(document)
    assert before["h_tot"] == pytest.approx(0.105, abs=0.01)  # the ambient, which no column gives, takes a part
    assert before["A_egrmax"] == pytest.approx(-0.0354, abs=0.005)
    assert before["eta_sc"] == pytest.approx(-0.0297, abs=0.005)
    assert all(abs(error) < 0.015 for error in after.values()), after
    fit = document.fit
    assert fit.held_out_nll_before is not None and fit.held_out_nll_after is not None
    assert fit.held_out_nll_before - fit.held_out_nll_after == pytest.approx(0.182, abs=0.02)
    assert fit.chi2_per_sample_after == pytest.approx(1.06, abs=0.05)


def test_a_healthy_engine_is_let_be(answer: Callable[[str], Answer]) -> None:
    document = answer("healthy").document
    assert not document.mismatch and document.effects == () and document.location is None
    assert document.p_value > 1e-3
    assert all(abs(error) < 0.018 for error in _health_off(document).values())
    assert document.fit.held_out_nll_after == document.fit.held_out_nll_before
    smallest = document.minimum_detectable
    assert smallest["boost_leak"] == pytest.approx(5.3e-6, rel=0.3) and smallest["p_em_gain"] < 0.04


@pytest.mark.thorough
def test_a_law_takes_the_place_of_a_name_that_is_withheld(answer: Callable[[str], Answer]) -> None:
    found = answer("withheld")
    document = found.document
    assert document.mismatch and document.location is not None
    assert document.location.site == "intake_mass_balance" and document.location.probability > 0.95
    (effect,) = document.effects
    assert effect.name == NONE_OF_THESE and effect.law is not None and effect.law.startswith("added to intake_balance")
    terms = load_engine(found.folder / "engine.yaml").terms
    assert [type(term) for term in terms] == [LawTerm]
    law = terms[0]
    assert isinstance(law, LawTerm) and law.point == "intake_balance" and law.groups[0].kind == "orifice"
    # A choked nozzle of 8e-5 m2 at 1 bar and 300 K lets 0.01867 kg/s pass.
    assert law.coefficient == pytest.approx(-0.0187, rel=0.06)
    fit = document.fit
    assert fit.held_out_nll_before is not None and fit.held_out_nll_after is not None
    assert fit.held_out_nll_before - fit.held_out_nll_after == pytest.approx(0.306, abs=0.03)
    assert all(abs(error) < 0.013 for error in _health_off(document).values())  # h_tot is known to 2.6 %


def test_the_library_says_what_the_command_says(
    recording: Callable[[str], Path], answer: Callable[[str], Answer]
) -> None:
    """Of a healthy engine; of one with a leak `tests/api` compares them file by file."""
    source = read_recording(recording("healthy"), engine=we2011.PARAMETERS)
    found = discover(source, we2011.PARAMETERS, Options(sensors=SENSORS))
    written = answer("healthy")
    assert [doubt.code for doubt in written.document.warnings] == ["short"]  # what the command adds: five minutes
    assert found.document == written.document.model_copy(update={"warnings": ()})
    assert found.engine == load_engine(written.folder / "engine.yaml")
    assert {"total", "singles", "variants"} <= set(found.runtime)


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "effect"), [("healthy", None), ("leak", "boost_leak")])
def test_held_and_rounded_channels_count_at_their_own_readings(name: str, effect: str | None) -> None:
    """Counted in every row, they raise the twin's chi-square to 1.4 and put `blow_by` beside the leak."""
    document = discover(reading(as_logged(recorded(MACHINES[name]))), we2011.PARAMETERS).document
    assert [found.names for found in document.effects] == ([(effect,)] if effect else [])
    assert all(abs(error) < 0.02 for error in _health_off(document).values())  # h_tot is stated to 2.3 %
    assert document.fit.chi2_per_sample_after == pytest.approx(1.03, abs=0.08)
    if effect:
        assert document.effects[0].magnitude == pytest.approx(3.86e-5, abs=0.5 * 2.32e-6)
        assert document.effects[0].std == pytest.approx(2.57e-6, rel=0.2)


@pytest.mark.thorough
def test_a_manifold_may_be_slow() -> None:
    """Ten seconds, not a lag of the fuel."""
    document = discover(reading(recorded(MACHINES["inertia"])), we2011.PARAMETERS).document
    (found,) = document.effects
    assert found.names == ("exhaust_thermal_inertia",)
    assert found.magnitude == pytest.approx(10.0, abs=0.2) and found.std is not None and found.std < 0.1


def test_the_repaired_engine_simulates_the_leak(
    recording: Callable[[str], Path], answer: Callable[[str], Answer], tmp_path: Path
) -> None:
    """The boost that the command's engine file simulates is nearer to the readings than the twin's before."""
    found, readings = answer("leak"), recording("leak")
    errors = {}
    for label, engine in (("repaired", found.folder / "engine.yaml"), ("published", None)):
        out = tmp_path / f"{label}.csv"
        options = [] if engine is None else ["--engine", str(engine)]
        assert main(["simulate", str(readings), "--out", str(out), *options]) == 0
        simulated, measured = pd.read_csv(out), pd.read_csv(readings)
        errors[label] = (simulated["p_im_pa"] - measured["p_im_pa"]).abs().median()
    assert errors["repaired"] < 0.8 * errors["published"]


def test_everything_beside_the_document_is_written(answer: Callable[[str], Answer]) -> None:
    folder = answer("leak").folder
    assert {path.name for path in folder.iterdir()} == {
        "discrepancy.json", "details.json", "report.html", "figures", "implied.parquet", "engine.yaml", "runtime.json",
    }  # fmt: skip
    assert pd.read_parquet(folder / "implied.parquet")["w_leak_im_kg_s"].median() > 0.004
    assert "boost_leak" in (folder / "report.html").read_text(encoding="utf-8")
    assert answer("leak").details["singles"][0]["names"] == ["boost_leak"]


@pytest.mark.thorough
def test_a_fault_that_goes_again_is_told_so_and_undone_when_it_was_there(
    recording: Callable[[str], Path], ask: Ask, tmp_path: Path
) -> None:
    table = pd.read_csv(recording("healthy"))
    there = (table.time_s >= 100.0) & (table.time_s < 200.0)
    table.loc[there, "w_c_kg_s"] *= 1.06
    path = tmp_path / "goes.csv"
    table.to_csv(path, index=False)
    found = ask(path)
    document = found.document
    (effect,), location = document.effects, document.location
    assert effect.name == "w_c_gain" and effect.magnitude == pytest.approx(0.06, abs=0.01) and location is not None
    assert location.onset_s == pytest.approx(100.0, abs=3.0) and location.until_s == pytest.approx(200.0, abs=3.0)
    words = f"from {location.onset_s:.0f} to {location.until_s:.0f} s, and gone since then"
    assert words in sentence(document)
    (term,) = load_engine(found.folder / "engine.yaml").terms
    assert (term.onset_s, term.until_s) == (location.onset_s, location.until_s)
    assert not ask(path, "--engine", found.folder / "engine.yaml").document.mismatch


@pytest.mark.thorough
def test_a_fault_that_comes_and_goes_is_told_in_its_parts(
    recording: Callable[[str], Path], ask: Ask, tmp_path: Path
) -> None:
    table = pd.read_csv(recording("healthy"))
    table.loc[table.time_s.between(50.0, 110.0) | table.time_s.between(160.0, 230.0), "w_c_kg_s"] *= 1.06
    path = tmp_path / "loose.csv"
    table.to_csv(path, index=False)
    found = ask(path)
    (effect,), location = found.document.effects, found.document.location
    assert effect.name == "w_c_gain" and effect.magnitude == pytest.approx(0.06, abs=0.01) and location is not None
    times = (location.onset_s, *location.gone_s[0], location.until_s)
    assert times == pytest.approx((50.0, 110.0, 160.0, 230.0), abs=3.0)
    words = f"coming and going: from {times[0]:.0f} to {times[1]:.0f} s and from {times[2]:.0f} to {times[3]:.0f} s"
    assert words in sentence(found.document)
    (term,) = load_engine(found.folder / "engine.yaml").terms
    assert term.gone_s == location.gone_s
