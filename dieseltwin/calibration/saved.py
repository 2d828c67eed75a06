"""Files of a calibration: an engine file that every command takes, and a sidecar with what it doesn't hold.

`engine.yaml` holds engine parameters; beside it `engine.calibration.json` the fits, the covariance and each map's
tolerance. A repaired engine is `repaired.yaml`, terms included, with `repaired.steady.json`: every formulation of the
unmeasured places with its covariance, and the first guess of the states, so that `imply` can answer for new points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from dieseltwin.atomic import write_json, write_text
from dieseltwin.calibration.calibrate import Calibration
from dieseltwin.calibration.coefficients import BELIEFS
from dieseltwin.calibration.discover import PointsDiscovery
from dieseltwin.calibration.imply import Answerer, Answers, Guess, guess_of
from dieseltwin.calibration.local_errors import LocalErrors, Smoothness, local_errors, thinned
from dieseltwin.calibration.steady_model import SteadyModel, term_values
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.engine_files import load_engine
from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.errors import InputError
from dieseltwin.notes import doubts_among, warnings_of
from dieseltwin.recordings.noise import SETTLED_NOISE
from dieseltwin.recordings.steady_points import SINCE, SteadyPoints
from dieseltwin.sealed import read_json, sealed_json, sealed_text

FORMAT = 1
STEADY_FORMAT = 3  # 1 held one formulation and the terms that the engine file now has
WITHOUT_POINTS = 2  # still read: answers without what the balances left at the points
_OURS = ("JSON that this version wrote", "write it anew")


def calibration_sidecar(engine_file: Path) -> Path:
    """`engine.yaml` -> `engine.calibration.json`."""
    return engine_file.with_suffix(".calibration.json")


def steady_sidecar(engine_file: Path) -> Path:
    """`repaired.yaml` -> `repaired.steady.json`."""
    return engine_file.with_suffix(".steady.json")


def channel_map_file(engine_file: Path) -> Path:
    """`engine.yaml` -> `engine.channels.yaml`."""
    return engine_file.with_suffix(".channels.yaml")


def write_engine(engine: EngineParameters, path: Path, heading: str) -> Path:
    """The engine's parameters as YAML that --engine takes."""
    content = engine.model_dump(mode="json", exclude_defaults=False)
    body = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
    return write_text(path, sealed_text("".join(f"# {line}\n" for line in heading.splitlines()) + body))


def write_calibration(calibration: Calibration, path: Path) -> list[Path]:
    """Engine file, sidecar, and a channel map where an actuator is turned round; returns what was written."""
    written = [write_engine(calibration.engine, path, "Calibrated by `dieseltwin calibrate`; fits, covariance and "
                            f"tolerances: {calibration_sidecar(path).name}")]
    geometry = calibration.geometry
    content = {
        "format": FORMAT,
        "points": {"path": str(calibration.points.path), "sha256": calibration.points.sha256,
                   "used": calibration.points.size, "held_out": int(calibration.held_out.sum()),
                   "origin": calibration.points.origin},
        "fits": {name: _finite(asdict(fit)) for name, fit in calibration.fits.items()},
        "tolerances": calibration.tolerances(),
        "coefficients": [asdict(c) for c in calibration.coefficients],
        "covariance": {"names": [c.name for c in calibration.coefficients],
                       "matrix": calibration.covariance.tolist()},
        "information_divided_by": calibration.estimate.inflation,
        "converged": calibration.estimate.converged,
        "actuators": [asdict(a) for a in calibration.actuators],
        "notes": list(calibration.notes),
        "warnings": warnings_of(doubts_among(calibration.notes)),
        "base": calibration.base.model_dump(mode="json"),
        "geometry": geometry.model_dump(mode="json"),
    }  # fmt: skip
    written.append(write_json(calibration_sidecar(path), sealed_json(content)))
    turned = [a.column for a in calibration.actuators if a.opens < 0]
    if turned:
        entries = {f"{c}": {"column": c, "scale": -1.0, "offset": 100.0} for c in turned}
        text = "# These actuators close with rising position: give this map with --channels.\n"
        text += yaml.safe_dump(entries)
        written.append(write_text(channel_map_file(path), sealed_text(text)))
    return written


def base_and_geometry(path: Path) -> tuple[EngineParameters, EngineParameters]:
    """Base and geometry of a calibrated engine file (from its sidecar), else the engine itself for both."""
    engine = load_engine(path)
    sidecar = next((f for f in (calibration_sidecar(path), steady_sidecar(path)) if f.is_file()), None)
    if sidecar is None:
        return engine, engine
    content = _read(sidecar, *((FORMAT,) if sidecar == calibration_sidecar(path) else (STEADY_FORMAT, WITHOUT_POINTS)))
    try:
        base, geometry = EngineParameters(**content["base"]), EngineParameters(**content["geometry"])
        return base, geometry.replace(terms=engine.terms)
    except (KeyError, TypeError, ValueError) as error:
        raise _broken(sidecar, error) from None


def other_points(engine_file: Path, points: SteadyPoints) -> list[str]:
    """A sentence where an engine was calibrated from other points, which a judgement without `--reference` forgets."""
    sidecar = calibration_sidecar(engine_file)
    if not sidecar.is_file():
        return []
    known = _read(sidecar, FORMAT).get("points", {})
    if not known.get("sha256") or known["sha256"] == points.sha256:
        return []
    return [f"{engine_file.name} was calibrated from other points ({Path(known['path']).name}); its coefficients are "
            "fitted anew to these, which takes up most of a fault: give those points as --reference to judge by them"]


def since_rows(result: PointsDiscovery) -> dict[str, int]:
    """Slot of a term of the repaired engine -> data row of the first judged point that has it, where that isn't the
    first of all."""
    points = result.points
    acts = {slot: points.columns.get(f"{SINCE}{slot}") for slot in term_values(result.engine().terms)}
    return {slot: int(points.row[column > 0.5].min()) for slot, column in acts.items() if column is not None}


def acting_since(points: SteadyPoints, judged_sha256: str, rows: Mapping[str, int]) -> SteadyPoints:
    """Points with where each term of a repaired engine acts, if they are those that it was found on: the file holds the
    engine of the last one, and the points before an onset aren't its. Other points as they are.

    Args:
        points: that are asked or judged.
        judged_sha256: of the points that the terms were found on.
        rows: of `since_rows`.
    """
    if not rows or not judged_sha256 or points.sha256 != judged_sha256:
        return points
    names = ", ".join(f"{slot} (since data row {row})" for slot, row in rows.items())
    note = f"these are the points that the engine was repaired by: {names} acts from there on, not in the points before"
    acts = {f"{SINCE}{slot}": (points.row >= row).astype(np.float64) for slot, row in rows.items()}
    acting = replace(points.with_columns(**acts), notes=(*points.notes, note))
    warmer = [row for slot, row in rows.items() if slot in EFFECTS and EFFECTS[slot].site == "intake_temperature"]
    if warmer and "t_im_k" in points:  # what was usual of the charge was told by the points before
        acting = acting.with_usual_charge(points.row < min(warmer))
    return acting


def as_repaired_by(engine_file: Path, points: SteadyPoints) -> SteadyPoints:
    """`acting_since` by the sidecar of an engine file; the points as they are where there is none."""
    sidecar = steady_sidecar(engine_file)
    if calibration_sidecar(engine_file).is_file() or not sidecar.is_file():
        return points
    content = _read(sidecar, STEADY_FORMAT, WITHOUT_POINTS)
    try:
        return acting_since(points, *_found_on(content))
    except (TypeError, ValueError) as error:
        raise _broken(sidecar, error) from None


def _found_on(content: Mapping[str, Any]) -> tuple[str, dict[str, int]]:
    """SHA-256 of the points that the terms of a sidecar were found on, and since which of their rows they act."""
    return str(content.get("judged_sha256", "")), dict(content.get("since_row", {}))


def write_repaired(result: PointsDiscovery, path: Path, answers: Answers | None = None) -> list[Path]:
    """The repaired machine: an engine file with its terms, and the sidecar that `imply` reads.

    Args:
        result: what the points say.
        path: of the engine file.
        answers: `answers_of` the result where that was asked before: they take seconds.
    """
    written = [write_engine(result.engine(), path, "Repaired by `dieseltwin discover`; --engine accepts it. What is "
                            f"believed of unmeasured places stands in {steady_sidecar(path).name}")]
    known = repaired_by(result, answers or answers_of(result))
    answers, guess = known.answers, known.answers.first.guess
    content = {
        "format": STEADY_FORMAT,
        "terms": [term.model_dump(mode="json", exclude_none=True) for term in result.engine().terms],
        "beliefs": [asdict(c) for c in BELIEFS],
        "formulations": {name: _formulation(answerer) for name, answerer in answers.formulations.items()},
        "noise": dict(SETTLED_NOISE),
        "points": {name: _listed(column) for name, column in thinned(result.points).columns.items()},
        "guess": {"weights": guess.weights.tolist(), "centre": guess.centre.tolist(), "spread": guess.spread.tolist(),
                  "residual": guess.residual.tolist()},
        "turned": list(known.turned), "judged_sha256": known.judged_sha256, "since_row": dict(known.since_row),
        "base": result.calibration.base.model_dump(mode="json"),
        "geometry": result.calibration.geometry.model_dump(mode="json"),
    }  # fmt: skip
    written.append(write_json(steady_sidecar(path), sealed_json(content)))
    return written


def _formulation(answerer: Answerer) -> dict[str, Any]:
    return {
        "engine": answerer.model.engine.model_dump(mode="json"), "active": sorted(answerer.model.active),
        "values": dict(answerer.values),
        "free": [{"name": name, "low": answerer.bounds[name][0], "high": answerer.bounds[name][1]}
                 for name in answerer.names],
        "covariance": answerer.covariance.tolist(), "discrepancy": dict(answerer.discrepancy),
        "smoothness": {row: asdict(s) for row, s in answerer.local.smoothness.items()} if answerer.local else {},
    }  # fmt: skip


@dataclass(frozen=True)
class Repaired:
    """What `imply` needs of a repaired engine.

    Attributes:
        answers: by every formulation.
        turned: actuator columns that must be turned round.
        judged_sha256: of the points that its terms were found on; since_row: as of `since_rows`.
    """

    answers: Answers
    turned: tuple[str, ...]
    judged_sha256: str
    since_row: Mapping[str, int]

    def acting(self, points: SteadyPoints) -> SteadyPoints:
        """As `acting_since`."""
        return acting_since(points, self.judged_sha256, self.since_row)


def load_repaired(path: Path) -> Repaired:
    """What `imply` needs, of a repaired engine file and the sidecar beside it.

    Raises:
        InputError: no engine file, or no or a broken sidecar beside it.
    """
    load_engine(path)  # the same messages for a wrong engine file as everywhere
    sidecar = steady_sidecar(path)
    if not sidecar.is_file():
        raise InputError(str(path), f"no {sidecar.name} beside it", "the repaired.yaml of `dieseltwin discover POINTS`",
                         "run `dieseltwin discover POINTS --engine engine.yaml --out DIR` first")
    content = _read(sidecar, STEADY_FORMAT, WITHOUT_POINTS)
    try:
        guess = Guess(*(np.array(content["guess"][k]) for k in ("weights", "centre", "spread", "residual")))
        found = {}
        for name, part in content["formulations"].items():
            model = SteadyModel(EngineParameters(**part["engine"]), frozenset(part["active"]))
            found[name] = Answerer(
                model, part["values"], tuple(c["name"] for c in part["free"]), np.array(part["covariance"]),
                part["discrepancy"], guess, content["noise"],
                {c["name"]: (float(c["low"]), float(c["high"])) for c in part["free"]},
                _local_errors(model, part, guess, content.get("points")),
            )  # fmt: skip
        return Repaired(Answers(found), tuple(content["turned"]), *_found_on(content))
    except (KeyError, TypeError, ValueError) as error:
        raise _broken(sidecar, error) from None


def repaired_by(result: PointsDiscovery, answers: Answers) -> Repaired:
    """The same without a file; `answers`: of `answers_of`."""
    turned = tuple(a.column for a in result.calibration.actuators if a.opens < 0)
    return Repaired(answers, turned, result.points.sha256, since_rows(result))


def answers_of(result: PointsDiscovery) -> Answers:
    """The same without a file."""
    guess = guess_of(result.calibration.points)
    points = thinned(result.points)
    answerers = {}
    for name, (model, found) in result.formulations.items():
        values = {**result.repaired.start, **found.values()}
        answerers[name] = Answerer(
            model, values, tuple(c.name for c in found.coefficients), found.covariance,
            dict(zip(model.rows, found.discrepancy.tolist(), strict=True)), guess, SETTLED_NOISE,
            {c.name: (c.low, c.high) for c in found.coefficients},
            local_errors(model, points, values, (guess.centre, guess.spread)),
        )  # fmt: skip
    return Answers(answerers)


def _local_errors(
    model: SteadyModel, part: Mapping[str, Any], guess: Guess, columns: Mapping[str, list[float | None]] | None
) -> LocalErrors | None:
    """Of a formulation in a file; None where the file is from before there were any."""
    if columns is None:
        return None
    arrays = {name: np.array(column, dtype=np.float64) for name, column in columns.items()}
    points = SteadyPoints(arrays, np.arange(len(next(iter(arrays.values())))))
    known = {row: Smoothness(**s) for row, s in part["smoothness"].items()}
    return local_errors(model, points, part["values"], (guess.centre, guess.spread), known)


def _listed(column: NDArray[np.float64]) -> list[float | None]:
    """As JSON has it: None where missing."""
    return [float(v) if np.isfinite(v) else None for v in column]


def _read(path: Path, *versions: int) -> dict[str, Any]:
    content = read_json(path, *_OURS)
    if content.get("format") not in versions:
        raise _broken(path, "another format")
    return content


def _broken(path: Path, error: object) -> InputError:
    return InputError(str(path), f"no readable sidecar ({error})", *_OURS)


def _finite(values: Mapping[str, Any]) -> dict[str, Any]:
    return {k: (v if not isinstance(v, float) or np.isfinite(v) else None) for k, v in values.items()}
