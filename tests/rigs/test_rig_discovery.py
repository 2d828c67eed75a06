"""A sound cart, and one that is too light for the steps of the integration."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.rigs import rounds
from dieseltwin.rigs.parameters import RigParameters

CART: dict[str, Any] = {
    "name": "cart", "states": {"v": {"scale": 0.5, "unit": "m/s", "nearest": "v_m_s"}}, "inputs": {"force_n": "N"},
    "parameters": {"m": {"value": 1.5, "prior_std": 0.1, "scale": 0.05, "unit": "kg"},
                   "b": {"value": 2.0, "prior_std": 0.1, "scale": 0.1, "unit": "N s/m"}},
    "quantities": {"drag": {"formula": "(b + worn)*v", "unit": "N", "site": "bearing", "ports": ["v"]},
                   "net": {"formula": "force_n - drag - dry*tanh(v/0.05)", "unit": "N", "site": "balance",
                           "relative": False, "ports": ["v"], "scale": 0.2}},
    "rates": {"v": "net/m"}, "readings": {"v_m_s": "v"}, "sub_steps": 4, "window_s": 5.0, "first_rows": 10,
    "effects": {"worn": {"site": "bearing", "law": "(b + c) v", "unit": "N s/m", "tolerance": 0.05, "limits": [0, 5]},
                "dry": {"site": "balance", "law": "F sign(v)", "unit": "N", "tolerance": 0.02, "limits": [0, 3]}},
}  # fmt: skip


def driven(
    mass: float = 1.5, n: int = 900, drag: float = 2.0, grown: float = 0.0, course: Callable[[float], float] = float
) -> pd.DataFrame:
    """Samples every 0.05 s, integrated here in small steps; drag grows by `grown` times its course over the recording,
    from 0 to 1."""
    rng, parts, step = np.random.default_rng(1), 40, 0.05
    force = np.interp(np.arange(n), np.arange(0, n + 40, 20), rng.uniform(-8.0, 8.0, n // 20 + 2))
    v, rows = 0.0, []
    for k in range(n):
        rows.append((k * step, force[k], v + 0.004 * rng.standard_normal()))
        for share in (np.arange(parts) + 0.5) / parts:
            now = force[k] + share * (force[min(k + 1, n - 1)] - force[k])
            v += step / parts * (now - (drag + grown * course(k / n)) * v) / mass
    return pd.DataFrame(rows, columns=["time_s", "force_n", "v_m_s"])


@cache
def rig() -> RigParameters:
    return RigParameters.model_validate(CART)


def test_a_sound_cart_has_nothing() -> None:
    assert not dt.discover(driven(), rig()).document.mismatch


def test_a_sensor_that_is_absent_in_the_judged_part_keeps_no_finding_back() -> None:
    pair = RigParameters.model_validate(CART | {"readings": {"v_m_s": "v", "other": "v"}})
    table = driven(drag=3.0)
    table["other"] = table["v_m_s"].where(table.index < 400)
    found = dt.discover(table, pair)
    assert [effect.name for effect in found.document.effects] == ["worn"]
    fit = found.document.fit
    assert fit.share_explained is not None and fit.share_explained > 0.9 and fit.held_out_nll_after is not None
    assert "nan" not in found.sentence


def test_wear_that_grows_is_told_as_such() -> None:
    found = dt.discover(driven(grown=1.0), rig())
    (effect,), location = found.document.effects, found.document.location
    assert effect.name == "worn" and effect.magnitude == pytest.approx(1.0, rel=0.05) and location is not None
    assert location.grows and "grown evenly from nothing" in found.sentence
    (term,) = found.engine.terms
    assert term.grown_s == pytest.approx(44.95) and term.onset_s == pytest.approx(0.0, abs=2.0)


def test_a_name_that_leaves_several_times_the_noise_says_so() -> None:
    """Wear that comes and goes three times is met by its mean."""
    found = dt.discover(driven(grown=4.0, course=lambda share: math.sin(3.0 * math.pi * share) ** 2), rig())
    assert "worn" in [effect.name for effect in found.document.effects]
    (doubt,) = [item for item in found.document.warnings if item.code == "residuals"]
    assert doubt.affects == ("v_m_s",) and "times its noise" in doubt.text
    found = dt.discover(driven(drag=3.0), rig())
    assert found.document.mismatch and "residuals" not in [item.code for item in found.document.warnings]


def test_a_misfit_without_a_name_or_a_law_is_no_clean_bill() -> None:
    """A sensor that wanders, for which the file has no name, was "no mismatch"."""
    found = dt.discover(driven().assign(v_m_s=lambda t: t["v_m_s"] + 0.2 * np.sin(t["time_s"])), rig())
    assert not found.document.effects and "something is missing" in found.sentence
    (doubt,) = [item for item in found.document.warnings if item.code == "residuals"]
    assert doubt.text in found.sentence and "times its noise" in doubt.text


def test_a_sensor_that_has_no_place_in_the_file_is_a_law_elsewhere_and_that_is_said() -> None:
    """An offset since 25 s was "no mismatch". A force that is as large over the drag shows the same."""
    found = dt.discover(driven().assign(v_m_s=lambda t: t["v_m_s"] + 0.2 * (t["time_s"] > 25.0)), rig())
    assert "added to net: 0.4" in found.sentence and "since 25 s" in found.sentence
    (doubt,) = [item for item in found.document.warnings if item.code == "no_sensor_site"]
    assert doubt.affects == ("v_m_s",) and "sensor:v_m_s" in doubt.text


def test_what_the_last_finding_leaves_says_whether_more_is_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    quiet, loud = np.array([1.0]), np.array([20.0])
    monkeypatch.setattr(rounds, "times_noise", lambda at, errors: errors)
    monkeypatch.setattr(rounds, "rms_left", lambda at: at)

    def course(fit: np.ndarray, *foretold: np.ndarray) -> rounds.Course:
        taken = tuple(SimpleNamespace(after=errors, taken=True) for errors in foretold)
        return rounds.Course(taken, rig(), fit)  # type: ignore[arg-type]

    assert not course(quiet, loud, quiet).is_loud  # before the second finding something was missing, by itself
    assert course(loud, quiet, quiet).is_loud and course(quiet, loud).is_loud and course(loud).is_loud


def test_a_recording_that_is_not_the_machines_is_no_clean_bill() -> None:
    """Speeds in mm/s under a name in m/s were "no mismatch": no effect has such a size."""
    foreign = driven().assign(v_m_s=lambda t: 1000.0 * t["v_m_s"])
    found = dt.discover(foreign, rig())
    assert found.sentence.startswith("Nothing can be said of cart: v_m_s is off by ")
    (doubt,) = [item for item in found.document.warnings if item.code == "wrong_engine"]
    assert doubt.affects == ("v_m_s",) and not found.document.mismatch
    assert not dt.discover(driven(), rig()).document.warnings


def test_inputs_that_are_taken_wrongly_between_rows_are_said() -> None:
    """Half a row late, which friction and a wrong mass follow a little."""
    found = dt.discover(driven(), RigParameters.model_validate(CART | {"hold": "held"}))
    (doubt,) = [item for item in found.document.warnings if item.code == "hold"]
    assert "give hold: linear" in doubt.text and any("hold: linear" in line for line in map(str, found.lines()))


def test_steps_that_are_too_long_are_said_with_what_would_do() -> None:
    """A light cart comes to rest within one sample; what four steps make of that looked like physics."""
    light = {**CART["parameters"], "m": {"value": 0.1, "prior_std": 0.01, "scale": 0.01, "unit": "kg"}}
    coarse = RigParameters.model_validate({**CART, "parameters": light, "sub_steps": 2})
    found = dt.discover(driven(mass=0.1), coarse)
    (doubt,) = [item for item in found.document.warnings if item.code == "long_steps"]
    assert doubt.affects == ("v_m_s",) and "in place of 2" in doubt.text
    assert [line for line in found.lines() if line.startswith("note: ")] == [f"note: {doubt.text}"]
    enough = int(doubt.text.split("sub_steps: ")[1].split()[0])
    assert 3 <= enough <= 30
    finer = dt.discover(driven(mass=0.1), coarse.model_copy(update={"sub_steps": enough}))
    assert not finer.document.mismatch and not finer.document.warnings
    assert not [line for line in finer.lines() if line.startswith("note: ")]


def test_what_the_parameters_say_as_well_is_said() -> None:
    """A reading a twentieth too large from the first row on was "no mismatch", without a word: a mass and a friction
    that are smaller do the same."""
    sensor = {"site": "sensor:v_m_s", "law": "reading (1 + g)", "unit": "-", "tolerance": 0.01, "limits": [-0.3, 0.3],
              "sensor": True}  # fmt: skip
    parameters = {name: {**item, "prior_std": 0.3 * item["value"]} for name, item in CART["parameters"].items()}
    sliding = {**CART["quantities"]["net"], "formula": "force_n - drag"}
    changed = {
        **CART, "parameters": parameters, "quantities": {**CART["quantities"], "net": sliding},
        "effects": {"worn": CART["effects"]["worn"], "v_gain": sensor}, "readings": {"v_m_s": "v*(1 + v_gain)"},
    }  # fmt: skip
    found = dt.discover(driven().assign(v_m_s=lambda t: 1.05 * t["v_m_s"]), RigParameters.model_validate(changed))
    assert not found.document.mismatch
    (line,) = found.lines()[1:]
    assert line.startswith("not seen") and not found.document.warnings
    assert "v_gain " in line and "worn " in line and ("(m, b)" in line or "(b, m)" in line)
