"""One bad input: what is written beside the good files, and the command that is given it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Case:
    """One bad input.

    Attributes:
        name: group and what is wrong.
        make: writes its files into a folder that holds the good ones, and gives the arguments.
        environment: variables that are set while it runs.
    """

    name: str
    make: Callable[[Path], list[str]]
    environment: tuple[tuple[str, str], ...] = ()


def plain(*arguments: str, prepare: Callable[[Path], object] | None = None) -> Callable[[Path], list[str]]:
    """Arguments in which {} stands for the folder."""

    def make(folder: Path) -> list[str]:
        if prepare is not None:
            prepare(folder)
        return [argument.replace("{}", str(folder)) for argument in arguments]

    return make
