"""Calibrating an engine that has no parameters yet."""

from __future__ import annotations

import os
from collections.abc import Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from dieseltwin.api.engines import NAMED, PUBLISHED, AnyEngine, diesel_engine, petrol_base
from dieseltwin.api.petrol import PetrolCalibrated, calibrate_petrol
from dieseltwin.api.points import Calibrated, calibrate_points
from dieseltwin.api.reading import Channels, Source
from dieseltwin.engine import EngineParameters, load_engine
from dieseltwin.errors import InputError
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording
from dieseltwin.recordings.steady_points import SteadyPoints
from dieseltwin.rigs.parameters import RigParameters, is_rig
from dieseltwin.settings.names import refuse_options

LARGEST_NOISE_PCT = 20.0


def calibrate(
    points: Source | SteadyPoints | PetrolRecording,
    base: AnyEngine = PUBLISHED,
    *,
    geometry: EngineParameters | Mapping[str, Any] | str | Path | None = None,
    channels: Channels | None = None,
    noise_pct: float | None = None,
    seed: int = 0,
) -> Calibrated | PetrolCalibrated:
    """Calibrate another engine of the same kind: a diesel engine from steady points, a petrol engine from driving.

    Args:
        points: a file, a table or what `read` gave: steady points, or a recording whose quiet stretches stand for them;
            for a petrol engine a fault-free recording of ten minutes or more.
        base: engine to begin with: name, file or parameters.
        geometry: of this diesel engine: a YAML file or a mapping (bore_mm, stroke_mm or displacement_l, n_cyl, r_c,
            ...) or parameters; the base's without it.
        channels: channel map for foreign names and units.
        noise_pct: standard deviation of every sensor [%].
        seed: of the held-out third.

    Raises:
        InputError: anything that can't be used, too few points, a recording without idling.
    """
    first = base_engine(base)
    if isinstance(first, PetrolParameters):
        refuse_options({"--geometry": geometry, "--noise": noise_pct}, "for a petrol engine")
        if isinstance(points, SteadyPoints):
            raise InputError("recording", "settled points", "a recording of driving", "give the recording")
        return calibrate_petrol(points, first, channels)
    if isinstance(points, PetrolRecording):
        raise InputError("points", "a petrol engine's recording", "points of a diesel engine, as the base is",
                         "name a petrol engine as base")
    if noise_pct is not None and not (isinstance(noise_pct, Real) and 0.0 < noise_pct <= LARGEST_NOISE_PCT):
        raise InputError("--noise", noise_pct, f"0 to {LARGEST_NOISE_PCT:g} %",
                         "give the sensors' standard deviation in %")
    if not isinstance(seed, Integral) or seed < 0:
        raise InputError("--seed", repr(seed), "a whole number from 0 on", "choose another")
    return calibrate_points(points, first, geometry, channels, noise_pct, seed)


def base_engine(base: AnyEngine) -> EngineParameters | PetrolParameters:
    """The engine to begin with; one that isn't calibrated yet will do.

    Raises:
        InputError: neither a name nor a file that can be used, or a rig.
    """
    if isinstance(base, EngineParameters | PetrolParameters):
        return base
    if not isinstance(base, RigParameters | str | Path):
        raise InputError("base", f"a {type(base).__name__}", f"{', '.join(NAMED)}, an engine file or parameters",
                         "give one of these")
    if isinstance(base, RigParameters) or (os.path.isfile(base) and is_rig(base)):
        name = base.name if isinstance(base, RigParameters) else base
        raise InputError("--base", f"{name}, a rig", "an engine", "use `dieseltwin identify` on a recording of it")
    petrol = petrol_base(base)
    if petrol is not None:
        return petrol
    if str(base) == PUBLISHED:
        return diesel_engine(PUBLISHED)
    if Path(base).suffix in (".yaml", ".yml"):
        return load_engine(base)
    raise InputError("--base", repr(str(base)), f"{', '.join(NAMED)} or an engine file", "name one of these")
