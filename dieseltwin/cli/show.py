"""`dieseltwin engine show` and `dieseltwin params show`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from dieseltwin.settings.params import load_params

WIDTH = 10_000  # one line a leaf, however long


def _plain_yaml(values: dict[str, Any]) -> Iterator[str]:
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=WIDTH)
    yield from text.rstrip("\n").split("\n")


def _flow_yaml(value: Any) -> str:
    """A list or mapping on one line."""
    return yaml.safe_dump(value, sort_keys=False, allow_unicode=True, default_flow_style=True, width=WIDTH).strip()


def engine_lines(engine: Path | None) -> Iterator[str]:
    """The parameters of an engine file (the published set without one) as YAML, the units as comments."""
    from dieseltwin.engine import EngineParameters, load_engine, we2011

    parameters = load_engine(engine) if engine is not None else we2011.PARAMETERS
    for name, value in parameters.model_dump(mode="json").items():
        description = EngineParameters.model_fields[name].description or ""
        if name == "terms":
            value = [{key: v for key, v in term.items() if v is not None} for term in value]
            line = f"terms: {_flow_yaml(value)}"
        else:
            line = "".join(_plain_yaml({name: value})).strip("{}")  # a scalar alone comes in braces
        yield f"{line}  # {description}" if description else line


def params_lines(params: Path | None, profile: str) -> Iterator[str]:
    """The settings of one profile as YAML, headed by their hash."""
    loaded = load_params(params, profile)
    yield f"# sha256 {loaded.sha256}"
    yield from _plain_yaml(loaded.model_dump(mode="json"))
