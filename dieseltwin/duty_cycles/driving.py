"""From a demand to engine inputs: fuel through the engine's own torque, positions through the ECU map, limits kept.

The smoke limit, the EGR limit and the turbo's speed limit depend on the engine's response, and the response on the
inputs. A real ECU closes these loops while driving; here the whole drive is simulated, limited and simulated again
until no limit is broken, which gives inputs that can be given to any other engine or ambient unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from dieseltwin.duty_cycles.ecu import idle_weight, positions
from dieseltwin.duty_cycles.random_driving import slow_dither
from dieseltwin.duty_cycles.schedules import Demand
from dieseltwin.engine import EngineParameters, Inputs, bind, constants, simulate
from dieseltwin.errors import NotConvergedError
from dieseltwin.settings.params import DrivingConfig, EcuConfig

Modified = Literal["none", "u_egr", "u_vgt"]

RESPONSE_STEP_S = 0.2  # limits are watched at the rate of the recordings
MAX_PASSES = 40
FREE_PASSES = 4  # passes in which limits may also open again (the fuel then moves by 0.01 mg); later ones only tighten
MARGIN = 0.01  # relative distance that a tightened limit keeps
SMOKE_EGR_CUT = 0.3  # wanted fuel this share above the allowed one shuts the EGR valve, as ECUs do on tip-in
TURBO_LEAD_S = 4.0  # the turbo's lag: the VGT opens so long before the speed limit would be met
# VGT opening per pass where the turbo is too fast: at rest 10 % of opening slow it by 1 to 4 %
VGT_STEP_PCT, VGT_GAIN_PCT = 3.0, 400.0
# "marginally modified" positions of Set-III and Set-IV: spread about the middle and dithered more
MODIFIED_GAIN, MODIFIED_DITHER_PCT = 1.15, 5.0
MODIFIED_MIDDLE_PCT = {"u_egr": 40.0, "u_vgt": 48.0}


@dataclass(frozen=True)
class Driving:
    """Inputs that keep the limits, and what the engine they were made with does.

    Attributes:
        inputs: time_s and the four inputs at the demand's times (n rows).
        response: every quantity at 0.2 s, laboratory parameters at the baseline ambient.
        limited_share: share of the rows whose fuel the smoke limit holds back [-].
    """

    inputs: pd.DataFrame
    response: pd.DataFrame
    limited_share: float


def fuel_for_torque(
    torque_nm: np.ndarray, n_e_rpm: np.ndarray, p_im: np.ndarray, p_em: np.ndarray, parameters: EngineParameters
) -> np.ndarray:
    """Fuel u_delta [mg/cycle] that gives a torque at given pressures: the engine's torque is affine in the fuel.

    Args:
        torque_nm: (n,) [N m]; n_e_rpm: (n,) [rpm]; p_im, p_em: (n,) [Pa].
    """
    torque, c = bind("numpy").torque, constants(parameters)
    motored = torque(0.0, n_e_rpm, p_im, p_em, c)
    per_mg = torque(1.0, n_e_rpm, p_im, p_em, c) - motored
    return np.asarray((torque_nm - motored) / per_mg)


def drive(
    demand: Demand,
    config: DrivingConfig,
    parameters: EngineParameters,
    rng: np.random.Generator,
    modified: Modified = "none",
) -> Driving:
    """Engine inputs for a demand.

    Args:
        demand: wanted speed and torque, equal time steps.
        config: ECU limits, jitter and dither.
        parameters: the engine, at the ambient that the inputs are made for.
        rng: source of jitter and dither.
        modified: position with a wider range (Set-III, Set-IV).

    Raises:
        NotConvergedError: a limit is still broken after the last pass.
    """
    loop = _Loop(demand, config, parameters, rng, modified)
    for passes in range(1, MAX_PASSES + 1):
        response = loop.simulated()
        broken = loop.broken(response)
        if not any(broken.values()) and passes >= FREE_PASSES:
            return Driving(loop.inputs, response, loop.limited_share())
        loop.tighten(response, may_open=passes < FREE_PASSES)
    raise NotConvergedError(
        f"driving {demand.name}: limits still broken after {MAX_PASSES} passes: {broken}; "
        "relax the limits or the reserves in params.yaml"
    )


class _Loop:
    """State of the passes: the inputs and the limits in force at each of their rows."""

    def __init__(
        self, demand: Demand, config: DrivingConfig, parameters: EngineParameters, rng: np.random.Generator,
        modified: Modified,
    ) -> None:  # fmt: skip
        self.demand, self.ecu, self.parameters, self.modified = demand, with_reserve(config.ecu), parameters, modified
        n = demand.time_s.size
        self.step_s = float(demand.time_s[1] - demand.time_s[0])
        self.n_e = np.clip(
            demand.n_e_rpm + config.random.speed_jitter_rpm * rng.standard_normal(n), *parameters.n_e_range
        )
        self.fuel_jitter = config.random.fuel_jitter_mg * rng.standard_normal(n)
        self.dither_egr = slow_dither(n, self.step_s, config.random, rng)
        self.dither_vgt = slow_dither(n, self.step_s, config.random, rng)
        self.extra = slow_dither(n, self.step_s, config.random, rng)
        self.extra *= MODIFIED_DITHER_PCT / self.extra.std()
        self.fuel_cap = np.full(n, parameters.u_delta_range[1])
        self.egr_scale = np.ones(n)
        self.vgt_opening = np.zeros(n)
        # the watched samples between two rows of the inputs
        self.fine_s = RESPONSE_STEP_S * np.arange(round(demand.time_s[-1] / RESPONSE_STEP_S) + 1)
        self.every = round(self.step_s / RESPONSE_STEP_S)
        still = np.full(n, parameters.p_amb)
        self.wanted = self._wanted(still, still)
        self.inputs = self._inputs()

    def _wanted(self, p_im: np.ndarray, p_em: np.ndarray) -> np.ndarray:
        fuel = fuel_for_torque(self.demand.torque_nm, self.n_e, p_im, p_em, self.parameters) + self.fuel_jitter
        fuel *= 1.0 - self.demand.motoring
        return np.clip(fuel, self.ecu.fuel_min_mg, self.parameters.u_delta_range[1])

    def _inputs(self) -> pd.DataFrame:
        fuel = np.minimum(self.wanted, self.fuel_cap)
        u_egr, u_vgt = positions(self.n_e, fuel, self.step_s, self.ecu)
        u_egr, u_vgt = u_egr * (1.0 + self.dither_egr), u_vgt * (1.0 + self.dither_vgt)
        driving = 1.0 - idle_weight(self.n_e, fuel)
        if self.modified == "u_egr":
            u_egr = u_egr + driving * self._change(u_egr)
        elif self.modified == "u_vgt":
            u_vgt = u_vgt + driving * self._change(u_vgt)
        u_egr = u_egr * np.clip(1.0 - (self.wanted / fuel - 1.0) / SMOKE_EGR_CUT, 0.0, 1.0) * self.egr_scale
        p = self.parameters
        return pd.DataFrame(
            {
                "time_s": self.demand.time_s,
                "n_e_rpm": self.n_e,
                "u_delta_mg": fuel,
                "u_egr_pct": np.clip(u_egr, *p.u_egr_range),
                "u_vgt_pct": np.clip(u_vgt + self.vgt_opening, *p.u_vgt_range),
            }
        )

    def _change(self, position: np.ndarray) -> np.ndarray:
        middle = MODIFIED_MIDDLE_PCT[self.modified]
        return (MODIFIED_GAIN - 1.0) * (position - middle) + self.extra

    def simulated(self) -> pd.DataFrame:
        fine = {name: np.interp(self.fine_s, self.demand.time_s, self.inputs[name]) for name in self.inputs.columns[1:]}
        return simulate(Inputs(self.fine_s, **fine), self.parameters, oxygen=False)

    def broken(self, response: pd.DataFrame) -> dict[str, int]:
        """Rows of the response that break each limit."""
        return {name: int(np.count_nonzero(rows)) for name, rows in limit_breaks(response, self.ecu).items()}

    def tighten(self, response: pd.DataFrame, may_open: bool) -> None:
        # lambda is proportional to 1/fuel, so this is the fuel at which the present air flow meets the limit
        limit = response["u_delta_mg"] * response["lambda"] / (self.ecu.smoke_lambda_min * (1.0 + MARGIN))
        cap = np.maximum(self._worst(limit.to_numpy(), smallest=True), self.ecu.fuel_min_mg)
        cap = np.minimum(cap, self.parameters.u_delta_range[1])
        self.fuel_cap = cap if may_open else np.minimum(self.fuel_cap, cap)
        most = self._worst(response["egr_fraction"].to_numpy(), smallest=False)
        self.egr_scale *= np.minimum(1.0, self.ecu.egr_fraction_max * (1.0 - MARGIN) / np.maximum(most, 1e-3))
        self._open_turbine(response["omega_t_rad_s"].to_numpy())
        if may_open:
            p_im, p_em = (response[name].to_numpy()[:: self.every] for name in ("p_im_pa", "p_em_pa"))
            self.wanted = self._wanted(p_im, p_em)
        self.inputs = self._inputs()

    def _open_turbine(self, omega_t: np.ndarray) -> None:
        limit = self.ecu.turbo_speed_max_rad_s * (1.0 - MARGIN)
        excess = np.maximum(omega_t / limit - 1.0, 0.0)
        lead = round(TURBO_LEAD_S / RESPONSE_STEP_S)
        # a maximum over the seconds to come: the origin shifts the window into the future
        ahead = maximum_filter1d(excess, 2 * lead + 1, mode="nearest")[:: self.every]
        self.vgt_opening += np.where(ahead > 0.0, VGT_STEP_PCT + VGT_GAIN_PCT * ahead, 0.0)
        fully_open = self.inputs["u_vgt_pct"].to_numpy() >= self.parameters.u_vgt_range[1]
        self.fuel_cap *= np.where((ahead > 0.0) & fully_open, 1.0 - 2.0 * ahead - MARGIN, 1.0)

    def _worst(self, fine: np.ndarray, smallest: bool) -> np.ndarray:
        """Extreme value of a watched signal between the neighbouring rows of each row of the inputs, (n,)."""
        filtered = (minimum_filter1d if smallest else maximum_filter1d)(fine, 2 * self.every + 1, mode="nearest")
        return filtered[:: self.every]

    def limited_share(self) -> float:
        return float(np.mean(self.inputs["u_delta_mg"].to_numpy() < self.wanted - 1e-6 * self.wanted))


def with_reserve(ecu: EcuConfig) -> EcuConfig:
    """The limits that inputs are made for, so that other parameters and ambients stay within the stated ones."""
    return ecu.model_copy(
        update={
            "smoke_lambda_min": ecu.smoke_lambda_min * (1.0 + ecu.smoke_reserve_rel),
            "turbo_speed_max_rad_s": ecu.turbo_speed_max_rad_s * (1.0 - ecu.turbo_reserve_rel),
        }
    )


def limit_breaks(response: pd.DataFrame, ecu: EcuConfig) -> dict[str, np.ndarray]:
    """Which rows of a simulation break the smoke, EGR and turbo limits: name -> (n,) bool.

    At the least fuel nothing can be taken back: the smoke limit does not apply there.
    """
    fuelled = response["u_delta_mg"].to_numpy() > ecu.fuel_min_mg * (1.0 + MARGIN)
    fraction = response["egr_fraction"].to_numpy()
    return {
        "smoke": fuelled & (response["lambda"].to_numpy() < ecu.smoke_lambda_min),
        "egr_fraction": (fraction < 0.0) | (fraction > ecu.egr_fraction_max),
        "turbo_speed": response["omega_t_rad_s"].to_numpy() >= ecu.turbo_speed_max_rad_s,
    }
