"""Driving: regulation schedules and random transients, and the engine inputs that follow through an ECU map."""

from dieseltwin.duty_cycles.driving import Driving, drive, fuel_for_torque, limit_breaks
from dieseltwin.duty_cycles.ecu import idle_weight, positions
from dieseltwin.duty_cycles.random_driving import random_demand, slow_dither, smoothed_demand
from dieseltwin.duty_cycles.schedules import (
    FULL_LOAD_SPEED_RPM,
    FULL_LOAD_TORQUE_NM,
    SCHEDULES,
    Demand,
    Schedule,
    denormalised_speed,
    full_load_torque,
    joined,
    load_schedule,
    schedule_demand,
    speed_per_norm,
)

__all__ = [
    "FULL_LOAD_SPEED_RPM", "FULL_LOAD_TORQUE_NM", "SCHEDULES", "Demand", "Driving", "Schedule", "denormalised_speed",
    "drive", "fuel_for_torque", "full_load_torque", "idle_weight", "joined", "limit_breaks", "load_schedule",
    "positions", "random_demand", "schedule_demand", "slow_dither", "smoothed_demand", "speed_per_norm",
]  # fmt: skip
