"""What a twin offers is asked of the object, in every version of Python."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Protocol, cast, runtime_checkable

import numpy as np
import pytest

import dieseltwin
from dieseltwin.calibration.steady_twin import SteadyTwin
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.interface import Twin, WithSignals, single
from dieseltwin.discovery.twins.offers import Offer
from dieseltwin.discovery.twins.several import SeveralTwin
from dieseltwin.discovery.twins.simple import SimpleTwin
from dieseltwin.petrol.twin import PetrolTwin
from dieseltwin.rigs.twin import RigTwin


@runtime_checkable
class _Weighed(Offer, Protocol):
    mass_kg: float

    def weigh(self) -> float: ...


class _Scale:
    def __init__(self) -> None:
        self.mass_kg = 2.0

    def weigh(self) -> float:
        return self.mass_kg


class _Carried(_Scale, _Weighed):
    """Carries the protocol out by name."""


def test_a_twin_around_another_offers_what_that_one_does() -> None:
    around = WithSignals(_Scale(), {})  # type: ignore[arg-type]
    assert isinstance(around, _Weighed) and around.weigh() == 2.0
    # what Python 3.12 and later look at, where there is nothing
    assert inspect.getattr_static(around, "weigh", None) is None
    assert not isinstance(WithSignals(object(), {}), _Weighed)  # type: ignore[arg-type]


OF_ITS_OWN = {"combined", "driven", "engine_of", "with_own_laws"}  # of the diesel's twin; nobody asks one around it


@pytest.mark.parametrize("kind", [EngineTwin, SeveralTwin, SimpleTwin, SteadyTwin, PetrolTwin, RigTwin])
def test_a_twin_with_signals_has_them_in_all_that_it_is_asked_about_lanes(kind: type) -> None:
    """The tolerances of settled points with a law were once taken about the machine without it."""
    for name, function in inspect.getmembers(kind, inspect.isfunction):
        if name.startswith("_") or name in OF_ITS_OWN or list(inspect.signature(function).parameters)[1:2] != ["lanes"]:
            continue
        inner = SimpleNamespace(**{name: lambda lanes, *more: lanes.signals})
        around = WithSignals(cast(Twin, inner), {"W_c": np.ones(3)})
        assert "W_c" in getattr(around, name)(single(np.zeros(1), np.zeros((1, 1)))), name


def test_a_class_that_carries_a_protocol_out_is_asked_for_as_a_class() -> None:
    assert isinstance(_Carried(), _Carried) and isinstance(_Carried(), _Weighed)
    assert not isinstance(_Scale(), _Carried)


def test_every_protocol_that_is_asked_for_at_run_time_asks_the_object() -> None:
    source = "".join(path.read_text() for path in sorted(Path(dieseltwin.__file__).parent.rglob("*.py")))
    bases = re.findall(r"@runtime_checkable\s+class \w+\(([^)]*)\)", source)
    assert len(bases) > 5
    assert all({"Offer", "Twin"} & {name.strip() for name in base.split(",")} for base in bases), bases
