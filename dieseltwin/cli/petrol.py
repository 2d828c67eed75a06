"""`dieseltwin discover --engine petrol.yaml` and `dieseltwin calibrate --base liu_petrol`: the petrol engine's part."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path

from dieseltwin.atomic import atomic_folder, check_writable, write_bytes, write_json
from dieseltwin.errors import InputError
from dieseltwin.petrol.calibrate import calibrate
from dieseltwin.petrol.discover import details, discover_petrol
from dieseltwin.petrol.parameters import PetrolParameters, is_petrol, load_petrol, save_petrol
from dieseltwin.petrol.recording import read_petrol
from dieseltwin.settings.strict import read_mapping, validate

BASE = "liu_petrol"
OWNED = ("figures", "report.html", "engine.yaml", "runtime.json", "details.json")


def is_petrol_engine(engine: Path | None) -> bool:
    """Whether --engine names a petrol engine's file."""
    return engine is not None and engine.is_file() and is_petrol(engine)


def is_petrol_base(base: str | Path) -> bool:
    """Whether --base names the petrol engine or a YAML file of that kind."""
    return str(base) == BASE or is_petrol_engine(Path(base))


def run_discover_petrol(recording: Path, out: Path, engine: Path) -> Iterator[str]:
    """Judge a recording and write discrepancy.json, details.json, report.html, figures/, engine.yaml, runtime.json.

    Raises:
        InputError: a file that can't be used; nothing is written then.
    """
    from dieseltwin.report.petrol import build_petrol_report

    parameters = load_petrol(engine)
    source = read_petrol(recording)
    content = engine.read_bytes()
    with atomic_folder(out, owned=OWNED) as folder:
        found = discover_petrol(source, parameters, sha256(content).hexdigest())
        found.document.write(folder / "discrepancy.json")
        write_json(folder / "details.json", details(found))
        write_bytes(folder / "engine.yaml", content)
        build_petrol_report(found, folder / "report.html", folder / "figures")
        write_json(folder / "runtime.json", {
            "seconds": found.runtime_s, "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            "platform": platform.platform(), "cpus": os.cpu_count()})
    yield found.sentence
    yield f"results: {out}"


def run_calibrate_petrol(recording: Path, out: Path, base: str | Path = BASE) -> Iterator[str]:
    """Calibrate on a fault-free recording and write the engine file; yields lines to print.

    Raises:
        InputError: a recording that is too short, has no idling or lacks columns.
    """
    from dieseltwin.report.petrol import calibration_lines

    shell = PetrolParameters() if str(base) == BASE else validate(PetrolParameters, read_mapping(base), str(base))
    if out.suffix not in (".yaml", ".yml"):
        raise InputError("--out", out, "a .yaml file", "name one")
    check_writable(out)
    source = read_petrol(recording)
    engine, fits, scores = calibrate(source.signals, shell, source.sha256)
    save_petrol(engine, out)
    yield from calibration_lines(fits, scores, engine.detection.threshold)
    yield f"engine: {out}"
