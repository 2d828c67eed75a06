"""Networks: initial weights, dropout that stays on, stacks, multi-head bases, causality, files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from dieseltwin.errors import InputError
from dieseltwin.networks import (
    MLP,
    CausalityDeepONet,
    DeepONetSizes,
    MultiHead,
    load_state,
    network_from_spec,
    save_state,
    soft_clip,
    soft_clip_slope,
)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


# --- perceptron --------------------------------------------------------------------------------------------------


def test_initial_weights_are_as_the_paper_prints_them() -> None:
    network = MultiHead((1, 300, 300, 200), generator=generator())
    hidden, head = network.body.weights[1], network.head.weights[0]
    assert float(hidden.detach().std()) == pytest.approx(math.sqrt(2 / 600), rel=0.02)
    assert float(head.detach().std()) == pytest.approx(math.sqrt(10 / 500), rel=0.02)
    assert all(float(bias.detach().abs().max()) == 0 for bias in network.body.biases)


def test_a_perceptron_is_its_formula() -> None:
    network = MLP((2, 5, 3, 1), generator=generator(), dtype=torch.float64)
    x = np.array([[0.3, -1.0], [2.0, 0.1]])
    w, b = ([p.detach().numpy() for p in group] for group in (network.weights, network.biases))
    expected = np.tanh(np.tanh(x @ w[0] + b[0]) @ w[1] + b[1]) @ w[2] + b[2]
    with torch.no_grad():
        np.testing.assert_allclose(network(torch.as_tensor(x)).numpy(), expected, rtol=1e-13)


def test_dropout_stays_on_after_training() -> None:
    network = MLP((1, 200, 200, 1), dropout=0.3, generator=generator()).eval()
    x = torch.ones(4, 1)
    rows = network(x, generator=generator(1))
    assert len(torch.unique(rows)) == 4  # a fresh mask for each row


def test_a_realised_mask_is_repeatable_and_keeps_the_mean() -> None:
    network = MLP((1, 200, 200, 1), dropout=0.3, generator=generator())
    masks = network.sample_masks(generator=generator(1))
    same = network.sample_masks(generator=generator(1))
    other = network.sample_masks(generator=generator(2))
    assert all(torch.equal(a, b) for a, b in zip(masks, same, strict=True))
    assert not any(torch.equal(a, b) for a, b in zip(masks, other, strict=True))
    assert [m.shape for m in masks] == [(200,), (200,)]
    kept = torch.cat(masks)
    assert float((kept == 0).double().mean()) == pytest.approx(0.3, abs=0.07)
    assert float(kept.max()) == pytest.approx(1 / 0.7)  # what stays is scaled up, so that the mean stays


def test_masks_broadcast_over_the_rows_of_many_runs_or_members() -> None:
    single = MLP((1, 20, 1), dropout=0.5, generator=generator())
    assert [m.shape for m in single.sample_masks((6, 1), generator=generator(1))] == [(6, 1, 20)]
    stack = MLP((1, 20, 1), dropout=0.5, members=3, generator=generator())
    assert [m.shape for m in stack.sample_masks(generator=generator(1))] == [(3, 1, 20)]


def test_stacked_members_are_the_single_networks() -> None:
    stack = MLP((2, 8, 8, 1), members=3, generator=generator(), dtype=torch.float64)
    singles = [MLP((2, 8, 8, 1), dtype=torch.float64) for _ in range(3)]
    for k, single in enumerate(singles):
        single.load_state_dict({name: value[k] for name, value in stack.state_dict().items()})
    shared = torch.rand(7, 2, generator=generator(9), dtype=torch.float64)
    result = stack(shared)
    assert result.shape == (3, 7, 1)
    for k, single in enumerate(singles):
        torch.testing.assert_close(result[k], single(shared), rtol=1e-13, atol=1e-14)
    own = torch.rand(3, 7, 2, generator=generator(8), dtype=torch.float64)
    torch.testing.assert_close(stack(own)[2], singles[2](own[2]), rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: MLP((3,)), "widths"),
        (lambda: MLP((3, 0, 1)), "widths"),
        (lambda: MLP((1, 1), activation="tan"), "activation"),
        (lambda: MLP((1, 1), dropout=1.0), "dropout"),
        (lambda: MultiHead((1, 5)), "MultiHead"),
        (lambda: MultiHead((2, 5, 3)).basis(torch.zeros(1, 2)), "basis"),
        (lambda: MultiHead((2, 5, 3), first_scale=(1.0, 2.0)), "first_scale"),
        (lambda: CausalityDeepONet(1, 1), "n_times"),
        (lambda: CausalityDeepONet(5, 1)(torch.zeros(1, 6), torch.zeros(1, 1)), "window"),
        (lambda: network_from_spec({"kind": "CNN"}), "kind of network"),
    ],
)
def test_refusals_say_what_is_wrong(make, word: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=word):
        make()


# --- multi-head --------------------------------------------------------------------------------------------------


def test_basis_and_its_derivative() -> None:
    network = MultiHead((1, 30, 20, 7), first_scale=(5.0, 20.0), generator=generator(), dtype=torch.float64)
    x = torch.linspace(-1, 1, 41, dtype=torch.float64)[:, None]
    h, dh = network.basis(x)
    assert h.shape == dh.shape == (41, 20)
    torch.testing.assert_close(network.head(h), network(x))
    step = 1e-5
    difference = (network.body(x + step) - network.body(x - step)) / (2 * step)
    torch.testing.assert_close(dh, difference, rtol=1e-6, atol=1e-7)


def test_a_spread_first_layer_makes_a_well_conditioned_basis() -> None:
    x = torch.linspace(-1, 1, 301, dtype=torch.float64)[:, None]
    sizes = (1, 120, 120, 70, 2)
    with torch.no_grad():
        printed = MultiHead(sizes, generator=generator(), dtype=torch.float64).body(x)
        spread = MultiHead(sizes, first_scale=(25.0, 60.0), generator=generator(), dtype=torch.float64).body(x)
    assert torch.linalg.cond(printed) > 1e12
    assert torch.linalg.cond(spread) < 1e6


# --- causality DeepONet --------------------------------------------------------------------------------------------


def deeponet(n: int = 12, **options) -> CausalityDeepONet:  # type: ignore[no-untyped-def]
    return CausalityDeepONet(
        n, 2, sizes=DeepONetSizes(input_hidden=(9,), n_basis=6), generator=generator(), **options
    )


def test_the_future_does_not_change_the_past() -> None:
    network = deeponet()
    u = torch.rand(3, 12, generator=generator(1))
    initial = torch.rand(3, 2, generator=generator(2))
    before = network(u, initial)
    for changed in range(12):
        other = u.clone()
        other[:, changed:] = torch.rand(3, 12 - changed, generator=generator(3))
        after = network(other, initial)
        assert torch.equal(after[:, :changed], before[:, :changed])
        assert not torch.equal(after[:, changed], before[:, changed])


def test_rows_are_the_papers_table() -> None:
    rows = deeponet(4).rows(torch.tensor([[1.0, 2.0, 3.0, 4.0]]))
    expected = torch.tensor([[1.0, 0, 0, 0], [2, 1, 0, 0], [3, 2, 1, 0], [4, 3, 2, 1]])
    assert torch.equal(rows[0], expected)


def test_a_shorter_window_is_the_start_of_a_longer_one() -> None:
    network = deeponet()
    u, initial = torch.rand(1, 12, generator=generator(1)), torch.rand(1, 2, generator=generator(2))
    torch.testing.assert_close(network(u[:, :5], initial), network(u, initial)[:, :5])


def test_each_output_sees_its_own_initial_value_only() -> None:
    network = deeponet()
    u = torch.rand(1, 12, generator=generator(1))
    a, b = network(u, torch.tensor([[0.2, 0.5]])), network(u, torch.tensor([[0.2, 0.9]]))
    assert torch.equal(a[..., 0], b[..., 0])
    assert not torch.equal(a[..., 1], b[..., 1])


def test_outputs_keep_their_limits() -> None:
    network = deeponet(memory=3.0, trunk_slopes=(1.0, 100.0))
    wild = network(100.0 * torch.randn(8, 12, generator=generator(1)), torch.rand(8, 2))
    assert float(wild.detach().min()) >= 0.0 and float(wild.detach().max()) <= 1.0


def test_soft_clip_is_the_identity_between_its_limits() -> None:
    z = torch.linspace(0.1, 0.9, 9, dtype=torch.float64)
    torch.testing.assert_close(soft_clip(z, 100.0), z, rtol=0, atol=1e-6)
    limits = soft_clip(torch.tensor([-5.0, 0.0, 1.0, 5.0], dtype=torch.float64), 100.0)
    expected = torch.tensor([0.0, math.log(2) / 100, 1 - math.log(2) / 100, 1.0], dtype=torch.float64)
    torch.testing.assert_close(limits, expected, rtol=0, atol=1e-12)
    edge = torch.linspace(-0.1, 1.1, 49, dtype=torch.float64, requires_grad=True)
    soft_clip(edge, 100.0).sum().backward()
    torch.testing.assert_close(edge.grad, soft_clip_slope(edge.detach(), 100.0), rtol=1e-9, atol=1e-12)


def test_a_deeponet_is_linear_in_its_last_layers_before_the_clip() -> None:
    network = deeponet(clip_sharpness=300.0)
    rows, initial = torch.rand(20, 12, generator=generator(1)), torch.rand(20, 2, generator=generator(2))
    time = network.times()[torch.arange(20) % 12]
    with torch.no_grad():
        for k in range(2):
            linear = network.last_layer_design(k, rows, initial, time) @ network.last_layer(k).flatten()
            expected = network.from_rows(rows, initial, time)[:, k]
            torch.testing.assert_close(soft_clip(linear + network.offset[k], 300.0), expected)
        network.set_last_layer(1, torch.zeros_like(network.last_layer(1)))
        assert torch.unique(network.from_rows(rows, initial, time)[:, 1]).shape == (1,)


def test_memory_shortens_the_first_weights() -> None:
    weights = deeponet(200, memory=5.0).input_branches[0].weights[0].detach()
    assert float(weights[100:].abs().max()) < 1e-6 * float(weights[:5].abs().max())


# --- files -------------------------------------------------------------------------------------------------------

NETWORKS = {
    "mlp": lambda seed: MLP((2, 5, 1), "silu", 0.1, members=3, generator=generator(seed), dtype=torch.float64),
    "multi-head": lambda seed: MultiHead((1, 9, 4, 6), first_scale=(2.0, 3.0), generator=generator(seed)),
    "deeponet": lambda seed: CausalityDeepONet(7, 2, memory=2.0, trunk_slopes=(1.0, 9.0), generator=generator(seed)),
}


def saved(path: Path, network: torch.nn.Module) -> Path:
    return save_state(path, network.state_dict(), {"spec": network.spec(), "note": 1})


def loaded(path: Path) -> torch.nn.Module:
    state, meta = load_state(path)
    assert meta["note"] == 1
    network = network_from_spec(meta["spec"])
    network.load_state_dict(state)
    return network


@pytest.mark.parametrize("name", list(NETWORKS))
def test_a_network_comes_back_bit_for_bit(name: str, tmp_path: Path) -> None:
    network = NETWORKS[name](1)
    path = saved(tmp_path / "a.pt", network)
    again = loaded(path)
    assert again.spec() == network.spec()
    state = again.state_dict()
    assert all(torch.equal(state[key], value) for key, value in network.state_dict().items())
    same = saved(tmp_path / "other name.pt", NETWORKS[name](1)).read_bytes()
    assert same == path.read_bytes()
    assert saved(tmp_path / "b.pt", NETWORKS[name](2)).read_bytes() != same


@pytest.mark.parametrize("content", [None, b"", b"time_s,u\n0,1\n", "truncated"])
def test_a_bad_file_is_one_line(content: bytes | str | None, tmp_path: Path) -> None:
    path = tmp_path / "bad.pt"
    if content == "truncated":
        whole = saved(tmp_path / "a.pt", NETWORKS["mlp"](1)).read_bytes()
        path.write_bytes(whole[: len(whole) // 2])
    elif content is not None:
        path.write_bytes(content)  # type: ignore[arg-type]
    with pytest.raises(InputError) as error:
        load_state(path)
    assert "bad.pt" in str(error.value) and "\n" not in str(error.value)


def test_a_file_without_a_checksum_is_still_read(tmp_path: Path) -> None:
    network = NETWORKS["mlp"](1)
    path = saved(tmp_path / "a.pt", network)
    content = torch.load(path, weights_only=True)
    torch.save({"schema": 1, "meta": content["meta"], "state": content["state"]}, tmp_path / "old.pt")
    assert loaded(tmp_path / "old.pt").spec() == network.spec()
    torch.save({**content, "meta": content["meta"].replace('"note": 1', '"note": 2')}, tmp_path / "changed.pt")
    with pytest.raises(InputError, match="SHA-256 differs"):
        load_state(tmp_path / "changed.pt")
