"""Engine parameters: the published names as a frozen model, and the flat constants the equations read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from dieseltwin.engine.model_constants import CONSTANT_NAMES, PUBLISHED, Constants, derived
from dieseltwin.engine.terms import AnyTerm
from dieseltwin.errors import InputError
from dieseltwin.settings.strict import NO_YES_FOR_A_NUMBER, asked_of, holds_boolean, unknown_name
from dieseltwin.symbols import HEALTH_NAMES, INPUT_COLUMNS

HEALTH = HEALTH_NAMES
"""The four health parameters, in the order of every array that holds them."""

HEALTH_UNITS = {"A_egrmax": "m2", "A_vgtmax": "m2", "eta_sc": "-", "h_tot": "W/(m2 K)"}


HIGHEST_INPUT = 1e5  # of any input's range [rpm, mg/cycle, %]: beyond it the unit is another one


class EngineParameters(BaseModel):
    """Parameters of the mean-value engine model, SI units unless the description says otherwise.

    Names are those of Wahlström & Eriksson (2011) and of the paper. Vectors hold the coefficients in the order of the
    equation that the description names.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    c_pa: float = Field(gt=1, lt=1e5, description="specific heat of air at constant pressure [J/(kg K)]")
    c_va: float = Field(gt=1, lt=1e5, description="specific heat of air at constant volume [J/(kg K)]")
    c_pe: float = Field(gt=1, lt=1e5, description="specific heat of exhaust gas at constant pressure [J/(kg K)]")
    R_a: float = Field(gt=1, lt=1e4, description="gas constant of air [J/(kg K)]")
    R_e: float = Field(gt=1, lt=1e4, description="gas constant of exhaust gas [J/(kg K)]")
    gamma_a: float = Field(gt=1, lt=3, description="heat capacity ratio of air [-]")
    gamma_e: float = Field(gt=1, lt=3, description="heat capacity ratio of exhaust gas [-]")
    T_amb: float = Field(gt=150, lt=400, description="ambient temperature [K]")
    p_amb: float = Field(gt=3e4, lt=2e5, description="ambient pressure [Pa]")
    T_im: float = Field(gt=200, lt=500, description="intake manifold temperature [K]")
    V_im: float = Field(gt=1e-5, lt=10, description="intake manifold volume [m3]")
    V_em: float = Field(gt=1e-5, lt=10, description="exhaust manifold volume [m3]")
    V_d: float = Field(gt=1e-5, lt=10, description="displacement [m3]")
    r_c: float = Field(gt=1, lt=100, description="compression ratio [-]")
    n_cyl: int = Field(gt=0, le=32, description="number of cylinders [-]")
    q_HV: float = Field(gt=1e4, lt=1e9, description="heating value of the fuel [J/kg]")
    eta_sc: float = Field(gt=0, lt=10, description="compensation factor for non-ideal cycles [-] (health parameter)")
    x_cv: float = Field(ge=0, le=1, description="share of fuel burnt at constant volume [-]")
    h_tot: float = Field(
        ge=0, lt=1e5, description="heat transfer coefficient of the exhaust pipes [W/(m2 K)] (health parameter)"
    )
    d_pipe: float = Field(gt=1e-4, lt=10, description="pipe diameter [m]")
    l_pipe: float = Field(gt=1e-4, lt=100, description="pipe length [m]")
    n_pipe: int = Field(gt=0, le=100, description="number of pipes [-]")
    c_vol: tuple[float, float, float] = Field(description="volumetric efficiency (A.6)")
    A_egrmax: float = Field(gt=1e-9, lt=1, description="maximum effective EGR area [m2] (health parameter)")
    Pi_egropt: float = Field(gt=0, lt=1, description="choking pressure quotient of the EGR valve [-]")
    c_egr: tuple[float, float, float] = Field(description="EGR area ratio over u~_egr in % (A.23)")
    tau_egr1: float = Field(gt=1e-5, lt=100, description="EGR actuator lag 1 [s]")
    tau_egr2: float = Field(gt=1e-5, lt=100, description="EGR actuator lag 2 [s]")
    K_egr: float = Field(description="EGR actuator overshoot gain [-]")
    tau_degr: float = Field(ge=0, lt=10, description="EGR actuator dead time [s]")
    A_vgtmax: float = Field(gt=1e-9, lt=1, description="maximum effective turbine area [m2] (health parameter)")
    K_t: float = Field(gt=0, lt=100, description="choking exponent of the turbine (A.27) [-]")
    c_f1: float = Field(description="VGT area ratio (A.30) [-]")
    c_f2: float = Field(description="VGT area ratio (A.30) [-]")
    c_vgt1: float = Field(gt=0, lt=1e5, description="VGT area ratio (A.30) [%]")
    c_vgt2: float = Field(description="VGT area ratio (A.30) [%]")
    tau_vgt: float = Field(gt=1e-5, lt=100, description="VGT actuator lag [s]")
    tau_dvgt: float = Field(ge=0, lt=10, description="VGT actuator dead time [s]")
    J_t: float = Field(gt=1e-8, lt=1, description="turbocharger inertia [kg m2]")
    R_t: float = Field(gt=1e-4, lt=1, description="turbine blade radius [m]")
    R_c: float = Field(gt=1e-4, lt=1, description="compressor blade radius [m]")
    eta_tmmax: float = Field(gt=0, le=1, description="maximum turbine efficiency [-]")
    BSR_opt: float = Field(gt=0, lt=10, description="blade speed ratio of best turbine efficiency [-]")
    c_m: tuple[float, float, float] = Field(description="turbine efficiency curvature (A.35)")
    omega_tlin: float = Field(description="speed below which c_m is linear [rad/s] (published simulation)")
    c_mlin: float = Field(description="slope of the linear part of c_m (published simulation)")
    eta_cmax: float = Field(gt=0, le=1, description="maximum compressor efficiency [-]")
    Q_c: tuple[float, float, float] = Field(description="a_1, a_2, a_3 of the compressor efficiency (A.43)")
    W_copt: float = Field(gt=1e-5, lt=100, description="compressor flow of best efficiency [kg/s]")
    pi_copt: float = Field(description="transformed pressure quotient of best efficiency [-]")
    c_pi: float = Field(gt=0, lt=100, description="exponent of pi_c (A.42) [-]")
    c_omega_psi: tuple[float, float, float] = Field(description="ellipse coefficient c_Psi1 (A.47)")
    c_omega_phi: tuple[float, float, float] = Field(description="ellipse coefficient c_Phi1 (A.48)")
    c_psi2: float = Field(description="ellipse centre (A.46) [-]")
    c_phi2: float = Field(description="ellipse centre (A.46) [-]")
    AF_s: float = Field(gt=0, lt=1000, description="stoichiometric air/fuel ratio [-]")
    gamma_cyl: float = Field(gt=1, lt=3, description="heat capacity ratio in the cylinder, for torque [-]")
    eta_igch: float = Field(gt=0, lt=10, description="combustion chamber efficiency, for torque [-]")
    c_fric: tuple[float, float, float] = Field(description="friction over (n_e/1000)^2, n_e/1000, 1 [bar]")
    p_cmap: float = Field(101325.0, gt=3e4, lt=2e5, description="ambient pressure of the compressor's maps [Pa]")
    T_cmap: float = Field(298.15, gt=150, lt=400, description="ambient temperature of them [K]")
    k_cflow: float = Field(
        0.0, ge=-1, le=2, description="how far its efficiency goes by corrected flow; 0: by mass flow [-]"
    )
    k_cspeed: float = Field(
        0.0, ge=-1, le=2, description="how far its ellipse goes by corrected speed; 0: by speed [-]"
    )
    n_e_range: tuple[float, float] = Field((500.0, 2000.0), description="valid engine speed [rpm]")
    u_delta_range: tuple[float, float] = Field((1.0, 250.0), description="valid injected mass [mg/cycle]")
    u_egr_range: tuple[float, float] = Field((0.0, 100.0), description="valid EGR position [%]")
    u_vgt_range: tuple[float, float] = Field((20.0, 100.0), description="valid VGT position [%]")

    terms: tuple[AnyTerm, ...] = Field((), description="what the published model leaves out (`dieseltwin effects`)")

    @field_validator("*", mode="before")
    @classmethod
    def _no_yes_for_a_number(cls, value: Any) -> Any:
        entries = value if isinstance(value, list | tuple) else (value,)
        if any(holds_boolean(entry) for entry in entries):
            raise ValueError(NO_YES_FOR_A_NUMBER)
        return value

    @property
    def input_ranges(self) -> dict[str, tuple[float, float]]:
        """Valid range of each input's column [rpm, mg/cycle, %, %]."""
        ranges = (self.n_e_range, self.u_delta_range, self.u_egr_range, self.u_vgt_range)
        return dict(zip(INPUT_COLUMNS, ranges, strict=True))

    @field_validator("n_e_range", "u_delta_range", "u_egr_range", "u_vgt_range")
    @classmethod
    def _lower_end_first(cls, ends: tuple[float, float]) -> tuple[float, float]:
        low, high = ends
        if not 0.0 <= low < high <= HIGHEST_INPUT:
            raise ValueError(f"two numbers from 0 to {HIGHEST_INPUT:g}, the lower one first")
        return ends

    def replace(self, **changes: Any) -> EngineParameters:
        """A copy with the named parameters changed; raises InputError for an unknown name or a value out of range."""
        return validated({**self.model_dump(), **changes}, source="engine parameters")

    def health(self) -> np.ndarray:
        """The health parameters in the order of `HEALTH`, shape (4,)."""
        return np.array([getattr(self, name) for name in HEALTH])


def validated(values: Mapping[str, Any], source: str) -> EngineParameters:
    """Parameters from values by name; raises InputError with `source` for an unknown name or a value out of range."""
    known = list(EngineParameters.model_fields)
    for key in values:
        if key not in known:
            raise unknown_name(f"{source}: engine parameters", key, known)
    try:
        return EngineParameters(**values)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        raise InputError(
            f"{source}: engine parameter {name}",
            got=repr(first.get("input")),
            allowed=_allowed(first),
            do="correct the value",
        ) from None


def _allowed(problem: Mapping[str, Any]) -> str:
    """What pydantic asks of a value, and of which quantity in which unit: a displacement in litres is out of range."""
    field = EngineParameters.model_fields.get(str(problem["loc"][0])) if problem["loc"] else None
    asked = asked_of(str(problem["msg"]))
    return f"{asked}; it is the {field.description}" if field is not None and field.description else asked


_VECTORS: dict[str, tuple[str, ...]] = {
    "c_vol": ("c_vol1", "c_vol2", "c_vol3"),
    "c_egr": ("c_egr1", "c_egr2", "c_egr3"),
    "c_m": ("c_m1", "c_m2", "c_m3"),
    "Q_c": ("a_1", "a_2", "a_3"),
    "c_omega_psi": ("c_omega_psi1", "c_omega_psi2", "c_omega_psi3"),
    "c_omega_phi": ("c_omega_phi1", "c_omega_phi2", "c_omega_phi3"),
    "c_fric": ("c_fric1", "c_fric2", "c_fric3"),
}


ELEMENTS: Mapping[str, tuple[str, int]] = {
    element: (vector, index) for vector, elements in _VECTORS.items() for index, element in enumerate(elements)
}
"""Element of a vector parameter -> (parameter, index)."""

_PUBLISHED = frozenset(PUBLISHED)


def _scalars(parameters: EngineParameters) -> dict[str, float]:
    values: dict[str, float] = {}
    for name, value in parameters:
        if name in _VECTORS:
            values.update(zip(_VECTORS[name], value, strict=True))
        elif name in _PUBLISHED:
            values[name] = float(value)
    return values


def described() -> dict[str, str]:
    """Scalar parameter (vectors by element: ``c_vol1``) -> what it is, with its unit."""
    words = {name: field.description or "" for name, field in EngineParameters.model_fields.items()}
    elements = {element: words[name] for name, vector in _VECTORS.items() for element in vector}
    return {name: {**words, **elements}[name] for name in PUBLISHED}


def constants(parameters: EngineParameters) -> Constants:
    """The constants of one parameter set, all floats. Use ``._replace(A_egrmax=tensor)`` for unknowns."""
    values = _scalars(parameters)
    return Constants(**values, **derived(values))


@dataclass(frozen=True)
class ParameterBatch:
    """B parameter sets for the compiled simulator.

    Attributes:
        values: constants, shape (n_constants, B), rows in the order of `CONSTANT_NAMES`.
        terms: what the published model leaves out, the same in all sets.
    """

    values: np.ndarray
    terms: tuple[AnyTerm, ...] = ()

    @property
    def size(self) -> int:
        """Number of parameter sets B."""
        return int(self.values.shape[1])

    def constants(self) -> Constants:
        """The constants as arrays of shape (B, 1), to broadcast over time."""
        return Constants(*(row[:, None] for row in self.values))


def parameter_batch(parameters: EngineParameters, size: int | None = None, **columns: Any) -> ParameterBatch:
    """B parameter sets that share `parameters` but for the named columns.

    Args:
        parameters: the common set.
        size: B, needed only without columns.
        columns: scalar parameter name (vectors by element: ``c_vol1``) -> values of shape (B,).

    Raises:
        InputError: unknown name, or columns of different length.
    """
    lengths = {np.size(value) for value in columns.values()}
    if len(lengths) > 1:
        raise InputError(
            "parameter batch",
            got=f"columns of lengths {sorted(lengths)}",
            allowed="one length B",
            do="align the columns",
        )
    batch = lengths.pop() if lengths else (size or 1)
    common = _scalars(parameters)
    values: dict[str, Any] = dict(zip(common, np.repeat(list(common.values()), batch).reshape(-1, batch), strict=True))
    for name, column in columns.items():
        if name not in PUBLISHED:
            raise unknown_name("parameter batch", name, PUBLISHED)
        values[name] = np.asarray(column, dtype=np.float64).reshape(batch)
    values.update(derived(values))
    rows = np.array([values[name] for name in CONSTANT_NAMES], dtype=np.float64)
    return ParameterBatch(rows, parameters.terms)
