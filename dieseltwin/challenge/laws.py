"""How far a found law is off on driving that the tool never saw.

The law's site and form may differ from the truth's and still say the same, so it is judged by what it does to the
readings: 1 with no law at all, 0 with the truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.challenge.driving import INPUTS, Driving
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.sensors import NOISE_REL, SENSORS, SensorSet, shown
from dieseltwin.discovery.verdict.document import NONE_OF_THESE, load_discrepancy
from dieseltwin.engine import Inputs, simulate, we2011
from dieseltwin.engine.engine_files import load_engine
from dieseltwin.engine.terms import CorrectionTerm, OneTerm, Term, as_later

SETTLED_ROWS = 25  # of the start, left out


def law_error(result: Path, clean: pd.DataFrame, fault: Fault, health: Mapping[str, float]) -> float | None:
    """RMS error of the readings' change by the found law over the RMS of the true change, both in sigmas of the noise.

    Everything at the true health parameters with the published maps, over the inputs of the second recording; the
    truth is the plant's, the law is simulated by the tool's engine.

    Args:
        result: folder of the case's result; clean: signals of the second recording; fault: the truth; health: true.

    Returns:
        None where no law was found, or the answer isn't `none_of_these`. Whatever terms the engine file of such an
        answer carries are the law, in whichever words, save those of effects that the answer names beside it and what
        was learned of the engine's maps: both sides run on the published maps.
    """
    named = {effect.name for effect in load_discrepancy(result).effects}
    if NONE_OF_THESE not in named:
        return None
    terms = [
        term for term in load_engine(result / "engine.yaml").terms
        if not (isinstance(term, CorrectionTerm) or (isinstance(term, Term) and term.effect in named))
    ]  # fmt: skip
    return error_of(terms, clean, fault, health) if terms else None


def error_of(terms: Sequence[OneTerm], clean: pd.DataFrame, fault: Fault, health: Mapping[str, float]) -> float:
    """`law_error` of given terms; arguments as there."""
    lasting = as_later(terms)
    driving = Driving(*(clean[name].to_numpy(dtype=float) for name in ("time_s", *INPUTS)))
    parameters: dict[str, Any] = {**we2011.PARAMETERS.model_dump(), **health}
    fault = fault.lasting()
    run = run_plant(driving, parameters, (fault,))
    truth = shown(run, driving, (fault,), SensorSet.perfect())
    start = np.array([run[name][0] for name in SENSORS[:3]])
    engine = we2011.PARAMETERS.replace(**health)
    inputs = Inputs(driving.time_s, *(getattr(driving, name) for name in INPUTS))
    without, found = (
        simulate(inputs, engine.replace(terms=t), initial=start, oxygen=False) for t in ((), lasting)
    )
    missed, all_of_it = 0.0, 0.0
    for name, noise in zip(SENSORS, NOISE_REL, strict=True):
        sigma = noise * float(clean[name].mean())
        rows = slice(SETTLED_ROWS, None)
        missed += float(np.mean(((found[name].to_numpy() - truth[name])[rows] / sigma) ** 2))
        all_of_it += float(np.mean(((without[name].to_numpy() - truth[name])[rows] / sigma) ** 2))
    return float(np.sqrt(missed / all_of_it))
