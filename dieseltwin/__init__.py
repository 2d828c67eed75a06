"""Digital twin of a diesel engine's gas path: simulation, identification of its health parameters, discovery.

    import dieseltwin as dt

    found = dt.discover("drive.csv", "engine.yaml")
    print(found.sentence)

Paper: Nath, Kumar, Smith, Karniadakis, "A Digital Twin for Diesel Engines: Operator-infused Physics-Informed
Neural Networks with Transfer Learning for Engine Health Monitoring".
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from dieseltwin.version import __version__

if TYPE_CHECKING:  # for type checkers and editors; at run time `__getattr__` fetches a name when it is asked for
    from dieseltwin.api.calibration import calibrate as calibrate
    from dieseltwin.api.channels import channels as channels
    from dieseltwin.api.discovery import discover as discover
    from dieseltwin.api.engines import engine as engine
    from dieseltwin.api.export import export as export
    from dieseltwin.api.fleet import fleet as fleet
    from dieseltwin.api.histories import history as history
    from dieseltwin.api.identification import Setup as Setup
    from dieseltwin.api.identification import identify as identify
    from dieseltwin.api.learning import learn as learn
    from dieseltwin.api.points import imply as imply
    from dieseltwin.api.reading import dataset as dataset
    from dieseltwin.api.reading import read as read
    from dieseltwin.api.simulation import simulate as simulate
    from dieseltwin.api.versions import show_versions as show_versions
    from dieseltwin.api.watch import watch as watch

# Name -> module of `dieseltwin.api` that holds it. Loaded when first used: `import dieseltwin` loads no numpy.
_ROOMS = {
    "Setup": "identification",
    "calibrate": "calibration",
    "channels": "channels",
    "dataset": "reading",
    "discover": "discovery",
    "export": "export",
    "fleet": "fleet",
    "history": "histories",
    "identify": "identification",
    "imply": "points",
    "learn": "learning",
    "read": "reading",
    "show_versions": "versions",
    "simulate": "simulation",
    "watch": "watch",
}

__all__ = [
    "Setup", "__version__", "calibrate", "channels", "dataset", "discover", "engine", "export", "fleet", "history",
    "identify", "imply", "learn", "read", "show_versions", "simulate", "watch",
]  # fmt: skip


def _of_the_front_door(name: str, room: str) -> Any:
    return getattr(import_module(f"{__name__}.api.{room}"), name)


if not TYPE_CHECKING:  # a type checker would take every name for one of these

    def __getattr__(name: str) -> Any:
        if name == "engine":
            return import_module(f"{__name__}.engine")
        if name not in _ROOMS:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        found = globals()[name] = _of_the_front_door(name, _ROOMS[name])
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Imported(ModuleType):
    """A module of a class of its own, which cloudpickle doesn't know as one: functions of a script that use it go to
    the processes of joblib, Dask or Ray."""

    def __reduce__(self) -> tuple[Any, ...]:
        return import_module, (self.__name__,)


class _EnginePackage(_Imported):
    """`dieseltwin.engine`: a package that, called, is the front door's function: `engine("we2011")`."""

    def __call__(self, *source: Any, **changes: Any) -> Any:
        return _of_the_front_door("engine", "engines")(*source, **changes)


class _Package(_Imported):
    """This package. The import system sets a package's sub-packages as its attributes; that of `engine` is callable."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "engine":
            value.__class__ = _EnginePackage
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
