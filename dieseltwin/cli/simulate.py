"""`dieseltwin simulate`: inputs from a file, every quantity of the engine into another."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dieseltwin.atomic import check_writable
from dieseltwin.cli.effects import with_effects
from dieseltwin.cli.petrol import is_petrol_engine, run_simulate_petrol
from dieseltwin.engine import EngineParameters, Inputs, load_engine, settle, simulate, we2011
from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import INPUTS
from dieseltwin.recordings.reader import Recording, read_recording, write_recording
from dieseltwin.settings.strict import refuse_options

STATE_COLUMNS = ("p_im_pa", "p_em_pa", "omega_t_rad_s")
SUFFIXES = (".csv", ".parquet")


def run_simulate(
    inputs: Path, out: Path, *, engine: Path | None = None, channels: Path | None = None,
    effects: Sequence[str] | None = None,
) -> int:  # fmt: skip
    """Simulate over a file of inputs and write the result; returns the number of rows written.

    Args:
        inputs: CSV or Parquet with time_s and the four inputs; ambient and the states of its first row where present.
        out: .csv or .parquet, written atomically.
        engine: YAML overriding engine parameters.
        channels: channel map of the inputs.
        effects: NAME=VALUE of effects to add to the engine's terms.

    Raises:
        InputError: any file that cannot be used or written.
    """
    if out.suffix.lower() not in SUFFIXES:
        raise InputError(f"--out {out}", f"ending {out.suffix or 'nothing'}", ", ".join(SUFFIXES), "choose one of them")
    if engine is not None and is_petrol_engine(engine):
        refuse_options({"--effect": effects or None}, "for a petrol engine: write them as terms into its file")
        return run_simulate_petrol(inputs, out, engine, channels)
    parameters = load_engine(engine) if engine is not None else we2011.PARAMETERS
    parameters = with_effects(parameters, effects)
    recording = read_recording(inputs, channels, parameters, sensors=(), any_rate=True)
    check_writable(out)
    parameters = parameters.replace(T_amb=recording.t_amb_k, p_amb=recording.p_amb_pa)
    table = simulate(_inputs(recording), parameters, initial=_initial(recording, parameters))
    if not np.isfinite(table.to_numpy(dtype=np.float64)).all():
        bad = [name for name in table if not np.isfinite(table[name]).all()]
        raise InputError(f"simulating {inputs}", f"values that are not finite in {bad[0]}",
                         "inputs and parameters of a running engine", "check the inputs and --engine")
    write_recording(table, out)
    return len(table)


def _inputs(recording: Recording) -> Inputs:
    columns = recording.columns
    for name in INPUTS:
        missing = np.flatnonzero(~np.isfinite(columns[name]))
        if missing.size:
            raise InputError(f"{recording.path}: column {name}, data row {missing[0] + 1}", "no number",
                             "a number in every row of an input", "fill in or drop this row")
    n_e, u_delta, u_egr, u_vgt = (columns[name] for name in INPUTS)
    return Inputs(recording.time_s, n_e, u_delta, u_egr, u_vgt)


def _initial(recording: Recording, parameters: EngineParameters) -> np.ndarray:
    """p_im, p_em [Pa], omega_t [rad/s] of the first row where it has them, else at rest at the first inputs; (3,)."""
    first = np.array([recording.columns[c][0] if c in recording.columns else np.nan for c in STATE_COLUMNS])
    if np.isfinite(first).all():
        return first
    inputs = _inputs(recording).clipped(parameters)
    settled = settle(inputs.n_e_rpm[0], inputs.u_delta_mg[0], inputs.u_egr_pct[0], inputs.u_vgt_pct[0], parameters)
    return np.where(np.isfinite(first), first, settled)
