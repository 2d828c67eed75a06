"""`dieseltwin identify`: a recording in, health parameters with their uncertainty out, as files and as a table."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dieseltwin.atomic import atomic_folder, write_json
from dieseltwin.engine import MEASURED, EngineParameters, load_engine, we2011
from dieseltwin.errors import InputError
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import NoiseLevels, SegmentProblem, problems_from_recording
from dieseltwin.identification.result import Identification
from dieseltwin.recordings.reader import CRANKING_RPM, Recording, read_recording, rows_out_of_range
from dieseltwin.settings.methods import find
from dieseltwin.settings.params import Params, load_params
from dieseltwin.surrogates.files import networks_for

# Below, the turbo's seconds do not fit in; above, the health parameters are no longer constants of one segment.
SEGMENT_RANGE_S = (10.0, 3600.0)
MISFIT = 2.0  # chi-square a sample from which the noise or the model is clearly not what was assumed
OPTIONAL_RESULTS = ("curves.parquet", "figures")  # another method in the same folder must not leave its own behind


def run_identify(
    recording: Path,
    out: Path,
    *,
    method: str,
    runs: int | None = None,
    engine: Path | None = None,
    channels: Path | None = None,
    models: Path | None = None,
    maps: str | None = None,
    segment_s: float | None = None,
    seed: int | None = None,
    params: Path | None = None,
    profile: str = "quick",
) -> list[str]:
    """Identify the health parameters of a recording and write the results into a folder, all or nothing.

    Args:
        recording: CSV or Parquet.
        out: folder for identification.json, runtime.json, states.parquet and figures/.
        method: one of `settings.methods.names()`.
        runs: independent starts a segment; None takes the settings' number for this method.
        engine: YAML overriding engine parameters; its health parameters are where the search starts.
        channels: channel map of the recording.
        models: folder of pretrained networks.
        maps: which empirical maps: exact, paper or improved.
        segment_s: length of a segment [s]; None takes the settings'.
        seed: None takes the settings' seed.
        params, profile: settings.

    Returns:
        The lines to print: the table of estimates, notes, where the files are.

    Raises:
        InputError: any file or option that cannot be used; nothing is written then.
    """
    chosen = find(method, "--method")
    chosen.check_installed()
    settings = load_params(params, profile)
    runs = settings.identify.runs_of(method) if runs is None else runs
    if runs < 1:
        raise InputError("--runs", runs, "1 or more", "ask for at least one run")
    if segment_s is not None and not SEGMENT_RANGE_S[0] <= segment_s <= SEGMENT_RANGE_S[1]:
        raise InputError("--segment", f"{segment_s:g} s", "{:g} to {:g} s".format(*SEGMENT_RANGE_S), "choose another")
    parameters = load_engine(engine) if engine is not None else we2011.PARAMETERS
    source = read_recording(recording, channels, parameters)
    problems, left_out = _usable(problems_of(source, parameters, settings, segment_s), source)
    networks = networks_for(chosen, models, maps)
    notes = [*_notes(source, parameters), *left_out]
    if sys.stderr.isatty():  # a person waits; a log file needs no promise
        print(f"{recording}: {len(problems)} segments, {runs} runs each, {method} ...", file=sys.stderr)
    # The folder is opened before the work: a place that cannot be written to is better known now.
    with atomic_folder(out, owned=OPTIONAL_RESULTS) as folder:
        found = identify_segments(
            problems,
            method,
            runs,
            settings.seed if seed is None else seed,
            config=settings.identify,
            **networks,
        )
        about = {"params_sha256": settings.sha256, "recording_sha256": source.sha256, "notes": notes}
        _write(folder, found, {**found.runtime(), **about}, problems)
    document = found.to_json()
    return [*table(document), *notes, *misfits(document), f"results: {out}"]


def problems_of(
    source: Recording, parameters: EngineParameters, settings: Params, segment_s: float | None = None
) -> list[SegmentProblem]:
    """Segments of the recording as estimation problems; noise is the settings' share of the whole recording's means."""
    missing = np.full(source.time_s.shape, np.nan)
    signals = np.column_stack([source.columns.get(name, missing) for name in MEASURED])
    signals = signals[source.columns["n_e_rpm"] >= CRANKING_RPM]  # a standing engine would lower the means
    noise = NoiseLevels.from_signals(signals, relative=settings.noise.channels)
    duration_s = settings.identify.segment_s if segment_s is None else segment_s
    return problems_from_recording(source, parameters, noise=noise, duration_s=duration_s)


def _usable(problems: list[SegmentProblem], source: Recording) -> tuple[list[SegmentProblem], list[str]]:
    """Segments whose states can be started, and a note for each one left out.

    Raises:
        InputError: none is left.
    """
    usable, notes = [], []
    for problem in problems:
        dead = [name for i, name in enumerate(MEASURED[:3]) if not problem.observed[:, i].any()]
        if dead:
            notes.append(f"note: {problem.name} left out: no reading of {', '.join(dead)}")
        else:
            usable.append(problem)
    if not usable:
        raise InputError(f"{source.path}: {', '.join(MEASURED[:3])}", "no segment with readings of all three",
                         "at least one", "record longer or ask for longer segments")
    return usable, notes


def _notes(source: Recording, parameters: EngineParameters) -> list[str]:
    ranges = {
        "n_e_rpm": parameters.n_e_range,
        "u_delta_mg": parameters.u_delta_range,
        "u_egr_pct": parameters.u_egr_range,
        "u_vgt_pct": parameters.u_vgt_range,
    }
    counts = rows_out_of_range(source.columns, ranges)
    read = [f"note: {note}" for note in source.notes]
    return read + [f"note: {count} of {len(source.time_s)} rows of {name} are outside the engine's range "
                   f"{ranges[name][0]:g} to {ranges[name][1]:g}" for name, count in counts.items()]


def misfits(document: Mapping[str, Any]) -> list[str]:
    """A warning when the fit leaves more than the noise explains: the intervals do not hold then."""
    everything = [s for run in document["runs"] for s in run["segments"]]
    stuck = sum(not s["converged"] for s in everything)
    notes = []
    if stuck:
        notes = [f"note: {stuck} of {len(everything)} fits did not converge (`converged` in identification.json); a "
                 "segment without a converged fit is left out of the pooled values"]
    values = [s["chi2_per_sample"] for s in everything]
    known = [value for value in values if value is not None]
    if not known or float(np.median(known)) <= MISFIT:
        return notes
    size = float(np.sqrt(np.median(known)))
    return [*notes, f"note: the fit leaves {size:.2g} times the noise assumed in params.yaml: a sensor, the engine "
            "file or the model is off, or the method has not converged; the intervals are too narrow"]


def _write(folder: Path, found: Identification, runtime: Mapping[str, Any], problems: list[SegmentProblem]) -> None:
    from dieseltwin.report import curves_table, identification_figures

    write_json(folder / "identification.json", found.to_json())
    write_json(folder / "runtime.json", runtime)
    found.states.to_parquet(folder / "states.parquet", index=False)
    curves = curves_table(found)
    if curves is not None:
        curves.to_parquet(folder / "curves.parquet", index=False)
    identification_figures(found, problems, folder / "figures")


def table(document: Mapping[str, Any]) -> list[str]:
    """The pooled estimates as lines of text: value, standard deviation, 90 % interval, bound, segments used."""
    segments = document["segments"]
    head = f"{'parameter':<10} {'estimate':>12} {'std':>10} {'90 % interval':>27} {'bound':>10}  unit       segments"
    lines = [f"{document['method']}, {len(document['runs'])} runs, {len(segments)} segments", head]
    for name, entry in document["parameters"].items():
        used = sum(bool(segment["parameters"][name]["identifiable"]) for segment in segments)
        if entry["mean"] is None:
            lines.append(f"{name:<10} not identifiable here (drive with more EGR, load or time)")
            continue
        low, high = entry["interval_90"] or (float("nan"), float("nan"))
        interval = f"{low:.5g} to {high:.5g}"
        bound = "-" if entry["bound"] is None else f"{entry['bound']:.3g}"
        lines.append(f"{name:<10} {entry['mean']:>12.6g} {entry['std']:>10.3g} {interval:>27} {bound:>10}  "
                     f"{entry['unit']:<9}  {used} of {len(segments)}")
    return lines
