"""What an estimator is given: one segment of a recording, its noise, and the parameters taken as known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dieseltwin.arrays import Array
from dieseltwin.engine import MEASURED, EngineParameters, Inputs
from dieseltwin.engine.sensor_effects import undo_sensor_terms
from dieseltwin.errors import InputError
from dieseltwin.recordings.circumstances import with_charge
from dieseltwin.recordings.held import decimal_step
from dieseltwin.recordings.noise import STEP_TO_STD, CutOff, cut_offs
from dieseltwin.sensors import NEEDED, SENSORS

if TYPE_CHECKING:
    from dieseltwin.recordings.reader import Recording, Segment

PAPER_NOISE: tuple[float, ...] = tuple(sensor.noise for sensor in SENSORS)
"""Relative noise of the sensors: the paper's noisy few-shot case, and of our own those that it hasn't [-]."""

NOISE_FLOOR: tuple[float, ...] = tuple(sensor.floor for sensor in SENSORS)
"""Smallest noise of each sensor that is believed [SI]."""

PAPER_CHANNELS: tuple[str, ...] = NEEDED
"""The five channels that the paper measures."""

FINE_AMBIENT_PA, COARSEST_AMBIENT_PA = 100.0, 1000.0
"""Steps of a recorded ambient pressure that are as good as none, and the coarsest that a message or a display has."""

START_SAMPLES = 3
"""Samples whose mean is the first guess of an initial state."""


@dataclass(frozen=True)
class NoiseLevels:
    """Noise standard deviation of each measured channel.

    Attributes:
        sigma: (C,) in the order of `MEASURED` [SI].
    """

    sigma: Array

    def __post_init__(self) -> None:
        sigma = np.asarray(self.sigma, dtype=np.float64)
        if sigma.shape != (len(MEASURED),) or not np.all(np.isfinite(sigma) & (sigma > 0.0)):
            raise InputError(
                "noise levels",
                sigma.tolist(),
                f"one positive number for each of {MEASURED}",
                "give them in SI units",
            )
        object.__setattr__(self, "sigma", sigma)

    @classmethod
    def from_signals(cls, signals: ArrayLike, relative: ArrayLike = PAPER_NOISE) -> NoiseLevels:
        """Percentages of the mean over the whole recording: the noise that the paper adds, `NOISE_FLOOR` at least.

        Args:
            signals: (n, C) clean (or measured) channels of the whole recording, NaN where absent.
            relative: (C,) noise as a share of the mean [-].

        Returns:
            Levels; a channel that is absent everywhere gets its floor and is never used.
        """
        values = np.asarray(signals, dtype=np.float64)
        present = np.isfinite(values)
        mean = np.where(present, values, 0.0).sum(axis=0) / np.maximum(present.sum(axis=0), 1)
        return cls(np.maximum(np.abs(mean) * np.asarray(relative), np.asarray(NOISE_FLOOR)))


@dataclass(frozen=True)
class SegmentProblem:
    """One segment (usually a minute) from which the health parameters are to be found.

    Attributes:
        t0_s, t1_s: start and end of the segment in the recording [s].
        inputs: inputs of n samples, preceded by `inputs.n_history` samples of history.
        measured: (n, C) readings in the order of `MEASURED` [SI]; NaN = masked.
        sigma: (C,) noise standard deviation, same units.
        parameters: the known parameters, ambient of the recording included; its health values are the
            starting point.
        true_initial: (5,) p_im, p_em, omega_t, x_r, T_1 at the start, only for simulated recordings.
        truth: true values of the four unknowns, only for simulated recordings.
        noise_draws: (D, n, C) further readings of the same segment, run r uses draw r modulo D; None =
            `measured` for all.
        cut_off: column of `measured` -> where its noise is cut off, so that readings are too high on average.
        p_amb_std_pa: standard deviation of the ambient pressure, which was recorded in coarse steps [Pa].
    """

    t0_s: float
    t1_s: float
    inputs: Inputs
    measured: Array
    sigma: Array
    parameters: EngineParameters
    true_initial: Array | None = None
    truth: Mapping[str, float] | None = None
    noise_draws: Array | None = field(default=None, repr=False)
    cut_off: Mapping[int, CutOff] = field(default_factory=dict, repr=False)
    p_amb_std_pa: float = 0.0

    def __post_init__(self) -> None:
        measured = np.asarray(self.measured, dtype=np.float64)
        n = len(self.inputs.time_s) - self.inputs.n_history
        if measured.shape != (n, len(MEASURED)):
            raise InputError(
                f"measured channels of {self.name}",
                f"shape {measured.shape}",
                f"({n}, {len(MEASURED)})",
                "give one row for each input sample after the history",
            )
        if self.noise_draws is not None and self.noise_draws.shape[1:] != measured.shape:
            raise InputError(
                f"noise draws of {self.name}",
                f"shape {self.noise_draws.shape}",
                f"(D, {n}, {len(MEASURED)})",
                "draw noise for every reading",
            )
        object.__setattr__(self, "measured", measured)
        object.__setattr__(self, "sigma", NoiseLevels(np.asarray(self.sigma, dtype=np.float64)).sigma)

    @property
    def name(self) -> str:
        """How messages call this segment."""
        return f"segment {self.t0_s:g}-{self.t1_s:g} s"

    @property
    def time_s(self) -> Array:
        """(n,) sample times of the segment [s]."""
        return np.asarray(self.inputs.time_s[self.inputs.n_history :])

    @property
    def observed(self) -> NDArray[np.bool_]:
        """(n, C) true where a reading exists."""
        return np.isfinite(self.measured)

    def readings(self, runs: int) -> Array:
        """Readings that each run sees.

        Args:
            runs: number of runs R.

        Returns:
            (R, n, C) readings, NaN where masked.
        """
        if self.noise_draws is None:
            return np.broadcast_to(self.measured, (runs, *self.measured.shape))
        return self.noise_draws[np.arange(runs) % len(self.noise_draws)]

    def first_states(self, readings: ArrayLike | None = None, *, absent: ArrayLike | None = None) -> Array:
        """First guess of p_im, p_em, omega_t at the start: mean of the first readings that exist.

        Args:
            readings: (.., n, C) readings; None takes `measured`.
            absent: (3,) values of the states whose channel has no reading at all [Pa, Pa, rad/s]; None refuses those.

        Returns:
            (.., 3) guess [Pa, Pa, rad/s].

        Raises:
            InputError: one of the three channels has no reading in the whole segment, and `absent` is None.
        """
        values = np.asarray(self.measured if readings is None else readings, dtype=np.float64)[..., :3]
        present = np.isfinite(values)
        if absent is None and not present.any(axis=-2).all():
            missing = [MEASURED[i] for i in range(3) if not present[..., i].any()]
            raise InputError(
                f"{', '.join(missing)} in {self.name}",
                "no reading",
                "at least one",
                "leave the segment out or record the channel",
            )
        counted = present & (np.cumsum(present, axis=-2) <= START_SAMPLES)
        total, count = np.where(counted, values, 0.0).sum(axis=-2), counted.sum(axis=-2)
        return np.where(count > 0, total / np.maximum(count, 1), 0.0 if absent is None else absent)

    def with_noise_draws(self, draws: int, rng: np.random.Generator) -> SegmentProblem:
        """Treat `measured` as clean and add independent Gaussian noise draws.

        Args:
            draws: number of draws D.
            rng: source of the noise.

        Returns:
            The same problem whose run r sees draw r modulo D, and whose `measured` is the first draw.
        """
        noise = rng.standard_normal((draws, *self.measured.shape)) * self.sigma
        noisy = self.measured + noise
        return replace(self, measured=noisy[0], noise_draws=noisy)


def problem_from_segment(
    segment: Segment,
    parameters: EngineParameters,
    noise: NoiseLevels,
    *,
    channels: Sequence[str] | None = None,
    true_initial: ArrayLike | None = None,
    truth: Mapping[str, float] | None = None,
) -> SegmentProblem:
    """Turn a recording's segment into an estimation problem.

    Args:
        segment: `recordings.Segment` (t0_s, t1_s, inputs, measured).
        parameters: known parameters; ambient values must be those of the recording. Offsets and gains of sensors
            among its terms are taken out of the readings.
        noise: noise of the whole recording.
        channels: channels of `MEASURED` to use, the others are masked; None = all that are recorded.
        true_initial: (5,) true p_im, p_em, omega_t, x_r, T_1 of simulated data, for the faithful methods.
        truth: true health values of simulated data, for figures only; no estimator reads it.

    Returns:
        The problem.

    Raises:
        InputError: an unknown channel name.
    """
    inputs = segment.inputs
    conditions = {name: values[inputs.n_history :] for name, values in inputs.columns.items()}
    measured, parameters = undo_sensor_terms(
        segment.measured, inputs.segment_time_s, inputs.recording_start_s, conditions, parameters
    )
    if channels is not None:
        unknown = sorted(set(channels) - set(MEASURED))
        if unknown:
            raise InputError("channels", ", ".join(unknown), ", ".join(MEASURED), "correct the names")
        for i, name in enumerate(MEASURED):
            if name not in channels:
                measured[:, i] = np.nan
    return SegmentProblem(
        t0_s=float(segment.t0_s),
        t1_s=float(segment.t1_s),
        inputs=segment.inputs,
        measured=measured,
        sigma=noise.sigma,
        parameters=parameters,
        true_initial=None if true_initial is None else np.asarray(true_initial, dtype=np.float64),
        truth=truth,
    )


def problems_from_recording(
    recording: Recording,
    parameters: EngineParameters,
    *,
    noise: NoiseLevels | None = None,
    duration_s: float = 60.0,
    channels: Sequence[str] | None = None,
    truth: Mapping[str, float] | None = None,
) -> list[SegmentProblem]:
    """Split a recording into estimation problems; ambient and noise are those of the whole recording.

    Args:
        recording: `recordings.Recording`.
        parameters: known parameters and starting values; T_amb, p_amb and, where recorded, T_im are the recording's.
        noise: noise levels; None takes the paper's percentages of the recording's means, never below
            `NOISE_FLOOR`.
        duration_s: length of a segment [s].
        channels: channels of `MEASURED` to use; None = all that are recorded.
        truth: true health values of simulated data, for figures only.

    Returns:
        One problem for each segment.
    """
    ambient = parameters.replace(T_amb=float(recording.t_amb_k), p_amb=float(recording.p_amb_pa))
    known = with_charge(ambient, recording)
    segments = list(recording.segments(duration_s))
    if noise is None:
        noise = NoiseLevels.from_signals(np.concatenate([s.measured for s in segments]))
    missing = np.full(recording.time_s.shape, np.nan)
    cut_off = cut_offs(np.column_stack([recording.columns.get(name, missing) for name in MEASURED]))
    problems = [problem_from_segment(s, known, noise, channels=channels, truth=truth) for s in segments]
    return [replace(p, cut_off=cut_off, p_amb_std_pa=_rounding(recording)) for p in problems]


def _rounding(recording: Recording) -> float:
    """Standard deviation of the recorded ambient pressure where it comes in coarse steps, else 0 [Pa]."""
    step = decimal_step(np.asarray(recording.columns.get("p_amb_pa", np.nan), dtype=np.float64))
    return STEP_TO_STD * min(step, COARSEST_AMBIENT_PA) if step > FINE_AMBIENT_PA else 0.0
