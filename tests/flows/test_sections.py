"""A step's key changes with the sections of params.yaml that it reads, by itself or through the library, and with
nothing else in that file."""

from __future__ import annotations

import copy
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from dieseltwin.settings.defaults import default_discover, default_search
from dieseltwin.settings.params import SECTIONS_VARIABLE, load_params
from tasks import discover, ensembles, evaluate, identify, pretrain, promote, prove, report, simulate, watch
from tasks.progress import Display
from tasks.run_context import STEPS, RunContext, Step
from tasks.workspace import PROJECT, Workspace

MODULES = (discover, ensembles, evaluate, identify, pretrain, promote, prove, report, simulate, watch)

# Functions of the library that look a section up by themselves.
LOOK_UPS = {
    "default_search": {"discover"},
    "default_discover": {"discover"},
    "default_learn": {"learn"},
    "default_watch": {"watch"},
    "load_params": {"any"},
}

# Steps whose modules hold such a function and whose runs don't come to it: there it would be an error, no stale result.
NEVER_CALLED = {
    "report": {"discover"},  # a page of figures makes no twin
    "evaluation-page": {"discover"},
    "watched": {"watch"},  # `judge` has no history
}


def steps() -> list[Step]:
    """All steps of the project, without those of the tests."""
    return [made for made in STEPS.values() if made.function.__module__ in {module.__name__ for module in MODULES}]


def settings() -> dict[str, Any]:
    return load_params(PROJECT / "params.yaml").model_dump(mode="json")


def looked_up(made: Step, context: RunContext) -> set[str]:
    """Sections that the modules of a step look up."""
    found: set[str] = set()
    defined = {"dieseltwin.settings.params", "dieseltwin.settings.defaults"}
    for module in set(made.code(context).modules) & context.sources.modules - defined:
        path = PROJECT / module.replace(".", "/")
        text = (path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text(encoding="utf-8")
        for name, sections in LOOK_UPS.items():
            if re.search(rf"^from dieseltwin.settings.(?:params|defaults) import [^#]*\b{name}\b", text, re.MULTILINE):
                found |= sections
    return found


def test_every_step_that_looks_settings_up_holds_those_sections_in_its_key() -> None:
    context = RunContext(Workspace(PROJECT), Display(PROJECT / "unused"))
    for made in steps():
        assert looked_up(made, context) - NEVER_CALLED.get(made.name, set()) == set(made.sections), made.name
    holders = {made.name for made in steps() if "discover" in made.sections}
    assert holders == {"discover", "case", "opened", "baseline-bands", "baseline", "score", "watched"}


def keys(found: dict[str, Any], context: RunContext) -> dict[str, str]:
    return {made.name: made.key(context, {}, {"sections": made.sections_of(found)}) for made in steps()}


def test_a_value_changes_the_keys_of_the_steps_that_look_it_up_alone() -> None:
    context = RunContext(Workspace(PROJECT), Display(PROJECT / "unused"))
    before, found = keys(settings(), context), copy.deepcopy(settings())
    found["report"]["dpi"] += 1
    assert keys(found, context) == before
    found["discover"]["search"]["driving"]["alarm_gain"] += 1.0
    changed = {name for name, key in keys(found, context).items() if key != before[name]}
    assert changed == {made.name for made in steps() if "discover" in made.sections}


def test_the_text_of_the_settings_is_in_no_key(tmp_path: Path) -> None:
    shutil.copytree(PROJECT / "dieseltwin", tmp_path / "dieseltwin", ignore=shutil.ignore_patterns("__pycache__"))
    codes = []
    for ending in ("", "# a remark\n"):
        path = tmp_path / "dieseltwin" / "params.yaml"
        path.write_text(path.read_text(encoding="utf-8") + ending, encoding="utf-8")
        context = RunContext(Workspace(tmp_path), Display(tmp_path / "unused"), library_root=tmp_path)
        looked_at = (simulate.driving_sets, report.report, prove.case)
        codes.append([made.code(context).digest for made in looked_at])
    assert codes[0] == codes[1]


def test_a_call_without_the_steps_sections_is_refused() -> None:
    context = RunContext(Workspace(PROJECT), Display(PROJECT / "unused"))
    for given in ({}, {"sections": {"discover": settings()["discover"]}}):
        with pytest.raises(TypeError, match=r"case: sections: got .*; allowed: \['discover', 'learn'\]"):
            prove.case.key(context, {}, given)


def test_given_sections_stand_for_the_files_in_a_process_and_those_it_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    section = settings()["discover"]
    section["search"]["driving"]["alarm_gain"] = 31.5
    monkeypatch.setenv(SECTIONS_VARIABLE, json.dumps({"discover": section}))
    assert default_search().driving.alarm_gain == default_discover().search.driving.alarm_gain == 31.5
    program = "from dieseltwin.settings.defaults import default_search; print(default_search().driving.alarm_gain)"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=PROJECT)
    assert said.stdout == "31.5\n"


def test_a_section_that_was_not_given_is_an_error_and_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    from dieseltwin.settings.defaults import default_learn, default_watch

    monkeypatch.setenv(SECTIONS_VARIABLE, "{}")
    for look_up in (default_discover, default_learn, default_watch, load_params):
        with pytest.raises(RuntimeError, match=r"got a question beyond the sections .* \(none\)"):
            look_up()
    assert load_params(PROJECT / "params.yaml").seed == settings()["seed"]
