"""Turbine and compressor (paper, appendix A.I "Turbocharger", "Compressor")."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array, maximum, minimum, positive_power, root, where
from dieseltwin.engine.model_constants import Constants

PI_T_MAX = 0.9999  # limiters of the published simulation: turbine pressure quotient,
ETA_TM_MIN = 0.2  # turbine efficiency in [0.2, 1],
ETA_TM_MAX = 1.0
C_PSI1_MIN = 0.0  # ellipse coefficients of the compressor map,
C_PHI1_MIN = 0.1
ETA_C_MIN = 0.2  # compressor efficiency,
W_C_MIN = 1e-4  # kg/s compressor flow


def turbine_pressure_ratio(p_em: Array, c: Constants) -> Array:
    """Pressure quotient over the turbine Pi_t [-] (A.28), at most 0.9999."""
    return minimum(c.p_amb / p_em, PI_T_MAX)


def f_Pi_t(Pi_t: Array, c: Constants) -> Array:
    """Choking function of the turbine f_Pi_t [-] (A.27)."""
    return root(1.0 - positive_power(Pi_t, c.K_t))


def f_vgt(u_vgt: Array, c: Constants) -> Array:
    """Effective area ratio of the VGT f_vgt [-] (A.30; A.29 is its implicit form) from u~_vgt [%]."""
    x = (u_vgt - c.c_vgt2) / c.c_vgt1
    return c.c_f2 + c.c_f1 * root(1.0 - x * x)


def F_vgt_Pi_t(u_vgt: Array, Pi_t: Array, c: Constants) -> Array:
    """Product of VGT area ratio and choking function F_vgt,Pi_t [-] (A.31). Empirical map N_3."""
    return f_vgt(u_vgt, c) * f_Pi_t(Pi_t, c)


def turbine_flow(F_vgt_Pi_t: Array, p_em: Array, T_em: Array, c: Constants) -> Array:
    """Turbine mass flow W_t [kg/s] (A.26)."""
    return c.A_vgtmax * p_em * F_vgt_Pi_t / root(T_em * c.R_e)


def turbine_expansion(Pi_t: Array, c: Constants) -> Array:
    """Isentropic temperature drop over inlet temperature 1 - Pi_t**(1 - 1/gamma_e) [-] (factor of A.32 and A.34)."""
    return 1.0 - positive_power(Pi_t, c.turbine_exponent)


def blade_speed_ratio(omega_t: Array, T_em: Array, Pi_t: Array, c: Constants) -> Array:
    """Blade speed ratio BSR [-] (A.34), limited to [0, 2 BSR_opt]."""
    bsr = c.R_t * omega_t / root(2.0 * c.c_pe * T_em * turbine_expansion(Pi_t, c))
    return minimum(maximum(bsr, 0.0), 2.0 * c.BSR_opt)


def turbine_efficiency_curvature(omega_t: Array, c: Constants) -> Array:
    """Curvature c_m [-] (A.35): power law above omega_tlin, straight line below it (published simulation)."""
    power_law = c.c_m1 * positive_power(omega_t - c.c_m2, c.c_m3)
    line = maximum(c.c_mlin * (omega_t - c.c_m2) / (c.omega_tlin - c.c_m2), 0.0)
    return where(omega_t > c.omega_tlin, power_law, line)


def eta_tm(omega_t: Array, T_em: Array, Pi_t: Array, c: Constants) -> Array:
    """Turbine efficiency with mechanical losses eta_tm [-] (A.33), in [0.2, 1]. Empirical map N_4."""
    deviation = blade_speed_ratio(omega_t, T_em, Pi_t, c) - c.BSR_opt
    eta = c.eta_tmmax - turbine_efficiency_curvature(omega_t, c) * deviation * deviation
    return minimum(maximum(eta, ETA_TM_MIN), ETA_TM_MAX)


def turbine_power(eta_tm: Array, W_t: Array, T_em: Array, Pi_t: Array, c: Constants) -> Array:
    """Turbine power less mechanical losses P_t eta_m [W] (A.32); eta_m is lumped into eta_tm."""
    return eta_tm * W_t * c.c_pe * T_em * turbine_expansion(Pi_t, c)


def turbo_speed_rate(P_t_eta_m: Array, P_c: Array, omega_t: Array, c: Constants) -> Array:
    """Rate of the turbo speed domega_t/dt [rad/s2] (A.24)."""
    return (P_t_eta_m - P_c) / (c.J_t * omega_t)


def compressor_pressure_ratio(p_im: Array, c: Constants) -> Array:
    """Pressure quotient over the compressor Pi_c [-] (A.37), not below 1."""
    return maximum(p_im / c.p_amb, 1.0)


def compressor_heating(Pi_c: Array, c: Constants) -> Array:
    """Isentropic temperature rise over inlet temperature Pi_c**(1 - 1/gamma_a) - 1 [-] (factor of A.36, A.38, A.44).

    The print of A.39 has the bracket misplaced: the exponent is 1 - 1/gamma_a and 1 is subtracted from the power.
    """
    return positive_power(Pi_c, 1.0 - c.inverse_gamma_a) - 1.0


def energy_transfer_coefficient(T_amb: Array, Pi_c: Array, omega_t: Array, c: Constants) -> Array:
    """Energy transfer coefficient of the compressor Psi_c [-] (A.44)."""
    return 2.0 * c.c_pa * T_amb * compressor_heating(Pi_c, c) / (c.R_c * c.R_c * omega_t * omega_t)


def corrected_flow(W_c: Array, c: Constants) -> Array:
    """Flow over which the compressor's efficiency is told [kg/s]: as it would be in the weather that its map is of.

    A compressor has one map of corrected flow W_c sqrt(T_amb/T_ref)/(p_amb/p_ref) in all weather (Heywood,
    1988, section 6.8.2). A.41 is over mass flow: k_cflow 0 is that, 1 is corrected flow.
    """
    return W_c * c.flow_correction


def corrected_speed(omega_t: Array, c: Constants) -> Array:
    """Speed over which the compressor's ellipse is told [rad/s], as `corrected_flow`: over omega_t sqrt(T_ref/T_amb),
    which stands for the tip's Mach number, with k_cspeed 1, over speed as in A.47 and A.48 with 0."""
    return omega_t * c.speed_correction


def ellipse_coefficient_psi(omega_t: Array, c: Constants) -> Array:
    """Ellipse coefficient c_Psi1 [-] (A.47), not below 0."""
    value = (c.c_omega_psi1 * omega_t + c.c_omega_psi2) * omega_t + c.c_omega_psi3
    return maximum(value, C_PSI1_MIN)


def ellipse_coefficient_phi(omega_t: Array, c: Constants) -> Array:
    """Ellipse coefficient c_Phi1 [-] (A.48), not below 0.1."""
    value = (c.c_omega_phi1 * omega_t + c.c_omega_phi2) * omega_t + c.c_omega_phi3
    return maximum(value, C_PHI1_MIN)


def Phi_c(T_amb: Array, Pi_c: Array, omega_t: Array, c: Constants) -> Array:
    """Volumetric flow coefficient Phi_c [-] (A.50; A.46 is its implicit form). Empirical map N_6."""
    psi = energy_transfer_coefficient(T_amb, Pi_c, omega_t, c) - c.c_psi2
    omega = corrected_speed(omega_t, c)
    argument = (1.0 - ellipse_coefficient_psi(omega, c) * psi * psi) / ellipse_coefficient_phi(omega, c)
    return root(argument) + c.c_phi2


def compressor_flow(Phi_c: Array, omega_t: Array, c: Constants) -> Array:
    """Compressor mass flow W_c [kg/s] (A.49; A.45 is the same solved for Phi_c), at least 1e-4 kg/s."""
    return maximum(c.p_amb * c.wheel_volume * omega_t / (c.R_a * c.T_amb) * Phi_c, W_C_MIN)


def transformed_pressure_ratio(Pi_c: Array, c: Constants) -> Array:
    """Transformed compressor pressure quotient pi_c [-] (A.42)."""
    return positive_power(Pi_c - 1.0, c.c_pi)


def eta_c(W_c: Array, Pi_c: Array, c: Constants) -> Array:
    """Compressor efficiency eta_c [-] (A.40 with A.41, A.43), at least 0.2. Empirical map N_5."""
    x1 = corrected_flow(W_c, c) - c.W_copt
    x2 = transformed_pressure_ratio(Pi_c, c) - c.pi_copt
    return maximum(c.eta_cmax - (c.a_1 * x1 * x1 + 2.0 * c.a_3 * x1 * x2 + c.a_2 * x2 * x2), ETA_C_MIN)


def isentropic_compressor_power(W_c: Array, Pi_c: Array, c: Constants) -> Array:
    """Isentropic compressor power P_c,s [W] (A.38)."""
    return W_c * c.c_pa * c.T_amb * compressor_heating(Pi_c, c)


def compressor_power(P_cs: Array, eta_c: Array) -> Array:
    """Compressor power P_c [W] (A.39)."""
    return P_cs / eta_c


def compressor_out_temperature(eta_c: Array, Pi_c: Array, c: Constants) -> Array:
    """Temperature behind the compressor T_c [K] (A.36 solved for T_c)."""
    return c.T_amb * (1.0 + compressor_heating(Pi_c, c) / eta_c)
