"""The paper's data: Set-I to Set-IV (inputs), Cases I-VII (recordings), clean and noisy field data.

Paper: section "Data generation" and its case table; where it leaves something open docs/definitions.md rules, and the
numbers stand in `params.yaml` under `driving` and `noise`. Inputs are made once, with laboratory parameters at the
baseline ambient, and reused in all cases.

Every function returns a DataFrame in the column names of the recordings; `write_recording` writes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from dieseltwin.duty_cycles.driving import Driving, drive
from dieseltwin.duty_cycles.random_driving import random_demand, smoothed_demand
from dieseltwin.duty_cycles.schedules import Demand, joined, load_schedule, schedule_demand
from dieseltwin.engine import HEALTH, MEASURED, EngineParameters, Inputs, simulate, we2011
from dieseltwin.errors import InputError
from dieseltwin.recordings.reader import Recording, Segment, read_recording, recording
from dieseltwin.sensors import relative_noise
from dieseltwin.settings.params import CaseConfig, DrivingConfig, EngineConfig, NoiseConfig, Params
from dieseltwin.settings.strict import unknown_name
from dieseltwin.symbols import INPUT_COLUMNS

JOINT_S = 4.0  # passage between blocks of driving: the longest ramp of the random driving
# Set-II is arranged around the only long idle in the second half of the WHTC, seconds 1146-1195
SET_II_START_S, SET_II_IDLE_END_S = 1061, 1195
SET_II_IDLE_UNTIL_S, SET_II_BUSY_UNTIL_S = 181, 300  # minute 2-3 is all idle, minutes 3-5 are all driving
SCHEDULE_HALF_S, SCHEDULE_END_S = 900, 1800
# 24 minutes do not hold the WHSC (1895 s): the sets take its start (idle, full load, part load at one speed), ten
# minutes of the WHTC and random driving for the rest
SHORT_SET_WHSC_S, SHORT_SET_WHTC_S = (181, 420), (151, 750)
HEALTH_SPREAD = 0.25  # of validation engines about the laboratory's, either way [-]
BENCHMARK_SEGMENT_S, BENCHMARK_STEP_S = 60.0, 0.0125


def set_demand(name: str, config: DrivingConfig) -> Demand:
    """What the driver asks for in a set; rows at the set's input step.

    Raises:
        InputError: unknown set, or a duration that its schedules do not fit in.
    """
    if name not in config.sets:
        raise unknown_name("set", name, list(config.sets))
    arrange = {"set_i": _set_i, "set_ii": _set_ii}.get(name, _short_set)
    settings = config.sets[name]
    return arrange(config, settings.duration_s, settings.input_step_s, _generator(settings.seed, 0))


def _generator(seed: int, stream: int) -> np.random.Generator:
    return np.random.default_rng([seed, stream])


def _set_i(config: DrivingConfig, duration_s: float, step_s: float, rng: np.random.Generator) -> Demand:
    whsc, whtc = load_schedule("whsc"), load_schedule("whtc")
    blocks = [
        schedule_demand(whsc, config.speed_map, 1, whsc.time_s[-1], step_s),
        schedule_demand(whtc, config.speed_map, 1, SCHEDULE_HALF_S, step_s),
    ]
    return _with_random(blocks, config, duration_s, step_s, rng)


def _short_set(config: DrivingConfig, duration_s: float, step_s: float, rng: np.random.Generator) -> Demand:
    blocks = [
        schedule_demand(load_schedule("whsc"), config.speed_map, *SHORT_SET_WHSC_S, step_s),
        schedule_demand(load_schedule("whtc"), config.speed_map, *SHORT_SET_WHTC_S, step_s),
    ]
    return _with_random(blocks, config, duration_s, step_s, rng)


def _with_random(
    blocks: list[Demand], config: DrivingConfig, duration_s: float, step_s: float, rng: np.random.Generator
) -> Demand:
    """The blocks and random driving for the rest of the duration."""
    rows = sum(block.time_s.size for block in blocks)
    rest_s = duration_s - rows * step_s
    _check_rest(rest_s)
    return joined([*blocks, random_demand(rest_s, step_s, config.random, rng)], step_s, JOINT_S)


def _check_rest(rest_s: float) -> None:
    if rest_s < 60.0:
        raise InputError("driving.sets: duration_s", f"{rest_s:g} s left for random driving", "at least 60 s",
                         "give the set a longer duration")


def _set_ii(config: DrivingConfig, duration_s: float, step_s: float, rng: np.random.Generator) -> Demand:
    """Minute 0-1 drives, 1-2 enters idle, 2-3 idles, 3-5 drive; then the rest of WHTC seconds 901-1800."""
    whtc = load_schedule("whtc")

    def block(first_s: float, last_s: float) -> Demand:
        return schedule_demand(whtc, config.speed_map, first_s, last_s, step_s)

    start = block(SET_II_START_S, SET_II_IDLE_END_S)
    # the schedule's last second runs to the first row of the next block
    tail = [
        block(SET_II_IDLE_END_S + 1, SCHEDULE_END_S),
        block(SCHEDULE_HALF_S + 1, SET_II_START_S - 1),
    ]
    rows = start.time_s.size + sum(part.time_s.size for part in tail)
    rest_s = duration_s - rows * step_s
    _check_rest(rest_s)
    idle_s = SET_II_IDLE_UNTIL_S - start.time_s.size * step_s
    busy_s = SET_II_BUSY_UNTIL_S - start.time_s.size * step_s
    middle = random_demand(rest_s, step_s, config.random, rng, idle_start_s=idle_s, busy_until_s=busy_s)
    return smoothed_demand(joined([start, middle, *tail], step_s, JOINT_S), config.random)


def drive_set(name: str, config: DrivingConfig, parameters: EngineParameters | None = None) -> Driving:
    """Inputs of a set with the response of the engine that they were made with (laboratory, baseline ambient)."""
    demand = set_demand(name, config)
    settings = config.sets[name]
    return drive(demand, config, parameters or we2011.PARAMETERS, _generator(settings.seed, 1), settings.modified)


def make_set(name: str, config: DrivingConfig, parameters: EngineParameters | None = None) -> pd.DataFrame:
    """Inputs of a set: time_s and the four inputs at the set's input step, linear in between.

    Args:
        name: "set_i", "set_ii", "set_iii" or "set_iv".
        config: `driving` of params.yaml.
        parameters: laboratory parameters at the baseline ambient; the published set by default.
    """
    return drive_set(name, config, parameters).inputs


def laboratory_parameters(config: EngineConfig) -> EngineParameters:
    """The published parameters with the overrides of params.yaml, at the baseline ambient."""
    return we2011.PARAMETERS.replace(**config.overrides) if config.overrides else we2011.PARAMETERS


def field_parameters(config: EngineConfig) -> EngineParameters:
    """Laboratory health parameters divided by the field ratios at full precision: what identification must find."""
    lab = laboratory_parameters(config)
    unknown = [name for name in config.field_ratios if name not in HEALTH]
    if unknown:
        raise unknown_name("engine.field_ratios", unknown[0], HEALTH)
    return lab.replace(**{name: getattr(lab, name) / ratio for name, ratio in config.field_ratios.items()})


def case_parameters(name: str, driving: DrivingConfig, engine: EngineConfig) -> EngineParameters:
    """Engine and ambient of a case of the paper's table."""
    case = _case(name, driving)
    base = laboratory_parameters(engine) if case.parameters == "lab" else field_parameters(engine)
    return base.replace(T_amb=base.T_amb + case.delta_t_amb_k, p_amb=base.p_amb + case.delta_p_amb_pa)


def _case(name: str, driving: DrivingConfig) -> CaseConfig:
    if name not in driving.cases:
        raise unknown_name("case", name, list(driving.cases))
    return driving.cases[name]


def make_case(
    name: str, params: Params, inputs: pd.DataFrame | None = None, *, sample_s: float | None = None
) -> pd.DataFrame:
    """The clean recording of a case: every quantity of the simulation, and the ambient.

    Args:
        name: "case_i" to "case_vii".
        params: settings of the run.
        inputs: the set's inputs when they are made already; otherwise they are made here.
        sample_s: spacing of the rows [s]; `driving.sample_s` by default, `driving.sample_eta_tm_s` to train eta_tm.
    """
    case = _case(name, params.driving)
    if inputs is None:
        inputs = make_set(case.set, params.driving, laboratory_parameters(params.engine))
    sample_s = params.driving.sample_s if sample_s is None else sample_s
    parameters = case_parameters(name, params.driving, params.engine)
    # the oxygen columns are for people who plot a recording; at the fine rate of eta_tm they would double the time
    oxygen = sample_s >= params.driving.sample_s
    return simulated(inputs, parameters, sample_s, params.engine.step_s, oxygen=oxygen)


def simulated(
    inputs: pd.DataFrame, parameters: EngineParameters, sample_s: float, step_s: float, *, oxygen: bool = True
) -> pd.DataFrame:
    """Simulate inputs that are linear between their rows; one row every `sample_s` [s], ambient columns included."""
    known = inputs["time_s"].to_numpy()
    n = round((known[-1] - known[0]) / sample_s) + 1
    # k * 0.2 has 17 digits; rounded, the times read 0.6 as a logger writes them
    time = np.round(known[0] + sample_s * np.arange(n), 6)
    n_e, u_delta, u_egr, u_vgt = (np.interp(time, known, inputs[name]) for name in INPUT_COLUMNS)
    frame = simulate(Inputs(time, n_e, u_delta, u_egr, u_vgt), parameters, step_s=step_s, oxygen=oxygen)
    _check_finite(frame)
    frame["p_amb_pa"] = parameters.p_amb
    frame["t_amb_k"] = parameters.T_amb
    frame["t_im_k"] = parameters.T_im
    return frame


def _check_finite(frame: pd.DataFrame) -> None:
    """Raise `InputError` where the simulation got away: a network would learn from it without a word."""
    wrong = ~np.isfinite(frame.to_numpy(dtype=float))
    if wrong.any():
        row = int(np.argmax(wrong.any(axis=1)))
        name = frame.columns[int(np.argmax(wrong[row]))]
        got = f"{name} = {frame[name].iloc[row]} at {frame['time_s'].iloc[row]:g} s of the simulation"
        raise InputError("engine", got,
                         "finite values", "take a smaller engine.step_s or mend engine.overrides")  # fmt: skip


def noise_sigma(clean: Mapping[str, np.ndarray] | pd.DataFrame, noise: NoiseConfig) -> np.ndarray:
    """Standard deviation of the noise of each sensor, in the order of `engine.MEASURED`, (C,) [SI].

    A percentage of the mean of the clean signal over the whole recording; NaN for an absent sensor.
    """
    means = np.array([np.nanmean(clean[name]) if name in clean else np.nan for name in MEASURED])
    return np.asarray(relative_noise(noise)) * means


def add_noise(clean: pd.DataFrame, noise: NoiseConfig) -> pd.DataFrame:
    """The recording as sensors would give it: the inputs and the sensors only, Gaussian noise on the sensors.

    Args:
        clean: simulated recording.
        noise: `noise` of params.yaml; another seed, other noise of the same level.
    """
    rng = np.random.default_rng([noise.seed, 0])
    noisy = clean[["time_s", *INPUT_COLUMNS]].copy()
    for name, sigma in zip(MEASURED, noise_sigma(clean, noise), strict=True):
        # drawn for absent sensors too, so that the noise of one sensor does not depend on the others
        draws = rng.standard_normal(len(clean))
        if name in clean:
            noisy[name] = clean[name].to_numpy() + sigma * draws
    for name in ("p_amb_pa", "t_amb_k"):
        if name in clean:
            noisy[name] = clean[name].to_numpy()
    return noisy


def make_validation(
    seed: int, params: Params, *, duration_s: float = 1200.0
) -> tuple[pd.DataFrame, EngineParameters]:
    """A clean recording to choose hyper-parameters on: random driving of another seed, other health values.

    Case-V is not for tuning. Health values are drawn uniformly within `HEALTH_SPREAD` about the laboratory's
    (eta_sc within a third of it), the baseline ambient, Set-II's sampling.

    Returns:
        The clean recording and the parameters it was made with.

    Raises:
        InputError: a seed that one of the sets uses.
    """
    used = {settings.seed: name for name, settings in params.driving.sets.items()}
    if seed in used:
        raise InputError("validation seed", seed, f"not the seed of {used[seed]}", "take another seed")
    rng = _generator(seed, 2)
    lab = laboratory_parameters(params.engine)
    spreads = {name: HEALTH_SPREAD / 3.0 if name == "eta_sc" else HEALTH_SPREAD for name in HEALTH}
    truth = lab.replace(**{n: getattr(lab, n) * (1.0 + rng.uniform(-s, s)) for n, s in spreads.items()})
    sample_s = params.driving.sample_s
    demand = random_demand(duration_s, sample_s, params.driving.random, rng)
    inputs = drive(demand, params.driving, lab, rng).inputs
    return simulated(inputs, truth, sample_s, params.engine.step_s), truth


def benchmark_segments(path: str | Path, parameters: EngineParameters) -> tuple[Recording, tuple[Segment, ...]]:
    """The benchmark driving: the inputs of a reference trace, simulated with `parameters`, cut into segments.

    Five minutes at 5 Hz give five segments of 301 points that share their end rows.

    Args:
        path: file with time_s, the four inputs and, for the start, p_im_pa, p_em_pa and omega_t_rad_s.
        parameters: the engine to record, for instance the field values.
    """
    source = read_recording(path, engine=parameters, sensors=())
    n_e, u_delta, u_egr, u_vgt = (source.columns[name] for name in INPUT_COLUMNS)
    inputs = Inputs(source.time_s, n_e, u_delta, u_egr, u_vgt)
    start = ("p_im_pa", "p_em_pa", "omega_t_rad_s")
    initial = np.array([source.columns[n][0] for n in start]) if all(n in source.columns for n in start) else None
    frame = simulate(inputs, parameters, initial=initial, step_s=BENCHMARK_STEP_S)
    made = recording(frame, parameters, where=f"{path} simulated")
    return made, made.segments(BENCHMARK_SEGMENT_S)
