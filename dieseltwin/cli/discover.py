"""`dieseltwin discover`: a recording in, what the twin leaves out, as a document, a report and a repaired engine."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from dieseltwin import __version__
from dieseltwin.atomic import atomic_folder, write_json, write_text
from dieseltwin.cli.calibrate import run_discover_points
from dieseltwin.cli.petrol import Asked, is_petrol_engine, run_discover_petrol
from dieseltwin.discovery.twins.diesel import MAP_TOLERANCE
from dieseltwin.discovery.verdict.checks import check_engine, check_fit, check_recording, check_sensitivity
from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import FILE_NAME
from dieseltwin.discovery.verdict.explain import DETAILS, check_name, details_of, explain, load_details, plain
from dieseltwin.engine import HEALTH, EngineParameters, load_engine, we2011
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import SENSORS
from dieseltwin.recordings.reader import Recording, read_recording
from dieseltwin.recordings.steady_points import has_time
from dieseltwin.settings.strict import refuse_options, unknown_name

TOLERANCE_RANGE = (0.0, 0.05)  # map tolerance [-]; with more, nothing is left to find
OWNED = ("figures", "report.html", "implied.parquet", "engine.yaml", "runtime.json", DETAILS)


@dataclass(frozen=True)
class Core:
    """The three things that the command needs of `discovery.discover`; tests put others in their place."""

    options: Callable[..., Any]
    prepare: Callable[..., Any]
    discover: Callable[..., Discovery]


def _core() -> Core:
    from dieseltwin.discovery.discover import Options, discover, prepare

    return Core(Options, prepare, discover)


def run_discover(
    recording: Path | None,
    out: Path,
    *,
    engine: Path | None = None,
    sensors: str | None = None,
    channels: Path | None = None,
    withhold: str | None = None,
    map_tolerance: float | None = None,
    seed: int = 0,
    name: str | None = None,
) -> Iterator[str]:
    """Find what the twin leaves out and write it into a folder, all or nothing; yields the lines to print.

    Args:
        recording: CSV or Parquet; None only with `name`, to explain results that are there.
        out: folder for discrepancy.json, details.json, report.html, figures/, implied.parquet, engine.yaml,
            runtime.json.
        engine: YAML overriding engine parameters; terms in it are part of the twin.
        sensors: comma-separated columns to use; None takes all that the recording has.
        channels: channel map of the recording.
        withhold: comma-separated effects to keep out of the catalogue.
        map_tolerance: standard deviation of the maps' smooth relative error that is believed [-]; None takes 0.003.
        seed: of everything random.
        name: an effect; say why it was or wasn't chosen. With results of the same question in `out`, nothing is run.

    Raises:
        InputError: any file or option that can't be used, a recording or an engine file that can't carry a verdict;
            nothing is written then.
    """
    of_recordings = {
        "--sensors": sensors, "--withhold": withhold, "--map-tolerance": map_tolerance, "--explain": name,
    }  # fmt: skip
    if is_petrol_engine(engine) and engine is not None and recording is not None:
        asked_petrol = Asked(sensors, channels, withhold, map_tolerance, seed, name)
        yield from run_discover_petrol(recording, out, engine, asked_petrol)
        return
    map_tolerance = MAP_TOLERANCE if map_tolerance is None else map_tolerance
    asked = _asked(engine, sensors, channels, withhold, map_tolerance, seed)
    if name is not None:
        check_name(name)
    if recording is None:
        if name is None:
            raise InputError("RECORDING", "nothing", "a CSV or Parquet file", "name the recording")
        yield from explain(name, out)
        return
    if name is not None and _answered(recording, out, asked):
        yield from explain(name, out)
        return
    if not has_time(recording, channels):
        refuse_options(of_recordings, "for settled points")
        yield from run_discover_points(recording, out, engine=engine, channels=channels, seed=seed)
        return
    began = time.perf_counter()
    parameters = load_engine(engine) if engine is not None else we2011.PARAMETERS
    source = _read(recording, channels, parameters)
    used, notes = check_recording(source, parameters, asked["sensors"])
    notes = [*(f"note: {note}" for note in source.notes), *notes]
    core = _core()
    options = core.options(
        sensors=used, withhold=tuple(asked["withhold"]), map_tolerance=map_tolerance, seed=seed
    )
    # The folder is opened before the work: a place that cannot be written to is better known now.
    with atomic_folder(out, owned=OWNED) as folder:
        _progress(f"{recording}: {source.duration_s:.0f} s, {', '.join(used)} ...")
        smallest = dict(core.prepare(source, parameters, options).minimum_detectable)
        check_sensitivity(source, smallest, {n: max(map(abs, e.limits)) for n, e in EFFECTS.items()})
        yield from notes
        yield from visible_table(smallest)
        _progress("fitting ...")
        found = core.discover(source, parameters, options)
        check_fit(source, parameters, found.engine, found.document.fit.chi2_per_sample_after)
        _write(folder, found, source, used, asked, notes, began)
    yield ""
    from dieseltwin.report.discovery_words import sentence

    yield sentence(found.document)
    yield f"results: {out}"
    if name is not None:
        yield ""
        yield from explain(name, out)


def _read(recording: Path, channels: Path | None, parameters: EngineParameters) -> Recording:
    """The recording; where it can't be one of this engine, the air balance says so better than a unit would."""
    try:
        return read_recording(recording, channels, parameters, sensors=())
    except InputError:
        size = we2011.PARAMETERS.replace(p_amb=parameters.p_amb, T_amb=parameters.T_amb)
        try:
            source = read_recording(recording, channels, size, sensors=())
        except InputError:
            source = None
        if source is not None:
            check_engine(source, parameters)
        raise


def _progress(text: str) -> None:
    if sys.stderr.isatty():  # a person waits; a log file needs no promise
        print(text, file=sys.stderr)


def _names(text: str | None) -> tuple[str, ...] | None:
    if text is None:
        return None
    return tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def _asked(
    engine: Path | None, sensors: str | None, channels: Path | None, withhold: str | None, map_tolerance: float,
    seed: int,
) -> dict[str, Any]:  # fmt: skip
    """The question as JSON types: what has to agree for old results to be an answer to it."""
    hidden = _names(withhold) or ()
    for effect in hidden:
        if effect not in EFFECTS:
            raise unknown_name("--withhold", effect, list(EFFECTS))
    low, high = TOLERANCE_RANGE
    if not low <= map_tolerance <= high:  # not so for NaN either
        raise InputError("--map-tolerance", f"{map_tolerance:g}", f"{low:g} to {high:g}", "choose another")
    if seed < 0:
        raise InputError("--seed", seed, "0 or more", "choose another")
    named = _names(sensors)
    if sensors is not None and not named:
        raise InputError("--sensors", "no name", f"columns such as {','.join(SENSORS)}", "name some or leave it out")
    return {
        "sensors": None if named is None else sorted(named), "withhold": sorted(hidden),
        "map_tolerance": map_tolerance, "seed": seed, "engine_sha256": _sha256(engine),
        "channels_sha256": _sha256(channels), "code_version": __version__,
    }  # fmt: skip


def _sha256(path: Path | None) -> str | None:
    """Hash of a file that may be missing; the reader complains about that better."""
    return None if path is None or not path.is_file() else hashlib.sha256(path.read_bytes()).hexdigest()


def _answered(recording: Path, out: Path, asked: Mapping[str, Any]) -> bool:
    """Whether `out` holds the results of just this question."""
    if not (out / DETAILS).is_file() or not (out / FILE_NAME).is_file():
        return False
    details = load_details(out)
    return details["options"] == json.loads(json.dumps(asked)) and details["recording_sha256"] == _sha256(recording)


def visible_table(smallest: Mapping[str, float]) -> list[str]:
    """What the recording could show, as lines of text: smallest visible size, tolerance, place."""
    from dieseltwin.report.discovery_words import magnitude_words

    rows = []
    for name, size in smallest.items():
        effect = EFFECTS[name]
        mark = "" if size <= effect.tolerance else f"  {size / effect.tolerance:.2g} x tolerance"
        shown = magnitude_words(name, size, None, effect.unit, extra=False, digits=2)
        least = magnitude_words(name, effect.tolerance, None, effect.unit, extra=False, digits=2)
        rows.append((size / effect.tolerance, f"{name:<31}{shown:>18}{least:>18}   {effect.site}{mark}"))
    head = f"{'this recording could show':<31}{'from':>18}{'of interest from':>18}   in"
    return [head, *(line for _, line in sorted(rows))]


def engine_yaml(found: Discovery) -> str:
    """The repaired engine as YAML that --engine accepts, terms included."""
    import yaml

    values = found.engine.model_dump(mode="json")
    return "# Repaired by `dieseltwin discover`; --engine accepts it.\n" + yaml.safe_dump(
        values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100
    )


def _write(
    folder: Path, found: Discovery, source: Recording, used: Sequence[str], asked: Mapping[str, Any],
    notes: list[str], began: float,
) -> None:  # fmt: skip
    from dieseltwin.discovery.verdict.implied import implied_frame
    from dieseltwin.report.discovery_page import build_discovery_report

    found.document.write(folder / FILE_NAME)
    write_json(folder / DETAILS, details_of(found, asked, notes))
    write_text(folder / "engine.yaml", engine_yaml(found))
    stds = {n: v.std for n, v in found.document.health.items() if v.std is not None and n in HEALTH}
    table = implied_frame(source, found.engine, stds, sensors=used, starts=found.starts, local=found.local)
    table.to_parquet(folder / "implied.parquet", index=False)
    build_discovery_report(found, folder / "report.html", figures_dir=folder / "figures")
    runtime = {
        **found.runtime,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "seconds": time.perf_counter() - began,
        "host": platform.node(),
        "platform": platform.platform(),
        "cpus": os.cpu_count(),
    }
    write_json(folder / "runtime.json", plain(runtime))

