"""Files say when they aren't what was written; a person who edits one removes its checksum."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.flipped_bytes import Kind, cache_kinds, cheap_kinds, judged, kept_kinds
from dieseltwin.api.driving import engine_yaml
from dieseltwin.api.saved import saved
from dieseltwin.calibration.saved import base_and_geometry
from dieseltwin.challenge.run import read_manifest
from dieseltwin.discovery.verdict.document import load_discrepancy
from dieseltwin.discovery.verdict.explain import load_details
from dieseltwin.engine import load_engine, we2011
from dieseltwin.errors import InputError
from dieseltwin.report.results import load_method
from dieseltwin.sealed import MARK, check_text, opened_json, sealed_json, sealed_text


@pytest.mark.parametrize("kinds", [cheap_kinds, kept_kinds, cache_kinds])
def test_a_flipped_byte_is_noticed_or_harmless(tmp_path: Path, kinds: Callable[[Path], list[Kind]]) -> None:
    rng = np.random.default_rng(4)
    for kind in (kind for kind in kinds(tmp_path) if not kind.open):
        ends = dict(judged(kind, tmp_path, 12, rng))
        assert set(ends) <= {"noticed", "harmless"}, (kind.name, ends)


def test_an_edited_engine_file_is_taken_without_its_last_line(tmp_path: Path) -> None:
    path = tmp_path / "engine.yaml"
    text = engine_yaml(we2011.FIELD)
    path.write_text(text)
    assert load_engine(path) == we2011.FIELD
    edited = text.replace("n_cyl: 6", "n_cyl: 5")
    path.write_text(edited)
    with pytest.raises(InputError, match="remove the line that begins with"):
        load_engine(path)
    path.write_text(edited[: edited.index(MARK)])
    assert load_engine(path).n_cyl == 5


def test_text_and_objects_round_trip() -> None:
    check_text(sealed_text("a: 1"), "x")
    check_text("a: 1\n", "x")
    content = {"b": (1, 2.5, None), "a": {"c": "d"}}
    assert opened_json(sealed_json(content), "x", "make it again") == content
    assert opened_json([1], "x", "") == [1]
    with pytest.raises(InputError, match="SHA-256 differs"):
        opened_json({**sealed_json(content), "a": 1}, "x", "make it again")
    with pytest.raises(InputError, match="SHA-256 differs"):  # a flipped byte in the checksum's own key
        opened_json({name.replace("_sha", "_spa"): v for name, v in sealed_json(content).items()}, "x", "")


@pytest.mark.parametrize("text", ["[" * 100_000 + "]" * 100_000, "[1]"])
@pytest.mark.parametrize(("name", "read"), [
    ("details.json", load_details), ("discrepancy.json", load_discrepancy), ("identification.json", saved),
    ("identification.json", load_method), ("engine.calibration.json", lambda f: base_and_geometry(f / "engine.yaml")),
    ("manifest.json", read_manifest),
])  # fmt: skip
def test_lists_are_refused_however_deep(
    tmp_path: Path, name: str, read: Callable[[Path], object], text: str
) -> None:
    """Of JSON files that hold an object."""
    (tmp_path / "engine.yaml").write_text("r_c: 17\n")
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match="a list" if text == "[1]" else "lists in lists thousands deep") as refused:
        read(tmp_path)
    assert str(tmp_path / name) in str(refused.value) and "\n" not in str(refused.value)
