"""A step's key holds the settings that its method reads, a page's hash those that its numbers rest on; no others."""

from __future__ import annotations

import copy
import re
from pathlib import Path
from typing import Any

import pytest

from dieseltwin.settings.params import load_params
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


@pytest.mark.parametrize(
    ("method", "own"), [("classical", "classical"), ("few-shot-newton", "newton"), ("few-shot-adam", "adam")]
)
def test_a_change_of_another_methods_section_leaves_a_method_alone(method: str, own: str) -> None:
    before = own_settings(settings(), method)
    for section in {"classical", "newton", "adam", "baseline", "multi_stage", "runs"} - {own}:
        assert own_settings(changed("identify", section), method) == before, section
    for names in (("identify", own), ("identify", "minutes"), ("noise", "seed"), ("engine", "step_s")):
        assert own_settings(changed(*names), method) != before, names


def test_the_flow_of_the_identification_asks_for_each_methods_own_settings() -> None:
    text = (PROJECT / "flows" / "identify.py").read_text(encoding="utf-8")
    asked = set(re.findall(r'own_settings\(settings, "([\w-]+)"\)', text))
    assert asked == {"classical", "few-shot-newton", "few-shot-adam"}


def test_what_is_said_of_the_origin_changes_with_the_named_sections_alone() -> None:
    sections = ("seed", "engine", "noise", "identify")
    before = about(settings(), RECORDING, sections)
    for names in (("promotion", "minutes"), ("proof", "cases"), ("discover", "seed"), ("report", "dpi")):
        assert about(changed(*names), RECORDING, sections) == before, names
    for names in (("noise", "seed"), ("engine", "step_s"), ("identify", "minutes")):
        assert about(changed(*names), RECORDING, sections)["params_sha256"] != before["params_sha256"], names
    assert about(settings(), RECORDING, reversed(sections)) == before
