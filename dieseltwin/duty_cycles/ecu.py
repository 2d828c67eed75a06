"""ECU map: engine speed and fuel to EGR and VGT positions, idle included.

A map of this shape is what series engines have: EGR at part load, shut towards full load where the air is needed; the
turbine open at high flow, closed at low flow to hold the boost; at idle the valve nearly shut, and shut after some
seconds against fouling. The numbers were laid out on the published engine at rest: lambda above 1.2 up to full load
from 1000 rpm on, EGR fraction below 0.32, turbo below 12,000 rad/s (tests go over the map).
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from dieseltwin.settings.params import EcuConfig

_SPEED_RPM = (600.0, 1000.0, 1300.0, 1600.0, 1900.0)
_FUEL_MG = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0, 210.0, 250.0)
# rows: speed; columns: fuel; positions in %
_U_EGR_PCT = (
    (40.0, 35.0, 33.0, 28.0, 20.0, 12.0, 6.0, 2.0, 0.0),
    (58.0, 52.0, 45.0, 37.0, 30.0, 21.0, 13.0, 5.0, 0.0),
    (66.0, 59.0, 51.0, 43.0, 33.0, 25.0, 16.0, 7.0, 0.0),
    (66.0, 59.0, 48.5, 42.0, 31.5, 22.0, 16.0, 7.0, 0.0),
    (60.0, 50.0, 39.0, 35.0, 27.0, 14.0, 11.0, 5.0, 0.0),
)
_U_VGT_PCT = (
    (32.0, 36.0, 40.0, 42.0, 40.0, 36.0, 33.0, 30.0, 27.0),
    (32.0, 36.5, 43.5, 48.5, 53.5, 58.0, 60.0, 58.0, 53.0),
    (33.0, 37.0, 44.0, 50.0, 56.0, 63.0, 69.0, 72.0, 72.0),
    (34.5, 38.5, 48.0, 54.0, 60.0, 68.0, 74.0, 80.0, 88.0),
    (36.0, 40.0, 52.0, 57.0, 62.0, 76.0, 82.0, 89.0, 97.0),
)
# idle is below this speed and fuel, with a soft passage so that jitter does not switch it
_IDLE_SPEED_RPM = (660.0, 760.0)
_IDLE_FUEL_MG = (15.0, 30.0)


def _map(table: tuple[tuple[float, ...], ...]) -> RegularGridInterpolator:
    return RegularGridInterpolator((np.array(_SPEED_RPM), np.array(_FUEL_MG)), np.array(table))


_EGR_MAP, _VGT_MAP = _map(_U_EGR_PCT), _map(_U_VGT_PCT)


def idle_weight(n_e_rpm: np.ndarray, u_delta_mg: np.ndarray) -> np.ndarray:
    """1 at idle, 0 when driving, linear between (n,) [-]."""
    low, high = _IDLE_SPEED_RPM
    slow = np.clip((high - n_e_rpm) / (high - low), 0.0, 1.0)
    low, high = _IDLE_FUEL_MG
    unloaded = np.clip((high - u_delta_mg) / (high - low), 0.0, 1.0)
    return slow * unloaded


def positions(
    n_e_rpm: np.ndarray, u_delta_mg: np.ndarray, step_s: float, config: EcuConfig
) -> tuple[np.ndarray, np.ndarray]:
    """EGR and VGT positions of the map, (n,) and (n,) [%].

    Args:
        n_e_rpm, u_delta_mg: (n,) engine speed [rpm] and fuel [mg/cycle] over time, `step_s` apart.
    """
    from scipy.signal import lfilter  # takes half a second to load, and who only reads recordings drives nothing

    points = np.column_stack(
        [np.clip(n_e_rpm, _SPEED_RPM[0], _SPEED_RPM[-1]), np.clip(u_delta_mg, _FUEL_MG[0], _FUEL_MG[-1])]
    )
    idle = idle_weight(n_e_rpm, u_delta_mg)
    # how long the engine has idled: a leaky count that a burst of load empties
    keep = np.exp(-step_s / config.idle_shut_after_s)
    idled = np.clip((lfilter([1.0 - keep], [1.0, -keep], idle) - 0.5) / 0.4, 0.0, 1.0) * idle
    at_idle = config.idle_u_egr_pct + idled * (config.idle_shut_u_egr_pct - config.idle_u_egr_pct)
    return (1.0 - idle) * _EGR_MAP(points) + idle * at_idle, _VGT_MAP(points)
