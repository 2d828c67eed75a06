"""The two rigs of the examples, simulated with what their files lack: the four commands name, size and repair it.

The plants are integrated here in small steps of their own, with dry friction that sticks and a tank that overflows.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.cli.app import main
from dieseltwin.rigs.parameters import RigParameters, load_rig
from tests.end_to_end.conftest import Answer
from tests.pages import check_page, groups_of, without_pictures

RIGS = Path(__file__).resolve().parents[2] / "examples" / "rigs"

MASS, F_V, F_C, OFFSET = 95.0, 203.0, 20.4, -3.0
"""Of the axis: mass [kg], viscous friction [N s/m], dry friction [N], constant force [N]."""

K_PUMP, K_UPPER, K_LOWER, AREA_RATIO, OVERFLOW = 0.047, 0.065, 0.062, 0.9, 0.15
"""Of the tanks, as the example has them; the upper one's overflow [1/s] falls into the lower one."""


def axis_recording(seconds: float = 8.0, seed: int = 0) -> pd.DataFrame:
    """The axis at 1 kHz."""
    rng = np.random.default_rng(seed)
    step, n = 1e-4, round(seconds * 1e4)
    time = np.arange(n) * step
    places = rng.uniform(0.0, 0.25, int(seconds / 1.5) + 3)
    smooth = np.hanning(4000)
    wanted = np.interp(time, 1.5 * np.arange(places.size), places)
    wanted = np.convolve(np.pad(wanted, (2000, 1999), mode="edge"), smooth / smooth.sum(), "valid")
    speed = np.gradient(wanted, step)
    q, v, force, rows = wanted[0], 0.0, 0.0, []
    for k in range(n):
        if k % 10 == 0:
            force = 9000.0 * (wanted[k] - q) + 1800.0 * (speed[k] - v) + 60.0 * np.sin(2.0 * np.pi * 7.0 * time[k])
            rows.append((time[k], q + 2e-6 * rng.standard_normal(), force))
        sliding = v != 0.0
        dry = F_C * np.sign(v) if sliding else float(np.clip(force - OFFSET, -F_C, F_C))
        faster = v + step * (force - F_V * v - dry - OFFSET) / MASS
        if sliding and v * faster < 0.0:
            faster = 0.0
        q, v = q + 0.5 * step * (v + faster), faster
    return pd.DataFrame(rows, columns=["time_s", "q_m", "motor_force_N"])


def tanks_recording(n: int = 1024, seed: int = 0) -> pd.DataFrame:
    """The tanks every 4 s."""
    rng = np.random.default_rng(seed)
    time = 4.0 * np.arange(n)
    tones = np.arange(1, 18)
    pump = np.sin(2.0 * np.pi * np.outer(time / (4.0 * n), tones) + rng.uniform(0.0, 2.0 * np.pi, tones.size))
    pump = np.clip(3.2 + 1.8 * pump.sum(axis=1) / np.sqrt(0.5 * tones.size), 0.8, 8.0)
    upper, lower, parts, rows = 5.0, 5.0, 40, []
    for k in range(n):
        rows.append((time[k], pump[k], min(lower, 10.0) + 0.01 * rng.standard_normal()))
        for share in (np.arange(parts) + 0.5) / parts:
            voltage = pump[k] + share * (pump[min(k + 1, n - 1)] - pump[k])
            over, outlet = OVERFLOW * max(upper - 10.0, 0.0), K_UPPER * np.sqrt(max(upper, 0.0))
            filling = AREA_RATIO * (outlet + over) - K_LOWER * np.sqrt(max(lower, 0.0))
            upper += 4.0 / parts * (K_PUMP * voltage - outlet - over)
            lower += 4.0 / parts * filling
    return pd.DataFrame(rows, columns=["time_s", "u_pump_V", "y_lower_tank_V"])


@dataclass(frozen=True)
class Case:
    """What was found on the first part of a recording, and free runs over the rest.

    Attributes:
        answer: of `discover`.
        fitted: what `identify` made of the rig on the first part.
        errors: rms error of the reading over the rest, of the fitted rig and of the repaired one.
    """

    answer: Answer
    fitted: RigParameters
    errors: tuple[float, float]

    @property
    def repaired(self) -> RigParameters:
        """The machine that `discover` wrote."""
        return load_rig(self.answer.folder / "engine.yaml")


def _asked(rig: str, recording: pd.DataFrame, first: int, folder: Path) -> Case:
    """`discover` and `identify` on the first rows, `simulate` with what both wrote on the others."""
    early, late, file = folder / "early.csv", folder / "late.csv", RIGS / f"{rig}.yaml"
    recording.iloc[:first].to_csv(early, index=False)
    recording.iloc[first:].to_csv(late, index=False)
    assert main(["discover", str(early), "--engine", str(file), "--out", str(folder / "found")]) == 0
    assert main(["identify", str(early), "--engine", str(file), "--out", str(folder / "fitted")]) == 0
    errors = []
    for name in ("fitted", "found"):
        engine, out = folder / name / "engine.yaml", folder / f"{name}.csv"
        assert main(["simulate", str(late), "--engine", str(engine), "--out", str(out)]) == 0
        machine, table = load_rig(engine), pd.read_csv(out)
        (column,) = machine.readings
        measured = recording[column].iloc[first :: machine.every].to_numpy()[: len(table)]
        left = (table[column].to_numpy() - measured)[machine.first_rows or 0 :]
        errors.append(float(np.sqrt(np.mean(left**2))))
    return Case(Answer(folder / "found"), load_rig(folder / "fitted" / "engine.yaml"), (errors[0], errors[1]))


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> Case:
    with without_pictures():
        return _asked("positioning_axis", axis_recording(12.0), 8000, tmp_path_factory.mktemp("axis"))


@pytest.fixture(scope="module")
def tanks(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """A third of the public record's length: short records are where the overflow was missed."""
    return _asked("cascaded_tanks", tanks_recording(700), 350, tmp_path_factory.mktemp("tanks"))


@pytest.mark.thorough
def test_axis_names_its_friction(axis: Case) -> None:
    found = axis.answer.document
    first = found.effects[0]
    assert (first.name, first.equivalent_names) == ("coulomb_friction", ()) and first.law == "F_c sign(v)"
    assert found.location is not None and found.location.site == "force_balance"
    machine = axis.repaired
    sizes = {t.effect: t.magnitude for t in machine.terms}
    assert sizes["coulomb_friction"] == pytest.approx(F_C, rel=0.05)
    assert sizes["constant_force"] == pytest.approx(OFFSET, rel=0.1)
    assert "asymmetric_friction" in next(e for e in found.effects if e.name == "constant_force").equivalent_names
    values = [p.value for p in machine.parameters.values()]
    assert values == pytest.approx([MASS, F_V], rel=0.03)


def test_tanks_name_the_overflow(tanks: Case) -> None:
    found = tanks.answer.document
    (effect,) = found.effects
    assert effect.name == "upper_overflow" and effect.magnitude is not None and effect.std is not None
    assert effect.magnitude == pytest.approx(OVERFLOW, abs=4.0 * effect.std) and effect.std < 0.02
    assert found.location is not None and found.location.site == "lower_tank"
    values = [p.value for p in tanks.repaired.parameters.values()]
    assert values == pytest.approx((K_PUMP, K_UPPER, K_LOWER, AREA_RATIO), rel=0.03)


def test_the_page_says_it_all(tanks: Case) -> None:
    page = tanks.answer.folder / "report.html"
    check_page(page, "over=upper_overflow·max(0,hupper−10)")
    whole, last = groups_of(page)
    assert [panel["unit"] for panel in whole["panels"]] == ["V", "V", "V"] and whole["marks"][0]["until"] is not None
    measured, before, after = (np.array(line["y"]) for line in last["panels"][0]["lines"])
    assert last["panels"][0]["x"][0] > whole["panels"][0]["x"][0]  # the part that no fit has seen
    assert np.sqrt(np.mean((after - measured) ** 2)) < 0.2 * np.sqrt(np.mean((before - measured) ** 2))
    text = page.read_text(encoding="utf-8")
    share = tanks.answer.document.fit.share_explained
    assert share is not None and share > 0.9 and "90 % interval" in text and "misfit explained" in text


@pytest.mark.thorough
def test_the_repaired_machines_run_free_where_no_fit_has_seen_them(axis: Case, tanks: Case) -> None:
    assert axis.errors[1] < 0.2 * axis.errors[0]
    assert tanks.errors[1] < 0.02 < 0.2 * tanks.errors[0]  # the readings' noise is 0.01 V


def test_the_next_discovery_takes_the_repaired_machine(tanks: Case, tmp_path: Path) -> None:
    repaired, out = tanks.answer.folder / "engine.yaml", tmp_path / "again"
    with without_pictures():
        assert main(["discover", str(tanks.answer.folder.parent / "early.csv"), "--engine", str(repaired),
                     "--out", str(out)]) == 0  # fmt: skip
    assert not any(effect.named for effect in Answer(out).document.effects)
    assert load_rig(out / "engine.yaml").terms[0].effect == "upper_overflow"


def test_why_a_name_was_not_taken(tanks: Case, capsys: pytest.CaptureFixture[str]) -> None:
    early, out = tanks.answer.folder.parent / "early.csv", tanks.answer.folder
    asked = ["discover", str(early), "--engine", str(RIGS / "cascaded_tanks.yaml"), "--out", str(out), "--explain"]
    assert main([*asked, "upper_overflow"]) == 0
    assert "chosen in round 1" in capsys.readouterr().out
    assert main([*asked, "upper_overflw"]) == 2
    assert "did you mean upper_overflow" in capsys.readouterr().err
