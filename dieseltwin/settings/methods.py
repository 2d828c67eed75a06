"""Estimators are found by name: every module in a folder `methods` of one of the library's rooms is one.

The file `few_shot_newton.py` is the method `few-shot-newton`. It holds `METHOD`, which says all that others must know
of it: the command line, the settings, figures, tasks and tables ask here and name no method themselves. A new estimator
is one new file in `dieseltwin/identification/methods/`.

A module of a method imports at its top only what is quick to import: settings are read before anything is computed.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dieseltwin.errors import InputError
from dieseltwin.settings.extras import require
from dieseltwin.settings.names import unknown_name

if TYPE_CHECKING:
    from dieseltwin.settings.method_settings import MethodSettings

FOLDER = "methods"
EXACT = "exact"
MAPS = (EXACT, "paper", "improved")
"""Kinds of empirical maps: the formulae themselves, or learned ones."""


@dataclass(frozen=True)
class MethodStyle:
    """How a method is drawn: colour, marker, line style, and the name that a reader sees."""

    colour: str
    marker: str
    line: str
    label: str


@dataclass(frozen=True)
class Needs:
    """What must have been learned before: names of files of `models/`, None for nothing, and the usual kind of maps."""

    bodies: str | None = None
    operators: str | None = None
    maps: str = EXACT


@dataclass(frozen=True)
class Method:
    """One estimator.

    Attributes:
        name: as `--method` takes it; the file's name with hyphens.
        estimate: `estimate(problems, runs, seed, *, bodies, operators, maps, config)`, one `SegmentEstimate` a segment;
            `config` is `IdentifyConfig`. Or the name of the module that holds this function, which is imported when the
            method is run.
        settings: model of its section in params.yaml.
        style: how it is drawn.
        learned: in words, what of it is learned.
        rank: place in tables and legends, the quick ones first.
        needs: what must have been learned before.
        extra: extra of the package without which it cannot run; None for the core.
        package: the import that this extra brings.
        with_epochs: whether it trains for a number of epochs. Its runs then come in batches, of which `estimate` is
            told the number of the first as `first_run`, and they can be read at the last epoch.
        varied: settings of a variant of the evaluation that it reads, besides the sensors.
        sources: method whose trained runs it starts from in the evaluation.
    """

    name: str
    estimate: str | Callable[..., list[Any]]
    settings: type[MethodSettings]
    style: MethodStyle
    learned: str
    rank: int = 100
    needs: Needs = field(default_factory=Needs)
    extra: str | None = None
    package: str = "torch"
    with_epochs: bool = False
    varied: frozenset[str] = frozenset({"start"})
    sources: str | None = None

    @property
    def modules(self) -> tuple[str, ...]:
        """The module that declares it, and the one of its function where that is another."""
        declared = _modules()[self.name]
        return (declared, self.estimate) if isinstance(self.estimate, str) else (declared,)

    def run(self, problems: Sequence[Any], runs: int, seed: int, **given: Any) -> list[Any]:
        """One estimate a segment; arguments as of `estimate`."""
        found = self.estimate
        function = importlib.import_module(found).estimate if isinstance(found, str) else found
        estimates: list[Any] = function(problems, runs, seed, **given)
        return estimates

    def check_installed(self) -> None:
        """Refuse a method whose extra is not installed.

        Raises:
            InputError: the extra is missing; the message names it.
        """
        if self.extra is not None:
            require(self.package, self.extra, f"--method {self.name}")


def names() -> tuple[str, ...]:
    """Names of all methods; nothing is imported for it."""
    return tuple(_modules())


def find(name: str, what: str = "method") -> Method:
    """The method of that name.

    Args:
        name: as `--method` takes it.
        what: where the name stands, for the message.

    Raises:
        InputError: no such method; the message says which one was probably meant.
    """
    modules = _modules()
    if name not in modules:
        raise unknown_name(what, name, list(modules))
    found = importlib.import_module(modules[name]).METHOD
    if not isinstance(found, Method) or found.name != name:
        raise InputError(modules[name], "another METHOD", f"the method {name!r}", "name the file as the method")
    return found


def known(name: str) -> Method | None:
    """The method of that name, None where there is none: stored results may be of another version."""
    return find(name) if name in _modules() else None


def in_order() -> tuple[Method, ...]:
    """All methods by their rank."""
    return tuple(sorted((find(name) for name in names()), key=lambda method: (method.rank, method.name)))


def _modules() -> dict[str, str]:
    """Method -> module, in the order of the rooms' names."""
    package = __name__.partition(".")[0]
    return {
        path.stem.replace("_", "-"): f"{package}.{path.parts[-3]}.{FOLDER}.{path.stem}"
        for folder in importlib.import_module(package).__path__
        for path in sorted(Path(folder).glob(f"*/{FOLDER}/[!_]*.py"))
    }
