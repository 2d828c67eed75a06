"""What physics the twin leaves out: of driving, of settled points, of a petrol engine."""

from __future__ import annotations

import filecmp
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from dieseltwin.api import driving, rigs
from dieseltwin.api.engines import AnyEngine, Engine, petrol_base
from dieseltwin.api.findings import Asked, Discovered, Kind, Question
from dieseltwin.api.reading import Channels, Made, Opened, Source, as_engine, opened, settled, several
from dieseltwin.discovery.verdict.explain import Known, check_name
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.errors import InputError
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.recordings.reader import Recording
from dieseltwin.rigs.parameters import RigParameters

AnyRecording: TypeAlias = Source | Made


def discover(
    recording: AnyRecording | Sequence[AnyRecording],
    engine: AnyEngine | None = None,
    *,
    channels: Channels | None = None,
    sensors: Sequence[str] | None = None,
    withhold: Sequence[str] | None = None,
    map_tolerance: float | None = None,
    seed: int | None = None,
    reference: Source | Recording | Sequence[Source | Recording] = (),
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
        seed: of everything random; None is that of params.yaml.
        reference: recordings of the engine when it was known to be well; it is learned from them first.
        time_s: for a recording of the diesel engine, after so many seconds the best answer so far is given and says so;
            None is that of params.yaml.

    Raises:
        InputError: anything that can't be used, or that can't carry a verdict.
    """
    asked = Asked(sensors, withhold, map_tolerance, seed, several(reference), time_s=time_s)
    return ask(recording, engine, channels, asked).answer()


def ask(
    recording: AnyRecording | Sequence[AnyRecording],
    engine: AnyEngine | None = None,
    channels: Channels | None = None,
    asked: Asked | None = None,
) -> Question:
    """Read and check all that `discover` needs, and search for nothing yet; the errors are those of it."""
    asked = asked or Asked()
    machine = _machine(engine, asked)
    recordings = several(recording)
    _refuse_the_same(recordings, asked.reference)
    if not recordings:
        raise InputError("RECORDING", "nothing", "a recording", "name the recording")
    if len(recordings) > 1 and isinstance(machine, PetrolParameters | RigParameters):
        raise InputError("RECORDING", f"{len(recordings)}", "one of a petrol engine or a rig", "judge them one by one")
    read = []
    for item in recordings:
        read.append(opened(item, machine, channels))
    question = _kind(machine, read).ask(read, engine, channels, asked)
    if asked.explain is not None:
        check_name(asked.explain, question.catalogue)
    return question


def catalogue_of(folder: Path) -> Mapping[str, Known]:
    """Effects that the answer in a folder was chosen among, by the repaired machine beside it; those of the diesel
    engine where there is none."""
    file = folder / "engine.yaml"
    machine = as_engine(file) if file.is_file() else None
    if isinstance(machine, RigParameters):
        return rigs.catalogue_of(machine.model_copy(update={"terms": ()}))  # what was found is a term by now
    if isinstance(machine, PetrolParameters):
        from dieseltwin.petrol.effects import HYPOTHESES

        return HYPOTHESES
    return EFFECTS


def _machine(engine: AnyEngine | None, asked: Asked) -> Engine:
    """The machine that is meant. A petrol engine needs no maps where it is learned from references first."""
    if asked.reference and engine is not None:
        petrol = petrol_base(engine)
        if petrol is not None:
            return petrol
    return as_engine(engine)


def _kind(machine: Engine, read: Sequence[Opened]) -> Kind:
    """Who asks about such recordings of such a machine; what points and petrol engines need takes half a second."""
    if isinstance(machine, RigParameters):
        return rigs
    if isinstance(machine, PetrolParameters):
        from dieseltwin.api import petrol

        return petrol
    if len(read) == 1 and settled(read[0]):
        from dieseltwin.api import points

        return points
    return driving


def _refuse_the_same(recordings: Sequence[AnyRecording], reference: Sequence[object]) -> None:
    """Refuse a file that is its own reference, before anything is learned from it."""
    healthy = [item for item in reference if isinstance(item, str | Path) and Path(item).is_file()]
    for one in (item for item in recordings if isinstance(item, str | Path) and Path(item).is_file()):
        if any(filecmp.cmp(one, other, shallow=False) for other in healthy):
            raise InputError(str(one), "the reference itself", "driving that the engine wasn't learned from",
                             "judge another recording, or leave this one out of --reference")
