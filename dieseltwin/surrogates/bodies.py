"""Multi-head bodies: time bases for p_im and p_em, x_r, T_1 and omega_t over one minute (few-shot method, Phase I).

Paper: section "Training of multi-head neural networks", tables "Neural network for PINN" (sizes, output transformation
and scaling) and "Training of multi-head networks" (errors). A body is the frozen part of a network of 240 heads, 120
minutes of Case-I and 120 of Case-IV; in Phase II a new head of k weights and a bias makes a new minute.

Two kinds:

- "paper": as printed, Adam on the mean square error of the scaled outputs. The number of epochs is not printed. With
  `finish_heads` the heads of the trained body are solved in closed form at the end.
- "conditioned": the heads are eliminated (variable projection): the body minimises what is left of the training windows
  after their best heads, in inverse-transformed space. Its first layer starts with steep neurons spread over the
  minute, because the bases of the paper's start are numerically dependent (condition 1e16). Windows slide: bases for
  minutes in general, where the 240 minutes alone would be learnt by heart. Its basis is orthonormal on the samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import torch
from numpy.typing import ArrayLike

from dieseltwin.arrays import Array
from dieseltwin.errors import InputError
from dieseltwin.networks import MultiHead, load_state, network_from_spec, save_state
from dieseltwin.settings.params import BodiesConfig
from dieseltwin.surrogates.body_training import (
    WINDOW_ROWS,
    WINDOW_S,
    scaled_times,
    train_as_printed,
    train_by_projection,
)
from dieseltwin.surrogates.output_transforms import TRANSFORMS

Kind = Literal["paper", "conditioned"]
Space = Literal["state", "linear"]
Progress = Callable[[str, float], None]

TRAINING_CASES = ("case_i", "case_iv")
RANK_TOLERANCE = 1e-10
"""Directions of a basis with a smaller share of the largest singular value carry rounding errors only."""

BODIES: Mapping[str, tuple[str, ...]] = {
    "pressures": ("p_im_pa", "p_em_pa"),
    "x_r": ("x_r",),
    "T_1": ("t_1_k",),
    "omega_t": ("omega_t_rad_s",),
}
"""State columns of the networks N_1 to N_4, in the order of their heads."""


@dataclass(frozen=True)
class Body:
    """A trained network with its 240 heads a state, float64.

    Attributes:
        columns: its states, in the order of the heads.
        network: the multi-head network on time scaled to [-1, 1].
        shift, mix: (k,), (k, k); the basis is (h - shift) mix, with h the network's last hidden layer.
        curve: (points, 2) epochs and training loss.
    """

    columns: tuple[str, ...]
    network: MultiHead
    shift: Array
    mix: Array
    curve: Array

    @property
    def width(self) -> int:
        """Number k of basis functions."""
        return int(self.mix.shape[1])

    def basis(self, time01: ArrayLike, duration_s: float = WINDOW_S) -> tuple[Array, Array]:
        """Basis h (n, k) [-] and its rate dh/dt (n, k) [1/s] (exact).

        Args:
            time01: (n,) times over the segment, 0 at its start and 1 at its end.
            duration_s: length of the segment [s].
        """
        x = torch.as_tensor(2.0 * np.asarray(time01, dtype=np.float64) - 1.0)[:, None]
        with torch.no_grad():
            h, dh = self.network.basis(x)
        return (h.numpy() - self.shift) @ self.mix, dh.numpy() @ self.mix * (2.0 / duration_s)

    def training_minutes(self) -> dict[str, Array]:
        """What the stored heads say of the training minutes, (301, 240) [SI] a state: Case-I, then Case-IV."""
        with torch.no_grad():
            z = self.network(scaled_times()).numpy()
        parts = np.split(z, len(self.columns), axis=1)
        return {column: TRANSFORMS[column].state(part) for column, part in zip(self.columns, parts, strict=True)}


@dataclass(frozen=True)
class Bodies(Mapping[str, Body]):
    """The four bodies by name: "pressures", "x_r", "T_1", "omega_t"."""

    kind: Kind
    members: Mapping[str, Body]

    def __getitem__(self, name: str) -> Body:
        return self.members[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.members)

    def __len__(self) -> int:
        return len(self.members)

    def training_errors(self, cases: Mapping[str, pd.DataFrame]) -> dict[str, float]:
        """Relative L2 error [%] of the 240 stored heads of each state."""
        result = {}
        for body in self.values():
            for column, predicted in body.training_minutes().items():
                truth = _training_minutes(cases, column, predicted.shape[1])
                result[column] = _relative_pct(predicted, truth)
        return result

    def errors(self, recordings: Sequence[pd.DataFrame], space: Space = "state") -> dict[str, float]:
        """Relative L2 error [%] of the best heads for the minutes of clean recordings at 0.2 s.

        Args:
            recordings: with the states' columns [SI].
            space: compare states, or linear outputs (inverse-transformed states).
        """
        result = {}
        for body in self.values():
            h, _ = body.basis(np.linspace(0.0, 1.0, WINDOW_ROWS))
            for column in body.columns:
                result[column] = _projection_error(_design(h), recordings, column, space)
        return result

    def save(self, path: str | Path) -> Path:
        """Write the bodies to one file, atomically."""
        state, meta = {}, {}
        for name, body in self.items():
            arrays = {key: torch.as_tensor(getattr(body, key)) for key in ("shift", "mix", "curve")}
            state[name] = {"network": body.network.state_dict(), **arrays}
            meta[name] = {"spec": body.network.spec(), "columns": list(body.columns)}
        return save_state(path, state, {"kind": "Bodies", "training": self.kind, "members": meta})

    @classmethod
    def load(cls, path: str | Path) -> Bodies:
        """Bodies of a file of `save`, bit for bit."""
        state, meta = load_state(path)
        if meta.get("kind") != "Bodies":
            raise InputError(str(path), meta.get("kind"), "Bodies", "give the bodies' file")
        members = {}
        for name, about in meta["members"].items():
            network = network_from_spec(about["spec"])
            network.load_state_dict(state[name]["network"])
            arrays = {key: state[name][key].numpy() for key in ("shift", "mix", "curve")}
            members[name] = Body(tuple(about["columns"]), network, **arrays)
        return cls(meta["training"], {name: members[name] for name in BODIES})


def minutes(recording: pd.DataFrame, column: str) -> Array:
    """Whole minutes of a recording at 0.2 s, (301, m); neighbours share their end rows."""
    if column not in recording:
        raise InputError("recording for the bodies", f"no column {column}", list(TRANSFORMS), "simulate the states")
    values = recording[column].to_numpy(dtype=np.float64)
    count = (len(values) - 1) // (WINDOW_ROWS - 1)
    if count < 1:
        raise InputError("recording for the bodies", f"{len(values)} rows", f"at least {WINDOW_ROWS}", "give a minute")
    return values[np.arange(WINDOW_ROWS)[:, None] + (WINDOW_ROWS - 1) * np.arange(count)]


def pod_floor(
    training: Sequence[pd.DataFrame],
    held_out: Sequence[pd.DataFrame],
    widths: Mapping[str, int],
    space: Space = "state",
) -> dict[str, float]:
    """Relative L2 error [%] of projecting held-out minutes on a constant and the training minutes' singular vectors.

    The floor of a proper orthogonal decomposition: in inverse-transformed space, the first k vectors (k =
    `widths[body]`), p_im and p_em jointly.
    """
    result = {}
    for name, columns in BODIES.items():
        parts = [TRANSFORMS[c].linear(minutes(frame, c)) for c in columns for frame in training]
        z = np.concatenate(parts, axis=1)
        vectors = np.linalg.svd(z - z.mean(axis=0), full_matrices=False)[0][:, : widths[name]]
        for column in columns:
            result[column] = _projection_error(_design(vectors), held_out, column, space)
    return result


def train_bodies(
    cases: Mapping[str, pd.DataFrame],
    config: BodiesConfig,
    seed: int,
    kind: Kind = "conditioned",
    *,
    progress: Progress | None = None,
) -> Bodies:
    """Train the four bodies on Case-I and Case-IV.

    Args:
        cases: clean laboratory recordings "case_i" and "case_iv" at 0.2 s with the states' columns [SI].
        config: `pretrain.bodies` of params.yaml.
        seed: of the initial weights.
        kind: "paper" or "conditioned", see the module.
        progress: called with the body's name and the share done.
    """
    members = {}
    for stream, (name, columns) in enumerate(BODIES.items()):
        generator = torch.Generator().manual_seed(seed * len(BODIES) + stream)
        states = {column: _training_minutes(cases, column, config.heads) for column in columns}
        widths = (1, *config.sizes[name].hidden, config.heads * len(columns))
        tell = None if progress is None else (lambda share, name=name: progress(name, share))
        if kind == "paper":
            body = Body(columns, *train_as_printed(widths, states, config.paper, generator, tell))
            members[name] = _with_best_heads(body, states) if config.paper.finish_heads else body
        elif kind == "conditioned":
            windows = {column: [cases[case][column].to_numpy() for case in TRAINING_CASES] for column in columns}
            body = Body(columns, *train_by_projection(widths, windows, config.conditioned, generator, tell))
            members[name] = _with_best_heads(body, states)
        else:
            raise InputError("kind of bodies", repr(kind), ["paper", "conditioned"], "take one of these")
    return Bodies(kind, members)


def _with_best_heads(body: Body, states: Mapping[str, Array]) -> Body:
    """The body with the closed-form heads of its training minutes in the network."""
    h, _ = body.basis(np.linspace(0.0, 1.0, WINDOW_ROWS))
    heads = np.concatenate([_heads(h, TRANSFORMS[c].linear(y)) for c, y in states.items()], axis=1)
    weight = body.mix @ heads[1:]
    with torch.no_grad():
        body.network.head.weights[0].copy_(torch.as_tensor(weight))
        body.network.head.biases[0].copy_(torch.as_tensor(heads[:1] - body.shift @ weight))
    return body


def _training_minutes(cases: Mapping[str, pd.DataFrame], column: str, heads: int) -> Array:
    """(301, heads) [SI]: the first half of Case-I, the second of Case-IV."""
    missing = [case for case in TRAINING_CASES if case not in cases]
    if missing:
        raise InputError("training of the bodies", f"no {missing[0]}", TRAINING_CASES, "simulate it first")
    parts = [minutes(cases[case], column) for case in TRAINING_CASES]
    each = heads // len(parts)
    if any(part.shape[1] < each for part in parts):
        raise InputError("training of the bodies", [p.shape[1] for p in parts], f"{each} minutes a case", "fewer heads")
    return np.concatenate([part[:, :each] for part in parts], axis=1)


def _design(h: Array) -> Array:
    return np.concatenate([np.ones((len(h), 1)), h], axis=1)


def _heads(h: Array, z: Array) -> Array:
    return np.asarray(np.linalg.lstsq(_design(h), z, rcond=RANK_TOLERANCE)[0], dtype=np.float64)


def _projection_error(design: Array, recordings: Sequence[pd.DataFrame], column: str, space: Space) -> float:
    truth = np.concatenate([minutes(frame, column) for frame in recordings], axis=1)
    transform = TRANSFORMS[column]
    z = transform.linear(truth)
    projected = design @ np.linalg.lstsq(design, z, rcond=RANK_TOLERANCE)[0]
    return _relative_pct(transform.state(projected), truth) if space == "state" else _relative_pct(projected, z)


def _relative_pct(predicted: Array, truth: Array) -> float:
    return 100.0 * float(np.linalg.norm(predicted - truth) / np.linalg.norm(truth))
