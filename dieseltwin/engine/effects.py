"""The effects that the published model leaves out, as one family of objects, and terms: effects of one engine.

What is a term of the right-hand side is in `effect_laws` and `extended_model`; effects on the actuators' commands are
in `actuator_effects`, on readings in `sensor_effects`.
"""

from dieseltwin.engine.effect_catalogue import (
    ACTUATOR_EFFECTS,
    ADDED_AT,
    EFFECTS,
    POINTS,
    SITES,
    STATE_EFFECTS,
    Effect,
)
from dieseltwin.engine.terms import ActuatorTerm, LawGroup, LawTerm, Region, SensorTerm, Term

__all__ = [
    "ACTUATOR_EFFECTS", "ADDED_AT", "EFFECTS", "POINTS", "SITES", "STATE_EFFECTS",
    "ActuatorTerm", "Effect", "LawGroup", "LawTerm", "Region", "SensorTerm", "Term",
]  # fmt: skip
