"""Networks as ONNX: what the runtime computes is what the library computes, in its units, for any number of points."""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pytest

from dieseltwin.cli.app import main
from dieseltwin.engine.binding import equations

torch = pytest.importorskip("torch", reason="the extra `networks` brings PyTorch")
runtime = pytest.importorskip("onnxruntime", reason="the extra `export` brings onnxruntime")

from dieseltwin.networks import CausalityDeepONet, DeepONetSizes, MultiHead  # noqa: E402
from dieseltwin.networks.perceptron import MLP  # noqa: E402
from dieseltwin.surrogates.bodies import BODIES, Bodies, Body  # noqa: E402
from dieseltwin.surrogates.empirical import EmpiricalMaps, MapNetwork  # noqa: E402
from dieseltwin.surrogates.operators import ActuatorOperators, Operator  # noqa: E402

N = 7
POINTS = {"p_im": (1e5, 3e5), "n_e": (600, 1900), "u_egr": (0, 80), "u_vgt": (25, 95), "Pi_t": (0.4, 0.95),
          "omega_t": (2e3, 1e4), "T_em": (450, 900), "W_c": (0.05, 0.4), "Pi_c": (1.1, 3),
          "T_amb": (270, 310)}  # fmt: skip


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Untrained networks of every kind in the files of `make run`."""
    folder = tmp_path_factory.mktemp("models")
    rng = torch.Generator().manual_seed(3)
    double = torch.float64
    arguments = {name: [a for a in inspect.signature(equations()[name]).parameters if a != "c"] for name in equations()}
    maps = {}
    for name in ("eta_vol", "f_egr", "F_vgt_Pi_t", "eta_tm", "eta_c", "Phi_c"):
        size = _inputs_of(name, arguments[name])
        network = MLP((size, 8, 1), "tanh", members=2, generator=rng, dtype=double)
        free = np.full(size, np.inf)
        maps[name] = MapNetwork(network, -free, free, np.zeros(size), np.ones(size))
    EmpiricalMaps("improved", maps).save(folder / "maps_improved.pt")
    members = {name: Body(columns, MultiHead((1, 6, 5, 4), generator=rng, dtype=double), np.ones(5) * 0.1,
                          np.eye(5, 3), np.zeros((1, 2))) for name, columns in BODIES.items()}  # fmt: skip
    Bodies("conditioned", members).save(folder / "bodies_conditioned.pt")
    sizes = DeepONetSizes(input_hidden=(6,), initial_hidden=(5,), trunk_hidden=(5,), n_basis=4)
    networks = [CausalityDeepONet(12, count, sizes=sizes, generator=rng) for count in (2, 1)]
    egr, vgt = (Operator(network, 0.04, limits, 0.2, np.zeros((1, 2)))
                for network, limits in zip(networks, ((0.0, 100.0), (20.0, 100.0)), strict=True))  # fmt: skip
    ActuatorOperators(egr, vgt).save(folder / "operators.pt")
    return folder


def _inputs_of(name: str, arguments: list[str]) -> int:
    from dieseltwin.engine import constants, we2011
    from dieseltwin.surrogates.empirical_forms import bound_forms

    given = [np.full(2, POINTS[argument][0], dtype=float) for argument in arguments]
    return len(bound_forms("improved", "numpy")[name].inputs(*given, constants(we2011.PARAMETERS)))


def _run(path: Path, given: dict[str, np.ndarray]) -> np.ndarray:
    (found,) = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"]).run(None, given)
    return found


def test_every_network_is_what_the_library_computes(models: Path, tmp_path: Path):
    out = tmp_path / "onnx"
    assert main(["export", "--onnx", str(out), "--models", str(models)]) == 0
    rng = np.random.default_rng(1)
    maps = EmpiricalMaps.load(models / "maps_improved.pt")
    for name in maps.maps:
        of = [argument for argument in inspect.signature(equations()[name]).parameters if argument != "c"]
        given = {argument: rng.uniform(*POINTS[argument], N) for argument in of}
        got = _run(out / f"map_{name}_improved.onnx", given)
        assert got == pytest.approx(maps.evaluate(name, *given.values()), rel=1e-9)
    bodies = Bodies.load(models / "bodies_conditioned.pt")
    for name, body in bodies.items():
        time01 = np.linspace(0.0, 1.0, N)
        assert _run(out / f"body_{name}_conditioned.onnx", {"time01": time01}) == pytest.approx(body.basis(time01)[0])
    operators = ActuatorOperators.load(models / "operators.pt")
    for name, operator in (("egr", operators.egr), ("vgt", operators.vgt)):
        u = rng.uniform(*operator.limits_pct, (N, operator.network.n_times))
        initial = rng.uniform(*operator.limits_pct, (N, operator.network.outputs))
        got = _run(out / f"operator_{name}.onnx", {"u_delayed_pct": u, "initial_pct": initial})
        assert got == pytest.approx(operator.predict(u, initial), abs=1e-3)  # float32 inside, in per cent
    assert len(list(out.iterdir())) == 6 + 4 + 2
