"""Corrections of the maps: a fixed basis, the same value in the compiled simulator and along its trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.engine import Inputs, constants, load_engine, simulate, we2011
from dieseltwin.engine.actuation import actuate_lanes
from dieseltwin.engine.binding import numpy_model
from dieseltwin.engine.extended import Extension, simulate_extended
from dieseltwin.engine.extended_terms import along
from dieseltwin.engine.map_corrections import (
    ARGUMENTS,
    CORRECTED_POINTS,
    GRIDS,
    NODES,
    OF_RATIO,
    RANGES,
    basis,
    basis_along,
    corrections_of,
    look_up,
)
from dieseltwin.engine.parameters import parameter_batch
from dieseltwin.engine.terms import CorrectionTerm
from dieseltwin.errors import InputError


def _inputs() -> Inputs:
    time = np.arange(0.0, 20.0, 0.2)
    return Inputs(
        time, 1400.0 + 300.0 * np.sin(0.4 * time), 110.0 + 60.0 * np.sin(0.7 * time), 20.0 + 15.0 * np.sin(time),
        50.0 + 15.0 * np.cos(0.5 * time),
    )  # fmt: skip


def _engine(coefficients: np.ndarray):
    return we2011.PARAMETERS.replace(terms=(CorrectionTerm(coefficients=tuple(coefficients)),))


def test_every_map_has_unit_variance_inside_its_ranges():
    functions = basis()
    for m in range(len(GRIDS)):
        of_map = functions.grids == m
        variance = (functions.tables[of_map & ~functions.finer] ** 2).sum(axis=0)
        assert 0.98 < variance.mean() <= 1.0
        if m == OF_RATIO:
            continue
        tables, covariance = functions.tables[of_map], functions.finer_covariance[np.ix_(of_map, of_map)]
        finer = np.einsum("kxy,kl,lxy->xy", tables, covariance, tables)
        assert 0.98 < finer.mean() <= 1.0
        assert finer.min() > 0.9 and finer.max() < 1.3
    assert len(set(functions.names)) == len(functions.names) == len(functions.maps)


def test_look_up_meets_the_nodes_and_holds_beyond_the_edges():
    tables = basis().tables[:3]
    low, high = zip(*(RANGES[name] for name in ARGUMENTS["eta_vol"]), strict=True)
    x, y = (np.linspace(a, b, NODES) for a, b in zip(low, high, strict=True))
    assert look_up(tables, 0, x, y) == pytest.approx(tables[:, np.arange(NODES), np.arange(NODES)], abs=1e-12)
    beyond = look_up(tables, 0, np.array([0.0]), np.array([9e9]))[:, 0]
    assert beyond == pytest.approx(tables[:, 0, -1])


def test_look_up_takes_points_of_any_shape_and_unknown_ones():
    tables = np.random.default_rng(5).normal(size=(3, NODES, NODES))
    x, y = np.linspace(1e5, 3e5, 6).reshape(2, 3), np.float64(1200.0)
    several = look_up(tables, 0, x, y)
    assert several.shape == (3, 2, 3)
    assert np.array_equal(several.reshape(3, -1), look_up(tables, 0, x.ravel(), np.full(6, 1200.0)))
    unknown, lowest = look_up(tables, 0, np.array([np.nan]), y), look_up(tables, 0, np.array([0.0]), y)
    assert np.array_equal(unknown, lowest)


def test_corrections_of_zero_are_the_published_model():
    plain = simulate(_inputs(), we2011.PARAMETERS)
    corrected = simulate(_inputs(), _engine(np.zeros(len(basis().names))))
    for name in ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_c_kg_s"):
        assert corrected[name].to_numpy() == pytest.approx(plain[name].to_numpy(), rel=1e-3)


def test_simulator_and_frame_look_up_the_same_correction():
    """W_t of the frame is the simulated balance's own: with a corrected map the exhaust manifold still closes."""
    coefficients = 0.02 * np.random.default_rng(3).standard_normal(len(basis().names))
    table = simulate(_inputs(), _engine(coefficients))
    c = we2011.PARAMETERS
    states = (table["omega_t_rad_s"], table["t_em_k"], table["p_es_pa"] / table["p_em_pa"])
    variables = {
        "p_im": table["p_im_pa"], "n_e": table["n_e_rpm"], "u_egr": table["u_egr1_pct"],
        "u_vgt": table["u_vgt_act_pct"],
        "Pi_t": table["p_es_pa"] / table["p_em_pa"], "omega_t": table["omega_t_rad_s"], "W_c": table["w_c_kg_s"],
        "Pi_c": table["p_im_pa"] / table["p_bc_pa"], "Psi_c": np.zeros(len(table)),
        "BSR": numpy_model().blade_speed_ratio(*states, constants(c)),
    }  # fmt: skip
    along = basis_along({name: np.asarray(values) for name, values in variables.items()})
    at = basis().maps == CORRECTED_POINTS.index("eta_vol")
    published = c.c_vol[0] * np.sqrt(table["p_im_pa"]) + c.c_vol[1] * np.sqrt(table["n_e_rpm"]) + c.c_vol[2]
    assert table["eta_vol"].to_numpy() == pytest.approx((published * (1.0 + coefficients[at] @ along[at])).to_numpy())
    at = basis().maps == CORRECTED_POINTS.index("eta_tm")
    published = numpy_model().eta_tm(*states, constants(c))
    assert table["eta_tm"].to_numpy() == pytest.approx((published * (1.0 + coefficients[at] @ along[at])).to_numpy())
    # at the end, nearly at rest over a step, the flows of the intake manifold balance its pressure's change
    rate = c.R_a * table["t_im_k"] / c.V_im * (table["w_c_kg_s"] + table["w_egr_kg_s"] - table["w_ei_kg_s"])
    change = np.gradient(table["p_im_pa"], table["time_s"])
    inner = slice(5, -5)
    assert np.corrcoef(rate[inner], change[inner])[0, 1] > 0.98


def test_the_simulator_looks_the_compressor_up_in_the_weather_of_its_maps():
    """At rest the balances close along the trajectory by corrected flow and speed; by mass flow they don't."""
    coefficients = np.where(basis().usual, 0.03 * np.random.default_rng(3).standard_normal(len(basis().names)), 0.0)
    raw = _engine(coefficients).replace(p_amb=85e3, T_amb=275.0, p_cmap=101e3, T_cmap=298.0)
    high_up, time = raw.replace(k_cflow=1.0, k_cspeed=1.0), np.arange(0.0, 40.0, 0.2)
    inputs = Inputs(time, *(np.full(time.size, value) for value in (1400.0, 120.0, 20.0, 50.0)))
    actuation = actuate_lanes(inputs, high_up, {}, 1, None, 0.025)[0]
    plain = Extension(corrections=corrections_of(coefficients))
    first = np.array([[[1.4e5, 1.6e5, 6000.0]]])
    states = simulate_extended(actuation, parameter_batch(high_up), plain, first).states[0]
    rest, unlike = (along(states, actuation, engine.terms, constants(engine))[0] for engine in (high_up, raw))
    assert abs(rest.domega_t[-1]) < 1.0 and abs(rest.dp_im[-1]) < 20.0  # of 6000 rad/s and 140 kPa, a second
    assert abs(unlike.domega_t[-1]) > 100.0


def test_another_number_of_coefficients_is_refused():
    with pytest.raises(InputError, match="coefficients"):
        we2011.PARAMETERS.replace(terms=({"coefficients": [0.1]},))


def test_tables_are_sums_of_the_basis():
    coefficients = np.zeros(len(basis().names))
    coefficients[0] = 0.5
    tables = corrections_of(coefficients).tables
    assert tables[0] == pytest.approx(0.5 * basis().tables[0])
    assert not tables[1:].any()


def test_engine_without_a_second_file_is_no_learned_engine(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("learned: mine.learned.parquet\nlearned_sha256: abc\n")
    with pytest.raises(InputError, match=r"no mine\.learned\.parquet beside it"):
        load_engine(path)
