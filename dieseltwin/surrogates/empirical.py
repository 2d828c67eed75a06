"""The six empirical maps as small networks that stand in for the formulae (paper, table of surrogates).

`EmpiricalMaps` holds one stack of networks for each map and gives functions of the engine's signatures, which
``engine.bind(backend, replace=maps.replacements(backend))`` puts in the formulae's place. Weights are float64.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from dieseltwin.engine import EngineParameters, we2011
from dieseltwin.engine.binding import MAPS
from dieseltwin.engine.parameters import constants
from dieseltwin.errors import InputError
from dieseltwin.networks import MLP, load_state, network_from_spec, save_state
from dieseltwin.settings.strict import unknown_name
from dieseltwin.surrogates.empirical_forms import Kind, backend_globals, bound_forms
from dieseltwin.surrogates.map_layers import Layer, closed_form, network, numpy_network

LABELS = {
    "eta_vol": "eta_vol", "f_egr": "f_egr", "F_vgt_Pi_t": "f_vgt_pi_t", "eta_tm": "eta_tm", "eta_c": "eta_c",
    "Phi_c": "phi_c",
}  # fmt: skip
"""Column of a simulated recording that holds each map's value."""

DROPOUT_MEMBERS = 30  # realisations of the paper's dropout behind its uncertainty: the paper's number of runs
ERROR_COLUMNS = (
    "kind", "map", "recording", "n", "l2_rel", "mean_rel", "bias_rel", "max_rel", "std_rel", "z_rms",
)  # fmt: skip
RELATIVE_FLOOR = 0.01  # of the mean label: below it a relative error says nothing (shut valves)
STD_SEEN = 1e-4  # of the mean label: standard deviations below it count as agreement at a limit

_NEEDED = (
    "p_im_pa", "p_em_pa", "omega_t_rad_s", "n_e_rpm", "u_egr1_pct", "u_egr2_pct", "u_vgt_act_pct", "t_em_k", "w_c_kg_s",
    "p_amb_pa", "t_amb_k",
)  # fmt: skip


def map_arguments(frame: pd.DataFrame, parameters: EngineParameters) -> dict[str, tuple[np.ndarray, ...]]:
    """Arguments of the six maps, in the order of the engine's signatures (c left out), each (n,) [SI, rpm, %].

    Args:
        frame: simulated recording with actuator states and ambient columns.
        parameters: the engine; ambient pressure and temperature are taken from the frame.

    Raises:
        InputError: a column is missing.
    """
    missing = [name for name in _NEEDED if name not in frame]
    if missing:
        raise InputError(
            "maps: laboratory data", f"no column {missing[0]}", ", ".join(_NEEDED), "simulate the case again"
        )
    column = {name: frame[name].to_numpy(dtype=np.float64) for name in _NEEDED}
    engine = backend_globals("numpy")
    c = constants(parameters)._replace(p_amb=column["p_amb_pa"], T_amb=column["t_amb_k"])
    Pi_t = engine["turbine_pressure_ratio"](column["p_em_pa"], c)
    Pi_c = engine["compressor_pressure_ratio"](column["p_im_pa"], c)
    u_egr = engine["egr_valve_position"](column["u_egr1_pct"], column["u_egr2_pct"], c)
    omega_t = column["omega_t_rad_s"]
    return {
        "eta_vol": (column["p_im_pa"], column["n_e_rpm"]),
        "f_egr": (u_egr,),
        "F_vgt_Pi_t": (column["u_vgt_act_pct"], Pi_t),
        "eta_tm": (omega_t, column["t_em_k"], Pi_t),
        "eta_c": (column["w_c_kg_s"], Pi_c),
        "Phi_c": (column["t_amb_k"], Pi_c, omega_t),
    }


@dataclass(frozen=True)
class MapNetwork:
    """Networks of one map.

    Attributes:
        network: stack of members; member 0 is fitted to the labels as they are, the others to redrawn noise.
        low, high: limits of the network inputs (n_inputs,); infinite where there is none.
        centre, scale: of the limited inputs (n_inputs,).
        spread: factor on the standard deviation over the members that makes it the map's uncertainty.
    """

    network: MLP
    low: np.ndarray
    high: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    spread: float = 1.0


@dataclass(frozen=True)
class EmpiricalMaps:
    """The six maps of one kind.

    Attributes:
        kind: "paper" or "improved".
        maps: by the names of `engine.MAPS`.
        parameters: engine whose laboratory data they were trained on (inputs such as the blade speed ratio use it).
        meta: how they were trained (seed, label noise, seconds are kept apart), plain JSON.
        error_rows: rows of `errors`.
    """

    kind: Kind
    maps: Mapping[str, MapNetwork]
    parameters: EngineParameters = we2011.PARAMETERS
    meta: Mapping[str, Any] = field(default_factory=dict)
    error_rows: tuple[Mapping[str, Any], ...] = ()

    @property
    def members(self) -> int:
        """Members beside the nominal one (improved); the paper's kind has dropout realisations instead: 0."""
        return (self.maps["eta_vol"].network.members or 1) - 1

    @property
    def dropout(self) -> float:
        """Share of hidden neurons switched off in a realisation [-]."""
        return self.maps["eta_vol"].network.dropout

    # --- weights -----------------------------------------------------------------------------------------------

    def layers(
        self, name: str, member: int | Sequence[int] | None = None, dtype: torch.dtype = torch.float64
    ) -> list[Layer]:
        """Weights of one map with the input scaling and the dropout mask folded in.

        Args:
            name: of `engine.MAPS`.
            member: None: nominal network, without dropout. A number: improved, that member (1 ...; modulo their
                number); paper, the seed of one dropout realisation that stays as it is. Several numbers: a leading
                dimension of realisations.

        Returns:
            Per layer weights (in, out) and biases (1, out), or (R, in, out) and (R, 1, out).
        """
        if name not in self.maps:
            raise unknown_name("map", name, list(MAPS))
        item = self.maps[name]
        numbers = [member] if member is None or isinstance(member, (int, np.integer)) else list(member)
        one = [self._one_member(item, name, number) for number in numbers]
        stacked = len(one) > 1 or not (member is None or isinstance(member, (int, np.integer)))
        result = []
        for parts in zip(*one, strict=True):
            weight = torch.stack([p[0] for p in parts]) if stacked else parts[0][0]
            bias = torch.stack([p[1] for p in parts]) if stacked else parts[0][1]
            result.append((weight.to(dtype).contiguous(), bias.to(dtype).contiguous()))
        return result

    def _one_member(self, item: MapNetwork, name: str, number: int | None) -> list[Layer]:
        stack = item.network
        at = 0 if number is None or self.members == 0 else 1 + (int(number) - 1) % self.members
        layers = [
            (w[at].detach().double(), b[at].detach().double()) for w, b in zip(stack.weights, stack.biases, strict=True)
        ]
        scale, centre = torch.as_tensor(item.scale), torch.as_tensor(item.centre)
        weight, bias = layers[0]
        layers[0] = (weight / scale[:, None], bias - (centre / scale) @ weight)
        if number is not None and stack.dropout > 0.0:
            # a neuron that is off, or on and scaled up, is the same as scaled weights behind it
            generator = torch.Generator().manual_seed(int(number) * len(MAPS) + MAPS.index(name))
            masks = stack.sample_masks((1,), generator=generator)
            layers[1:] = [(w * m[0].double()[:, None], b) for (w, b), m in zip(layers[1:], masks, strict=True)]
        return layers

    # --- evaluation --------------------------------------------------------------------------------------------

    def replacements(
        self,
        backend: str = "torch",
        member: int | Sequence[int] | None = None,
        *,
        dtype: torch.dtype = torch.float64,
        slopes: bool = False,
    ) -> dict[str, Callable[..., Any]]:
        """Functions of the engine's six signatures for ``bind(backend, replace=...)``; compiled: `map_compiled`.

        Args:
            backend: "torch" or "numpy".
            member: see `layers`. With several, the arguments are (..., R, n) or broadcast to that.
            dtype: torch only: of weights and results.
            slopes: torch only: compute first derivatives with the values (`map_layers.ClosedForm`), which is quicker
                where they are wanted; without it any order is right.
        """
        if backend not in ("torch", "numpy"):
            raise unknown_name("backend", backend, ["torch", "numpy"])
        make = self._torch_map if backend == "torch" else self._numpy_map
        return {name: make(name, member, dtype, slopes) for name in MAPS}

    def _numpy_map(self, name: str, member: Any, *_: Any) -> Callable[..., np.ndarray]:
        form, item = bound_forms(self.kind, "numpy")[name], self.maps[name]
        layers = [(w.numpy(), b.numpy()) for w, b in self.layers(name, member)]
        low, high, activation = item.low, item.high, item.network.activation

        def evaluate(*arguments: Any) -> np.ndarray:
            inputs = np.broadcast_arrays(*form.inputs(*arguments))
            x = np.clip(np.stack(inputs, axis=-1), low, high)
            # a lone point is a row of one, so that (in, out) weights and rows meet
            z = numpy_network(x if x.ndim > 1 else x[None], layers, activation)
            z = z if x.ndim > 1 else z[0]
            return form.output(z, tuple(np.moveaxis(x, -1, 0)))

        evaluate.__name__ = name
        return evaluate

    def _torch_map(self, name: str, member: Any, dtype: torch.dtype, slopes: bool) -> Callable[..., Tensor]:
        form, item = bound_forms(self.kind, "torch")[name], self.maps[name]
        layers = self.layers(name, member, dtype)
        activation = item.network.activation
        limits = [
            (float(a) if np.isfinite(a) else None, float(b) if np.isfinite(b) else None)
            for a, b in zip(item.low, item.high, strict=True)
        ]
        run = closed_form if slopes else network

        def evaluate(*arguments: Any) -> Tensor:
            columns = [torch.as_tensor(v, dtype=dtype) for v in form.inputs(*arguments)]
            inputs = [
                v if a is None and b is None else torch.clamp(v, a, b)
                for v, (a, b) in zip(torch.broadcast_tensors(*columns), limits, strict=True)
            ]
            x = torch.stack(inputs, dim=-1)
            lone = x.ndim == 1
            z = run(x[None] if lone else x, layers, activation)
            return form.output(z[0] if lone else z, tuple(inputs))

        evaluate.__name__ = name
        return evaluate

    def evaluate(self, name: str, *arguments: Any, member: int | Sequence[int] | None = None) -> np.ndarray:
        """One map at numpy arguments of the engine's signature (c left out: the maps' own engine)."""
        return self._numpy_map(name, member)(*arguments, constants(self.parameters))

    def uncertainty(self, name: str, *arguments: Any) -> np.ndarray:
        """Standard deviation of one map's own error at numpy arguments (c left out), of their shape.

        improved: spread of the members, calibrated on held-out driving; paper: spread of its dropout realisations.
        """
        numbers = range(1, (self.members or DROPOUT_MEMBERS) + 1)
        c = constants(self.parameters)
        values = np.stack([self._numpy_map(name, number)(*arguments, c) for number in numbers])
        return self.maps[name].spread * np.std(values, axis=0, ddof=1)

    # --- errors ------------------------------------------------------------------------------------------------

    def errors(self) -> pd.DataFrame:
        """Errors of the nominal maps as found after training: one row per map and recording, see `error_table`."""
        return pd.DataFrame(list(self.error_rows), columns=list(ERROR_COLUMNS))

    def error_table(self, cases: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
        """Errors of the nominal maps on clean recordings.

        Columns: kind, map, recording, n, `l2_rel` (relative L2 error), `mean_rel` (mean of |error| / |label|, labels
        below a hundredth of their mean counted as that), `bias_rel` (mean error / mean label), `max_rel` (largest error
        / mean label), `std_rel` (rms of the map's own standard deviation / mean label) and `z_rms` (rms of error / own
        standard deviation: 1 is calibrated).
        """
        rows = []
        for recording, frame in cases.items():
            arguments = map_arguments(frame, self.parameters)
            for name in MAPS:
                rows.append(
                    {"kind": self.kind, "map": name, "recording": recording}
                    | self._errors_of(name, arguments[name], frame[LABELS[name]].to_numpy())
                )
        return pd.DataFrame(rows)

    def _errors_of(self, name: str, arguments: tuple[np.ndarray, ...], label: np.ndarray) -> dict[str, Any]:
        error = self.evaluate(name, *arguments) - label
        size = float(np.mean(np.abs(label)))
        std = self.uncertainty(name, *arguments)
        known = std > STD_SEEN * size  # at a cap or floor all members agree, and rightly so
        return {
            "n": label.size,
            "l2_rel": float(np.linalg.norm(error) / np.linalg.norm(label)),
            "mean_rel": float(np.mean(np.abs(error) / np.maximum(np.abs(label), RELATIVE_FLOOR * size))),
            "bias_rel": float(np.mean(error) / np.mean(label)),
            "max_rel": float(np.max(np.abs(error)) / size),
            "std_rel": float(np.sqrt(np.mean(std**2)) / size),
            "z_rms": float(np.sqrt(np.mean((error[known] / std[known]) ** 2))) if known.any() else 0.0,
        }

    # --- files -------------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> Path:
        """Write all maps to one file, atomically."""
        state: dict[str, Tensor] = {}
        specs: dict[str, Any] = {}
        for name, item in self.maps.items():
            state |= {f"{name}.network.{key}": value for key, value in item.network.state_dict().items()}
            state |= {f"{name}.{key}": torch.tensor(getattr(item, key)) for key in ("low", "high", "centre", "scale")}
            specs[name] = {"network": item.network.spec(), "spread": item.spread}
        meta = {
            "kind": self.kind, "maps": specs, "parameters": self.parameters.model_dump(mode="json"),
            "meta": dict(self.meta), "errors": [dict(row) for row in self.error_rows],
        }  # fmt: skip
        return save_state(path, state, meta)

    @classmethod
    def load(cls, path: str | Path) -> EmpiricalMaps:
        """Maps of a file of `save`, bit for bit."""
        state, meta = load_state(path)
        if "maps" not in meta:
            raise InputError(str(path), "another kind of network", "a file of empirical maps", "train the maps")
        maps: dict[str, MapNetwork] = {}
        for name in MAPS:
            spec = meta["maps"][name]
            stack = network_from_spec(spec["network"])
            if not isinstance(stack, MLP):
                raise InputError(str(path), f"a {type(stack).__name__} as {name}", "an MLP", "train the maps again")
            prefix = f"{name}.network."
            stack.load_state_dict({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
            ends = {key: state[f"{name}.{key}"].numpy() for key in ("low", "high", "centre", "scale")}
            maps[name] = MapNetwork(stack, **ends, spread=spec["spread"])
        return cls(meta["kind"], maps, EngineParameters(**meta["parameters"]), meta["meta"], tuple(meta["errors"]))
