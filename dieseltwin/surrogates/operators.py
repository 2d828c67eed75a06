"""Actuator operators: two causality DeepONets in place of the EGR and VGT actuator equations.

Paper: section "DeepONets for EGR and VGT states" and its appendix. D1 has four branches (the delayed EGR command
and an initial value, for each of u_egr1 and u_egr2), D2 two (the delayed VGT command and an initial value of u_vgt). A
window is one minute at 0.2 s, the inputs of the branches are u_d(t) = u(t - tau_d).

Where the paper leaves it open: a training sample is one row of a window's Toeplitz matrix. A mini-batch draws windows
at any start (the sliding-window augmentation) and one time in each, so that nothing but the recordings is stored; a
paper's epoch is one update on the full batch (144 x 301 rows of 301 inputs). The rest of the structure, the limits of
the outputs and the initial weights: `networks.CausalityDeepONet`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from dieseltwin.engine import EngineParameters, Inputs
from dieseltwin.errors import InputError
from dieseltwin.networks import (
    CausalityDeepONet,
    DeepONetSizes,
    load_state,
    network_from_spec,
    save_state,
    soft_clip,
    soft_clip_slope,
)
from dieseltwin.settings.params import OperatorConfig, OperatorsConfig

OPERATORS: Mapping[str, tuple[str, ...]] = {"egr": ("u_egr1_pct", "u_egr2_pct"), "vgt": ("u_vgt_act_pct",)}
"""Label columns of D1 and D2."""
COMMANDS: Mapping[str, str] = {"egr": "u_egr_pct", "vgt": "u_vgt_pct"}
TRAINING_CASES: Mapping[str, tuple[str, ...]] = {"egr": ("case_i", "case_vi"), "vgt": ("case_i", "case_vii")}

_START_SAMPLES = 6  # the first samples of a window, where the initial value is forgotten, are drawn more often
_WARM_UP_UPDATES = 100
_CURVE_POINTS = 100
_FINISH_CHUNK = 2000  # rows of the closed-form system at once: 26 MB
_FINISH_PASSES = 2  # the soft clip bends near the limits
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class ActuatorStates:
    """Actuator states at the samples of a segment, each (n,) [%]."""

    u_egr1: np.ndarray
    u_egr2: np.ndarray
    u_vgt: np.ndarray


@dataclass(frozen=True)
class Operator:
    """One trained DeepONet with its scaling.

    Attributes:
        network: takes and gives values scaled to [0, 1].
        delay_s: dead time of the command [s].
        limits_pct: range of the command, and so of a state behind first-order lags [%].
        sample_s: spacing of the window's samples [s].
        curve: (points, 2) updates and mean square error on the mini-batches (scaled) so far.
    """

    network: CausalityDeepONet
    delay_s: float
    limits_pct: tuple[float, float]
    sample_s: float
    curve: np.ndarray

    def scaled_command(self, u_pct: np.ndarray) -> Tensor:
        """Command [%] scaled so that the zeros before a window differ from its lower limit, if that is not 0."""
        return torch.as_tensor(np.asarray(u_pct) / self.limits_pct[1], dtype=torch.float32)

    def scaled_state(self, state_pct: np.ndarray) -> Tensor:
        """States [%] scaled by their limits to [0, 1]."""
        low, high = self.limits_pct
        return torch.as_tensor((np.asarray(state_pct) - low) / (high - low), dtype=torch.float32)

    def predict(self, u_delayed_pct: np.ndarray, initial_pct: np.ndarray) -> np.ndarray:
        """Actuator states in windows.

        Args:
            u_delayed_pct: (B, n) delayed commands u(t - tau_d) at 0, 0.2 s, ..., n at most a window [%].
            initial_pct: (B, outputs) states at the windows' start [%].

        Returns:
            (B, n, outputs) states [%]; a sample depends on the commands up to it only, bit for bit.
        """
        low, high = self.limits_pct
        with torch.no_grad():
            scaled = self.network(self.scaled_command(u_delayed_pct), self.scaled_state(initial_pct))
        return low + (high - low) * scaled.double().numpy()


@dataclass(frozen=True)
class ActuatorOperators:
    """D1 (EGR) and D2 (VGT)."""

    egr: Operator
    vgt: Operator

    def predict(self, inputs: Inputs) -> ActuatorStates:
        """Actuator states at the samples of a segment, from rest at the first row of its history.

        Args:
            inputs: with the input history before the segment, if any; without it the actuators rest at its start.
        """
        u_egr = _follow(self.egr, inputs, inputs.u_egr_pct)
        u_vgt = _follow(self.vgt, inputs, inputs.u_vgt_pct)
        return ActuatorStates(u_egr[:, 0], u_egr[:, 1], u_vgt[:, 0])

    def errors(self, recording: pd.DataFrame) -> dict[str, float]:
        """Relative L2 error [%] of each state over the windows of a clean recording at 0.2 s, initial values given."""
        return {label: error for name in OPERATORS for label, error in self._errors(name, [recording]).items()}

    def training_errors(self, cases: Mapping[str, pd.DataFrame]) -> dict[str, float]:
        """The same over the clean training recordings, the windows of all of them as one set (paper: 120 and 24)."""
        return {
            label: error
            for name, of in TRAINING_CASES.items()
            for label, error in self._errors(name, [cases[case] for case in of]).items()
        }

    def _errors(self, name: str, recordings: Sequence[pd.DataFrame]) -> dict[str, float]:
        operator: Operator = getattr(self, name)
        n = operator.network.n_times
        found, truth = [], []
        for recording in recordings:
            u, y = _signals(recording, name, operator.delay_s, operator.limits_pct)
            starts = np.arange(0, len(u) - n + 1, n - 1)
            if starts.size == 0:
                raise InputError("recording", f"{len(u)} rows", f"at least {n}", "give a minute or more")
            windows = starts[:, None] + np.arange(n)
            found.append(operator.predict(u[windows], y[starts]))
            truth.append(y[windows])
        off, size = np.concatenate(found) - np.concatenate(truth), np.concatenate(truth)
        norms = np.linalg.norm(off, axis=(0, 1)) / np.linalg.norm(size, axis=(0, 1))
        return {label: 100.0 * float(norm) for label, norm in zip(OPERATORS[name], norms, strict=True)}

    def save(self, path: str | Path) -> Path:
        """Write both operators to one file, atomically."""
        state: dict[str, Any] = {}
        meta: dict[str, Any] = {}
        for name in OPERATORS:
            operator: Operator = getattr(self, name)
            state[name] = {**operator.network.state_dict(), "curve": torch.as_tensor(operator.curve)}
            meta[name] = {
                "spec": operator.network.spec(),
                "delay_s": operator.delay_s,
                "limits_pct": list(operator.limits_pct),
                "sample_s": operator.sample_s,
            }
        return save_state(path, state, {"kind": "ActuatorOperators", **meta})

    @classmethod
    def load(cls, path: str | Path) -> ActuatorOperators:
        """Operators of a file of `save`, bit for bit."""
        state, meta = load_state(path)
        if meta.get("kind") != "ActuatorOperators":
            raise InputError(str(path), meta.get("kind"), "ActuatorOperators", "give the operators' file")
        made = {}
        for name in OPERATORS:
            network = network_from_spec(meta[name]["spec"])
            tensors = dict(state[name])
            curve = tensors.pop("curve").numpy()
            network.load_state_dict(tensors)
            options = {key: meta[name][key] for key in ("delay_s", "sample_s")}
            made[name] = Operator(network, limits_pct=tuple(meta[name]["limits_pct"]), curve=curve, **options)
        return cls(**made)


def train_operators(
    cases: Mapping[str, pd.DataFrame],
    config: OperatorsConfig,
    seed: int,
    parameters: EngineParameters,
    *,
    label_noise_rel: float = 0.0,
    progress: Progress | None = None,
) -> ActuatorOperators:
    """Train D1 on Case-I and Case-VI, D2 on Case-I and Case-VII.

    Args:
        cases: clean laboratory recordings by name, "case_i", "case_vi" and "case_vii"; commands and actuator states at
            `config.sample_s`.
        config: `pretrain.operators` of params.yaml.
        seed: of initial weights, mini-batches and label noise.
        parameters: gives the dead times (A.16, A.17, A.25) and the ranges of the commands.
        label_noise_rel: standard deviation of the noise added to the labels, of the mean absolute label [-].
        progress: called with the operator's name and the share done.
    """
    made = {}
    for stream, (name, case_names) in enumerate(TRAINING_CASES.items()):
        missing = [case for case in case_names if case not in cases]
        if missing:
            raise InputError(f"training of the {name} operator", f"no {missing[0]}", list(case_names), "simulate it")
        delay_s, limits = _actuator(name, parameters)
        signals = [_signals(cases[case], name, delay_s, limits) for case in case_names]
        generator = torch.Generator().manual_seed(seed * len(OPERATORS) + stream)
        tell = None if progress is None else (lambda share, name=name: progress(name, share))
        made[name] = _train(signals, getattr(config, name), config, limits, delay_s, label_noise_rel, generator, tell)
    return ActuatorOperators(**made)


def _actuator(name: str, parameters: EngineParameters) -> tuple[float, tuple[float, float]]:
    """Dead time [s] and range [%] of an actuator."""
    if name == "egr":
        return parameters.tau_degr, parameters.u_egr_range
    return parameters.tau_dvgt, parameters.u_vgt_range


def _signals(
    recording: pd.DataFrame, name: str, delay_s: float, limits: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Delayed command (n,) and states (n, outputs) [%] of a recording."""
    needed = ["time_s", COMMANDS[name], *OPERATORS[name]]
    missing = [column for column in needed if column not in recording]
    if missing:
        raise InputError(f"recording for the {name} operator", f"no column {missing[0]}", needed, "simulate the states")
    time = recording["time_s"].to_numpy()
    u = np.clip(recording[COMMANDS[name]].to_numpy(), *limits)
    return np.interp(time - delay_s, time, u), recording[list(OPERATORS[name])].to_numpy()


def _train(
    signals: Sequence[tuple[np.ndarray, np.ndarray]], config: OperatorConfig, common: OperatorsConfig,
    limits: tuple[float, float], delay_s: float, label_noise_rel: float, generator: torch.Generator,
    progress: Callable[[float], None] | None,
) -> Operator:  # fmt: skip
    n_times = round(common.window_s / common.sample_s) + 1
    outputs = signals[0][1].shape[1]
    memory = common.memory_s / common.sample_s
    half_window_s = common.window_s / 2.0  # scaled time runs over [-1, 1]
    network = CausalityDeepONet(
        n_times,
        outputs,
        sizes=DeepONetSizes(config.input_hidden, config.initial_hidden, config.trunk_hidden, config.basis),
        memory=memory / 2.0,
        trunk_slopes=(1.0, half_window_s / common.forget_s),
        generator=generator,
    )
    operator = Operator(network, delay_s, limits, common.sample_s, np.zeros((0, 2)))

    slide = max(1, round(common.slide_s / common.sample_s))
    data = _Rows.of(signals, operator, n_times, slide, label_noise_rel, generator)
    weights = torch.tensor(config.loss_weights)
    if weights.numel() != outputs:
        raise InputError("loss_weights", list(config.loss_weights), f"{outputs} values", "one weight for each output")

    optimiser = torch.optim.Adam(network.parameters(), lr=config.rate, betas=(0.9, 0.99))
    fade = torch.clamp(torch.arange(n_times) / memory, max=1.0)[:, None] ** 2
    curve, recent = [], 0.0
    every = max(1, config.updates // _CURVE_POINTS)
    for update in range(config.updates):
        share = update / config.updates
        rate = config.rate * min(1.0, (update + 1) / _WARM_UP_UPDATES) * 0.5 * (1.0 + math.cos(math.pi * share))
        optimiser.param_groups[0]["lr"] = rate
        history, initial, time, truth = data.draw(config.batch, common.start_share, generator)
        predicted = network.from_rows(history, initial, time)
        squares = ((predicted - truth) ** 2).mean(0)
        optimiser.zero_grad(set_to_none=True)
        (weights * squares).sum().backward()
        optimiser.step()
        with torch.no_grad():
            # weight decay that grows with the lag: an actuator forgets, so old samples must earn their weights
            for branch in network.input_branches:
                branch.weights[0].mul_(1.0 - rate * common.memory_decay * fade)
        recent += float(squares.mean().detach())
        if (update + 1) % every == 0:
            curve.append((update + 1, recent / every))
            recent = 0.0
            if progress is not None:
                progress((update + 1) / config.updates)
    if common.finish_rows:
        _finish(network, data, common, generator)
    return Operator(network, delay_s, limits, common.sample_s, np.asarray(curve))


@dataclass(frozen=True)
class _Rows:
    """Recordings one after the other, each behind the zeros that stand before a window; rows are drawn from them.

    Attributes:
        histories: (N, n_times) view, row i ends with sample i, oldest first.
        labels: (N, outputs) scaled states, row i those of sample i.
        windows: first samples of all windows.
        inside: (n_times, n_times), row a marks the lags that lie inside the window at its sample a.
        times: (n_times, 1) scaled times of a window.
    """

    histories: Tensor
    labels: Tensor
    windows: Tensor
    inside: Tensor
    times: Tensor

    @classmethod
    def of(
        cls, signals: Sequence[tuple[np.ndarray, np.ndarray]], operator: Operator, n_times: int, slide: int,
        label_noise_rel: float, generator: torch.Generator,
    ) -> _Rows:  # fmt: skip
        commands, labels, windows, offset = [], [], [], 0
        for u, y in signals:
            if len(u) < n_times:
                raise InputError("training recording", f"{len(u)} rows", f"at least {n_times}", "give a longer one")
            commands.append(torch.nn.functional.pad(operator.scaled_command(u), (n_times - 1, 0)))
            noise = torch.randn(y.shape, generator=generator, dtype=torch.float64).numpy()
            noisy = operator.scaled_state(y + label_noise_rel * np.abs(y).mean(0) * noise)
            labels.append(torch.nn.functional.pad(noisy, (0, 0, n_times - 1, 0)))
            windows.append(offset + torch.arange(0, len(u) - n_times + 1, slide))
            offset += len(u) + n_times - 1
        return cls(
            torch.cat(commands).unfold(0, n_times, 1),
            torch.cat(labels)[n_times - 1 :],
            torch.cat(windows),
            torch.tril(torch.ones(n_times, n_times)),
            operator.network.times(),
        )

    def draw(
        self, count: int, start_share: float, generator: torch.Generator
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Histories (count, n_times), initial values, times and labels of random samples of random windows."""
        window = self.windows[torch.randint(0, len(self.windows), (count,), generator=generator)]
        age = torch.randint(0, len(self.times), (count,), generator=generator)
        n_start = round(start_share * count)
        age[:n_start] = torch.randint(0, _START_SAMPLES, (n_start,), generator=generator)
        history = self.histories[window + age].flip(-1) * self.inside[age]
        return history, self.labels[window], self.times[age], self.labels[window + age]


def _finish(network: CausalityDeepONet, data: _Rows, common: OperatorsConfig, generator: torch.Generator) -> None:
    """Gauss-Newton on the last layer of each input branch: before the soft clip the outputs are linear in it.

    A ridge about the weights of the pass before; Adam alone stops several times above this optimum.
    """
    sharpness = network.clip_sharpness
    for k in [k for k in range(network.outputs) for _ in range(_FINISH_PASSES)]:
        start = network.last_layer(k).double()
        gram = torch.zeros((start.numel(), start.numel()), dtype=torch.float64)
        right = torch.zeros(start.numel(), dtype=torch.float64)
        for _ in range(math.ceil(common.finish_rows / _FINISH_CHUNK)):
            history, initial, time, truth = data.draw(_FINISH_CHUNK, common.start_share, generator)
            with torch.no_grad():
                design = network.last_layer_design(k, history, initial, time).double()
                z = design @ start.flatten() + network.offset[k].double()
                design *= soft_clip_slope(z, sharpness)[:, None]
                right += design.T @ (truth[:, k].double() - soft_clip(z, sharpness))
            gram += design.T @ design
        ridge = common.finish_ridge * gram.diagonal().mean()
        change = torch.linalg.solve(gram + ridge * torch.eye(len(gram), dtype=torch.float64), right)
        network.set_last_layer(k, (start + change.reshape(start.shape)).to(network.offset.dtype))


def _follow(operator: Operator, inputs: Inputs, u_pct: np.ndarray) -> np.ndarray:
    """States (n, outputs) [%] at the samples of a segment: windows one after the other, from the history's start."""
    u_pct = np.clip(u_pct, *operator.limits_pct)
    time, dt = inputs.segment_time_s, operator.sample_s
    outputs = operator.network.outputs

    def delayed(t: np.ndarray) -> np.ndarray:
        return np.interp(t - operator.delay_s, inputs.time_s, u_pct)

    # whole samples of the history, so that the grid meets the segment's start
    before = math.floor((time[0] - inputs.time_s[0]) / dt + 0.5 / operator.network.n_times)
    grid = time[0] + dt * np.arange(-before, 1)
    state = np.full((1, outputs), delayed(grid[:1])[0])
    initial = state[0] if before == 0 else _windows(operator, delayed(grid), state)[-1]
    grid = time[0] + dt * np.arange(math.ceil((time[-1] - time[0]) / dt - 0.5 / operator.network.n_times) + 1)
    states = _windows(operator, delayed(grid), np.asarray(initial, dtype=np.float64)[None, :])
    return np.stack([np.interp(time, grid, states[:, k]) for k in range(outputs)], axis=1)


def _windows(operator: Operator, u: np.ndarray, initial: np.ndarray) -> np.ndarray:
    """States (n, outputs) for delayed commands (n,) of any length; a window starts where the one before ends."""
    step = operator.network.n_times - 1
    parts = []
    for start in range(0, max(len(u) - 1, 1), step):
        states = operator.predict(u[None, start : start + step + 1], initial)[0]
        initial = states[-1:]
        parts.append(states if start == 0 else states[1:])
    return np.concatenate(parts)
