"""What `dieseltwin calibrate`, `dieseltwin imply`, and `dieseltwin discover` on settled points do."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from dieseltwin import __version__
from dieseltwin.atomic import atomic_folder, check_writable, write_json
from dieseltwin.cli.petrol import BASE as PETROL
from dieseltwin.cli.petrol import is_petrol_base, run_calibrate_petrol
from dieseltwin.engine import we2011
from dieseltwin.engine.engine_files import load_engine
from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.errors import InputError
from dieseltwin.settings.strict import refuse_options

BASES = {"we2011": we2011.PARAMETERS}
OWNED = ("discrepancy.json", "report.html", "report_figures", "implied.parquet", "repaired.yaml",
         "repaired.steady.json", "runtime.json")  # fmt: skip


def _base(name: str) -> EngineParameters:
    if name in BASES:
        return BASES[name]
    if Path(name).suffix in (".yaml", ".yml"):
        return load_engine(name)
    raise InputError("--base", repr(name), f"{', '.join((*BASES, PETROL))} or an engine file", "name one of these")


def run_calibrate(
    points: Path, out: Path, *, base: str = "we2011", geometry: Path | None = None, channels: Path | None = None,
    noise_pct: float | None = None, seed: int = 0,
) -> Iterator[str]:  # fmt: skip
    """Calibrate an engine to points (or a recording's quasi-steady windows); yields the lines to print.

    Writes the engine file, its sidecar, a report with figures, and a channel map if an actuator is turned round.

    Raises:
        InputError: files that can't be used, too few points, swapped columns; nothing is written then.
    """
    from dieseltwin.calibration.calibrate import calibrate, read_geometry
    from dieseltwin.calibration.likelihood import NOISE
    from dieseltwin.calibration.saved import calibration_sidecar, write_calibration
    from dieseltwin.recordings.steady_points import read_points
    from dieseltwin.report.calibration import calibration_report

    if is_petrol_base(base):
        refuse_options({"--geometry": geometry, "--channels": channels, "--noise": noise_pct}, "for a petrol engine")
        yield from run_calibrate_petrol(points, out, base)
        return
    if out.suffix not in (".yaml", ".yml"):
        raise InputError("--out", str(out), "a file ending in .yaml", "name an engine file")
    if noise_pct is not None and not 0.0 < noise_pct <= 20.0:
        raise InputError("--noise", noise_pct, "0 to 20 %", "give the sensors' standard deviation in %")
    first = _base(base)
    shape = read_geometry(geometry, first) if geometry is not None else first
    source = read_points(points, channels, shape)
    check_writable(out)
    noise = None if noise_pct is None else {name: noise_pct / 100.0 for name in NOISE}
    began = time.perf_counter()
    found = calibrate(source, first, shape, noise=noise, seed=seed, where=str(points))
    write_calibration(found, out)
    page = out.with_suffix(".html")
    calibration_report(found, page)
    yield f"{found.points.size} points ({source.origin}), {int(found.held_out.sum())} held out"
    yield "submodel              fit %  held out %  R2 held out  tolerance %"
    for name, fit in found.fits.items():
        yield (f"{name:20s} {fit.train:6.2f} {fit.held_out:11.2f} {fit.coefficient_of_determination:12.4f} "
               f"{100 * fit.tolerance:12.2f}")
    weak = [c.name for c in found.coefficients if c.verdict == "prior only"]
    if weak:
        yield f"decided by the base engine, not by the points: {', '.join(weak)}"
    for note in found.notes:
        yield f"- {note}"
    yield f"{out}, {calibration_sidecar(out).name}, {page.name} ({time.perf_counter() - began:.0f} s)"


def run_discover_points(
    points: Path, out: Path, *, engine: Path | None = None, channels: Path | None = None, seed: int = 0
) -> Iterator[str]:
    """What settled points say that the mean-value model lacks; writes a folder, yields the lines to print.

    Writes discrepancy.json, report.html with figures, implied.parquet, repaired.yaml with its sidecar, runtime.json.
    """
    from dieseltwin.calibration.calibrate import calibrate
    from dieseltwin.calibration.repair import repair
    from dieseltwin.calibration.saved import answerer_of, base_and_geometry, write_repaired
    from dieseltwin.calibration.verdict import document, sentence
    from dieseltwin.recordings.steady_points import read_points
    from dieseltwin.report.calibration import repair_report

    base, geometry = base_and_geometry(engine) if engine is not None else (we2011.PARAMETERS, we2011.PARAMETERS)
    source = read_points(points, channels, geometry)
    began = time.perf_counter()
    with atomic_folder(out, owned=OWNED) as folder:
        found = repair(calibrate(source, base, geometry, seed=seed, where=str(points)))
        used = found.calibration.points
        implied = answerer_of(found)(used)
        words = sentence(found)
        document(found).write(folder / "discrepancy.json")
        write_repaired(found, folder / "repaired.yaml")
        _table_of(used.columns, used.row, implied).to_parquet(folder / "implied.parquet", index=False)
        repair_report(found, implied, words, folder / "report.html")
        write_json(folder / "runtime.json", {"seconds": time.perf_counter() - began, "version": __version__})
    for c in found.candidates:
        taken = "taken" if c.chosen else ""
        yield f"round {c.round}: {c.term.name:32s} gain {c.gain:8.1f}  {c.magnitude:.4g} +- {c.std:.2g}  {taken}"
    yield ""
    yield words
    yield f"results: {out}"


def run_imply(points: Path, engine: Path, out: Path, *, channels: Path | None = None) -> Iterator[str]:
    """Every quantity nobody measured, for each point, with standard deviations; yields the lines to print.

    Raises:
        InputError: files that can't be used; nothing is written then.
    """
    from dieseltwin.calibration.saved import load_answerer
    from dieseltwin.recordings.channels import INPUTS
    from dieseltwin.recordings.reader import write_recording
    from dieseltwin.recordings.steady_points import read_points

    answerer, turned = load_answerer(engine)
    source = read_points(points, channels, answerer.model.engine, needed=INPUTS)
    if "exhaust_flap" in answerer.model.active and "u_flap_pct" not in source:
        raise InputError(f"{points}: column u_flap_pct", "none", "this column: the engine has an exhaust flap",
                         "add the flap's position")
    for column in turned:
        source = source.with_columns(**{column: 100.0 - source[column]})
    implied = answerer(source)
    for column in turned:
        source = source.with_columns(**{column: 100.0 - source[column]})
    write_recording(_table_of(source.columns, source.row, implied), out)
    yield f"{out}: {len(implied)} points, {', '.join(c for c in implied if not c.endswith('_std'))}"
    yield from outside(source, answerer.guess.centre, answerer.guess.spread)


def outside(source: object, centre: np.ndarray, spread: np.ndarray) -> list[str]:
    """One line if points lie beyond three standard deviations of the inputs that the engine was calibrated with."""
    from dieseltwin.recordings.channels import INPUTS

    far = np.zeros(0, dtype=bool)
    for i, name in enumerate(INPUTS):
        beyond = np.abs(source[name] - centre[i]) > 3.0 * spread[i]  # type: ignore[index]
        far = beyond if far.size == 0 else far | beyond
    return [f"{int(far.sum())} points lie far from those of the calibration: extrapolated"] if far.any() else []


def _table_of(columns: object, row: np.ndarray, implied: pd.DataFrame) -> pd.DataFrame:
    frame = pd.DataFrame({"row": row, **dict(columns)})  # type: ignore[call-overload]
    return pd.concat([frame.drop(columns=[c for c in implied if c in frame]), implied], axis=1)
