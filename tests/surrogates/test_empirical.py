"""The six learned maps: restrictions, limits, dropout, members, files, derivatives, all backends."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from operating_points import laboratory, operating_points

from dieseltwin.engine import MAPS, Inputs, actuate, bind, constants, parameter_batch, we2011
from dieseltwin.errors import InputError
from dieseltwin.networks import ACTIVATIONS, MLP
from dieseltwin.settings.maps import MapsConfig
from dieseltwin.settings.params import load_params
from dieseltwin.surrogates import empirical_training
from dieseltwin.surrogates.empirical import LABELS, EmpiricalMaps, map_arguments
from dieseltwin.surrogates.empirical_training import MapData, _with_a_slope, finish, train_maps
from dieseltwin.surrogates.map_compiled import compiled_simulator, flat_weights

KINDS = ("paper", "improved")
C = constants(we2011.PARAMETERS)


@pytest.fixture(scope="module")
def config() -> MapsConfig:
    maps = load_params(None, "quick").pretrain.maps
    paper = maps.paper.model_copy(update={"steps": 600, "finish_steps": 6, "finish_cells": 600})
    improved = maps.improved.model_copy(update={"cells": 1000, "members": 4, "starts": 4, "steps": 50})
    return maps.model_copy(update={"paper": paper, "improved": improved})


@pytest.fixture(scope="module")
def unfinished() -> dict[str, MLP]:
    """The networks of `trained`'s printed kind as Adam leaves them, those that are finished behind it."""
    return {}


@pytest.fixture(scope="module")
def trained(config: MapsConfig, unfinished: dict[str, MLP]) -> dict[str, EmpiricalMaps]:
    def finish_seen(name: str, network: MLP, *arguments: Any) -> MLP:
        unfinished[name] = network
        return finish(name, network, *arguments)

    data = {
        kind: MapData(laboratory(rows, 1), held_out={"held_out": operating_points(2000, 9)})
        for kind, rows in (("paper", 1000), ("improved", 4000))
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(empirical_training, "finish", finish_seen)
        return {kind: train_maps(data[kind], config, 3, kind) for kind in KINDS}


@pytest.fixture(scope="module")
def points() -> dict[str, tuple[np.ndarray, ...]]:
    """Arguments far beyond the training data, the limits of the engine included."""
    rng = np.random.default_rng(5)
    n = 2000

    def spread(low: float, high: float) -> np.ndarray:
        return np.concatenate([[low, high], rng.uniform(low, high, n)])

    Pi_t, Pi_c, omega_t = spread(0.05, 0.9999), spread(1.0, 10.0), spread(10.0, 21000.0)
    return {
        "eta_vol": (spread(5e4, 1e6), spread(300.0, 2500.0)),
        "f_egr": (spread(-80.0, 180.0),),
        "F_vgt_Pi_t": (spread(0.0, 120.0), Pi_t),
        "eta_tm": (omega_t, spread(250.0, 1800.0), Pi_t),
        "eta_c": (spread(1e-4, 2.0), Pi_c),
        "Phi_c": (spread(220.0, 330.0), Pi_c, omega_t),
    }


def table(maps: EmpiricalMaps, recording: str = "held_out") -> dict[str, dict[str, float]]:
    rows = maps.errors()
    return rows[rows["recording"] == recording].set_index("map").to_dict("index")


# --- what a map may return ------------------------------------------------------------------------------------


def test_paper_restrictions_hold_everywhere(trained, points):
    ranges = {
        "f_egr": (0.0, 1.0), "F_vgt_Pi_t": (0.0, 1.1), "eta_tm": (-np.inf, 0.818), "eta_c": (0.2, 1.0),
        "Phi_c": (0.0, 1.0), "eta_vol": (-np.inf, np.inf),
    }  # fmt: skip
    for name, (low, high) in ranges.items():
        for member in (None, 1, 2):
            value = trained["paper"].evaluate(name, *points[name], member=member)
            assert np.all(np.isfinite(value)), name
            assert np.all((value >= low) & (value <= high)), name


def test_improved_limits_hold_everywhere(trained, points):
    ranges = {
        "f_egr": (0.0, 2.0),
        "F_vgt_Pi_t": (0.0, 5.0),
        "eta_tm": (0.2, 0.818),
        "eta_c": (0.2, 2.0),
        "Phi_c": (0.0, 2.0),
    }
    for name, (low, high) in ranges.items():
        for member in (None, 1):
            value = trained["improved"].evaluate(name, *points[name], member=member)
            assert np.all(np.isfinite(value)), name
            assert np.all((value >= low) & (value <= high)), name


def test_a_shut_valve_is_shut_in_improved_only(trained):
    shut = np.array([0.0, -3.0, -80.0])
    assert np.array_equal(trained["improved"].evaluate("f_egr", shut), np.zeros(3))
    assert np.all(trained["paper"].evaluate("f_egr", shut) > 0.0)


def test_no_flow_without_pressure_drop(trained):
    near, nearer = trained["improved"].evaluate("F_vgt_Pi_t", np.array([50.0, 50.0]), np.array([0.9984, 0.9996]))
    assert near / nearer == pytest.approx(2.0, rel=1e-2)


# --- accuracy and uncertainty ---------------------------------------------------------------------------------


def test_improved_is_right_to_a_per_cent_of_three_per_cent_noise(trained):
    # 16,000 noisy labels; the whole laboratory has ten to seventy times as many
    rows = table(trained["improved"])
    for name in MAPS:
        assert rows[name]["l2_rel"] < 8e-3, name
        assert abs(rows[name]["bias_rel"]) < 2e-3, name


def test_without_noise_improved_is_right_to_half_a_per_cent(config):
    held_out = {"held_out": operating_points(2000, 9)}
    maps = train_maps(MapData(laboratory(2000, 1), held_out=held_out), config, 3, "improved", label_noise_rel=0.0)
    rows = table(maps)
    for name in ("eta_vol", "F_vgt_Pi_t", "eta_tm", "eta_c", "Phi_c"):
        assert rows[name]["mean_rel"] < 5e-3, name


def test_paper_learns(trained):
    rows = table(trained["paper"])
    for name, allowed in {"eta_vol": 0.05, "f_egr": 0.08, "F_vgt_Pi_t": 0.12, "eta_tm": 0.2, "eta_c": 0.12}.items():
        assert rows[name]["l2_rel"] < allowed, name


def test_gauss_newton_behind_adam_halves_the_errors_and_leaves_f_egr_alone(config, trained, unfinished):
    maps = trained["paper"].maps
    plain = {name: replace(item, network=unfinished.get(name, item.network)) for name, item in maps.items()}
    rows = EmpiricalMaps("paper", plain).error_table({"held_out": operating_points(2000, 9)}).set_index("map")
    after = table(trained["paper"])
    ratios = {name: after[name]["l2_rel"] / rows["l2_rel"][name] for name in config.paper.finish_maps}
    assert np.median(list(ratios.values())) < 0.5, ratios
    assert set(unfinished) == set(config.paper.finish_maps) and "f_egr" not in unfinished


def test_uncertainty_is_calibrated(trained):
    rows = table(trained["improved"])
    z = [rows[name]["z_rms"] for name in MAPS]
    assert 0.5 < np.median(z) < 2.0
    assert max(z) < 5.0
    arguments = map_arguments(operating_points(50, 2), we2011.PARAMETERS)
    for maps in trained.values():
        std = maps.uncertainty("eta_vol", *arguments["eta_vol"])
        assert std.shape == (50,)
        assert np.all(std > 0.0)


def test_error_table_is_what_it_says(trained):
    frame = operating_points(500, 4)
    maps = trained["improved"]
    row = maps.error_table({"x": frame}).set_index("map").loc["eta_c"]
    value = maps.evaluate("eta_c", *map_arguments(frame, we2011.PARAMETERS)["eta_c"])
    label = frame[LABELS["eta_c"]].to_numpy()
    assert row["l2_rel"] == pytest.approx(np.linalg.norm(value - label) / np.linalg.norm(label))
    assert row["mean_rel"] == pytest.approx(np.mean(np.abs(value / label - 1.0)))


# --- dropout and members --------------------------------------------------------------------------------------


def test_dropout_stays_on_and_differs_by_seed(trained):
    maps = trained["paper"]
    arguments = map_arguments(operating_points(20, 2), we2011.PARAMETERS)["eta_c"]
    values = np.stack([maps.evaluate("eta_c", *arguments, member=seed) for seed in range(40)])
    assert np.array_equal(values[7], maps.evaluate("eta_c", *arguments, member=7))
    distinct = len({v.tobytes() for v in values})
    # 60 hidden neurons at 1 %: 55 % of the realisations have all of them on
    assert 8 <= distinct <= 35


def test_dropped_neurons_are_the_masks_of_the_network(trained):
    maps = trained["paper"]
    item = maps.maps["eta_vol"]
    seed = 11
    generator = torch.Generator().manual_seed(seed * len(MAPS) + MAPS.index("eta_vol"))
    masks = item.network.sample_masks((1,), generator=generator)
    p_im, n_e = np.array([1.2e5, 2.0e5]), np.array([900.0, 1500.0])
    x = torch.as_tensor((np.stack([p_im, n_e], axis=-1) - item.centre) / item.scale, dtype=torch.float32)
    parts = zip(item.network.weights, item.network.biases, strict=True)
    *inner, last = [(w[0].detach(), b[0].detach()) for w, b in parts]
    for (weight, bias), mask in zip(inner, masks, strict=True):
        x = ACTIVATIONS[item.network.activation](x @ weight + bias) * mask
    expected = (x @ last[0] + last[1])[..., 0].numpy()
    assert maps.evaluate("eta_vol", p_im, n_e, member=seed) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_several_members_are_a_leading_dimension(trained, kind):
    maps = trained[kind]
    members = [1, 2, 3]
    arguments = map_arguments(operating_points(30, 2), we2011.PARAMETERS)
    stacked = maps.replacements("torch", member=members)
    for name in MAPS:
        given = [torch.tensor(a).expand(3, 30) for a in arguments[name]]
        value = stacked[name](*given, C)
        assert value.shape == (3, 30)
        for row, member in zip(value, members, strict=True):
            alone = maps.evaluate(name, *arguments[name], member=member)
            assert row.numpy() == pytest.approx(alone, rel=1e-10, abs=1e-12)
        segments = stacked[name](*[g.expand(2, 3, 30) for g in given], C)
        assert torch.allclose(segments[1], value, rtol=1e-12)


def test_same_seed_same_bits(config):
    cases = laboratory(200, 1)
    small = config.model_copy(
        update={
            "paper": config.paper.model_copy(
                update={"hidden": (8, 8), "steps": 10, "finish_steps": 2, "finish_cells": 60}
            ),
            "improved": config.improved.model_copy(update={"cells": 60, "steps": 5, "starts": 2, "members": 2}),
        }
    )
    arguments = map_arguments(operating_points(40, 2), we2011.PARAMETERS)
    for kind in KINDS:
        one, same, other = (train_maps(MapData(cases), small, seed, kind) for seed in (3, 3, 4))
        for name in MAPS:
            value = one.evaluate(name, *arguments[name])
            assert np.array_equal(value, same.evaluate(name, *arguments[name])), (kind, name)
            assert not np.array_equal(value, other.evaluate(name, *arguments[name])), (kind, name)


# --- files ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_save_and_load_are_bit_identical(trained, kind, tmp_path: Path):
    maps = trained[kind]
    path = maps.save(tmp_path / "maps.pt")
    loaded = EmpiricalMaps.load(path)
    assert loaded.save(tmp_path / "again.pt").read_bytes() == path.read_bytes()
    arguments = map_arguments(operating_points(40, 2), we2011.PARAMETERS)
    for name in MAPS:
        for member in (None, 2):
            first, second = (m.evaluate(name, *arguments[name], member=member) for m in (maps, loaded))
            assert np.array_equal(first, second)
        assert np.array_equal(maps.uncertainty(name, *arguments[name]), loaded.uncertainty(name, *arguments[name]))
    assert loaded.errors().equals(maps.errors())


def test_another_file_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match="no such file"):
        EmpiricalMaps.load(tmp_path / "none.pt")
    (tmp_path / "text.pt").write_text("not a network")
    with pytest.raises(InputError, match="train it again"):
        EmpiricalMaps.load(tmp_path / "text.pt")


# --- derivatives ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("slopes", [False, True])
def test_gradients_are_finite_everywhere(trained, points, kind, slopes):
    functions = trained[kind].replacements("torch", slopes=slopes)
    for name in MAPS:
        arguments = [torch.tensor(a, requires_grad=True) for a in points[name]]
        gradients = torch.autograd.grad(functions[name](*arguments, C).sum(), arguments)
        assert all(bool(torch.isfinite(g).all()) for g in gradients), name


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_match_differences_and_closed_form(trained, kind):
    arguments = map_arguments(operating_points(60, 2), we2011.PARAMETERS)
    plain, closed = (trained[kind].replacements("torch", member=1, slopes=s) for s in (False, True))
    for name in MAPS:
        given = [torch.tensor(a, requires_grad=True) for a in arguments[name]]
        first = torch.autograd.grad(plain[name](*given, C).sum(), given)
        second = torch.autograd.grad(closed[name](*given, C).sum(), given)
        for number, argument in enumerate(arguments[name]):
            step = 1e-6 * np.abs(argument) + 1e-9
            moved = [list(arguments[name]) for _ in range(2)]
            moved[0][number], moved[1][number] = argument + step, argument - step
            up, down = (trained[kind].evaluate(name, *m, member=1) for m in moved)
            difference = (up - down) / (2.0 * step)
            assert first[number].numpy() == pytest.approx(second[number].numpy(), rel=1e-9, abs=1e-14)
            close = np.isclose(
                first[number].numpy(), difference, rtol=1e-3, atol=1e-6 * np.abs(difference).max() + 1e-12
            )
            assert close.mean() > 0.8, (name, number)  # the rest lies on a limit, a tenth of the valves shut or open


def test_closed_form_works_forward_and_batched(trained):
    functions = trained["improved"].replacements("torch", slopes=True)
    W_c, Pi_c = torch.linspace(0.1, 0.4, 7, dtype=torch.float64), torch.linspace(1.2, 2.0, 7, dtype=torch.float64)
    tangents = torch.eye(7, dtype=torch.float64)
    forward = torch.func.vmap(lambda t: torch.func.jvp(lambda w: functions["eta_c"](w, Pi_c, C), (W_c,), (t,))[1])(
        tangents
    )
    exact = torch.autograd.functional.jacobian(
        lambda w: trained["improved"].replacements("torch")["eta_c"](w, Pi_c, C), W_c
    )
    assert torch.allclose(forward.T, exact, rtol=1e-10)


# --- in the engine --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_maps_replace_the_formulae_in_torch_and_numpy(trained, kind):
    states = (1.5e5, 1.7e5, 5500.0, 0.04, 312.0, 1300.0, 90.0, 35.0, 48.0)
    exact = bind("numpy").quantities(*states, C)
    learned = bind("numpy", replace=trained[kind].replacements("numpy")).quantities(*states, C)
    tensors = [torch.full((4,), s, dtype=torch.float64) for s in states]
    in_torch = bind("torch", replace=trained[kind].replacements("torch")).quantities(*tensors, C)
    for field in ("eta_vol", "f_egr", "F_vgt_Pi_t", "eta_tm", "Phi_c", "eta_c", "W_c", "W_t", "W_egr"):
        assert getattr(learned, field) == pytest.approx(getattr(exact, field), rel=0.02 if kind == "improved" else 0.5)
        assert getattr(in_torch, field).numpy() == pytest.approx(float(getattr(learned, field)), rel=1e-10)
    single = trained[kind].replacements("torch", dtype=torch.float32)["eta_c"](torch.tensor(0.2), torch.tensor(1.5), C)
    assert single.dtype == torch.float32
    assert single.shape == ()


def test_compiled_simulator_follows_the_equations_with_the_maps(config):
    # one neuron a map: compiling takes time with the number of weights, and coarse maps show a mix-up as well
    coarse = config.improved.model_copy(
        update={"hidden": dict.fromkeys(MAPS, (1,)), "cells": 200, "steps": 15, "starts": 2, "members": 2}
    )
    maps = train_maps(MapData(laboratory(800, 1)), config.model_copy(update={"improved": coarse}), 3, "improved")
    time = np.arange(0.0, 3.01, 0.2)
    inputs = Inputs(time, *(np.full(time.size, v) for v in (1300.0, 90.0, 35.0, 48.0)))
    actuation = actuate(inputs, we2011.PARAMETERS)
    batch, start = parameter_batch(we2011.PARAMETERS), np.array([1.5e5, 1.7e5, 5500.0])
    found = compiled_simulator(maps, 1)(actuation, batch, start)
    nominal = compiled_simulator(maps)(actuation, batch, start)
    assert not np.array_equal(found.states, nominal.states)
    model = bind("numpy", replace=maps.replacements("numpy", member=1))
    p_im, p_em, omega_t, x_r, T_1 = found.states[0].T
    q = model.quantities(p_im, p_em, omega_t, x_r, T_1, 1300.0, 90.0, 35.0, 48.0, C)
    assert found.measured[0, :, 3] == pytest.approx(q.W_egr, rel=1e-9)
    assert found.measured[0, :, 5] == pytest.approx(q.W_c, rel=1e-9)
    # states obey the learned equations: the turbo's change over a sample against the trapezoidal mean of its rate
    change = np.diff(omega_t[5:])
    assert change == pytest.approx(0.1 * (q.domega_t[5:-1] + q.domega_t[6:]), rel=0.05, abs=1e-3)


def test_the_compiled_simulator_wants_shallow_maps(trained):
    with pytest.raises(InputError, match="one hidden layer"):
        flat_weights(trained["paper"])


# --- bad input ------------------------------------------------------------------------------------------------


def test_what_is_missing_is_named(config):
    cases = laboratory(100, 1)
    with pytest.raises(InputError, match="u_egr2_pct"):
        train_maps(MapData({k: f.drop(columns="u_egr2_pct") for k, f in cases.items()}), config, 1, "improved")
    with pytest.raises(InputError, match="case_iv"):
        train_maps(MapData({k: f for k, f in cases.items() if k != "case_iv"}), config, 1, "improved")
    with pytest.raises(InputError, match="did you mean improved"):
        train_maps(MapData(cases), config, 1, "improve")  # type: ignore[arg-type]


def test_unknown_names_are_refused(trained):
    with pytest.raises(InputError, match="numpy"):
        trained["paper"].replacements("jax")
    with pytest.raises(InputError, match="eta_tm"):
        trained["paper"].layers("eta_t")


def test_eta_tm_above_its_cap_can_come_down():
    """min(0.818, z) alone has no slope above the cap; the training's has, with the printed value."""
    z = torch.tensor([0.5, 0.9], requires_grad=True)
    value = _with_a_slope(torch.clamp_max(z, 0.818), z, "eta_tm")
    torch.testing.assert_close(value.detach(), torch.tensor([0.5, 0.818]))
    value.sum().backward()
    assert (z.grad == 1.0).all()
