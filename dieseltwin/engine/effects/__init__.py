"""The effects that the published model leaves out: one file each, found by walking this package.

A file is one effect (`effect.Effect`), named like its module. Effects that enter at the same quantity act in the order
of their names. Gains and offsets of readings are alike but for their sizes, which stand in the table of `sensors`.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections import namedtuple
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

from dieseltwin.engine.effect import SITES, Curve, Effect, Entry
from dieseltwin.errors import DieselTwinError
from dieseltwin.sensors import SENSORS


def _of_readings() -> Iterator[Effect]:
    """The named gains and offsets of every sensor."""
    for sensor in SENSORS:
        for fault in sensor.faults:
            gain = fault.kind == "gain"
            words = f"{'a gain error' if gain else 'an offset'} of the {sensor.name} reading"
            yield Effect(
                name=f"{sensor.name.lower()}_{fault.kind}",
                site=f"sensor:{sensor.column}",
                enters=Entry("reading", sensor.column, fault.kind),
                law="reading (1 + g)" if gain else "reading + b",
                symbol="g" if gain else "b",
                unit="-" if gain else sensor.symbol.unit,
                tolerance=fault.tolerance,
                limits=(-fault.limit, fault.limit),
                kind="sensor",
                curve=Curve(sensor.name),
                phrase=f"{words} of {{m}}",
                source="offset and gain errors of data sheets",
                about=f"{words[0].upper()}{words[1:]}.",
            )


def _first_sentence(text: str) -> str:
    return text.split("\n\n")[0].replace("\n", " ").replace("`", "").strip()


def _found() -> dict[str, Effect]:
    found = {effect.name: effect for effect in _of_readings()}
    for name in sorted(module.name for module in pkgutil.iter_modules(__path__)):
        module = importlib.import_module(f"{__name__}.{name}")
        effect = replace(module.EFFECT, about=_first_sentence(module.__doc__ or ""))
        if effect.name != name or effect.site not in SITES:
            raise DieselTwinError(f"effect {effect.name!r} at {effect.site!r} in {name}.py: name it so, at a site")
        found[name] = effect
    for effect in found.values():
        unknown = sorted(set(effect.confused_with) - set(found))
        if unknown:
            raise DieselTwinError(f"effect {effect.name}: confused with {unknown}, which are no effects")
    return dict(sorted(found.items()))


EFFECTS: dict[str, Effect] = _found()
"""All effects by name, in the order of their names."""


def _entering(*through: str) -> tuple[str, ...]:
    return tuple(name for name, effect in EFFECTS.items() if effect.enters.through in through)


STATE_EFFECTS = _entering("quantity", "gas")
"""Effects inside the right-hand side, in the order of `Magnitudes` and of `extended.Extension.magnitudes`."""

ACTUATION_EFFECTS = _entering("command", "input")
"""Effects on what drives the engine, before the right-hand side."""

GAS_LAG = next(name for name, effect in EFFECTS.items() if effect.enters.through == "gas")
"""The effect by which the gas temperature in the exhaust manifold lags; there is one such state."""

_tuple_type: Any = namedtuple  # mypy wants the fields written out
Magnitudes = _tuple_type("Magnitudes", STATE_EFFECTS, module=__name__)
"""Magnitudes of `STATE_EFFECTS` at a moment [their units]; a drift's is rate times time."""


@cache
def effects_at(quantity: str) -> tuple[str, ...]:
    """Names of the effects that enter at a quantity of `hooks`."""
    return tuple(n for n, e in EFFECTS.items() if e.enters.through == "quantity" and e.enters.name == quantity)


HEATED_BY_GAS = tuple(name for name in effects_at("T_im") if "T_em" in EFFECTS[name].arguments)
"""Effects by which the exhaust gas heats the charge: its temperature is then a fixed point."""

IMPLICIT = (*effects_at("p_bc"), *effects_at("p_es"))
"""Effects whose law is solved at every evaluation: the flow that it asks for answers it."""

__all__ = [
    "ACTUATION_EFFECTS", "EFFECTS", "GAS_LAG", "HEATED_BY_GAS", "IMPLICIT", "SITES", "STATE_EFFECTS", "Effect",
    "Magnitudes", "effects_at",
]  # fmt: skip
