"""What may differ in the diesel engine: its insertion points (where, what a law may depend on there, over what its map
may be off), and the effects by name."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from dieseltwin.discovery.twins.interface import Hypothesis, LawScope
from dieseltwin.engine.effects import ACTUATION_EFFECTS, EFFECTS
from dieseltwin.engine.terms import LAW_VARIABLES, SENSOR_UNITS

LAW_KINDS = ("power", "ratio", "time", "difference", "head", "above_one", "share", "orifice", "bump")
"""Factors of laws that an engine file can carry (`engine.terms.LawTerm`)."""

OPERATORS = ("lag", "dead_time", "play")
"""Operators of laws, of actuators and gas: no slow rows show them."""


LAW_SCOPE = LawScope(
    kinds=(*LAW_KINDS, *OPERATORS), variables=LAW_VARIABLES, lagging_sensors=tuple(SENSOR_UNITS),
    channel_units=SENSOR_UNITS,
    commands={(e.enters.operator, f"u_{e.enters.name}"): e.name for e in EFFECTS.values()
              if e.enters.through == "command"},
    lags={e.enters.name: e.name for e in EFFECTS.values()
          if e.enters.operator == "lag" and e.enters.through in ("gas", "input")},
    holes={"intake_balance": "boost_leak", "exhaust_balance": "exhaust_leak"},
)  # fmt: skip
"""What laws of the diesel engine may be made of, where rows aren't slow."""


@dataclass(frozen=True)
class PointFacts:
    """Site, ports, size of an added signal, and the arguments of the map there (two ways of thinking of it)."""

    site: str
    ports: tuple[str, ...]
    scale: float = 1.0
    over: tuple[str, ...] = ()
    also: tuple[str, ...] = ()


POINT_FACTS: dict[str, PointFacts] = {
    "eta_vol": PointFacts("cylinder_flow", ("p_im", "n_e", "Pi_e"), over=("p_im", "n_e")),
    "W_eo": PointFacts("exhaust_mass_balance", ("p_im", "n_e", "u_delta")),
    "T_e": PointFacts("cylinder_out_temperature", ("u_delta", "n_e", "Pi_e")),
    "T_em": PointFacts("exhaust_temperature", ("T_em", "T_e", "W_eo", "W_f", "n_e")),
    "f_egr": PointFacts("egr_flow", ("u_egr", "Pi_egr", "t"), over=("u_egr",)),
    "W_t": PointFacts("turbine_flow", ("p_em", "u_vgt", "omega_t"), over=("u_vgt", "Pi_t")),
    "eta_tm": PointFacts(
        "turbine_power", ("omega_t", "Pi_t", "u_vgt"), over=("omega_t", "Pi_t"), also=("BSR", "omega_t")
    ),
    "p_es": PointFacts("turbine_flow", ("W_t", "T_em")),
    "W_c": PointFacts("compressor_flow", ("Pi_c", "omega_t"), over=("Psi_c", "omega_t"), also=("Pi_c", "omega_t")),
    "eta_c": PointFacts("compressor_power", ("Pi_c", "W_c"), over=("W_c", "Pi_c")),
    "p_bc": PointFacts("compressor_flow", ("W_c",)),
    "T_im": PointFacts("intake_temperature", ("T_c", "W_egr", "W_c", "egr_share", "T_em")),
    "intake_balance": PointFacts("intake_mass_balance", ("p_im",), 0.1),
    "exhaust_balance": PointFacts("exhaust_mass_balance", ("p_em", "T_em"), 0.1),
    "shaft_power": PointFacts("shaft_power", ("omega_t",), 5e3),
    "u_delta": PointFacts("fuel_injection", ("u_delta", "n_e")),
    "u_egr": PointFacts("egr_actuator", ("u_egr",), 20.0),
    "u_vgt": PointFacts("vgt_actuator", ("u_vgt",), 20.0),
    "egr_opening": PointFacts("egr_flow", ("u_egr", "Pi_egr", "t"), 0.2),
}
"""By the names of `engine.quantities.POINTS`."""


def hypotheses_of(
    channels: Sequence[str], further: Collection[str] = (), slow_rows: bool = False
) -> dict[str, Hypothesis]:
    """The effects that may explain a recording with these sensors and further inputs, by name.

    Slow rows don't say what the inputs did in between, so that lags, dead times and play of them are out of reach.
    """
    return {
        e.name: Hypothesis(
            e.name, e.site, e.law, e.unit, e.tolerance, e.limits, e.smooth, e.sizes, e.kind,
            f"u_{e.enters.name}_pct" if e.enters.operator == "stuck" else "",
        )
        for e in EFFECTS.values()
        if (e.enters.through != "reading" or e.enters.name in channels) and set(e.needs) <= set(further)
        and not (slow_rows and e.name in ACTUATION_EFFECTS)
    }
