"""Engine files: YAML that overrides any parameter of an engine."""

from __future__ import annotations

from pathlib import Path

from dieseltwin.engine.learned_file import LEARNED, SHA256, mean_coefficients
from dieseltwin.engine.parameters import EngineParameters, validated
from dieseltwin.engine.terms import effect_terms
from dieseltwin.engine.we2011 import PARAMETERS
from dieseltwin.errors import InputError
from dieseltwin.settings.strict import read_mapping


def load_engine(path: str | Path) -> EngineParameters:
    """Engine parameters from a YAML file that overrides any parameter of the published set.

    A file that `dieseltwin learn` wrote names a second one; its corrections of the maps are among the terms.

    Raises InputError for an unreadable file, an unknown name or a value out of range.
    """
    document = dict(read_mapping(path))
    if "kind" in document:
        raise InputError(f"engine file {path}", f"kind {document['kind']!r}", "a diesel engine's file, which has none",
                         "name a diesel engine's; `discover` and `simulate` take a petrol engine or a rig")
    if LEARNED in document:
        corrections = {"coefficients": mean_coefficients(Path(path), document)}
        terms = document.get("terms") or ()
        if not isinstance(terms, list | tuple):
            raise InputError(f"{path}: terms", repr(terms), "a list of terms", "mend this line")
        document["terms"] = (*terms, corrections)
        del document[LEARNED]
        document.pop(SHA256, None)
    found = validated({**PARAMETERS.model_dump(), **document}, source=f"engine file {path}")
    _refuse_repeated(found, path)
    return found


def _refuse_repeated(engine: EngineParameters, path: str | Path) -> None:
    """One effect with two sizes for the same driving is a slip: which one was meant can't be told."""
    seen = set()
    for term in effect_terms(engine.terms):
        times = term.onset_s, term.until_s, term.grown_s, term.gone_s
        place = (term.slot, *times, None if term.region is None else tuple(sorted(term.region.items())))
        if place in seen:
            raise InputError(f"engine file {path}: terms", f"{term.slot} twice for the same driving", "each once",
                             "drop one of the two, or add them up")
        seen.add(place)
