"""The four networks: values and rates against autograd, their gradient, starts."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from dieseltwin.paper.loops.pinn_networks import N_STATES, PAPER_NETWORKS, StateNetworks

TIME_S = np.linspace(60.0, 90.0, 31)
LANES = 3


def networks_and_values(slopes: tuple[float, float] | None = (2.0, 12.0)) -> tuple[StateNetworks, Tensor]:
    networks = StateNetworks(TIME_S, dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    values = torch.stack([networks.start(generator, slopes) for _ in range(LANES)])
    return networks, values + 0.1 * torch.randn(values.shape, generator=generator, dtype=torch.float64)


def by_autograd(networks: StateNetworks, values: Tensor) -> list[Tensor]:
    """Linear outputs and their rates with plain tanhs and reverse-mode differentiation by time."""
    time_s = torch.tensor(TIME_S).repeat(LANES, 1).requires_grad_()
    result = [torch.empty(0)] * N_STATES
    for spec, layers in zip(networks.specs, networks.layers, strict=True):
        h = (2.0 * (time_s - TIME_S[0]) / (TIME_S[-1] - TIME_S[0]) - 1.0).unsqueeze(1)
        for layer in layers[:-1]:
            h = torch.tanh(layer.weight(values) @ h + layer.bias(values))
        z = layers[-1].weight(values) @ h + layers[-1].bias(values)
        for row, state in enumerate(spec.states):
            parts = [z[:, row]]
            if spec.rates:
                parts.append(torch.autograd.grad(z[:, row].sum(), time_s, create_graph=True)[0])
            result[state] = torch.cat(parts, 1)
    return result


def test_sizes_are_those_of_the_papers_table() -> None:
    widths = {spec.name: spec.widths for spec in PAPER_NETWORKS}
    assert widths == {
        "pressures": (1, 15, 15, 15, 2), "x_r": (1, 15, 15, 15, 1), "T_1": (1, 15, 15, 15, 1), "omega_t": (1, 15, 15, 1)
    }  # fmt: skip
    assert sorted(state for spec in PAPER_NETWORKS for state in spec.states) == list(range(N_STATES))
    assert StateNetworks(TIME_S).size == 542 + 2 * 526 + 286


def test_values_and_rates_equal_autograd() -> None:
    networks, values = networks_and_values()
    found = networks.outputs(values)
    for ours, theirs in zip(found, by_autograd(networks, values), strict=True):
        torch.testing.assert_close(ours, theirs.detach(), rtol=1e-10, atol=1e-12)


def test_rates_are_those_of_neighbouring_times() -> None:
    networks, values = networks_and_values()
    n, step_s = len(TIME_S), 1e-4
    later = StateNetworks(TIME_S, dtype=torch.float64)
    later.input = networks.input + networks.input_rate * step_s
    z = networks.outputs(values)
    shifted = later.outputs(values)
    for state in range(3):
        difference = (shifted[state][:, :n] - z[state][:, :n]) / step_s
        torch.testing.assert_close(difference, z[state][:, n:], rtol=1e-3, atol=1e-3)


def test_gradient_equals_autograd_by_time() -> None:
    networks, values = networks_and_values()
    generator = torch.Generator().manual_seed(1)
    by_outputs = [torch.randn(row.shape, generator=generator, dtype=torch.float64) for row in networks.outputs(values)]
    leaf = values.clone().requires_grad_()
    scalar = sum((a * b).sum() for a, b in zip(by_autograd(networks, leaf), by_outputs, strict=True))
    (expected,) = torch.autograd.grad(scalar, leaf)
    found = torch.full_like(values, 7.0)
    networks.gradient(values, by_outputs, found)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)


def test_spread_start_covers_the_segment() -> None:
    networks = StateNetworks(TIME_S, dtype=torch.float64)
    values = networks.start(torch.Generator().manual_seed(3), (2.0, 12.0))[None]
    for rows in networks.layers:
        weight, bias = rows[0].weight(values)[0, :, 0], rows[0].bias(values)[0, :, 0]
        assert ((weight.abs() >= 2.0) & (weight.abs() <= 12.0)).all()
        centres = torch.sort(-bias / weight).values
        # one centre in each fifteenth of the scaled time [-1, 1]
        assert torch.equal(torch.floor((centres + 1.0) / 2.0 * 15.0), torch.arange(15.0, dtype=torch.float64))


def test_plain_start_has_the_papers_spread_and_no_biases() -> None:
    networks = StateNetworks(TIME_S, dtype=torch.float64)
    generator = torch.Generator().manual_seed(4)
    values = torch.stack([networks.start(generator, None) for _ in range(200)])
    for rows in networks.layers:
        for layer in rows:
            assert (layer.bias(values) == 0.0).all()
            expected = (2.0 / (layer.inputs + layer.outputs)) ** 0.5
            assert float(layer.weight(values).std()) == pytest.approx(expected, rel=0.05)
