"""The published parameter set: Wahlström & Eriksson (2011), 12.74 l, 6 cylinders, VGT and EGR.

J. Wahlström, L. Eriksson: Modelling diesel engines with a variable-geometry turbocharger and exhaust gas
recirculation by optimization of model parameters for capturing non-linear system dynamics. Proc. IMechE Part D,
225(7), 960-986, 2011. Values of the public simulation package TCDI_EGR_VGT; the ambient is the baseline of the
paper's case table.
"""

from __future__ import annotations

from dieseltwin.engine.parameters import EngineParameters

PARAMETERS = EngineParameters(
    c_pa=1011.0,
    c_va=724.0,
    c_pe=1332.0,
    R_a=287.0,
    R_e=286.0,
    gamma_a=1.3964088397790055,
    gamma_e=1.2734225621414914,
    T_amb=298.4636219512196,
    p_amb=101111.34146341463,
    T_im=300.6185731707316,
    V_im=0.022,
    V_em=0.02,
    V_d=0.01274,
    r_c=17.0,
    n_cyl=6,
    q_HV=42.9e6,
    eta_sc=1.1015294624801442,
    x_cv=2.3370584441920436e-14,
    h_tot=96.27545984019156,
    d_pipe=0.1,
    l_pipe=1.0,
    n_pipe=2,
    c_vol=(-0.000208166198, -0.00344651581, 1.1497021),
    A_egrmax=0.0004,
    Pi_egropt=0.6500040483261396,
    c_egr=(-0.00011104, 0.01778061, 0.0),
    tau_egr1=0.05,
    tau_egr2=0.13,
    K_egr=1.8,
    tau_degr=0.065,
    A_vgtmax=0.0008455767262643882,
    K_t=2.89019266110711,
    c_f1=1.9479627004385558,
    c_f2=-0.7763118932867504,
    c_vgt1=126.87193572285548,
    c_vgt2=117.14474688230767,
    tau_vgt=0.025,
    tau_dvgt=0.04,
    J_t=0.0002,
    R_t=0.04,
    R_c=0.04,
    eta_tmmax=0.818002726891074,
    BSR_opt=0.9755203161802092,
    c_m=(1.35634407, 2769.2092, 0.0100000987),
    omega_tlin=2796.9012935924584,
    c_mlin=1.4021470818125312,
    eta_cmax=0.7363607879724583,
    Q_c=(3.09189777, 2.14785596, -2.48232014),
    W_copt=0.27533757461959213,
    pi_copt=1.045517746825637,
    c_pi=0.2707594738764899,
    c_omega_psi=(1.08820511e-08, -0.000173197604, 1.02861648),
    c_omega_phi=(-1.42977827e-08, -0.00154988141, 29.6461722),
    c_psi2=0.0,
    c_phi2=0.0,
    AF_s=14.57,
    gamma_cyl=1.35,
    eta_igch=0.6893563004149508,
    c_fric=(0.97272276, -0.67688303, 0.59818913),
)
"""Laboratory values of the health parameters."""

HEALTH_SHIFT = {"A_egrmax": 1.333, "A_vgtmax": 1.1663, "eta_sc": 0.9179, "h_tot": 1.0}
"""Laboratory over field value (paper, table of true values)."""

FIELD = PARAMETERS.replace(**{name: getattr(PARAMETERS, name) / shift for name, shift in HEALTH_SHIFT.items()})
"""Field values of the health parameters."""
