"""`dieseltwin discover --engine petrol.yaml` and `dieseltwin calibrate --base liu_petrol`: the petrol engine's part."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path

from dieseltwin import __version__
from dieseltwin.atomic import atomic_folder, check_writable, write_json
from dieseltwin.discovery.verdict.document import FILE_NAME
from dieseltwin.discovery.verdict.explain import DETAILS, check_name, explain, plain
from dieseltwin.errors import InputError
from dieseltwin.petrol.calibrate import calibrate
from dieseltwin.petrol.discover import PetrolOptions, details, discover_petrol
from dieseltwin.petrol.effects import HYPOTHESES, NEEDS
from dieseltwin.petrol.parameters import PetrolParameters, is_petrol, load_petrol, save_petrol
from dieseltwin.petrol.recording import COLUMNS, read_petrol
from dieseltwin.petrol.simulate import simulate_petrol
from dieseltwin.recordings.reader import write_recording
from dieseltwin.settings.strict import listed, read_mapping, unknown_name, validate

BASE = "liu_petrol"
TOLERANCE_RANGE = (0.0, 0.1)  # of the maps [-]; with more, nothing is left to find
OWNED = ("figures", "report.html", "engine.yaml", "runtime.json", "details.json")


def is_petrol_engine(engine: Path | None) -> bool:
    """Whether --engine names a petrol engine's file."""
    return engine is not None and engine.is_file() and is_petrol(engine)


def is_petrol_base(base: str | Path) -> bool:
    """Whether --base names the petrol engine or a YAML file of that kind."""
    return str(base) == BASE or is_petrol_engine(Path(base))


@dataclass(frozen=True)
class Asked:
    """Options of `dieseltwin discover` for a petrol engine, as given.

    Attributes:
        sensors: comma-separated columns to use, None for all.
        channels: channel map of the recording.
        withhold: comma-separated effects to keep out of the catalogue.
        map_tolerance: standard deviation of the maps' smooth relative errors [-], None for the engine file's.
        seed: of everything random.
        name: an effect to explain.
    """

    sensors: str | None = None
    channels: Path | None = None
    withhold: str | None = None
    map_tolerance: float | None = None
    seed: int = 0
    name: str | None = None

    def options(self) -> PetrolOptions:
        """Checked.

        Raises:
            InputError: an unknown column or effect, a column that no verdict can do without, a size out of range.
        """
        used, hidden = _names(self.sensors), _names(self.withhold) or ()
        for column in used or ():
            if column not in COLUMNS:
                raise unknown_name("--sensors", column, list(COLUMNS))
        needed = [c for c in (*NEEDS["cylinder"], *NEEDS["throttle"]) if used is not None and c not in used]
        if needed:
            raise InputError("--sensors", f"no {listed(list(dict.fromkeys(needed)))}", listed(list(COLUMNS)),
                             "only p_amb_pa and t_amb_k can be left out: the air's balances need all others")
        for effect in hidden:
            if effect not in HYPOTHESES:
                raise unknown_name("--withhold", effect, list(HYPOTHESES))
        low, high = TOLERANCE_RANGE
        if self.map_tolerance is not None and not low <= self.map_tolerance <= high:
            raise InputError("--map-tolerance", f"{self.map_tolerance:g}", f"{low:g} to {high:g}", "choose another")
        if self.seed < 0:
            raise InputError("--seed", self.seed, "0 or more", "choose another")
        return PetrolOptions(used, hidden, self.map_tolerance, self.seed)


def _names(text: str | None) -> tuple[str, ...] | None:
    return None if text is None else tuple(dict.fromkeys(p.strip() for p in text.split(",") if p.strip()))


def run_discover_petrol(recording: Path, out: Path, engine: Path, asked: Asked | None = None) -> Iterator[str]:
    """Judge a recording and write discrepancy.json, details.json, report.html, figures/, engine.yaml, runtime.json.

    Raises:
        InputError: a file or an option that can't be used; nothing is written then.
    """
    from dieseltwin.report.petrol import build_petrol_report

    asked = asked or Asked()
    options = asked.options()
    if asked.name is not None:
        check_name(asked.name, HYPOTHESES)
    parameters = load_petrol(engine)
    source = read_petrol(recording, asked.channels)
    question = {
        "sensors": options.sensors, "withhold": list(options.withhold), "map_tolerance": options.map_tolerance,
        "seed": options.seed, "engine_sha256": sha256(engine.read_bytes()).hexdigest(), "code_version": __version__,
    }  # fmt: skip
    with atomic_folder(out, owned=OWNED) as folder:
        found = discover_petrol(source, parameters, options, str(question["engine_sha256"]))
        found.document.write(folder / FILE_NAME)
        write_json(folder / DETAILS, plain(details(found, question)))
        save_petrol(found.engine, folder / "engine.yaml")
        build_petrol_report(found, folder / "report.html", folder / "figures")
        write_json(folder / "runtime.json", {
            "seconds": found.runtime_s, "finished": datetime.now(UTC).isoformat(timespec="seconds"),
            "platform": platform.platform(), "cpus": os.cpu_count()})
    yield found.sentence
    yield f"results: {out}"
    if asked.name is not None:
        yield ""
        yield from explain(asked.name, out, HYPOTHESES)


def run_simulate_petrol(inputs: Path, out: Path, engine: Path, channels: Path | None = None) -> int:
    """Simulate a petrol engine over the inputs of a recording and write the result; returns the number of rows.

    Raises:
        InputError: any file that cannot be used or written.
    """
    parameters = load_petrol(engine)
    source = read_petrol(inputs, channels)
    check_writable(out)
    table = simulate_petrol(parameters, source)
    write_recording(table, out)
    return len(table)


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
    engine, fits = calibrate(source.signals, shell, source.sha256)
    save_petrol(engine, out)
    yield from calibration_lines(fits, engine.pieces)
    yield f"engine: {out}"
