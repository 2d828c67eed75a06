"""The two rigs of the examples, simulated with what their twins lack: named, sized, and simulated better afterwards.

The plants are integrated here in small steps of their own, with dry friction that sticks and a tank that overflows.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from dieseltwin.discovery.search.stepwise import Story, discover_stepwise, free_run, metric_of, repaired

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))
import cascaded_tanks
import positioning_axis

MASS, F_V, F_C, OFFSET = 95.0, 203.0, 20.4, -3.0
"""Of the axis: mass [kg], viscous friction [N s/m], dry friction [N], constant force [N]."""

K_PUMP, K_UPPER, K_LOWER, AREA_RATIO, OVERFLOW = 0.047, 0.065, 0.062, 0.9, 0.15
"""Of the tanks, as the example has them; the upper one's overflow [1/s] falls into the lower one."""


def axis_recording(seconds: float = 8.0, seed: int = 0) -> np.ndarray:
    """Columns of the axis' recording at 1 kHz: time, position, its reference, voltage, motor force, pulse force."""
    rng = np.random.default_rng(seed)
    step, n = 1e-4, round(seconds * 1e4)
    time = np.arange(n) * step
    places = rng.uniform(0.0, 0.25, int(seconds / 1.5) + 3)
    smooth = np.hanning(4000)
    wanted = np.interp(time, 1.5 * np.arange(places.size), places)
    wanted = np.convolve(np.pad(wanted, (2000, 1999), mode="edge"), smooth / smooth.sum(), "valid")
    speed = np.gradient(wanted, step)
    q, v, force, rows = wanted[0], 0.0, 0.0, []
    for k in range(n):
        if k % 10 == 0:
            force = 9000.0 * (wanted[k] - q) + 1800.0 * (speed[k] - v) + 60.0 * np.sin(2.0 * np.pi * 7.0 * time[k])
            rows.append((time[k], q + 2e-6 * rng.standard_normal(), wanted[k], force / 35.0, force, 0.0))
        sliding = v != 0.0
        dry = F_C * np.sign(v) if sliding else float(np.clip(force - OFFSET, -F_C, F_C))
        faster = v + step * (force - F_V * v - dry - OFFSET) / MASS
        if sliding and v * faster < 0.0:
            faster = 0.0
        q, v = q + 0.5 * step * (v + faster), faster
    return np.array(rows)


def tanks_recording(n: int = 1024, seed: int = 0) -> np.ndarray:
    """Columns of the tanks' recording every 4 s: time, pump voltage, level of the lower tank [V]."""
    rng = np.random.default_rng(seed)
    time = 4.0 * np.arange(n)
    tones = np.arange(1, 18)
    pump = np.sin(2.0 * np.pi * np.outer(time / (4.0 * n), tones) + rng.uniform(0.0, 2.0 * np.pi, tones.size))
    pump = np.clip(3.2 + 1.8 * pump.sum(axis=1) / np.sqrt(0.5 * tones.size), 0.8, 8.0)
    upper, lower, parts, rows = 5.0, 5.0, 40, []
    for k in range(n):
        rows.append((time[k], pump[k], min(lower, 10.0) + 0.01 * rng.standard_normal()))
        for share in (np.arange(parts) + 0.5) / parts:
            voltage = pump[k] + share * (pump[min(k + 1, n - 1)] - pump[k])
            over, outlet = OVERFLOW * max(upper - 10.0, 0.0), K_UPPER * np.sqrt(max(upper, 0.0))
            filling = AREA_RATIO * (outlet + over) - K_LOWER * np.sqrt(max(lower, 0.0))
            upper += 4.0 / parts * (K_PUMP * voltage - outlet - over)
            lower += 4.0 / parts * filling
    return np.array(rows)


def test_axis_names_its_friction(tmp_path: Path) -> None:
    path = tmp_path / "axis.csv"
    np.savetxt(path, axis_recording(), delimiter=",", header="columns of the recording")
    twin = positioning_axis.twin(path, 1.0)
    story = discover_stepwise(twin, most=2, floor=1e-5)
    first, second = story.steps
    assert (first.name, first.site, first.rivals) == ("coulomb_friction", "force_balance", ())
    assert "constant_force" in (second.name, *second.rivals)
    magnitudes = {name: size for name, (size, _) in story.magnitudes.items()}
    assert magnitudes["coulomb_friction"] == pytest.approx(F_C, rel=0.05)
    assert story.after.parameters == pytest.approx([MASS, F_V], rel=0.03)
    assert story.after.objective < 0.1 * story.before.objective
    assert "coulomb_friction at force_balance: F_c sign(v)" in story.sentences()[0]


@pytest.fixture(scope="module")
def tanks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tanks") / "tanks.csv"
    np.savetxt(path, tanks_recording(), delimiter=",", header="columns of the recording")
    return path


@pytest.fixture(scope="module")
def overflow(tanks: Path) -> Story:
    """The story of the earlier half."""
    whole = cascaded_tanks.twin(tanks)
    return discover_stepwise(whole.windowed(350.0, slice(0, len(whole.time_s) // 2)), floor=0.01)


def test_tanks_name_the_overflow(overflow: Story) -> None:
    (step,) = overflow.steps
    assert (step.name, step.site) == ("upper_overflow", "lower_tank") and overflow.law is None
    size, std = overflow.magnitudes["upper_overflow"]
    assert size == pytest.approx(OVERFLOW, abs=4.0 * std) and std < 0.01
    true = (K_PUMP, K_UPPER, K_LOWER, AREA_RATIO)
    assert overflow.after.parameters == pytest.approx(true, rel=0.02)


def test_repaired_tanks_run_free_where_no_fit_has_seen_them(tanks: Path, overflow: Story) -> None:
    whole = cascaded_tanks.twin(tanks)
    later = whole.windowed(None, slice(len(whole.time_s) // 2, None))
    whitening = metric_of(later, 0.01)
    twin, fit = repaired(later, overflow)
    error = later.measured - free_run(twin, fit, whitening, 50)
    assert np.sqrt(np.mean(error[50:] ** 2)) < 0.02  # the readings' noise is 0.01 V
