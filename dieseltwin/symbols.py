"""The nomenclature: every quantity's symbol, file column, unit, plausible range and equation, each once.

Recordings validate their columns against it, figures and tables take their labels from it, MLflow metrics are named by
`Symbol.name`. Equation numbers are those of the paper's appendix (Nath et al., Appendix A); "published" marks what
the published simulation (Wahlstrom & Eriksson 2011) has beyond the printed equations.
"""

from __future__ import annotations

from dataclasses import dataclass

from dieseltwin.settings.names import unknown_name


@dataclass(frozen=True)
class Symbol:
    """One quantity.

    Attributes:
        name: the paper's symbol as used in code, metrics and JSON ("p_im").
        column: the column of recordings and traces, with its unit ("p_im_pa"); for parameters the name itself.
        unit: SI unit for people ("Pa"; "-" where dimensionless).
        low, high: the range that any engine of this kind stays in [unit]; a recording whose median lies outside is in
            another unit or not this quantity.
        equation: where it is defined ("A.1"; several by comma), "input", "parameter" or "published".
        latex: the symbol for figures, without dollar signs.
        meaning: a few words.
    """

    name: str
    column: str
    unit: str
    low: float
    high: float
    equation: str
    latex: str
    meaning: str

    @property
    def label(self) -> str:
        """Axis label, '$p_{im}$ [Pa]'; without brackets where dimensionless."""
        return f"${self.latex}$" if self.unit == "-" else f"${self.latex}$ [{self.unit}]"

    @property
    def allowed(self) -> str:
        """The plausible range in words, '3e+04 to 1e+06 Pa'."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        return f"{self.low:.6g} to {self.high:.6g}{unit}"


_TABLE: tuple[Symbol, ...] = (
    # inputs
    Symbol("t", "time_s", "s", -1e10, 1e10, "input", "t", "time"),
    Symbol("n_e", "n_e_rpm", "rpm", 300.0, 4000.0, "input", "n_e", "engine speed"),
    Symbol("u_delta", "u_delta_mg", "mg/cycle", 0.0, 500.0, "input", r"u_\delta", "fuel per cylinder and cycle"),
    Symbol("u_egr", "u_egr_pct", "%", 0.0, 100.0, "input", "u_{egr}", "EGR valve position, 0 shut"),
    Symbol("u_vgt", "u_vgt_pct", "%", 0.0, 100.0, "input", "u_{vgt}", "VGT position, 100 open"),
    Symbol("u_flap", "u_flap_pct", "%", 0.0, 100.0, "input", "u_{flap}", "exhaust flap position, 100 open"),
    # manifolds and shaft
    Symbol("p_im", "p_im_pa", "Pa", 5e4, 1e6, "A.1", "p_{im}", "intake manifold pressure"),
    Symbol("p_em", "p_em_pa", "Pa", 6e4, 1.2e6, "A.2", "p_{em}", "exhaust manifold pressure"),
    Symbol("omega_t", "omega_t_rad_s", "rad/s", 300.0, 25000.0, "A.24", r"\omega_t", "turbocharger speed"),
    # cylinder
    Symbol("W_ei", "w_ei_kg_s", "kg/s", 0.0, 2.0, "A.3", "W_{ei}", "flow into the cylinders"),
    Symbol("W_eo", "w_eo_kg_s", "kg/s", 0.0, 2.0, "A.4", "W_{eo}", "flow out of the cylinders"),
    Symbol("W_f", "w_f_kg_s", "kg/s", 0.0, 0.1, "A.5", "W_f", "fuel flow"),
    Symbol("eta_vol", "eta_vol", "-", 0.3, 1.3, "A.6", r"\eta_{vol}", "volumetric efficiency"),
    Symbol("T_e", "t_e_k", "K", 250.0, 2500.0, "A.7", "T_e", "cylinder-out temperature"),
    Symbol("T_1", "t_1_k", "K", 240.0, 600.0, "A.9", "T_1", "temperature at intake valve closing"),
    Symbol("x_r", "x_r", "-", 0.0, 0.3, "A.10", "x_r", "residual gas fraction"),
    Symbol("T_em", "t_em_k", "K", 290.0, 1500.0, "A.15", "T_{em}", "exhaust manifold temperature"),
    # EGR valve
    Symbol("u_egr1", "u_egr1_pct", "%", -200.0, 300.0, "A.16", r"\tilde u_{egr1}", "quick EGR actuator state"),
    Symbol("u_egr2", "u_egr2_pct", "%", -200.0, 300.0, "A.17", r"\tilde u_{egr2}", "slow EGR actuator state"),
    Symbol("W_egr", "w_egr_kg_s", "kg/s", -0.002, 0.6, "A.19", "W_{egr}", "EGR flow"),
    Symbol("f_egr", "f_egr", "-", 0.0, 1.0, "A.23", "f_{egr}", "effective EGR area ratio"),
    # turbine
    Symbol("u_vgt_act", "u_vgt_act_pct", "%", -50.0, 150.0, "A.25", r"\tilde u_{vgt}", "VGT actuator state"),
    Symbol("W_t", "w_t_kg_s", "kg/s", 0.0, 2.0, "A.26", "W_t", "turbine flow"),
    Symbol("F_vgt_Pi_t", "f_vgt_pi_t", "-", 0.0, 1.3, "A.31", r"F_{vgt,\Pi_t}", "VGT area ratio times choking"),
    Symbol("P_t_eta_m", "p_t_eta_m_w", "W", 0.0, 5e5, "A.32", r"P_t\eta_m", "turbine power on the shaft"),
    Symbol("eta_tm", "eta_tm", "-", 0.0, 1.0, "A.33", r"\eta_{tm}", "turbine and mechanical efficiency"),
    # compressor
    Symbol("T_c", "t_c_k", "K", 200.0, 700.0, "A.36", "T_c", "compressor-out temperature"),
    Symbol("P_c", "p_c_w", "W", 0.0, 5e5, "A.39", "P_c", "compressor power"),
    Symbol("eta_c", "eta_c", "-", 0.0, 1.0, "A.40", r"\eta_c", "compressor efficiency"),
    Symbol("W_c", "w_c_kg_s", "kg/s", 0.0, 2.0, "A.49", "W_c", "compressor flow"),
    Symbol("Phi_c", "phi_c", "-", 0.0, 0.6, "A.50", r"\Phi_c", "volumetric flow coefficient"),
    # beyond the printed equations
    Symbol("X_Oim", "x_oim", "-", 0.0, 0.25, "published", "X_{Oim}", "oxygen mass fraction, intake manifold"),
    Symbol("X_Oem", "x_oem", "-", 0.0, 0.25, "published", "X_{Oem}", "oxygen mass fraction, exhaust manifold"),
    Symbol("lambda", "lambda", "-", 0.0, 1e6, "published", r"\lambda", "air to stoichiometric air"),
    Symbol("egr_fraction", "egr_fraction", "-", 0.0, 1.0, "published", r"W_{egr}/(W_c+W_{egr})", "EGR fraction"),
    Symbol("M_e", "torque_nm", "N m", -2000.0, 6000.0, "published", "M_e", "engine torque"),
    Symbol("T_im", "t_im_k", "K", 230.0, 500.0, "input", "T_{im}", "intake manifold temperature"),
    # ambient
    Symbol("p_amb", "p_amb_pa", "Pa", 5e4, 1.3e5, "input", "p_{amb}", "ambient pressure"),
    Symbol("T_amb", "t_amb_k", "K", 210.0, 340.0, "input", "T_{amb}", "ambient temperature"),
    # health parameters
    Symbol("A_egrmax", "A_egrmax", "m2", 1e-6, 1e-2, "A.21", "A_{egrmax}", "largest effective EGR area"),
    Symbol("A_vgtmax", "A_vgtmax", "m2", 1e-6, 1e-1, "A.26", "A_{vgtmax}", "largest VGT area"),
    Symbol("eta_sc", "eta_sc", "-", 0.3, 3.0, "A.7", r"\eta_{sc}", "compensation for non-ideal cycles"),
    Symbol("h_tot", "h_tot", "W/(m2 K)", 0.1, 5000.0, "A.15", "h_{tot}", "heat transfer of the exhaust pipes"),
)

SYMBOLS: dict[str, Symbol] = {s.name: s for s in _TABLE}
BY_COLUMN: dict[str, Symbol] = {s.column: s for s in _TABLE}

INPUT_COLUMNS = ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")
"""Columns of the engine's inputs, in the order of every array of inputs."""
STATES = tuple(SYMBOLS[name].column for name in ("p_im", "p_em", "omega_t", "x_r", "T_1"))
"""Columns of the engine's states, in the order of every array of states."""
HEALTH_NAMES = ("A_egrmax", "A_vgtmax", "eta_sc", "h_tot")


def symbol(name_or_column: str) -> Symbol:
    """The symbol of a name ("p_im") or of a column ("p_im_pa").

    Raises:
        InputError: neither a name nor a column; the message holds the closest ones.
    """
    found = SYMBOLS.get(name_or_column) or BY_COLUMN.get(name_or_column)
    if found is None:
        raise unknown_name("nomenclature", name_or_column, [*SYMBOLS, *BY_COLUMN])
    return found


def label(name_or_column: str) -> str:
    """Axis label with unit for a name or a column; an unknown one is returned as it is (channels of other rigs)."""
    found = SYMBOLS.get(name_or_column) or BY_COLUMN.get(name_or_column)
    return found.label if found is not None else name_or_column
