"""A new estimator is one file: it is found by name wherever methods are named."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
from segments import REFERENCE

import dieseltwin
from dieseltwin.cli.app import main
from dieseltwin.errors import InputError
from dieseltwin.report.style import method_style
from dieseltwin.settings import methods
from dieseltwin.settings.evaluation import EvaluationConfig
from dieseltwin.settings.params import load_params

NEW = '''
"""`nominal-values`: doesn't look at the readings; every run is the laboratory's value."""

import numpy as np
from pydantic import PositiveFloat

from dieseltwin.settings.method_settings import MethodSettings
from dieseltwin.settings.methods import Method, MethodStyle


class Settings(MethodSettings):
    spread: PositiveFloat = 0.05


def estimate(problems, runs, seed, *, config, **learned):
    from dieseltwin.identification.bound import nominal_bound
    from dieseltwin.identification.result import SegmentEstimate

    spread = config.of("nominal-values").spread
    found = []
    for problem in problems:
        states = np.tile([*problem.first_states(), 0.05, 320.0], (len(problem.time_s), 1))
        values = np.tile(problem.parameters.health(), (runs, 1))
        bound = nominal_bound(problem, states)
        found.append(
            SegmentEstimate(
                problem.t0_s, problem.t1_s, problem.time_s, values, spread * values,
                np.stack([values * (1 - spread), values * (1 + spread)], axis=-1), states, bound.absolute,
                bound.identifiable(config.identifiable_bound_rel), np.ones(runs, dtype=bool), 0.0, "nominal-values",
            )
        )
    return found


METHOD = Method("nominal-values", estimate, Settings, MethodStyle("#123456", "X", "-", "nominal"), "nothing", rank=5)
'''


@pytest.fixture
def new_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """One file in a folder `methods` of a room of the library."""
    file = tmp_path / "library" / "extra_room" / "methods" / "nominal_values.py"
    file.parent.mkdir(parents=True)
    file.write_text(NEW, encoding="utf-8")
    monkeypatch.setattr(dieseltwin, "__path__", [*dieseltwin.__path__, str(tmp_path / "library")])
    yield "nominal-values"
    for name in [name for name in sys.modules if name.startswith("dieseltwin.extra_room")]:
        del sys.modules[name]


def test_a_new_estimator_is_one_file(new_method: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = tmp_path / "drive.csv"
    pd.read_csv(REFERENCE).iloc[:151].assign(t_amb_k=298.15, p_amb_pa=101325.0).to_csv(recording, index=False)
    command = ["identify", str(recording), "--out", str(tmp_path / "found"), "--runs", "2", "--segment", "30"]
    assert main([*command, "--method", new_method]) == 0
    assert "nominal-values, 2 runs" in capsys.readouterr().out
    assert (tmp_path / "found" / "identification.json").is_file()
    assert main([*command, "--method", "nominal-value"]) == 2
    assert "did you mean nominal-values" in capsys.readouterr().err


def test_a_new_estimator_has_its_style_its_settings_and_its_place(new_method: str) -> None:
    assert method_style(new_method).colour == "#123456" and method_style(new_method).label == "nominal"
    assert [method.name for method in methods.in_order()][:2] == [new_method, "classical"]
    identify = load_params().identify
    assert identify.of(new_method).model_dump() == {"members": None, "spread": 0.05}
    own = {**identify.model_dump(), "methods": {new_method: {"spread": 0.1}}}
    assert type(identify).model_validate(own).of(new_method).model_dump()["spread"] == 0.1
    with pytest.raises(InputError, match=r"identify\.methods\.nominal-values.*spraed.*did you mean spread"):
        type(identify).model_validate({**own, "methods": {new_method: {"spraed": 0.1}}})
    evaluation = load_params().evaluation.model_dump()
    assert EvaluationConfig.model_validate({**evaluation, "members": {new_method: 3}, "variants": []}).members


def test_a_new_estimator_is_a_step_of_the_flows(new_method: str) -> None:
    from tasks.ensembles import steps_of_all as ensembles
    from tasks.evaluation_plan import ensembles_of
    from tasks.identify import steps_of_all as identifications
    from tasks.settings import own_settings

    settings = load_params().model_dump(mode="json")
    assert own_settings(settings, new_method)["identify"]["methods"] == {new_method: {"members": None, "spread": 0.05}}
    for steps in (identifications(), ensembles()):
        assert steps[new_method].entries == methods.find(new_method).modules
    settings["evaluation"] |= {"members": {new_method: 2}, "variants": []}
    assert {plan.method for plan in ensembles_of(settings)} == {new_method}


def test_unknown_methods_and_sections_are_refused_with_a_hint() -> None:
    with pytest.raises(InputError, match="did you mean multi-stage"):
        methods.find("multi_stage")
    identify = load_params().identify
    with pytest.raises(InputError, match=r"identify\.methods.*did you mean classical"):
        type(identify).model_validate({**identify.model_dump(), "methods": {"clasical": {}}})
    assert methods.known("of another version") is None


def test_every_method_says_what_it_is() -> None:
    looks = [method.style for method in methods.in_order()]
    assert len({look.colour for look in looks}) == len({look.label for look in looks}) == len(looks)
    assert {method.name for method in methods.in_order()} == set(methods.names())
    for method in methods.in_order():
        assert method.learned and issubclass(method.settings, object) and (method.sources is None or method.with_epochs)


def test_every_methods_modules_are_there_and_known_to_its_steps() -> None:
    from importlib.util import find_spec

    from tasks.identify import steps_of_all

    steps = steps_of_all()
    for method in methods.in_order():
        assert all(find_spec(module) is not None for module in method.modules)
        assert set(method.modules) <= set(steps[method.name].entries)
