"""Engine files: YAML that overrides any parameter of an engine."""

from __future__ import annotations

from pathlib import Path

from dieseltwin.engine.parameters import EngineParameters, validated
from dieseltwin.engine.we2011 import PARAMETERS
from dieseltwin.settings.strict import read_mapping


def load_engine(path: str | Path, base: EngineParameters = PARAMETERS) -> EngineParameters:
    """Engine parameters from a YAML file that overrides any parameter of `base` (default: the published set).

    Raises InputError for an unreadable file, an unknown name or a value out of range.
    """
    return validated({**base.model_dump(), **read_mapping(path)}, source=f"engine file {path}")
