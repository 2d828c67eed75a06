"""Engine files: YAML that overrides any parameter of an engine."""

from __future__ import annotations

from pathlib import Path

from dieseltwin.engine.learned_file import LEARNED, SHA256, mean_coefficients
from dieseltwin.engine.parameters import EngineParameters, validated
from dieseltwin.engine.we2011 import PARAMETERS
from dieseltwin.settings.strict import read_mapping


def load_engine(path: str | Path, base: EngineParameters = PARAMETERS) -> EngineParameters:
    """Engine parameters from a YAML file that overrides any parameter of `base` (default: the published set).

    A file that `dieseltwin learn` wrote names a second one; its corrections of the maps are among the terms.

    Raises InputError for an unreadable file, an unknown name or a value out of range.
    """
    document = dict(read_mapping(path))
    if LEARNED in document:
        corrections = {"coefficients": mean_coefficients(Path(path), document)}
        document["terms"] = (*(document.get("terms") or ()), corrections)
        del document[LEARNED], document[SHA256]
    return validated({**base.model_dump(), **document}, source=f"engine file {path}")
