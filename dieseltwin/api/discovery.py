"""What physics the twin leaves out: of driving, of settled points, of a petrol engine."""

from __future__ import annotations

import filecmp
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from dieseltwin.api.driving import ask_driving
from dieseltwin.api.engines import Engine, petrol_base
from dieseltwin.api.findings import Asked, Discovered, Question
from dieseltwin.api.reading import Channels, Made, Source, as_engine, opened
from dieseltwin.api.rigs import ask_rig
from dieseltwin.errors import InputError
from dieseltwin.learning.files import LearnedEngine, learned_engine_of
from dieseltwin.notes import Note
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording
from dieseltwin.recordings.named_columns import Imported
from dieseltwin.recordings.reader import Recording
from dieseltwin.recordings.steady_points import SteadyPoints
from dieseltwin.rigs.parameters import RigParameters
from dieseltwin.rigs.recording import RigRecording
from dieseltwin.settings.names import refuse_options

AnyRecording: TypeAlias = Source | Made


def discover(
    recording: AnyRecording | Sequence[AnyRecording],
    engine: Engine | str | Path | None = None,
    *,
    channels: Channels | None = None,
    sensors: Sequence[str] | None = None,
    withhold: Sequence[str] | None = None,
    map_tolerance: float | None = None,
    seed: int = 0,
    reference: Sequence[Source | Recording] = (),
    time_s: float | None = None,
) -> Discovered:
    """Find what physics the twin leaves out: where, what, how large, since when.

    Args:
        recording: a file, a table or what `read` gave: a recording, or settled points (no `time_s`). Several recordings
            of one diesel engine are judged together: one verdict, with the health of each.
        engine: what the twin believes: name, file or parameters of a diesel or a petrol engine; the published engine
            without it. A calibrated engine's file says by its sidecar what it was calibrated from, its parameters
            don't: give the file where settled points are judged.
        channels: channel map for foreign names and units.
        sensors: columns to use; None is all that there are.
        withhold: effects to keep out of the catalogue.
        map_tolerance: standard deviation of the maps' smooth relative error that is believed [-]; None is that of
            params.yaml, where all else that is decided by stands too.
        seed: of everything random.
        reference: recordings of the engine when it was known to be well; it is learned from them first.
        time_s: for a recording of the diesel engine, after so many seconds the best answer so far is given and says so;
            None is that of params.yaml.

    Raises:
        InputError: anything that can't be used, or that can't carry a verdict.
    """
    asked = Asked(sensors, withhold, map_tolerance, seed, reference, time_s=time_s)
    return ask(recording, engine, channels, asked).answer()


def ask(
    recording: AnyRecording | Sequence[AnyRecording],
    engine: Engine | str | Path | None = None,
    channels: Channels | None = None,
    asked: Asked | None = None,
) -> Question:
    """Read and check all that `discover` needs, and search for nothing yet; the errors are those of it."""
    asked = asked or Asked()
    machine = _machine(engine, asked)
    _refuse_the_same(recording, asked.reference)
    if isinstance(recording, Sequence) and not isinstance(recording, str):
        if len(recording) != 1:
            together = _together(recording, machine, channels)
            return ask_driving(together, engine, channels, asked, _known(engine, asked, channels))
        recording = recording[0]
    if isinstance(machine, RigParameters):
        refuse_options({"--channels": channels}, f"for {machine.name}: its file names the columns")
    if isinstance(machine, PetrolParameters):
        refuse_options({"--time": asked.time_s}, "for a petrol engine")
    read = opened(recording, channels)
    if isinstance(machine, RigParameters):
        return ask_rig(read, machine, asked)
    if isinstance(read, RigRecording):
        raise InputError("recording", "one of a rig", "one of an engine", "name the rig's file")
    if isinstance(machine, PetrolParameters):
        if isinstance(read, Recording | SteadyPoints):
            raise InputError("recording", "one of a diesel engine", "one of a petrol engine, as the engine is",
                             "name the engine that it belongs to")
        engine_file = Path(engine) if isinstance(engine, str | Path) else None
        from dieseltwin.api.petrol import ask_petrol  # what the others of its kind need takes half a second

        return ask_petrol(read, machine, engine_file, asked, channels)
    if isinstance(read, PetrolRecording):
        raise InputError("recording", "one of a petrol engine", "one of a diesel engine, as the engine is",
                         "name the engine that it belongs to")
    if isinstance(read, Recording) or (isinstance(read, Imported) and read.timed):
        return ask_driving([read], engine, channels, asked, _known(engine, asked, channels))
    refuse_options({"--map-tolerance": asked.map_tolerance, "--time": asked.time_s}, "for settled points")
    from dieseltwin.api.points import ask_points

    return ask_points(read, engine, channels, asked)


def _machine(engine: Engine | str | Path | None, asked: Asked) -> Engine:
    """The machine that is meant. A petrol engine needs no maps where it is learned from references first."""
    if asked.reference and engine is not None:
        petrol = petrol_base(engine)
        if petrol is not None:
            return petrol
    return as_engine(engine)


def _refuse_the_same(recording: AnyRecording | Sequence[AnyRecording], reference: Sequence[object]) -> None:
    """Refuse a file that is its own reference, before anything is learned from it."""
    judged = recording if isinstance(recording, Sequence) and not isinstance(recording, str) else (recording,)
    healthy = [item for item in reference if isinstance(item, str | Path) and Path(item).is_file()]
    for one in (item for item in judged if isinstance(item, str | Path) and Path(item).is_file()):
        if any(filecmp.cmp(one, other, shallow=False) for other in healthy):
            raise InputError(str(one), "the reference itself", "driving that the engine wasn't learned from",
                             "judge another recording, or leave this one out of --reference")


def _known(
    engine: Engine | str | Path | None, asked: Asked, channels: Channels | None
) -> tuple[LearnedEngine | None, Sequence[Note]]:
    """What is known of a diesel engine, as `learning.known_engine`."""
    if not asked.reference:
        return learned_engine_of(engine), ()
    from dieseltwin.api.learning import known_engine  # with what calibration needs, a third of a second

    return known_engine(engine, asked.reference, channels)


def _together(
    recordings: Sequence[AnyRecording], machine: Engine, channels: Channels | None
) -> list[Imported | Recording]:
    """Recordings that are to be judged together, opened.

    Raises:
        InputError: none at all, a petrol engine, settled points.
    """
    if not recordings:
        raise InputError("RECORDING", "nothing", "a recording", "name the recording")
    if isinstance(machine, PetrolParameters | RigParameters):
        raise InputError("RECORDING", f"{len(recordings)}", "one of a petrol engine or a rig", "judge them one by one")
    found: list[Imported | Recording] = []
    for item in recordings:
        read = opened(item, channels)
        if isinstance(read, SteadyPoints | PetrolRecording | RigRecording) or (
            isinstance(read, Imported) and not read.timed
        ):
            raise InputError("RECORDING", "settled points among several", "recordings over time of a diesel engine",
                             "judge settled points by themselves")  # fmt: skip
        found.append(read)
    return found
