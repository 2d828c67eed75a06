"""What the scorer asks of the tool's library, at the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dieseltwin.challenge.oracle import separability
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.records import engine_terms
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SensorSet, read
from dieseltwin.engine import we2011
from dieseltwin.recordings.reader import read_recording


def distances(fault: Fault, folder: Path) -> dict[str, float]:
    """D of every other effect for a minute of an engine that has nothing but the fault."""
    laboratory = we2011.PARAMETERS.model_dump()
    driving = draw_driving("random", 60.0, laboratory, np.random.default_rng(2))
    run = run_plant(driving, laboratory, (fault,))
    frame = read(run, driving, (fault,), SensorSet.perfect(), 6, np.random.default_rng(3))
    frame.to_csv(folder / "recording.csv", index=False)
    return separability(read_recording(folder / "recording.csv"), we2011.PARAMETERS, engine_terms((fault,))[0])


def test_what_a_late_fault_shows_is_what_is_left_of_the_recording(tmp_path: Path) -> None:
    middle, late, never = (
        distances(Fault("boost_leak", 8e-5, onset_s=onset), tmp_path) for onset in (30.0, 57.0, 61.0)
    )
    assert set(middle) == set(late) == set(never)
    assert max(late.values()) < 0.5 * max(middle.values())
    assert set(never.values()) == {0.0}
