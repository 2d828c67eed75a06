"""The engine's maps as tables: CSV for people, one file of C with look-up functions for controllers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from dieseltwin.arrays import Array
from dieseltwin.atomic import atomic_folder
from dieseltwin.codegen.transpile import number
from dieseltwin.engine.binding import Model, bind
from dieseltwin.engine.map_corrections import CORRECTED_POINTS, GRIDS, OF_RATIO, arguments_of, corrections_of, look_up
from dieseltwin.engine.model_constants import Constants
from dieseltwin.engine.parameters import EngineParameters, constants
from dieseltwin.engine.terms import corrections_in

NODES = 33
"""Evenly spaced nodes of an argument; where a formula has a kink over it, there is one more."""

LOOKED_UP_C = "maps.c"
_RANGES: dict[str, tuple[float, float]] = {
    "p_im": (9e4, 3.5e5), "u_egr": (0.0, 100.0), "Pi_t": (0.25, 0.9999), "omega_t": (1500.0, 14000.0),
    "BSR": (0.2, 1.8), "W_c": (0.0, 0.6), "Pi_c": (1.0, 3.5),
}  # fmt: skip
"""What an engine of this kind can reach [SI, %]; engine speed and the VGT have the engine's own ranges."""

_KINKS = {"omega_t": ("c_m2", "omega_tlin"), "u_egr": ("u_egr_vertex",)}
"""Constants at which maps bend sharply over an argument."""

_UNITS = {"p_im": "Pa", "n_e": "rpm", "u_egr": "%", "u_vgt": "%", "Pi_t": "-", "omega_t": "rad/s", "BSR": "-",
          "W_c": "kg/s", "Pi_c": "-"}  # fmt: skip


@dataclass(frozen=True)
class Map:
    """One of the engine's empirical maps.

    Attributes:
        arguments: names in the order of `formula`.
        grid: of `map_corrections.GRIDS`, whose learned correction multiplies the map; None: it has tables of its own.
        meaning: in words.
        formula: model, constants and arguments -> values.
    """

    arguments: tuple[str, ...]
    grid: int | None
    meaning: str
    formula: Callable[..., Array]


_grid = CORRECTED_POINTS.index

MAPS: dict[str, Map] = {
    "eta_vol": Map(("p_im", "n_e"), _grid("eta_vol"), "volumetric efficiency [-] (A.6)",
                   lambda m, c, p, n: m.eta_vol(p, n, c)),
    "f_egr": Map(("u_egr",), _grid("f_egr"), "effective area ratio of the EGR valve [-] (A.23)",
                 lambda m, c, u: m.f_egr(u, c)),
    "F_vgt_Pi_t": Map(("u_vgt", "Pi_t"), _grid("W_t"), "VGT area ratio times choking function [-] (A.31)",
                      lambda m, c, u, Pi: m.F_vgt_Pi_t(u, Pi, c)),
    "eta_tm": Map(("omega_t", "BSR"), None,
                  "turbine efficiency with mechanical losses [-] (A.33); times the next two's sum less 1",
                  lambda m, c, w, BSR: m.eta_tm(w, BSR, 0.5, c)),
    "eta_tm_learned": Map(("omega_t", "Pi_t"), _grid("eta_tm"), "learned factor of the turbine efficiency [-]; 1: none",
                          lambda m, c, w, Pi: np.ones_like(w)),
    "eta_tm_learned_bsr": Map(("omega_t", "BSR"), OF_RATIO, "further learned factor of it [-]; 1: none",
                              lambda m, c, w, BSR: np.ones_like(w)),
    "eta_c": Map(("W_c", "Pi_c"), _grid("eta_c"), "compressor efficiency [-] (A.40)",
                 lambda m, c, W, Pi: m.eta_c(W, Pi, c)),
    "Phi_c": Map(("omega_t", "Pi_c"), _grid("W_c"), "volumetric flow coefficient of the compressor [-] (A.50)",
                 lambda m, c, w, Pi: m.Phi_c(c.T_amb, Pi, w, c)),
}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """A map on a grid: nodes of each argument, values over all of them (n_1, n_2, ...)."""

    nodes: dict[str, Array]
    values: Array


def tabulated(engine: EngineParameters) -> dict[str, Table]:
    """Every map of the engine on a grid, learned corrections applied; at the engine's ambient.

    The turbine efficiency stands over speed and blade speed ratio, its learned factors over speed and pressure quotient
    and over speed and blade speed ratio; with both it is the efficiency times their sum less 1.

    Effects other than learned corrections don't change a map, and aren't in the tables.
    """
    model, c = bind("numpy", {"blade_speed_ratio": _given}), constants(engine)
    coefficients = corrections_in(engine.terms)
    learned = None if coefficients is None else corrections_of(coefficients).tables
    ranges = {**_RANGES, "n_e": engine.n_e_range, "u_vgt": engine.u_vgt_range}
    out = {}
    for name, about in MAPS.items():
        nodes = {of: _nodes(of, ranges[of], c) for of in about.arguments}
        grid = dict(zip(nodes, np.meshgrid(*nodes.values(), indexing="ij"), strict=True))
        values = about.formula(model, c, *grid.values())
        if learned is not None and about.grid is not None and about.grid < len(learned):
            values = values * (1.0 + _correction(learned[about.grid], about.grid, grid, model, c))
        out[name] = Table(nodes, np.asarray(values, dtype=np.float64))
    return out


def _given(omega_t: Array, BSR: Array, Pi_t: Array, c: Constants) -> Array:
    """The blade speed ratio as it is given, in the place of the exhaust temperature."""
    return BSR


def _nodes(argument: str, ends: tuple[float, float], c: Constants) -> Array:
    kinks = [value for name, value in c._asdict().items() if name in _KINKS.get(argument, ())]
    return np.union1d(np.linspace(*ends, NODES), [value for value in kinks if ends[0] < value < ends[1]])


def _correction(table: Array, m: int, grid: dict[str, Array], model: Model, c: Constants) -> Array:
    at = dict(grid)
    if "W_c" in grid:
        at["W_cc"] = model.corrected_flow(at["W_c"], c)
    if "omega_t" in grid:
        at["omega_c"] = model.corrected_speed(at["omega_t"], c)
    if "Psi_c" in GRIDS[m][1]:
        at["Psi_c"] = model.energy_transfer_coefficient(c.T_amb, at["Pi_c"], at["omega_t"], c)
    return look_up(table, m, *arguments_of(m, at))


def write_tables(engine: EngineParameters, name: str, folder: Path) -> list[Path]:
    """Write every map as CSV (a row a node, units in the heading) and all of them as `maps.c`.

    Args:
        engine: with its learned corrections; name: of the engine, for the headings.
        folder: where to; made if it isn't there.

    Raises:
        InputError: a folder that can't be written to.
    """
    tables = tabulated(engine)
    with atomic_folder(folder) as temporary:
        for of, table in tables.items():
            _frame(of, table).to_csv(temporary / f"{of}.csv", index=False, float_format="%.8g")
        (temporary / LOOKED_UP_C).write_text(look_up_c(tables, name), encoding="utf-8")
    return [folder / f"{of}.csv" for of in tables] + [folder / LOOKED_UP_C]


def _frame(name: str, table: Table) -> pd.DataFrame:
    grid = np.meshgrid(*table.nodes.values(), indexing="ij")
    columns = {f"{of} [{_UNITS[of]}]": values.ravel() for of, values in zip(table.nodes, grid, strict=True)}
    return pd.DataFrame({**columns, f"{name} [-]": table.values.ravel()})


_LOOK_UP = """/* Multilinear look-up between nodes, held beyond the edges; the last argument runs fastest. */
static double look_up(const double *values, int arguments, const int *count, const double *const *nodes,
                      const double *at)
{
    int first[2];
    double share[2], sum = 0.0;
    for (int j = 0; j < arguments; j++) {
        const double *x = nodes[j];
        int low = 0, high = count[j] - 1;
        while (high - low > 1) {
            const int middle = (low + high) / 2;
            if (x[middle] <= at[j])
                low = middle;
            else
                high = middle;
        }
        const double place = (at[j] - x[low]) / (x[low + 1] - x[low]);
        first[j] = low;
        share[j] = place > 0.0 ? (place < 1.0 ? place : 1.0) : 0.0;
    }
    for (int corner = 0; corner < 1 << arguments; corner++) {
        double weight = 1.0;
        int index = 0;
        for (int j = 0; j < arguments; j++) {
            const int upper = corner >> j & 1;
            weight *= upper ? share[j] : 1.0 - share[j];
            index = index * count[j] + first[j] + upper;
        }
        sum += weight * values[index];
    }
    return sum;
}
"""


def look_up_c(tables: dict[str, Table], name: str) -> str:
    """One file of C with a function a map: `double map_eta_vol(double p_im, double n_e)`."""
    parts = [f"/* Maps of the engine {name}. */\n", _LOOK_UP]
    for of, table in tables.items():
        values = ",\n    ".join(
            ", ".join(f"{value:.9g}" for value in row) for row in table.values.reshape(-1, table.values.shape[-1])
        )
        units = ", ".join(f"{argument} [{_UNITS[argument]}]" for argument in table.nodes)
        given = ", ".join(f"double {argument}" for argument in table.nodes)
        nodes = "".join(
            f"    static const double at_{argument}[] = {{{', '.join(map(number, places))}}};\n"
            for argument, places in table.nodes.items()
        )
        parts.append(
            f"/* {MAPS[of].meaning} over {units}. */\ndouble map_{of}({given})\n{{\n"
            f"    static const double values[] = {{\n    {values}\n    }};\n{nodes}"
            f"    static const int count[] = {{{', '.join(str(places.size) for places in table.nodes.values())}}};\n"
            f"    const double *const nodes[] = {{{', '.join(f'at_{argument}' for argument in table.nodes)}}};\n"
            f"    const double at[] = {{{', '.join(table.nodes)}}};\n"
            f"    return look_up(values, {len(table.nodes)}, count, nodes, at);\n}}\n"
        )
    return "\n".join(parts)
