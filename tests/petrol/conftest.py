"""Recordings of the made-up engine and its calibration; the real recordings where they are."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from dieseltwin.challenge.petrol_plant import drive
from dieseltwin.petrol.calibrate import fit_maps
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording, read_petrol

Recorder = Callable[..., PetrolRecording]


@pytest.fixture(scope="session")
def record(tmp_path_factory: pytest.TempPathFactory) -> Recorder:
    """Drive, write and read a recording, once with the same arguments."""
    folder = tmp_path_factory.mktemp("petrol")

    @cache
    def make(seed: int, duration_s: float = 600.0, **faults: float) -> PetrolRecording:
        path = folder / f"{seed}-{len(list(folder.iterdir()))}.csv"
        drive(duration_s, seed, **faults).to_csv(path, index=False)
        return read_petrol(path)

    return make


@pytest.fixture(scope="session")
def engine(record: Recorder) -> PetrolParameters:
    """Calibrated on fifteen minutes without a fault."""
    return fit_maps(record(1, 900.0).signals, PetrolParameters())[0]


@pytest.fixture(scope="session")
def liu() -> Path:
    """The real recordings, where they are."""
    shared = Path(__file__).resolve().parents[3] / "shared" / "data"
    folder = Path(os.environ.get("DIESELTWIN_DATA") or shared) / "liu_ice"
    if not folder.is_dir():
        pytest.skip(f"no {folder.name} in DIESELTWIN_DATA or ../shared/data")
    return folder
