"""Effects that an engine file holds already, on the rows of a recording."""

from __future__ import annotations

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.engine.courses import course
from dieseltwin.petrol.effects import undo_all
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording, Signals


def active_sizes(engine: PetrolParameters, recording: PetrolRecording) -> dict[str, Array]:
    """Effect -> (n,) size over the rows; its times count in the recording that the effect was found in."""
    sizes: dict[str, Array] = {}
    time_s = recording.signals.time_s + recording.time0_s
    for term in engine.terms:
        if term.found_in == recording.sha256:
            share = course(time_s, term.onset_s, term.until_s, term.grown_s)
        else:
            share = np.full(len(time_s), float(term.until_s is None))
        sizes[term.effect] = sizes.get(term.effect, np.zeros(len(time_s))) + term.magnitude * share
    return sizes


def without_terms(engine: PetrolParameters, recording: PetrolRecording) -> Signals:
    """The signals as the engine would have given them without its terms."""
    return undo_all(active_sizes(engine, recording), recording.signals)
