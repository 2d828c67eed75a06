"""A step's key holds the settings that its method reads, a page's hash those that its numbers rest on; no others."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from dieseltwin.settings import methods
from dieseltwin.settings.params import load_params
from tasks.identify import STEPS
from tasks.settings import about, own_settings
from tasks.store import Artifact
from tasks.workspace import PROJECT

RECORDING = Artifact(Path("case_v_noisy.parquet"), "0" * 64)


def settings() -> dict[str, Any]:
    return load_params(PROJECT / "params.yaml", "quick").model_dump(mode="json")


def changed(*names: str) -> dict[str, Any]:
    """The settings with the value behind ``names`` replaced."""
    found = copy.deepcopy(settings())
    section = found
    for name in names[:-1]:
        section = section[name]
    section[names[-1]] = {"changed": section[names[-1]]}
    return found


@pytest.mark.parametrize("method", methods.names())
def test_a_change_of_another_methods_section_leaves_a_method_alone(method: str) -> None:
    before = own_settings(settings(), method)
    for other in set(methods.names()) - {method}:
        assert own_settings(changed("identify", "methods", other), method) == before, other
    assert own_settings(changed("identify", "runs"), method) == before
    for where in (("identify", "methods", method), ("identify", "minutes"), ("noise", "seed"), ("engine", "step_s")):
        assert own_settings(changed(*where), method) != before, where


def test_the_flow_of_the_identification_compares_methods_that_there_are() -> None:
    from flows.identify import COMPARED

    assert set(COMPARED) <= set(STEPS) == set(methods.names())


def test_what_is_said_of_the_origin_changes_with_the_named_sections_alone() -> None:
    sections = ("seed", "engine", "noise", "identify")
    before = about(settings(), RECORDING, sections)
    for names in (("promotion", "minutes"), ("proof", "cases"), ("discover", "seed"), ("report", "dpi")):
        assert about(changed(*names), RECORDING, sections) == before, names
    for names in (("noise", "seed"), ("engine", "step_s"), ("identify", "minutes")):
        assert about(changed(*names), RECORDING, sections)["params_sha256"] != before["params_sha256"], names
    assert about(settings(), RECORDING, reversed(sections)) == before
