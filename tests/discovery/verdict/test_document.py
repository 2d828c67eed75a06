"""discrepancy.json is schema 1 to the letter: strict, complete, free of contradictions."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from dieseltwin.discovery.verdict.document import (
    Discrepancy,
    FoundEffect,
    fit_doubts,
    load_discrepancy,
    parse_discrepancy,
    with_warnings,
)
from dieseltwin.errors import InputError
from dieseltwin.notes import Note
from dieseltwin.sealed import sealed_json

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "report"))
import synthetic_discovery as synthetic

KEYS = ["schema", "recording", "mismatch", "p_value", "location", "effects", "more_is_missing", "health", "fit",
        "minimum_detectable", "provenance", "warnings"]  # fmt: skip
PARTS = {
    "recording": ["path", "sha256", "duration_s", "channels"],
    "location": ["site", "probability", "alternatives", "regions", "onset_s"],
    "fit": ["held_out_nll_before", "held_out_nll_after", "chi2_per_sample_before", "chi2_per_sample_after",
            "rmse_before", "rmse_after", "share_explained", "chi2_per_sample_beyond"],
    "provenance": ["code_version", "params_sha256"],
}  # fmt: skip
EFFECT_KEYS = ["name", "probability", "equivalent_names", "law", "magnitude", "std", "unit", "valid_for", "split_by"]


def changed(path: str, value: Any) -> str:
    """The leak's JSON with one value replaced, by a dotted path."""
    content = json.loads(json.dumps(synthetic.content(location={**synthetic.LOCATION, "regions": [synthetic.REGION]})))
    place: Any = content
    *parents, last = path.split(".")
    for part in parents:
        place = place[int(part)] if part.isdigit() else place[part]
    place[int(last) if last.isdigit() else last] = value
    return json.dumps(content)


def test_the_docs_explain_every_key_in_its_order(project_root: Path) -> None:
    text = (project_root / "docs" / "discovery.md").read_text(encoding="utf-8")
    table = text[text.index("\n| key | holds |") :].split("\n\n", 1)[0]
    explained = [key for row in table.splitlines()[3:] for key in re.findall(r"`(\w+)`", row.split("|")[1])]
    fields = Discrepancy.model_fields.items()
    keys = [field.serialization_alias or field.alias or name for name, field in fields]
    assert set(explained) == set(keys)
    assert [key for key in explained if key in KEYS[:-1]] == KEYS[:-1]  # `warnings` stands with those that may lack


def test_keys_are_those_of_the_schema() -> None:
    written = synthetic.document(location={**synthetic.LOCATION, "regions": [synthetic.REGION]}).to_json()
    assert list(written) == KEYS
    for part, keys in PARTS.items():
        assert list(written[part]) == keys
    assert list(written["effects"][0]) == EFFECT_KEYS
    assert list(written["health"]["eta_sc"]) == ["value", "std", "before"]
    assert list(written["location"]["alternatives"][0]) == ["site", "probability"]
    region = ["n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "share_of_evidence"]
    assert list(written["location"]["regions"][0]) == region
    assert written["schema"] == 1


@pytest.mark.parametrize(
    "content",
    [
        synthetic.content(),
        synthetic.healthy_content(),
        synthetic.content(effects=[synthetic.UNNAMED]),
        synthetic.content(effects=[{**synthetic.UNNAMED, "law": None, "unit": None}]),
        synthetic.content(effects=[synthetic.LEAK, synthetic.FRICTION]),
        synthetic.content(effects=[synthetic.LEAK, synthetic.UNNAMED]),
    ],
    ids=["named", "healthy", "none of these", "none, no law", "two", "one and an unnamed"],
)
def test_round_trip_through_a_file(content: dict[str, Any], tmp_path: Path) -> None:
    document = Discrepancy.model_validate(content)
    path = document.write(tmp_path / "discrepancy.json")
    assert load_discrepancy(path) == document == load_discrepancy(tmp_path)
    assert json.loads(path.read_text()) == sealed_json(document.to_json())


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("schema", 2, "schema 1"),
        ("schema", True, "schema 1"),
        ("surprise", 1, "a key that the schema doesn't have"),
        ("schema_version", 1, "a key that the schema doesn't have"),
        ("effects.0.surprise", 1, "effects.0.surprise"),
        ("p_value", 1.2, "less than or equal to 1"),
        ("p_value", "0.1", "valid number"),
        ("mismatch", 1, "boolean"),
        ("mismatch", False, "without a mismatch"),
        ("effects", [], "a mismatch needs a location and at least one effect"),
        ("location", None, "a mismatch needs a location"),
        ("effects.0.magnitude", None, "needs a law, a magnitude and a unit"),
        ("effects.0.std", -1.0, "greater than or equal to 0"),
        ("effects.0.equivalent_names", ["boost_leak"], "given twice"),
        ("effects.0.equivalent_names", ["none_of_these"], "no equivalent"),
        ("effects.0.name", "none_of_these", "no name fits"),
        ("location.probability", 0.99, "sum to 1.02"),
        ("location.regions.0.n_e_rpm", [1500, 1200], "the lower end comes first"),
        ("recording.duration_s", -1.0, "greater than or equal to 0"),
        ("minimum_detectable.boost_leak", -1e-6, "greater than or equal to 0"),
        ("health.eta_sc.value", None, "valid number"),
    ],
)
def test_what_the_schema_forbids_is_one_clear_line(path: str, value: Any, says: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_discrepancy(changed(path, value), "found.json")
    message = str(caught.value)
    assert says in message and message.startswith("found.json") and "\n" not in message


def test_missing_key_nan_key_twice_no_json_no_file(tmp_path: Path) -> None:
    content = synthetic.content()
    del content["p_value"]
    with pytest.raises(InputError, match=r"p_value: got nothing"):
        parse_discrepancy(json.dumps(content))
    with pytest.raises(InputError, match="NaN is no JSON"):
        parse_discrepancy(json.dumps(synthetic.content(p_value=float("nan"))))
    with pytest.raises(InputError, match="given twice"):
        parse_discrepancy('{"schema": 1, "schema": 1}')
    with pytest.raises(InputError, match="a list"):
        parse_discrepancy("[]")
    with pytest.raises(InputError, match="no such file"):
        load_discrepancy(tmp_path)


def test_numbers_that_are_none_cannot_be_built() -> None:
    with pytest.raises(ValidationError):
        synthetic.document(p_value=float("nan"))
    with pytest.raises(ValidationError):
        synthetic.document(effects=[{**synthetic.LEAK, "magnitude": float("inf")}])


def test_the_reported_set() -> None:
    leak = FoundEffect.model_validate(synthetic.LEAK)
    assert leak.named and leak.names == ("boost_leak", "compressor_efficiency_loss")
    assert not FoundEffect.model_validate(synthetic.UNNAMED).named


def test_a_fit_that_leaves_something_warns_once(tmp_path: Path) -> None:
    bare = synthetic.document(location={**synthetic.LOCATION, "regions": [synthetic.REGION]})
    fit = bare.fit.model_copy(update={"chi2_per_sample_after": 9.0})
    document = bare.model_copy(update={"more_is_missing": True, "fit": fit})
    said = with_warnings(with_warnings(document, fit_doubts(document)), [*fit_doubts(document), Note("short", "short")])
    assert [doubt.code for doubt in said.warnings] == ["more_is_missing", "misfit", "short"]
    assert "3 times the noise" in said.warnings[1].text
    said.write(tmp_path / "discrepancy.json")
    assert load_discrepancy(tmp_path) == said
