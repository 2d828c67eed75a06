"""What a twin offers is asked of the object, in every version of Python."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Protocol, runtime_checkable

import dieseltwin
from dieseltwin.discovery.twins.interface import WithSignals
from dieseltwin.discovery.twins.offers import Offer


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


def test_a_class_that_carries_a_protocol_out_is_asked_for_as_a_class() -> None:
    assert isinstance(_Carried(), _Carried) and isinstance(_Carried(), _Weighed)
    assert not isinstance(_Scale(), _Carried)


def test_every_protocol_that_is_asked_for_at_run_time_asks_the_object() -> None:
    source = "".join(path.read_text() for path in sorted(Path(dieseltwin.__file__).parent.rglob("*.py")))
    bases = re.findall(r"@runtime_checkable\s+class \w+\(([^)]*)\)", source)
    assert len(bases) > 5
    assert all({"Offer", "Twin"} & {name.strip() for name in base.split(",")} for base in bases), bases
