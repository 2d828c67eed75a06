"""The plant agrees with the twin where nothing is left out or the same is, and keeps its balances."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dieseltwin.challenge import plant
from dieseltwin.challenge.driving import Driving
from dieseltwin.challenge.map_errors import MAPS, TURBINE_OF_RATIO, MapErrors
from dieseltwin.challenge.plant import PlantRun, run_plant
from dieseltwin.challenge.plant_constants import plant_constants
from dieseltwin.challenge.plant_effects import FAMILIES, FLAP, Fault
from dieseltwin.challenge.routes import ECU, UNSTABLE_RPM, draw_driving
from dieseltwin.challenge.sensors import SENSORS, SensorSet, ar1, quantised, read, shown
from dieseltwin.engine import Inputs, simulate, we2011
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.terms import Term

LABORATORY = we2011.PARAMETERS.model_dump()
START = np.array([1.05e5, 1.1e5, 2000.0])
CATALOGUED = [name for name, family in FAMILIES.items() if family.catalogued]


@pytest.fixture(scope="module")
def drive() -> Driving:
    return draw_driving("random", 90.0, LABORATORY, np.random.default_rng(4))


def twin(drive: Driving, *terms: Term) -> dict[str, np.ndarray]:
    inputs = Inputs(drive.time_s, drive.n_e_rpm, drive.u_delta_mg, drive.u_egr_pct, drive.u_vgt_pct)
    engine = we2011.PARAMETERS.replace(terms=terms)
    frame = simulate(inputs, engine, initial=START, oxygen=False, step_s=0.005)
    return {name: frame[name].to_numpy() for name in frame}


def difference(signals: dict[str, np.ndarray], reference: dict[str, np.ndarray]) -> tuple[float, float]:
    """Largest and rms difference after the first second over the sensors, in per cent of the mean."""
    errors = [(signals[k] - reference[k])[5:] / reference[k].mean() for k in SENSORS]
    return 100 * max(np.abs(e).max() for e in errors), 100 * max(np.sqrt(np.mean(e**2)) for e in errors)


def test_plant_module_imports_nothing_of_the_engine() -> None:
    for name in ("plant", "plant_constants", "plant_effects", "actuators", "map_errors", "driving", "sensors"):
        source = (Path(plant.__file__).parent / f"{name}.py").read_text()
        imported = [node.module for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom)]
        assert not [m for m in imported if m and m.startswith("dieseltwin.engine")], name


def test_healthy_plant_is_the_twin(drive: Driving) -> None:
    run = run_plant(drive, LABORATORY, initial=START)
    largest, rms = difference(run.columns, twin(drive))
    assert largest < 0.05 and rms < 0.01


@pytest.mark.parametrize("name", [name for name in CATALOGUED if name != FLAP])
def test_every_effect_is_the_twins(name: str, drive: Driving) -> None:
    family = FAMILIES[name]
    magnitude = 45.0 if name.endswith("_stuck") else min(5.0 * family.tolerance, family.upper)
    fault = Fault(name, magnitude, onset_s=40.0 if family.onset else None)
    run = run_plant(drive, LABORATORY, (fault,), initial=START)
    signals = shown(run, drive, (fault,), SensorSet.perfect())
    reference = twin(drive, Term(effect=name, magnitude=magnitude, onset_s=fault.onset_s))
    largest, rms = difference(signals, reference)
    assert largest < (0.6 if name.endswith("_stuck") else 0.15)  # a jump takes it a step
    assert rms < 0.03
    without = twin(drive)
    assert difference(reference, without)[1] > 5 * rms


def test_a_path_that_has_clogged_passes_nothing(drive: Driving) -> None:
    """The share closed grows without end; the flow doesn't turn."""
    run = run_plant(drive, LABORATORY, (Fault("egr_clogging", 0.02),), initial=START)
    flow = run["w_egr_kg_s"]
    assert flow.min() >= 0.0 and flow[:100].max() > 0.0 and not flow[drive.time_s >= 50.0].any()


def test_a_flap_half_open_is_a_back_pressure(drive: Driving) -> None:
    """Elsewhere its area follows another law than the catalogue's, on purpose."""
    half, shut = (replace(drive, u_flap_pct=np.full(drive.time_s.size, pct)) for pct in (50.0, 25.0))
    same = run_plant(drive, LABORATORY, (Fault("back_pressure", 1e5),), initial=START)
    flap = (Fault(FLAP, 1e5),)
    np.testing.assert_allclose(run_plant(half, LABORATORY, flap, initial=START)["p_em_pa"], same["p_em_pa"], rtol=1e-12)
    more = run_plant(shut, LABORATORY, flap, initial=START)["p_es_pa"] - LABORATORY["p_amb"]
    assert more.mean() > 2.0 * (same["p_es_pa"] - LABORATORY["p_amb"]).mean()


@pytest.mark.parametrize("name", CATALOGUED)
def test_families_are_the_catalogues(name: str) -> None:
    family, effect = FAMILIES[name], EFFECTS[name]
    assert (family.site, family.unit, family.tolerance) == (effect.site, effect.unit, effect.tolerance)
    assert family.upper <= effect.limits[1] and family.signed <= (effect.limits[0] < 0.0)


def test_hidden_families_are_in_no_catalogue() -> None:
    assert not [name for name, family in FAMILIES.items() if not family.catalogued and name in EFFECTS]


def test_mass_is_kept(drive: Driving) -> None:
    faults = (Fault("boost_leak", 3e-5), Fault("exhaust_leak", 3e-5))
    run = run_plant(drive, LABORATORY, faults, MapErrors.draw(0.003, np.random.default_rng(1)), initial=START)
    # gas in the manifolds changes by what flows in and out (T_im is constant without a thermal fault)
    mass = run["p_im_pa"] * LABORATORY["V_im"] / (LABORATORY["R_a"] * LABORATORY["T_im"])
    net = run["w_c_kg_s"] + run["w_egr_kg_s"] - run["w_ei_kg_s"] - run["w_leak_im_kg_s"]
    integral = np.concatenate([[0.0], np.cumsum(0.1 * (net[1:] + net[:-1]))])
    later = slice(10, None)  # the start is away from rest: quicker than the samples
    stored = mass[later] - mass[10] - (integral[later] - integral[10])
    assert np.abs(stored).max() < 0.02 * np.ptp(mass)
    assert (run["w_leak_im_kg_s"] >= 0).all() and run["w_leak_em_kg_s"].min() > 0


def test_choked_leak_has_its_flow() -> None:
    n = 200
    high = Driving(0.2 * np.arange(n), np.full(n, 1600.0), np.full(n, 190.0), np.zeros(n), np.full(n, 55.0))
    run = run_plant(high, LABORATORY, (Fault("boost_leak", 5e-5),))
    gamma = LABORATORY["gamma_a"]
    choked = np.sqrt(gamma * (2.0 / (gamma + 1.0)) ** ((gamma + 1.0) / (gamma - 1.0)))
    p = run["p_im_pa"][-1]
    assert p > 2.0 * LABORATORY["p_amb"]
    expected = 5e-5 * p * choked / np.sqrt(LABORATORY["R_a"] * LABORATORY["T_im"])
    assert run["w_leak_im_kg_s"][-1] == pytest.approx(expected, rel=1e-9)


def test_implicit_laws_are_solved(drive: Driving) -> None:
    faults = (Fault("back_pressure", 1e5), Fault("air_filter_restriction", 4e4))
    run = run_plant(drive, LABORATORY, faults, initial=START)
    p_amb = LABORATORY["p_amb"]
    assert run["p_es_pa"] == pytest.approx(p_amb + 1e5 * run["w_t_kg_s"] ** 2 * run["t_em_k"] / 700.0, abs=0.1)
    assert run["p_bc_pa"] == pytest.approx(p_amb - 4e4 * run["w_c_kg_s"] ** 2, abs=0.1)


def test_half_the_step_changes_nothing(drive: Driving) -> None:
    coarse, fine = (run_plant(drive, LABORATORY, initial=START, step_s=h) for h in (0.005, 0.0025))
    assert difference(coarse.columns, fine.columns)[0] < 0.05


def test_map_errors_have_their_rms_and_are_smooth() -> None:
    draws = [MapErrors.draw(0.003, np.random.default_rng(k)).tables for k in range(60)]
    rms = np.sqrt(np.mean(np.square(draws), axis=(0, 2, 3)))
    assert rms[TURBINE_OF_RATIO] == 0.0
    rms = rms[: len(MAPS)]
    assert rms == pytest.approx(np.full(len(MAPS), 0.003), rel=0.25)
    fields = np.array(draws)[:, 0]
    third = fields.shape[1] // 3
    near = np.mean(fields[:, 1:] * fields[:, :-1]) / np.mean(fields**2)
    far = np.mean(fields[:, third:] * fields[:, :-third]) / np.mean(fields**2)
    assert near > 0.99 and far == pytest.approx(np.exp(-0.5), abs=0.12)


def test_an_error_over_the_blade_speed_ratio_changes_with_the_exhausts_temperature(drive: Driving) -> None:
    """Of the turbine's efficiency alone, by what its table says at the ratio that speed, drop and temperature give."""
    maps = MapErrors.none()
    ratio = np.linspace(maps.low[TURBINE_OF_RATIO, 1], maps.high[TURBINE_OF_RATIO, 1], maps.tables.shape[2])
    maps.tables[TURBINE_OF_RATIO] = 0.1 * (ratio - 0.6)
    run = run_plant(drive, LABORATORY, (), maps, initial=START)
    c, omega = plant_constants(LABORATORY), run["omega_t_rad_s"]
    drop = 1.0 - (c.p_amb / run["p_em_pa"]) ** ((c.gamma_e - 1.0) / c.gamma_e)
    of = np.minimum(c.R_t * omega / np.sqrt(2.0 * c.c_pe * run["t_em_k"] * drop), 2.0 * c.BSR_opt)
    turning = omega > c.omega_tlin
    curvature = c.c_m0 * (omega - c.c_m1)[turning] ** c.c_m2
    plain = np.clip(c.eta_tmmax - curvature * (of[turning] - c.BSR_opt) ** 2, 0.2, 1.0)
    off = 0.1 * (np.clip(of[turning], ratio[0], ratio[-1]) - 0.6)
    assert np.ptp(off) > 0.01 and turning.mean() > 0.5
    assert run["eta_tm"][turning] == pytest.approx(plain * (1.0 + off), rel=1e-9)


def test_noise_is_what_it_says() -> None:
    noise = ar1(200_000, 0.4, np.random.default_rng(0))
    assert noise.std() == pytest.approx(1.0, abs=0.02)
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.4, abs=0.02)
    levels = quantised(np.linspace(-1.0, 2.0, 1000), (0.0, 1.0))
    assert np.unique(levels).size <= 4096 and levels.min() == 0.0 and levels.max() == 1.0


def test_reading_shows_gain_offset_and_fault(drive: Driving) -> None:
    run = run_plant(drive, LABORATORY, initial=START)
    fault = Fault("p_em_offset", 3000.0, onset_s=45.0)
    plain, faulty = (shown(run, drive, faults, SensorSet.perfect()) for faults in ((), (fault,)))
    change = faulty["p_em_pa"] - plain["p_em_pa"]
    assert (change[drive.time_s < 45.0] == 0).all() and change[-1] == 3000.0
    assert all((faulty[k] == plain[k]).all() for k in SENSORS if k != "p_em_pa")
    gain = SensorSet(np.full(6, 0.01), np.zeros(6), np.zeros(6))
    assert shown(run, drive, (), gain)["w_c_kg_s"] == pytest.approx(1.01 * run["w_c_kg_s"])
    five = read(run, drive, (), SensorSet.perfect(), 5, np.random.default_rng(0))
    assert "w_c_kg_s" not in five and len(five) == drive.time_s.size


def test_region_and_onset_confine() -> None:
    drive = draw_driving("random", 60.0, LABORATORY, np.random.default_rng(8))
    runs = [run_plant(drive, LABORATORY, faults) for faults in (
        (), (Fault("boost_leak", 4e-5, onset_s=30.0),), (Fault("boost_leak", 4e-5, region={"n_e_rpm": (0.0, 1.0)}),)
    )]  # fmt: skip
    early = drive.time_s < 30.0
    assert (runs[1]["p_im_pa"][early] == runs[0]["p_im_pa"][early]).all()
    assert (runs[1]["w_leak_im_kg_s"][early] == 0).all() and runs[1]["w_leak_im_kg_s"][-1] > 0
    assert (runs[2]["p_im_pa"] == runs[0]["p_im_pa"]).all()


@pytest.mark.parametrize("kind", ["random", "whtc", "unstable"])
def test_driving_keeps_the_limits(kind: str) -> None:
    drive = draw_driving(kind, 240.0, LABORATORY, np.random.default_rng(11))
    run: PlantRun = run_plant(drive, LABORATORY)
    assert drive.time_s.size == 1200 and np.diff(drive.time_s) == pytest.approx(np.full(1199, 0.2))
    fuel_flow = drive.u_delta_mg * 1e-6 * LABORATORY["n_cyl"] * drive.n_e_rpm / 120.0
    air_fuel = run["w_c_kg_s"] / (fuel_flow * LABORATORY["AF_s"])
    assert np.quantile(air_fuel, 0.01) > ECU.smoke_lambda_min - 0.05
    assert run["omega_t_rad_s"].max() < ECU.turbo_speed_max_rad_s
    if kind == "unstable":
        assert np.mean((drive.n_e_rpm > UNSTABLE_RPM[0] - 20) & (drive.u_delta_mg < 70)) > 0.2
