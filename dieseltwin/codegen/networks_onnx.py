"""Learned maps, bodies and operators as ONNX (opset 17, https://onnx.ai): scaling and limits inside, units outside."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from dieseltwin.atomic import atomic_folder
from dieseltwin.engine.binding import equations
from dieseltwin.engine.parameters import constants
from dieseltwin.errors import InputError
from dieseltwin.surrogates.bodies import Bodies, Body
from dieseltwin.surrogates.empirical import EmpiricalMaps
from dieseltwin.surrogates.operators import ActuatorOperators, Operator

OPSET = 17
_TYPICAL = {"p_im": 1.5e5, "n_e": 1200.0, "u_egr": 30.0, "u_vgt": 50.0, "Pi_t": 0.6, "omega_t": 6000.0, "T_em": 700.0,
            "W_c": 0.2, "Pi_c": 1.6, "T_amb": 298.0}  # fmt: skip
"""Arguments of maps for the run that is recorded [SI, rpm, %]."""

ROWS = 3  # of that run; any number is taken afterwards


@dataclass(frozen=True)
class Network:
    """What becomes one file.

    Attributes:
        name: of the file.
        module: takes and gives physical units.
        arguments: name -> example; the first dimension is free.
        results: names of what it gives.
    """

    name: str
    module: nn.Module
    arguments: Mapping[str, Tensor]
    results: tuple[str, ...]


class _Map(nn.Module):
    """One learned map over the arguments of its equation."""

    def __init__(self, maps: EmpiricalMaps, name: str) -> None:
        super().__init__()
        self.evaluate = maps.replacements("torch")[name]
        self.constants = constants(maps.parameters)

    def forward(self, *arguments: Tensor) -> Tensor:
        value: Tensor = self.evaluate(*arguments, self.constants)
        return value


class _Basis(nn.Module):
    """Time basis of a body: (n,) shares of a segment -> (n, k)."""

    def __init__(self, body: Body) -> None:
        super().__init__()
        self.network = body.network.body
        self.register_buffer("shift", torch.as_tensor(body.shift))
        self.register_buffer("mix", torch.as_tensor(body.mix))

    def forward(self, time01: Tensor) -> Tensor:
        hidden: Tensor = self.network((2.0 * time01 - 1.0)[:, None].to(self.network.weights[0].dtype))
        return (hidden - self.shift) @ self.mix  # type: ignore[operator]  # both are tensors


class _States(nn.Module):
    """Actuator states of windows: delayed commands (B, n) [%], initial states (B, outputs) [%] -> (B, n, outputs)."""

    def __init__(self, operator: Operator) -> None:
        super().__init__()
        self.operator = operator
        self.network = operator.network
        n = operator.network.n_times
        at = torch.arange(n)
        self.register_buffer("rows", (n - 1) + at[:, None] - at[None, :])  # of the padded window, newest sample first

    def forward(self, u_pct: Tensor, initial_pct: Tensor) -> Tensor:
        low, high = self.operator.limits_pct
        u = nn.functional.pad((u_pct / high).float(), (self.network.n_times - 1, 0))
        initial = ((initial_pct - low) / (high - low)).float()[:, None, :]
        scaled: Tensor = self.network.from_rows(u[:, self.rows], initial, self.network.times())
        return low + (high - low) * scaled.double()


def of_maps(maps: EmpiricalMaps) -> Iterator[Network]:
    """The nominal network of every map, over its equation's arguments."""
    for name in maps.maps:
        arguments = [argument for argument in inspect.signature(equations()[name]).parameters if argument != "c"]
        examples = {argument: torch.full((ROWS,), _TYPICAL[argument], dtype=torch.float64) for argument in arguments}
        yield Network(f"map_{name}", _Map(maps, name), examples, (name,))


def of_bodies(bodies: Bodies) -> Iterator[Network]:
    """The time basis of every body; a state is its output transformation of bias + basis times head."""
    for name, body in bodies.items():
        yield Network(f"body_{name}", _Basis(body), {"time01": torch.linspace(0, 1, ROWS, dtype=torch.float64)},
                      ("basis",))  # fmt: skip


def of_operators(operators: ActuatorOperators) -> Iterator[Network]:
    """The operators of both actuators over whole windows."""
    for name in ("egr", "vgt"):
        operator: Operator = {"egr": operators.egr, "vgt": operators.vgt}[name]
        window = torch.full((ROWS, operator.network.n_times), 50.0, dtype=torch.float64)
        initial = torch.full((ROWS, operator.network.outputs), 50.0, dtype=torch.float64)
        yield Network(f"operator_{name}", _States(operator), {"u_delayed_pct": window, "initial_pct": initial},
                      ("states_pct",))  # fmt: skip


def networks_in(models: Path) -> list[Network]:
    """Every network of a folder that `make run` wrote.

    Raises:
        InputError: no such folder, or no networks in it.
    """
    if not models.is_dir():
        raise InputError(f"--models {models}", "no such folder", "the folder of pretrained networks", "check the path")
    found: list[Network] = []
    for path in sorted(models.glob("*.pt")):
        kind, _, variant = path.stem.partition("_")
        loaded = {"maps": lambda p: of_maps(EmpiricalMaps.load(p)), "bodies": lambda p: of_bodies(Bodies.load(p)),
                  "operators": lambda p: of_operators(ActuatorOperators.load(p))}.get(kind)  # fmt: skip
        if loaded is not None:
            found += [Network(f"{n.name}_{variant}" if variant else n.name, n.module, n.arguments, n.results)
                      for n in loaded(path)]  # fmt: skip
    if not found:
        raise InputError(f"--models {models}", "no networks", "the files that `make run` writes", "run it first")
    return found


def write_onnx(networks: Sequence[Network], folder: Path) -> list[Path]:
    """Write each network to `folder/NAME.onnx`.

    Raises:
        InputError: a folder that can't be written to.
    """
    with atomic_folder(folder) as temporary:
        for network in networks:
            _write(network, temporary / f"{network.name}.onnx")
    return [folder / f"{network.name}.onnx" for network in networks]


def _write(network: Network, path: Path) -> None:
    free: dict[str, Any] = {name: {0: "n"} for name in (*network.arguments, *network.results)}
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # the recorder warns of shapes that it takes as fixed: the ones that are
        torch.onnx.export(
            network.module.eval(), tuple(network.arguments.values()), str(path), input_names=list(network.arguments),
            output_names=list(network.results), dynamic_axes=free, opset_version=OPSET, dynamo=False,
        )  # fmt: skip
