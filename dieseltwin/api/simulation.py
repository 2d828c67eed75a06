"""Simulating an engine over recorded or made-up inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from dieseltwin.api.engines import AnyEngine, Engine, with_effects
from dieseltwin.api.reading import Channels, Source, as_engine, diesel_recording, petrol_recording, rig_recording
from dieseltwin.api.results import Result, drawn
from dieseltwin.engine import EngineParameters, Inputs
from dieseltwin.engine import simulate as simulate_inputs
from dieseltwin.engine.simulate import settle_first
from dieseltwin.errors import InputError
from dieseltwin.notes import counted
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording
from dieseltwin.petrol.simulate import beyond_maps, simulate_petrol
from dieseltwin.recordings.channels import INPUTS, optional_inputs
from dieseltwin.recordings.reader import Recording, write_recording
from dieseltwin.rigs.parameters import RigParameters
from dieseltwin.rigs.recording import RigRecording
from dieseltwin.rigs.simulate import refuse_runaway, simulate_rig
from dieseltwin.settings.names import refuse_options

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_ROWS = 1_500_000  # 42 hours at 10 Hz; every quantity and the oxygen's finer steps take two kilobytes a row
STATE_COLUMNS = ("p_im_pa", "p_em_pa", "omega_t_rad_s")


@dataclass(frozen=True, repr=False)
class Simulation(Result):
    """Every quantity of the engine at the times of the inputs.

    Attributes:
        frame: one row a time [SI, units in the names].
        engine: with the ambient of the inputs and the effects.
        readings: column -> (n,) what was given, inputs and the readings beside them [SI].
        notes: what reading did to the inputs, one sentence each.
    """

    frame: pd.DataFrame
    engine: Engine
    readings: Mapping[str, np.ndarray]
    notes: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        terms = f" with {counted(len(self.engine.terms), 'term')}" if self.engine.terms else ""
        time_s = self.frame["time_s"]
        kind = "a diesel engine" if isinstance(self.engine, EngineParameters) else "a petrol engine"
        kind = self.engine.name if isinstance(self.engine, RigParameters) else kind
        return f"{len(time_s)} rows over {time_s.iloc[-1] - time_s.iloc[0]:.0f} s of {kind}{terms}."

    def table(self) -> pd.DataFrame:
        return self.frame

    def plot(self, name: str | None = None) -> Figure:
        from dieseltwin.report.over_time import beside_readings

        return drawn(self, {"readings": lambda s: beside_readings(s.frame, s.readings)}, name)

    def save(self, out: str | Path) -> Path:
        return write_recording(self.frame, out)


def simulate(
    inputs: Source | Recording | PetrolRecording | RigRecording,
    engine: AnyEngine | None = None,
    *,
    channels: Channels | None = None,
    effects: Mapping[str, float | str] | None = None,
) -> Simulation:
    """Simulate an engine over inputs.

    Args:
        inputs: a file or a table with time_s, n_e_rpm, u_delta_mg, u_egr_pct, u_vgt_pct at any rate, or a recording.
            The states start at the first row's p_im_pa, p_em_pa, omega_t_rad_s where it has them, else at rest. For a
            petrol engine a recording of one; for a rig the columns of its file.
        engine: name, file or parameters; the published engine without it.
        channels: channel map of the inputs.
        effects: name in `dieseltwin effects` -> magnitude, added to the engine's terms.

    Raises:
        InputError: anything that can't be used, or values that are not finite.
    """
    machine = as_engine(engine)
    if isinstance(machine, RigParameters):
        refuse_options({"--effect": effects or None, "--channels": channels}, f"for {machine.name}")
        found = rig_recording(inputs, machine)
        frame = simulate_rig(machine, found)
        refuse_runaway(machine, frame)
        return Simulation(frame, machine, found.readings)
    if isinstance(inputs, RigRecording):
        raise InputError("inputs", "a rig's recording", "inputs of an engine", "name the rig's file")
    if isinstance(machine, PetrolParameters):
        refuse_options({"--effect": effects or None}, "for a petrol engine: write them as terms into its file")
        if isinstance(inputs, Recording):
            raise InputError("inputs", "those of a diesel engine", "a petrol engine's recording", "name its file")
        recorded = petrol_recording(inputs, channels)
        readings = {"p_im_pa": recorded.signals.p_im, "w_af_kg_s": recorded.signals.W_af}
        frame = simulate_petrol(machine, recorded)
        return Simulation(frame, machine, readings, tuple(beyond_maps(machine, frame)))
    if isinstance(inputs, PetrolRecording):
        raise InputError("inputs", "a petrol engine's recording", "inputs of a diesel engine", "name a petrol engine")
    parameters = with_effects(machine, effects)
    source = diesel_recording(inputs, channels, parameters, sensors=(), any_rate=True)
    if len(source.time_s) > MOST_ROWS:
        raise InputError(str(source.path or "inputs"), f"{len(source.time_s)} rows", f"at most {MOST_ROWS}",
                         "cut it, or average it down to 10 Hz")
    parameters = parameters.replace(T_amb=source.t_amb_k, p_amb=source.p_amb_pa)
    frame = simulate_inputs(_inputs(source), parameters, initial=_initial(source, parameters))
    if not np.isfinite(frame.to_numpy(dtype=np.float64)).all():
        bad = [name for name in frame if not np.isfinite(frame[name]).all()]
        raise InputError(f"simulating {source.path or 'the inputs'}", f"values that are not finite in {bad[0]}",
                         "inputs and parameters of a running engine", "check the inputs and --engine")
    return Simulation(frame, parameters, source.columns, source.notes)


def _inputs(recording: Recording) -> Inputs:
    columns = recording.columns
    for name in INPUTS:
        missing = np.flatnonzero(~np.isfinite(columns[name]))
        if missing.size:
            raise InputError(f"{recording.path or 'inputs'}: column {name}, data row {missing[0] + 1}", "no number",
                             "a number in every row of an input", "fill in or drop this row")
    n_e, u_delta, u_egr, u_vgt = (columns[name] for name in INPUTS)
    return Inputs(recording.time_s, n_e, u_delta, u_egr, u_vgt, u_flap_pct=optional_inputs(columns).get("u_flap_pct"))


def _initial(recording: Recording, parameters: EngineParameters) -> np.ndarray:
    """p_im, p_em [Pa], omega_t [rad/s] of the first row where it has them, else at rest at the first inputs; (3,)."""
    first = np.array([recording.columns[c][0] if c in recording.columns else np.nan for c in STATE_COLUMNS])
    if np.isfinite(first).all():
        return first
    inputs = _inputs(recording).clipped(parameters)
    settled = settle_first(inputs, parameters)
    return np.where(np.isfinite(first), first, settled)
