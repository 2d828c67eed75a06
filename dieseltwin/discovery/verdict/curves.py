"""What a finished discovery hands on: the document, the repaired engine, and the curves that figures are drawn from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.discovery.verdict.observed import Observed
from dieseltwin.engine.parameters import EngineParameters


class Candidate(TypedDict):
    """One effect that was weighed. Numbers that don't exist (nothing fitted) are None.

    Keys:
        name, site: as in the catalogue.
        log_likelihood_gain: over the health-only fit, all parameters refitted [-].
        magnitude, std, tolerance: in the effect's unit.
        probability: among all that were weighed [-].
        reason: why it was chosen or not, one sentence for people.
    """

    name: str
    site: str
    log_likelihood_gain: float | None
    magnitude: float | None
    std: float | None
    tolerance: float | None
    probability: float | None
    reason: str


class LawCurve(TypedDict):
    """One found term over its main argument.

    Keys:
        name: of the effect, or `none_of_these`.
        x_name: the argument ("p_im/p_amb").
        x, curve, low, high: (m,) the law and its 90 % band over the domain of the recording.
        points_x, points_y: (k,) what the recording says without the law: the term freed in k bins of x.
        unit: of the curve ("kg/s").
        points_std: (k,) standard deviations of the points, where known.
    """

    name: str
    x_name: str
    x: Array
    curve: Array
    low: Array
    high: Array
    points_x: Array
    points_y: Array
    unit: str
    points_std: NotRequired[Array]


@dataclass(frozen=True)
class Curves:
    """What the figures need, over the n rows and C channels that were used.

    Attributes:
        time_s: (n,) time [s].
        channels: names of the C columns.
        measured, before, after: (n, C) readings, the health-only fit, the repaired fit [SI]; NaN where missing.
        sigma: (C,) noise of each channel [SI].
        evidence_over_time: middles of windows (W,) [s], and the log-likelihood gained in each (W,) [-].
        evidence_map: condition name -> (n,) values.
        evidence: (n,) log-likelihood gained at each sample [-].
        candidates: what was weighed, strongest first.
        laws: the found terms as curves.
        tolerance: name -> smallest magnitude of interest [unit of the effect].
        units: name -> its unit.
        held_out: (n,) True where a row was not used for the fit; None where nothing was held out.
        allowed: (n, C) what the tolerances of maps and sensors explain beside the repaired fit [SI]; None where that
            isn't known.
        start_s: where on the axis of `time_s` the recording starts, from which onsets and ends count [s].
    """

    time_s: Array
    channels: tuple[str, ...]
    measured: Array
    before: Array
    after: Array
    sigma: Array
    evidence_over_time: tuple[Array, Array]
    evidence_map: Mapping[str, Array]
    evidence: Array
    candidates: Sequence[Candidate] = ()
    laws: Sequence[LawCurve] = ()
    tolerance: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    held_out: Array | None = None
    allowed: Array | None = None
    start_s: float = 0.0


@dataclass(frozen=True)
class Discovery:
    """The result of `discover`.

    Attributes:
        document: what `discrepancy.json` holds.
        engine: the repaired engine: health estimates and `terms`.
        engine_before: the engine of the health-only fit.
        curves: for figures.
        runtime: wall times by step [s], and whatever else differs from run to run.
        details: whatever else is worth keeping, JSON types; goes into `details.json`.
        starts, local: (W,) first rows of the windows of the repaired fit, among the rows with the engine running, and
            (W, 3) p_im, p_em [Pa], omega_t [rad/s] there; None where they weren't kept (`implied` then takes smoothed
            readings).
        observed: what the recording leaves in its engine's history; None without a learned engine.
    """

    document: Discrepancy
    engine: EngineParameters
    engine_before: EngineParameters
    curves: Curves
    runtime: Mapping[str, Any] = field(default_factory=dict)
    details: Mapping[str, Any] = field(default_factory=dict)
    starts: NDArray[np.int64] | None = None
    local: Array | None = None
    observed: Observed | None = None
