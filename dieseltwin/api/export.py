"""Taking an engine away: as C, as a functional mock-up unit, its maps as tables; networks as ONNX."""

from __future__ import annotations

import re
from contextlib import ExitStack
from pathlib import Path

from dieseltwin.api.engines import NAMED, PUBLISHED, AnyEngine, diesel_engine
from dieseltwin.atomic import atomic_path, check_folder, check_writable
from dieseltwin.codegen.c_engine import c_source
from dieseltwin.codegen.fmu import VERSIONS, check_platform, write_fmu
from dieseltwin.codegen.tables import write_tables
from dieseltwin.engine import EngineParameters
from dieseltwin.errors import InputError
from dieseltwin.settings.extras import require


def export(
    engine: AnyEngine = PUBLISHED, *, c: str | Path | None = None, fmu: str | Path | None = None,
    table: str | Path | None = None, fmi: int = 2, sources_only: bool = False, overwrite: bool = False,
) -> list[Path]:  # fmt: skip
    """Write an engine with its terms and learned maps for programs that know nothing of this package.

    Args:
        engine: name, file or parameters of a diesel engine.
        c: file of C to write: a simulator without dependencies.
        fmu: functional mock-up unit to write, for co-simulation.
        table: folder for the six empirical maps, learned corrections applied: a CSV each and `maps.c` with look-ups.
        fmi: version of FMI, 2 or 3.
        sources_only: leave the FMU's binary for this platform out; no compiler is needed then.
        overwrite: replace files that are there.

    Returns:
        The files that were written.

    Raises:
        InputError: nothing asked for, a petrol engine, a file that is there, no compiler.
    """
    targets = [Path(path) for path in (c, fmu) if path is not None]
    if not targets and table is None:
        raise InputError("export", "nothing to write", "--c, --fmu, --table, --onnx", "name one of them")
    found, name = exportable(engine)
    for path, option, ending in ((c, "--c", ".c"), (fmu, "--fmu", ".fmu")):
        if path is not None:
            _check_target(Path(path), option, ending, overwrite)
    if table is not None:
        _check_folder(Path(table), "--table", overwrite)
    if len({path.resolve() for path in targets}) < len(targets):
        raise InputError("export", f"{targets[0]} twice", "a file each", "choose another name")
    version = next((known for known in VERSIONS if known == fmi), None)
    if version is None:
        raise InputError("--fmi", fmi, "2 or 3", "choose one of them")
    if fmu is not None and not sources_only:
        check_platform(version)
    with ExitStack() as written:  # all of them or, on a full disk, none
        if c is not None:
            written.enter_context(atomic_path(c)).write_text(c_source(found, name), encoding="utf-8")
        if fmu is not None:
            write_fmu(found, name, written.enter_context(atomic_path(fmu)), version, binary=not sources_only)
        tables = [] if table is None else write_tables(found, name, Path(table))
    return targets + tables


def export_networks(models: str | Path, out: str | Path, *, overwrite: bool = False) -> list[Path]:
    """Write learned maps, bodies and operators as ONNX, physical units outside.

    Args:
        models: folder of the pretrained networks (`make run` leaves it in `models/`).
        out: folder for the files.
        overwrite: replace files that are there.

    Returns:
        The files that were written.

    Raises:
        InputError: an extra is missing, no networks, files that are there.
    """
    require("torch", "networks", "--onnx")
    require("onnx", "export", "--onnx")
    _check_folder(Path(out), "--onnx", overwrite)
    from dieseltwin.codegen.networks_onnx import networks_in, write_onnx  # needs torch, which the core hasn't

    return write_onnx(networks_in(Path(models)), Path(out))


def exportable(source: AnyEngine) -> tuple[EngineParameters, str]:
    """A diesel engine and its name.

    Raises:
        InputError: as `engines.diesel_engine`.
    """
    found = diesel_engine(source)
    if isinstance(source, str) and source in NAMED:
        return found, source
    return found, re.sub(r"\s+", "_", Path(source).stem) if isinstance(source, str | Path) else "engine"


def _check_folder(path: Path, option: str, overwrite: bool) -> None:
    if path.is_dir() and any(path.iterdir()) and not overwrite:
        raise InputError(f"{option} {path}", "a folder with files", "a new or empty one",
                         "choose another, or add --overwrite")
    check_folder(path)


def _check_target(path: Path, option: str, ending: str, overwrite: bool) -> None:
    if path.suffix.lower() != ending:
        raise InputError(f"{option} {path}", f"ending {path.suffix or 'nothing'}", ending, "choose another name")
    if path.exists() and not overwrite:
        raise InputError(f"{option} {path}", "a file that is there", "a new one", "choose another, or add --overwrite")
    check_writable(path)

