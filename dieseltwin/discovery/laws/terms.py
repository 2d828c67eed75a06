"""A found law as terms of the engine file, which simulate, identify and discover honour."""

from __future__ import annotations

from collections.abc import Sequence

from dieseltwin.discovery.laws.grammar import Factor, Form
from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.twin import point_index
from dieseltwin.discovery.twins.diesel_points import LAW_KINDS, LAW_SCOPE
from dieseltwin.discovery.twins.interface import Point
from dieseltwin.engine.effects import EFFECTS, GAS_LAG
from dieseltwin.engine.terms import ActuatorTerm, LawGroup, LawTerm, OneTerm, SensorTerm, Term


def law_terms_of(law: Law, points: Sequence[Point], onset_s: float | None = None) -> tuple[OneTerm, ...]:
    """The law's terms for the engine file; none where the file has no words for one of them.

    It has for products of powers, differences, shares and nozzles of known variables, for gain, offset and lag of a
    sensor, for dead time and play of an actuator, and for the lag of the exhaust gas.

    Args:
        law: found; points: of the twin.
        onset_s: since when it acts, from the recording's start [s]; None: always.
    """
    return tuple(term.model_copy(update={"onset_s": onset_s}) for term in _terms_of(law, points))


def _terms_of(law: Law, points: Sequence[Point]) -> tuple[OneTerm, ...]:
    if law.faults:
        return tuple(
            SensorTerm(sensor=fault.channel, fault=fault.kind, magnitude=fault.size, std=fault.std)
            for fault in law.faults
        )
    terms: list[OneTerm] = []
    for k, placed in enumerate(law.placed):
        if placed.form.fixed is not None:
            try:
                operated = _operator_term(placed.form)
            except ValueError:  # larger than the effect of that name may be
                return ()
            if operated is None:
                return ()
            terms.append(operated)
            continue
        factors: list[tuple[str, float, float]] = []
        groups: list[LawGroup] = []
        for factor in placed.form.factors:
            if factor.kind not in LAW_KINDS:
                return ()
            powers, own = _written(factor)
            factors += powers
            groups += own
        point = points[point_index(points, placed.form.point)]
        try:
            term = LawTerm(
                point=point.name, coefficient=placed.coefficient, unit=point.unit, factors=tuple(factors),
                groups=tuple(groups), text=law.text, std=law.std if k == 0 else None,
            )  # fmt: skip
        except ValueError:
            return ()
        terms.append(term)
    return tuple(terms)


def _written(factor: Factor) -> tuple[list[tuple[str, float, float]], list[LawGroup]]:
    """A factor as powers and groups."""
    kind, shape, names = factor.kind, float(factor.shape), factor.variables
    reference = float(factor.references[0])
    if kind == "time":
        return [("t", reference, 1.0)], []
    if kind == "power":
        return [(names[0], reference, shape)], []
    if kind == "ratio":
        return [(names[0], 1.0, shape), (names[1], 1.0, -shape)], []
    if kind == "orifice":
        heat = [(names[2], float(factor.references[2]), -0.5)] if len(names) == 3 else []
        return [(names[0], reference, 1.0), *heat], [LawGroup(kind="orifice", variables=names[:2])]
    if kind == "bump":
        return [], [LawGroup(kind="bump", variables=names, reference=reference, centre=shape)]
    if kind == "difference":
        return [], [LawGroup(kind="difference", variables=names, reference=reference, exponent=shape)]
    return [], [LawGroup(kind=kind, variables=names, exponent=shape)]  # type: ignore[arg-type]


def _operator_term(form: Form) -> Term | ActuatorTerm | None:
    """Dead time or play of an actuator, lag of the exhaust gas; None for what the file has no words for, and for a gas
    slower than any."""
    kind, size = form.factors[0].kind, float(form.factors[0].shape)
    if len(form.factors) > 1:
        return None
    effect = LAW_SCOPE.commands.get((kind, form.point))
    if effect is not None:
        fault = "dead_time" if kind == "dead_time" else "backlash"
        return ActuatorTerm(actuator=EFFECTS[effect].enters.name, fault=fault, magnitude=size)  # type: ignore[arg-type]
    gas = EFFECTS[GAS_LAG]
    if (kind, form.point) == ("lag", gas.enters.name) and gas.limits[0] <= size <= gas.limits[1]:
        return Term(effect=GAS_LAG, magnitude=size)
    return None


__all__ = ["law_terms_of"]
