"""Effects that an engine file holds already, on the rows of a recording."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dieseltwin.petrol.effects import undo_all
from dieseltwin.petrol.parameters import PetrolParameters, PetrolTerm
from dieseltwin.petrol.recording import PetrolRecording, Signals

Array = NDArray[np.float64]


def active_sizes(engine: PetrolParameters, recording: PetrolRecording) -> dict[str, Array]:
    """Effect -> (n,) size over the rows; its times count in the recording that the effect was found in."""
    sizes: dict[str, Array] = {}
    time_s = recording.signals.time_s + recording.time0_s
    for term in engine.terms:
        share = _course(term, time_s) if term.found_in == recording.sha256 else np.full(
            len(time_s), float(term.until_s is None))  # fmt: skip
        sizes[term.effect] = sizes.get(term.effect, np.zeros(len(time_s))) + term.magnitude * share
    return sizes


def _course(term: PetrolTerm, time_s: Array) -> Array:
    """(n,) share of a term's size at the time stamps of the recording that it was found in."""
    since = -np.inf if term.onset_s is None else term.onset_s
    until = np.inf if term.until_s is None else term.until_s
    if term.grown_s is not None:
        first = float(time_s[0]) if term.onset_s is None else term.onset_s
        return np.asarray(np.clip((time_s - first) / max(term.grown_s - first, 1.0), 0.0, 1.0))
    return ((time_s >= since) & (time_s < until)).astype(np.float64)


def without_terms(engine: PetrolParameters, recording: PetrolRecording) -> Signals:
    """The signals as the engine would have given them without its terms."""
    return undo_all(active_sizes(engine, recording), recording.signals)
