"""An engine file as `dieseltwin learn` writes it, without the learning: what is believed is ten times sharper."""

from __future__ import annotations

from pathlib import Path

from dieseltwin.engine import we2011
from dieseltwin.learning.belief import Belief, prior_belief
from dieseltwin.learning.files import LearnedEngine, save_learned
from dieseltwin.recordings.reader import recording
from tests.api.simulated import drive

MAP_RMS = 0.02


def learned_file(folder: Path) -> Path:
    """`mine.yaml` and the file beside it, of the published engine."""
    before = prior_belief(we2011.PARAMETERS, MAP_RMS)
    reference = recording(drive(30.0, seed=29))
    belief = Belief(before.mean, 0.01 * before.covariance)
    known = LearnedEngine(we2011.PARAMETERS, belief, MAP_RMS, (reference,), {}, {reference.sha256: 1.0})
    save_learned(known, folder / "mine.yaml")
    return folder / "mine.yaml"
