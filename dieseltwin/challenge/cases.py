"""The cases of a benchmark: the mix of docs/benchmark.md, each machine with health, maps, sensors, faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pandas as pd

from dieseltwin.challenge.driving import Driving
from dieseltwin.challenge.map_errors import CORRELATION_LENGTH, MapErrors
from dieseltwin.challenge.own_engine import (
    CORRELATION,
    OF_RATIO,
    REFERENCE_MIN,
    TIERS,
    draw_health,
    record_reference,
    same_sensors,
    weather,
    with_ambient,
    worn,
)
from dieseltwin.challenge.plant import PlantRun, run_plant
from dieseltwin.challenge.plant_effects import FAMILIES, Family, Fault
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SENSORS, SensorSet, read
from dieseltwin.errors import InputError

Kind = Literal["healthy", "withheld", "two", "partial", "single"]
Tier = Literal[
    "main", "one-percent", "own-engine", "own-engine-5", "own-engine-rough", "own-engine-ratio", "petrol", "points"
]
PETROL: Tier = "petrol"
POINTS: Tier = "points"
DRAWN: tuple[Tier, ...] = (PETROL, POINTS)
"""Tiers whose cases have drawn sizes and are told by nothing but their verdict."""


MIX: Mapping[Kind, float] = {"healthy": 0.25, "withheld": 0.15, "two": 0.15, "partial": 0.15}  # the rest single
MAP_RMS: Mapping[str, float] = {"main": 0.003, "one-percent": 0.01, **TIERS}
HEALTH_SPREAD = {"A_egrmax": 0.25, "A_vgtmax": 0.25, "eta_sc": 0.08, "h_tot": 0.25}  # uniform about the laboratory's
LARGEST_RATIO = 10.0  # of magnitude to tolerance; log-uniform from 1
UNCATALOGUED_SHARE = 0.2  # of the withheld cases: families that no catalogue holds
UNSTABLE_SHARE = {"healthy": 1.0 / 3.0}  # of recordings with stretches in the unstable region
UNSTABLE_SHARE_OTHERS = 0.1
WHTC_SHARE = 0.4
ONSET_REL = (0.25, 0.75)  # of the duration
REGION_SHARE = (0.35, 0.65)  # of the samples, before two columns are combined
DURATION_S = 600.0

# streams of random numbers of a case
_FAULTS, _MACHINE, _DRIVING, _HELD_OUT, _NOISE, _HELD_OUT_NOISE, _REFERENCE = range(7)
_PLAN = 2**31


@dataclass(frozen=True)
class Plan:
    """What one case is to be, before anything is driven.

    Attributes:
        number: 1, 2, ...; kind: of the mix; effects: names of the faults; withhold: what the tool must not know
            (every case has some, so that the list tells nothing).
        route: kind of driving (`routes.draw_driving`).
        partial: "onset" or "region" for partial cases.
    """

    number: int
    kind: Kind
    effects: tuple[str, ...]
    withhold: tuple[str, ...]
    route: str
    partial: str | None = None

    @property
    def name(self) -> str:
        """Name of the case's folder."""
        return f"case_{self.number:04d}"


@dataclass(frozen=True)
class Case:
    """One case with both of its recordings; what `make` writes."""

    recording: pd.DataFrame
    held_out: pd.DataFrame
    held_out_clean: PlantRun
    answers: dict[str, Any]
    references: tuple[pd.DataFrame, ...] = ()


def make_plans(n: int, seed: int, *, sensors: int = 6, healthy_only: bool = False) -> tuple[Plan, ...]:
    """The mix of n cases in random order.

    Raises:
        InputError: n below 1, or other than 5 or 6 sensors.
    """
    if n < 1:
        raise InputError("challenge: --n", n, "at least 1", "ask for more cases")
    if sensors not in (5, 6):
        raise InputError("challenge: --sensors", sensors, "5 (the paper's) or 6 (with w_c)", "choose one")
    rng = np.random.default_rng([seed, _PLAN])
    kinds: list[Kind] = ["healthy"] * n if healthy_only else _mixed(n, rng)
    catalogue = [f for f in FAMILIES.values() if f.catalogued and f.dealt and not _blind(f, sensors)]
    hidden = [f for f in FAMILIES.values() if not f.catalogued]
    decks = {
        "any": _Deck(catalogue, rng),
        "onset": _Deck([f for f in catalogue if f.onset], rng),
        "region": _Deck([f for f in catalogue if f.boxes], rng),
        "hidden": _Deck(hidden, rng),
    }
    order = rng.permutation(n)
    plans: list[Plan] = []
    for k in range(n):
        kind = kinds[k]
        partial = ("onset" if rng.random() < 0.5 else "region") if kind == "partial" else None
        effects: list[Family] = []
        if kind == "withheld" and rng.random() < UNCATALOGUED_SHARE:
            effects = [decks["hidden"].deal()]
        elif kind != "healthy":
            effects = [decks[partial or "any"].deal()]
        if kind == "two":
            effects.append(decks["any"].deal(unlike=effects[0]))
        if kind == "withheld" and effects[0].catalogued:
            withheld = effects[0]
        else:
            others = [f for f in catalogue if not {f.name, *f.equivalents} & {e.name for e in effects}]
            withheld = others[rng.integers(len(others))]
        share = UNSTABLE_SHARE.get(kind, UNSTABLE_SHARE_OTHERS)
        route = "unstable" if rng.random() < share else ("whtc" if rng.random() < WHTC_SHARE else "random")
        withhold = tuple(sorted((withheld.name, *withheld.equivalents)))
        plans.append(Plan(int(order[k]) + 1, kind, tuple(e.name for e in effects), withhold, route, partial))
    return tuple(sorted(plans, key=lambda plan: plan.number))


def _mixed(n: int, rng: np.random.Generator) -> list[Kind]:
    kinds: list[Kind] = []
    for kind, share in MIX.items():
        whole = n * share
        kinds += [kind] * (int(whole) + int(rng.random() < whole - int(whole)))
    return (kinds + ["single"] * n)[:n]


def _blind(family: Family, sensors: int) -> bool:
    return family.site.startswith("sensor:") and family.site.removeprefix("sensor:") not in SENSORS[:sensors]


class _Deck:
    """Families dealt like cards, so that every one occurs before any comes back."""

    def __init__(self, families: Sequence[Family], rng: np.random.Generator) -> None:
        self.families, self.rng = list(families), rng
        self.left: list[Family] = []

    def deal(self, unlike: Family | None = None) -> Family:
        for _ in range(4 * len(self.families)):
            if not self.left:
                self.left = [self.families[k] for k in self.rng.permutation(len(self.families))]
            card = self.left.pop()
            if unlike is None or (card.site != unlike.site and card.name not in unlike.equivalents):
                return card
        raise InputError("challenge: two effects", "no two of different sites", "families of two sites", "add some")


def build_case(
    plan: Plan, seed: int, laboratory: Mapping[str, Any], *, tier: Tier = "main", sensors: int = 6,
    duration_s: float = DURATION_S, reference_min: float = REFERENCE_MIN,
) -> Case:  # fmt: skip
    """Drive, fault and record one machine, and a second time on other driving.

    Args:
        plan: what it is to be; seed: of the benchmark; laboratory: published parameters by name.
        reference_min: minutes of the engine when it was well, in the own-engine tiers [min].
    """

    def stream(k: int) -> np.random.Generator:
        return np.random.default_rng([seed, plan.number, k])

    rng = stream(_MACHINE)
    own = tier in TIERS
    then, wear, parameters, maps = _draw_engine(laboratory, tier, rng)
    sensor_set = SensorSet.draw(rng)
    driving = draw_driving(plan.route, duration_s, laboratory, stream(_DRIVING))
    later = draw_driving("whtc" if plan.route == "random" else "random", duration_s, laboratory, stream(_HELD_OUT))
    faults = tuple(draw_fault(name, plan, driving, stream(_FAULTS), k) for k, name in enumerate(plan.effects))
    lasting = tuple(fault.lasting() for fault in faults)
    days = [weather(parameters, laboratory, rng) if own else parameters for _ in range(2)]
    run = run_plant(driving, days[0], faults, maps)
    run_later = run_plant(later, days[1], lasting, maps)
    recording = read(run, driving, faults, sensor_set, sensors, stream(_NOISE))
    others = same_sensors(sensor_set, run, run_later) if own else sensor_set
    held_out = read(run_later, later, lasting, others, sensors, stream(_HELD_OUT_NOISE))
    references: tuple[pd.DataFrame, ...] = ()
    if own:
        recording, held_out = with_ambient(recording, days[0]), with_ambient(held_out, days[1])
        references = record_reference(
            then, laboratory, maps, (sensor_set, run, sensors), reference_min, stream(_REFERENCE)
        )
    answers = {
        "case": plan.name, "kind": plan.kind, "partial": plan.partial, "effects": [f.document() for f in faults],
        "withhold": list(plan.withhold), "tier": tier, "seed": seed, "route": plan.route, "held_out_route": later.kind,
        "health": {name: parameters[name] for name in HEALTH_SPREAD}, "sensors": sensor_set.document(),
        "map_rms": {"mean": maps.rms},
    }  # fmt: skip
    if own:
        answers["since_reference"] = wear
    return Case(recording, held_out, run_later, answers, references)


def _draw_engine(
    laboratory: Mapping[str, Any], tier: Tier, rng: np.random.Generator
) -> tuple[dict[str, Any], dict[str, float], dict[str, Any], MapErrors]:
    """An engine's parameters when it was well, its wear since then, its parameters now, and its maps."""
    own = tier in TIERS
    then, wear = draw_health(laboratory, rng) if own else (dict(laboratory), {})
    parameters = worn(then, wear)
    if not own:
        for name, spread in HEALTH_SPREAD.items():
            parameters[name] = laboratory[name] * (1.0 + rng.uniform(-spread, spread))
    maps = MapErrors.draw(MAP_RMS[tier], rng, CORRELATION.get(tier, CORRELATION_LENGTH), tier in OF_RATIO)
    return then, wear, parameters, maps


def maps_of(answers: Mapping[str, Any], laboratory: Mapping[str, Any]) -> MapErrors:
    """The errors of a case's maps, drawn again from what its sealed answers say."""
    number = int(str(answers["case"]).rsplit("_", 1)[-1])
    return _draw_engine(laboratory, answers["tier"], np.random.default_rng([answers["seed"], number, _MACHINE]))[3]


def draw_fault(name: str, plan: Plan, driving: Driving, rng: np.random.Generator, k: int) -> Fault:
    """The k-th fault of a machine: its size, when or where it acts."""
    family = FAMILIES[name]
    for _ in range(k):  # the second fault has draws of its own
        rng.random(8)
    ratio = LARGEST_RATIO ** rng.random()
    magnitude = min(family.tolerance * ratio, family.upper)
    if rng.random() < 0.5 and family.signed:
        magnitude = -magnitude
    fault = Fault(name, magnitude)
    if plan.partial == "onset":
        duration = driving.time_s[-1] - driving.time_s[0]
        return replace(fault, onset_s=round(float(duration * rng.uniform(*ONSET_REL)), 1))
    if plan.partial == "region":
        columns = family.boxes[rng.integers(len(family.boxes))]
        share = rng.uniform(*REGION_SHARE)
        width = share ** (1.0 / len(columns))
        boxes = {}
        for column in columns:
            start = rng.uniform(0.0, 1.0 - width)
            low, high = np.quantile(getattr(driving, column), [start, start + width])
            boxes[column] = (round(float(low), 1), round(float(high), 1))
        return replace(fault, region=boxes)
    return fault
