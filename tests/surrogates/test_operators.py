"""Actuator operators: trained on short synthetic driving against an exact solution of their own."""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.engine import Inputs, we2011
from dieseltwin.errors import InputError
from dieseltwin.settings.params import OperatorConfig, OperatorsConfig
from dieseltwin.surrogates.operators import OPERATORS, ActuatorOperators, train_operators

PARAMETERS = we2011.PARAMETERS
STEP_S = 0.2
UPDATES = 400


def lag(time: np.ndarray, u: np.ndarray, delay_s: float, tau_s: float) -> np.ndarray:
    """First-order lag behind a dead time by tiny explicit steps, from rest."""
    fine = 1e-3
    t = np.arange(0.0, time[-1] + fine / 2, fine)
    delayed = np.interp(t - delay_s, time, u)
    gain = 1.0 - float(np.exp(-fine / tau_s))
    middle = (0.5 * (delayed[1:] + delayed[:-1])).tolist()
    y = list(accumulate(middle, lambda last, u: last + gain * (u - last), initial=float(delayed[0])))
    return np.interp(time, t, y)


def driving(seed: int, minutes: float) -> pd.DataFrame:
    """Ramps between random positions, knots on whole seconds, idle with the EGR valve nearly shut at times."""
    rng = np.random.default_rng(seed)
    seconds = np.arange(round(60 * minutes) + 1)
    time = STEP_S * np.arange(round(60 * minutes / STEP_S) + 1)
    commands = {}
    for name, low, high, idle in (("u_egr_pct", 10.0, 80.0, 0.5), ("u_vgt_pct", 25.0, 80.0, 40.0)):
        corners = np.sort(rng.choice(seconds, len(seconds) // 5, replace=False))
        levels = np.where(rng.random(len(corners)) < 0.2, idle, rng.uniform(low, high, len(corners)))
        at_seconds = np.interp(seconds, corners, levels) + rng.normal(0.0, 1.5, len(seconds))
        limits = PARAMETERS.u_vgt_range if "vgt" in name else PARAMETERS.u_egr_range
        commands[name] = np.interp(time, seconds, np.clip(at_seconds, *limits))
    p = PARAMETERS
    return pd.DataFrame(
        {
            "time_s": time,
            **commands,
            "u_egr1_pct": lag(time, commands["u_egr_pct"], p.tau_degr, p.tau_egr1),
            "u_egr2_pct": lag(time, commands["u_egr_pct"], p.tau_degr, p.tau_egr2),
            "u_vgt_act_pct": lag(time, commands["u_vgt_pct"], p.tau_dvgt, p.tau_vgt),
        }
    )


def config(updates: int, finish_rows: int = 4000, finish_ridge: float = 1e-7) -> OperatorsConfig:
    one = {
        "input_hidden": (12,), "initial_hidden": (8,), "trunk_hidden": (16, 16), "basis": 16,
        "updates": updates, "batch": 256, "rate": 6e-3,
    }  # fmt: skip
    return OperatorsConfig(
        window_s=20.0, sample_s=STEP_S, slide_s=STEP_S, memory_s=2.0, memory_decay=10.0, forget_s=0.05,
        start_share=0.25, finish_rows=finish_rows, finish_ridge=finish_ridge,
        egr=OperatorConfig(**one, loss_weights=(1.0, 100.0)), vgt=OperatorConfig(**one, loss_weights=(1.0,)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def cases() -> dict[str, pd.DataFrame]:
    return {name: driving(seed, 4.0) for seed, name in enumerate(("case_i", "case_vi", "case_vii"))}


@pytest.fixture(scope="module")
def operators(cases: dict[str, pd.DataFrame]) -> ActuatorOperators:
    return train_operators(cases, config(UPDATES), 1, PARAMETERS)


def inputs(frame: pd.DataFrame, n_history: int = 0) -> Inputs:
    time = frame["time_s"].to_numpy()
    filler = np.full(len(time), 1200.0), np.full(len(time), 80.0)
    return Inputs(time, *filler, frame["u_egr_pct"].to_numpy(), frame["u_vgt_pct"].to_numpy(), n_history)


def error_pct(found: np.ndarray, truth: np.ndarray) -> float:
    return 100 * float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


# --- accuracy ----------------------------------------------------------------------------------------------------


def test_a_short_training_generalises(operators: ActuatorOperators) -> None:
    unseen = driving(77, 3.0)
    errors = operators.errors(unseen)
    assert list(errors) == ["u_egr1_pct", "u_egr2_pct", "u_vgt_act_pct"]
    assert max(errors.values()) < 1.0, errors
    # better than no operator at all: the command in place of the state
    command = {label: error_pct(unseen["u_egr_pct"].to_numpy(), unseen[label].to_numpy()) for label in OPERATORS["egr"]}
    assert all(errors[label] < 0.3 * command[label] for label in command), (errors, command)


def test_training_errors_are_those_of_all_training_windows_together(
    cases: dict[str, pd.DataFrame], operators: ActuatorOperators
) -> None:
    found, single = operators.training_errors(cases), {name: operators.errors(frame) for name, frame in cases.items()}
    assert list(found) == list(single["case_i"])
    n = operators.egr.network.n_times
    for label, of in {"u_egr1_pct": ("case_i", "case_vi"), "u_vgt_act_pct": ("case_i", "case_vii")}.items():
        whole = [len(cases[case]) - (len(cases[case]) - 1) % (n - 1) for case in of]  # rows of whole windows
        rows = [np.append(np.arange(size), np.arange(n - 1, size - 1, n - 1)) for size in whole]  # joints count twice
        values = [cases[case][label].to_numpy()[at] for case, at in zip(of, rows, strict=True)]
        squares = np.array([np.square(value).sum() for value in values])
        each = np.array([single[case][label] for case in of])
        assert found[label] == pytest.approx(float(np.sqrt((squares * each**2).sum() / squares.sum())), rel=1e-6)


@pytest.mark.thorough
def test_the_closed_form_finish_is_worth_it(cases: dict[str, pd.DataFrame], operators: ActuatorOperators) -> None:
    unseen = driving(77, 3.0)
    adam = train_operators(cases, config(UPDATES, finish_rows=0), 1, PARAMETERS).errors(unseen)
    finished = operators.errors(unseen)
    assert all(finished[label] < 0.5 * adam[label] for label in adam), (finished, adam)


def test_training_lowers_the_loss(operators: ActuatorOperators) -> None:
    for operator in (operators.egr, operators.vgt):
        assert operator.curve[-1, 0] == UPDATES
        assert operator.curve[-1, 1] < 0.05 * operator.curve[0, 1]


@pytest.mark.thorough
def test_noisy_labels_cost_little(cases: dict[str, pd.DataFrame], operators: ActuatorOperators) -> None:
    noisy = train_operators(cases, config(UPDATES, finish_ridge=1e-5), 1, PARAMETERS, label_noise_rel=0.03)
    errors, clean = noisy.errors(driving(77, 3.0)), operators.errors(driving(77, 3.0))
    assert errors != clean
    assert max(errors.values()) < 2.0, errors


# --- structure ---------------------------------------------------------------------------------------------------


def test_branches_and_outputs_are_the_papers(operators: ActuatorOperators) -> None:
    for operator, outputs in ((operators.egr, 2), (operators.vgt, 1)):
        network = operator.network
        assert len(network.input_branches) == len(network.initial_branches) == outputs
        assert network.input_branches[0].widths[0] == network.n_times == 101
        assert network.trunk.widths[0] == network.initial_branches[0].widths[0] == 1


def test_the_future_does_not_change_the_past(operators: ActuatorOperators) -> None:
    frame = driving(5, 0.3)
    other = frame.copy()
    changed = 40
    other.loc[changed:, ["u_egr_pct", "u_vgt_pct"]] = 55.0
    before, after = (operators.predict(inputs(f)) for f in (frame, other))
    for name in ("u_egr1", "u_egr2", "u_vgt"):
        # the command is delayed by less than a sample, so the sample `changed` may differ and none before it
        np.testing.assert_array_equal(getattr(before, name)[:changed], getattr(after, name)[:changed])
        assert not np.array_equal(getattr(before, name)[changed:], getattr(after, name)[changed:])


def test_states_keep_the_limits_of_the_commands(operators: ActuatorOperators) -> None:
    frame = driving(5, 0.3)
    slammed = np.where(np.arange(len(frame)) // 10 % 2, 150.0, -50.0)
    frame["u_egr_pct"] = frame["u_vgt_pct"] = slammed
    states = operators.predict(inputs(frame))
    for values, (low, high) in (
        (states.u_egr1, PARAMETERS.u_egr_range),
        (states.u_egr2, PARAMETERS.u_egr_range),
        (states.u_vgt, PARAMETERS.u_vgt_range),
    ):
        assert values.min() >= low and values.max() <= high


# --- whole segments ----------------------------------------------------------------------------------------------


def test_the_history_gives_the_initial_state(operators: ActuatorOperators) -> None:
    frame = driving(6, 1.0)
    ramp = frame["u_egr_pct"].diff().abs().rolling(3).sum().iloc[20:200].idxmax()  # starts in the middle of a ramp
    segment = frame.iloc[ramp - 10 : ramp + 80]
    with_history = operators.predict(inputs(segment, n_history=10))
    without = operators.predict(inputs(segment.iloc[10:]))
    truth = segment["u_egr2_pct"].to_numpy()[10:]
    assert abs(with_history.u_egr2[0] - truth[0]) < 0.5 * abs(without.u_egr2[0] - truth[0])


def test_a_segment_longer_than_a_window_is_chained(operators: ActuatorOperators) -> None:
    frame = driving(7, 1.5)  # 4.5 windows
    states = operators.predict(inputs(frame))
    assert states.u_egr1.shape == (451,)
    for name, column in zip(("u_egr1", "u_egr2", "u_vgt"), ("u_egr1_pct", "u_egr2_pct", "u_vgt_act_pct"), strict=True):
        assert error_pct(getattr(states, name), frame[column].to_numpy()) < 1.0
    # the second window starts with the last states of the first
    time = frame["time_s"].to_numpy()
    delayed = np.interp(time - PARAMETERS.tau_degr, time, frame["u_egr_pct"])
    u_egr = np.stack([states.u_egr1, states.u_egr2], axis=1)
    again = operators.egr.predict(delayed[None, 100:201], u_egr[None, 100])[0]
    np.testing.assert_allclose(u_egr[101:201], again[1:], rtol=1e-9)


def test_samples_between_the_grid(operators: ActuatorOperators) -> None:
    frame = driving(8, 0.5)
    coarse = frame.iloc[::5]  # the knots: the same command, sampled once a second
    np.testing.assert_allclose(
        operators.predict(inputs(coarse)).u_egr2, operators.predict(inputs(frame)).u_egr2[::5], atol=1e-4
    )


# --- files, seeds, refusals ----------------------------------------------------------------------------------------


def test_operators_come_back_bit_for_bit(operators: ActuatorOperators, tmp_path: Path) -> None:
    loaded = ActuatorOperators.load(operators.save(tmp_path / "operators.pt"))
    segment = inputs(driving(5, 0.5), n_history=10)
    mine, theirs = operators.predict(segment), loaded.predict(segment)
    for name in ("u_egr1", "u_egr2", "u_vgt"):
        np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))
    np.testing.assert_array_equal(loaded.egr.curve, operators.egr.curve)
    assert loaded.egr.limits_pct == operators.egr.limits_pct


def test_the_same_seed_gives_the_same_bytes(cases: dict[str, pd.DataFrame], tmp_path: Path) -> None:
    written = [
        train_operators(cases, config(20, finish_rows=2000), seed, PARAMETERS).save(tmp_path / f"{k}.pt").read_bytes()
        for k, seed in enumerate((3, 3, 4))
    ]
    assert written[0] == written[1] != written[2]


def test_refusals(cases: dict[str, pd.DataFrame], operators: ActuatorOperators, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="case_vi"):
        train_operators({"case_i": cases["case_i"]}, config(5), 0, PARAMETERS)
    with pytest.raises(InputError, match="no column u_egr2_pct"):
        operators.errors(cases["case_i"].drop(columns="u_egr2_pct"))
    with pytest.raises(InputError, match="rows"):
        operators.errors(cases["case_i"].iloc[:50])
    with pytest.raises(InputError, match="rows"):
        train_operators({**cases, "case_vi": cases["case_vi"].iloc[:50]}, config(5), 0, PARAMETERS)
    with pytest.raises(InputError, match="loss_weights"):
        wrong = config(5).model_copy(update={"egr": config(5).vgt})
        train_operators(cases, wrong, 0, PARAMETERS)
