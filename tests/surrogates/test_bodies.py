"""Multi-head bodies: transforms, projection training, exact rates, POD floor, files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dieseltwin.errors import InputError
from dieseltwin.settings.params import (
    BodiesConditionedConfig,
    BodiesConfig,
    BodiesPaperConfig,
    BodyConfig,
)
from dieseltwin.surrogates.bodies import BODIES, TRANSFORMS, Bodies, minutes, pod_floor, train_bodies
from dieseltwin.surrogates.body_training import second_moment

CENTRES = {"p_im_pa": 1.6e5, "p_em_pa": 1.9e5, "x_r": 0.035, "t_1_k": 308.0, "omega_t_rad_s": 5.5e3}
SPREADS = {"p_im_pa": 3e4, "p_em_pa": 4e4, "x_r": 0.005, "t_1_k": 2.0, "omega_t_rad_s": 1e3}
TIME01 = np.linspace(0.0, 1.0, 301)


def smooth_recording(seed: int, n_minutes: int) -> pd.DataFrame:
    """Each state a sum of random waves of 4-60 s: as smooth as driving, without an engine."""
    rng = np.random.default_rng(seed)
    time = 0.2 * np.arange(300 * n_minutes + 1)
    frame = pd.DataFrame({"time_s": time})
    for column, centre in CENTRES.items():
        periods, phases = rng.uniform(4.0, 60.0, 40), rng.uniform(0.0, 2 * np.pi, 40)
        waves = np.sin(2 * np.pi * time[:, None] / periods + phases) * periods
        wave = waves.sum(1) / np.sqrt((periods**2).sum() / 2)
        frame[column] = centre + SPREADS[column] * wave
    return frame


def small_config(**changes: object) -> BodiesConfig:
    return BodiesConfig(
        heads=12,
        sizes={
            "pressures": BodyConfig(hidden=(40, 40, 40)),
            "x_r": BodyConfig(hidden=(40, 30)),
            "T_1": BodyConfig(hidden=(30, 20)),
            "omega_t": BodyConfig(hidden=(40, 30)),
        },
        paper=BodiesPaperConfig(epochs=60, rate=3e-3, finish_heads=bool(changes.get("finish_heads", True))),
        conditioned=BodiesConditionedConfig(
            epochs=150, rate=3e-3, lbfgs_steps=20, first_layer_scale=(15.0, 40.0)
        ),
    )


@pytest.fixture(scope="module")
def cases() -> dict[str, pd.DataFrame]:
    return {"case_i": smooth_recording(1, 6), "case_iv": smooth_recording(2, 6)}


@pytest.fixture(scope="module")
def conditioned(cases: Mapping[str, pd.DataFrame]) -> Bodies:
    return train_bodies(cases, small_config(), seed=3)


# --- output transforms -------------------------------------------------------------------------------------------


@given(st.sampled_from(sorted(TRANSFORMS)), st.floats(-12.0, 12.0))
def test_transforms_go_there_and_back(column: str, z: float) -> None:
    transform = TRANSFORMS[column]
    state = transform.state(z)
    assert float(transform.linear(state)) == pytest.approx(z, rel=1e-6, abs=1e-6)


def test_transforms_are_the_papers() -> None:
    assert float(TRANSFORMS["p_im_pa"].state(0.0)) == pytest.approx(1e5 * np.log(2))
    assert float(TRANSFORMS["p_em_pa"].state(0.0)) == pytest.approx(1e5 * np.log(2))
    assert float(TRANSFORMS["omega_t_rad_s"].state(0.0)) == pytest.approx(5e3 * np.log(2))
    assert float(TRANSFORMS["x_r"].state(0.0)) == 0.5
    assert float(TRANSFORMS["t_1_k"].state(0.0)) == pytest.approx(300 * np.log(2) + 230)


@pytest.mark.parametrize(
    ("column", "bad"), [("p_im_pa", 0.0), ("x_r", 1.0), ("t_1_k", 229.0), ("omega_t_rad_s", np.nan)]
)
def test_states_outside_the_transform_are_refused(column: str, bad: float) -> None:
    with pytest.raises(InputError, match="state for a head"):
        TRANSFORMS[column].linear([CENTRES[column], bad])


# --- training ----------------------------------------------------------------------------------------------------


def test_the_second_moment_is_that_of_all_windows(cases: Mapping[str, pd.DataFrame]) -> None:
    recording = cases["case_i"]["x_r"].to_numpy()[:700]
    windows = np.lib.stride_tricks.sliding_window_view(TRANSFORMS["x_r"].linear(recording), 301)
    windows = windows - windows.mean(axis=1, keepdims=True)
    expected = windows.T @ windows / len(windows)
    found = second_moment({"x_r": [recording]})
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_the_pod_floor_is_numpys(cases: Mapping[str, pd.DataFrame]) -> None:
    held_out = smooth_recording(9, 4)
    widths = {"pressures": 7, "x_r": 5, "T_1": 4, "omega_t": 3}
    found = pod_floor(list(cases.values()), [held_out], widths)
    for name, columns in BODIES.items():
        z = np.stack(
            [
                TRANSFORMS[column].linear(frame[column].to_numpy()[start : start + 301])
                for column in columns
                for frame in cases.values()
                for start in range(0, 1800, 300)
            ]
        )
        z = z - z.mean(axis=1, keepdims=True)
        u = np.linalg.svd(z)[2][: widths[name]]
        for column in columns:
            truth = np.stack([held_out[column].to_numpy()[k : k + 301] for k in range(0, 1200, 300)])
            linear = TRANSFORMS[column].linear(truth)
            mean = linear.mean(axis=1, keepdims=True)
            kept = mean + (linear - mean) @ u.T @ u  # the vectors are orthogonal to the constant
            error = TRANSFORMS[column].state(kept) - truth
            assert found[column] == pytest.approx(100 * np.sqrt((error**2).sum() / (truth**2).sum()), rel=1e-8)


def test_a_conditioned_body_reaches_the_pod_floor_on_new_minutes(
    cases: Mapping[str, pd.DataFrame], conditioned: Bodies
) -> None:
    held_out = [smooth_recording(9, 4)]
    floor = pod_floor(list(cases.values()), held_out, {name: body.width for name, body in conditioned.items()})
    errors = conditioned.errors(held_out)
    assert all(errors[column] < 1.2 * floor[column] for column in floor), (errors, floor)
    assert all(error < 1.0 for error in conditioned.training_errors(cases).values())


def test_training_lowers_the_loss(conditioned: Bodies) -> None:
    for body in conditioned.values():
        assert body.curve[-1, 1] < 0.5 * body.curve[0, 1]


def test_the_conditioned_basis_is_orthonormal_and_free_of_the_constant(conditioned: Bodies) -> None:
    for name, body in conditioned.items():
        h, _ = body.basis(TIME01)
        assert h.dtype == np.float64 and h.shape == (301, body.width) == (301, small_config().sizes[name].hidden[-1])
        np.testing.assert_allclose(h.T @ h, np.eye(body.width), atol=1e-8)
        np.testing.assert_allclose(h.sum(axis=0), 0.0, atol=1e-8)


def test_rates_against_finite_differences(conditioned: Bodies) -> None:
    inner, step = np.linspace(0.1, 0.9, 50), 1e-6
    for body in conditioned.values():
        _, rate = body.basis(inner)
        difference = (body.basis(inner + step)[0] - body.basis(inner - step)[0]) / (2 * step * 60.0)
        np.testing.assert_allclose(rate, difference, atol=1e-6 * np.abs(rate).max())
    _, slow = conditioned["x_r"].basis(inner, duration_s=120.0)
    np.testing.assert_allclose(2 * slow, conditioned["x_r"].basis(inner)[1])


def test_stored_heads_are_case_i_then_case_iv(cases: Mapping[str, pd.DataFrame], conditioned: Bodies) -> None:
    stored = conditioned["pressures"].training_minutes()["p_em_pa"]
    assert stored.shape == (301, 12)
    expected = np.concatenate([minutes(cases["case_i"], "p_em_pa"), minutes(cases["case_iv"], "p_em_pa")], axis=1)
    assert np.abs(stored - expected).max() < 0.2 * SPREADS["p_em_pa"]


def test_bodies_as_printed(cases: Mapping[str, pd.DataFrame]) -> None:
    adam = train_bodies(cases, small_config(finish_heads=False), 3, "paper")
    finished = train_bodies(cases, small_config(finish_heads=True), 3, "paper")
    for name, body in adam.items():
        assert body.curve[-1, 1] < body.curve[0, 1]
        np.testing.assert_array_equal(body.basis(TIME01)[0], finished[name].basis(TIME01)[0])
    before, after = adam.training_errors(cases), finished.training_errors(cases)
    assert all(after[column] < before[column] for column in before)


@pytest.mark.thorough
def test_the_same_seed_gives_the_same_bytes(
    cases: Mapping[str, pd.DataFrame], conditioned: Bodies, tmp_path: Path
) -> None:
    one = conditioned.save(tmp_path / "a.pt").read_bytes()
    again = train_bodies(cases, small_config(), seed=3).save(tmp_path / "b.pt").read_bytes()
    other = train_bodies(cases, small_config(), seed=4).save(tmp_path / "c.pt").read_bytes()
    assert one == again != other


def test_bodies_come_back_bit_for_bit(conditioned: Bodies, tmp_path: Path) -> None:
    loaded = Bodies.load(conditioned.save(tmp_path / "bodies.pt"))
    assert loaded.kind == "conditioned" and list(loaded) == list(BODIES)
    for name, body in conditioned.items():
        for mine, theirs in zip(body.basis(TIME01), loaded[name].basis(TIME01), strict=True):
            np.testing.assert_array_equal(mine, theirs)
        np.testing.assert_array_equal(body.curve, loaded[name].curve)


# --- refusals ----------------------------------------------------------------------------------------------------


def test_refusals(cases: Mapping[str, pd.DataFrame]) -> None:
    with pytest.raises(InputError, match="case_iv"):
        train_bodies({"case_i": cases["case_i"]}, small_config(), 0)
    with pytest.raises(InputError, match="kind of bodies"):
        train_bodies(cases, small_config(), 0, "best")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="minutes a case"):
        train_bodies({**cases, "case_iv": smooth_recording(1, 2)}, small_config(), 0)
    with pytest.raises(InputError, match="no column x_r"):
        minutes(cases["case_i"].drop(columns="x_r"), "x_r")
    with pytest.raises(InputError, match="rows"):
        minutes(cases["case_i"].iloc[:200], "x_r")
