"""Pretrained networks by their kind: what `make run` leaves in `models/`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from dieseltwin.errors import InputError
from dieseltwin.settings.extras import require
from dieseltwin.settings.methods import EXACT, MAPS, Method, Needs
from dieseltwin.settings.names import unknown_name

CLASSES = {
    "bodies": ("bodies", "Bodies"),
    "operators": ("operators", "ActuatorOperators"),
    "maps": ("empirical", "EmpiricalMaps"),
}
"""Kind of networks -> module of this package and class; by name, so that who needs one doesn't rest on the others."""

MODELS_FOLDER = Path("models")
MAKE_THEM = "make them with `make run` or check the path"


def files_of(needs: Needs) -> dict[str, str]:
    """Kind of networks -> name of its file, for what a method needs; empty for the exact formulae alone."""
    files = {"bodies": needs.bodies, "operators": needs.operators}
    if needs.maps != EXACT:
        files["maps"] = f"maps_{needs.maps}.pt"
    return {kind: name for kind, name in files.items() if name is not None}


def load_networks(files: Mapping[str, Path]) -> dict[str, Any]:
    """Load pretrained networks, as keyword arguments for `identify_segments`.

    Args:
        files: kind ("bodies", "operators", "maps") -> its file.

    Raises:
        InputError: the extra `networks` is not installed, or a file holds something else.
    """
    if files:
        require("torch", "networks", "learned maps, operators or bodies")
    found = {}
    for kind, path in files.items():
        module, name = CLASSES[kind]
        found[kind] = getattr(import_module(f"{__package__}.{module}"), name).load(path)
    return found


def networks_for(method: Method, models: Path | None = None, maps: str | None = None) -> dict[str, Any]:
    """Pretrained networks for `identify_segments`, as keyword arguments.

    Args:
        method: what it needs is loaded.
        models: folder of `make run`; None takes `models` of the working folder.
        maps: "exact", "paper" or "improved"; None takes the method's usual ones.

    Raises:
        InputError: an unknown kind of maps, no such folder or file, or a file that holds something else.
    """
    maps = method.needs.maps if maps is None else maps
    if maps not in MAPS:
        raise unknown_name("--maps", maps, MAPS)
    files = files_of(replace(method.needs, maps=maps))
    folder = MODELS_FOLDER if models is None else models
    if (files or models is not None) and not folder.is_dir():
        raise InputError(
            f"--models {folder}", "no such folder", "the folder of pretrained networks", MAKE_THEM
        )
    for name in files.values():
        if not (folder / name).is_file():
            raise InputError(f"--models {folder}", f"no {name}", "the files that `make run` writes", MAKE_THEM)
    return load_networks({kind: folder / name for kind, name in files.items()})
