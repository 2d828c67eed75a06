"""The repaired model's view of every quantity that nobody measured, row by row."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dieseltwin.discovery.twins.diesel import STEP_S, EngineTwin
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.engine import EngineParameters, actuate
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.extended_frame import extended_frame
from dieseltwin.engine.extended_terms import simulate_terms
from dieseltwin.engine.parameters import parameter_batch
from dieseltwin.engine.terms import CorrectionTerm, LawTerm, OneTerm, Term
from dieseltwin.recordings.reader import Recording
from dieseltwin.symbols import INPUT_COLUMNS

_GIVEN = ("time_s", *INPUT_COLUMNS)
STD = "_std"


def implied_frame(
    recording: Recording,
    engine: EngineParameters,
    stds: Mapping[str, float] | None = None,
    *,
    sensors: Sequence[str] | None = None,
    starts: NDArray[np.int64] | None = None,
    local: Array | None = None,
) -> pd.DataFrame:
    """Every quantity of the repaired engine along the recording, with standard deviations where they are known.

    The standard deviations are those of the health parameters and of the terms, taken to the quantities at the same
    states, first order, as if independent; so a state (pressure, turbo speed) has none, and a quantity that two
    correlated parameters move in opposite ways has one that is too large.

    Args:
        recording: rows with the engine running become rows of the table.
        engine: repaired, with its terms.
        stds: health parameter -> standard deviation [its unit]; the terms carry their own.
        sensors: columns that were used.
        starts, local: (W,) windows' first rows and (W, 3) states p_im, p_em [Pa], omega_t [rad/s] there, both or none;
            None takes windows of equal length and smoothed readings.

    Returns:
        Columns of `extended_frame`, `time_s` on the recording's clock; `<column>_std` behind those that have one.
    """
    twin = EngineTwin(recording, engine, sensors)
    engine = twin.engine
    if starts is None or local is None:
        starts, local = twin.starts, twin.initial(twin.first_local())
    actuation = actuate(twin.inputs, engine, STEP_S)
    observed = simulate_terms(actuation, parameter_batch(engine), local[None], restarts=starts, sensors=False)
    states = observed.states[0]
    frame = extended_frame(states, actuation, engine)
    variance = pd.DataFrame(0.0, index=frame.index, columns=frame.columns)
    for changed in _one_std_away(engine, stds or {}):
        variance += (extended_frame(states, actuation, changed) - frame).to_numpy(dtype=np.float64) ** 2
    frame["time_s"] = twin.recording_time_s
    columns: dict[str, Array] = {}
    for name in frame:
        columns[str(name)] = frame[name].to_numpy()
        std = np.sqrt(variance[name].to_numpy())
        if name not in _GIVEN and std.max() > 0.0:
            columns[f"{name}{STD}"] = std
    return pd.DataFrame(columns)


def _one_std_away(engine: EngineParameters, stds: Mapping[str, float]) -> Iterator[EngineParameters]:
    """The engine with one uncertain number after another moved by its standard deviation, within what is possible."""
    for name, std in stds.items():
        if std > 0.0:
            yield engine.replace(**{name: getattr(engine, name) + std})
    for k, term in enumerate(engine.terms):
        if isinstance(term, CorrectionTerm) or term.std is None or term.std <= 0.0:
            continue
        if isinstance(term, Term):
            effect = EFFECTS[term.effect]
            moved = term.magnitude + term.std
            moved = moved if moved <= effect.limits[1] else term.magnitude - term.std
            if not effect.limits[0] <= moved <= effect.limits[1]:
                continue
            changed: OneTerm = term.model_copy(update={"magnitude": moved})
        elif not isinstance(term, LawTerm):
            changed = term.model_copy(update={"magnitude": term.magnitude + term.std})
        else:
            changed = term.model_copy(update={"coefficient": term.coefficient + term.std})
        yield engine.replace(terms=(*engine.terms[:k], changed, *engine.terms[k + 1 :]))
