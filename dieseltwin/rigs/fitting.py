"""A rig's free parameters from a recording, and how well they foretell what comes after it."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation, first_fit, fit_fully
from dieseltwin.discovery.likelihood.metric import Metric, covariance_of, std_of
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.errors import InputError
from dieseltwin.recordings.noise import estimate_noise
from dieseltwin.rigs.parameters import RigParameters
from dieseltwin.rigs.recording import RigRecording
from dieseltwin.rigs.simulate import first_states, run_error
from dieseltwin.rigs.twin import RigTwin

ROUNDS = 20  # of a fit

_ANYWHERE = 100.0  # scales of a state, within which a window may begin with it


def fitted(rig: RigParameters, recording: RigRecording) -> tuple[RigParameters, Linearisation]:
    """The rig with its parameters and the sizes of its terms fitted to a recording, and the fit.

    Standard deviations are those in the size of the misfit that is left.
    """
    at = _fit(rig, recording)
    found, std = at.fit.parameters, _std(at)
    values = dict(zip(rig.parameters, zip(found, std, strict=True), strict=False))
    sizes = found[len(rig.parameters) :], std[len(rig.parameters) :]
    parameters = {name: p.model_copy(update={"value": float(values[name][0]), "std": float(values[name][1])})
                  for name, p in rig.parameters.items()}
    terms = tuple(t.model_copy(update={"magnitude": float(np.clip(m, *rig.effects[t.effect].limits)), "std": float(s)})
                  for t, m, s in zip(rig.terms, *sizes, strict=True))
    return rig.model_copy(update={"parameters": parameters, "terms": terms}), at


def fitted_surely(rig: RigParameters, recording: RigRecording) -> tuple[RigParameters, Linearisation]:
    """`fitted`, for a machine and a recording that nobody has looked at.

    Raises:
        InputError: no fit stays finite.
    """
    try:
        with np.errstate(all="ignore"):  # a machine that runs away: refused below
            found, fit = fitted(rig, recording)
        if np.isfinite(fit.jacobian).all():
            return found, fit
    except np.linalg.LinAlgError:
        pass
    raise InputError(recording.path, f"no fit of {rig.name} that stays finite", "a recording of this machine",
                     "check values and units of columns and of the file, give more sub_steps, or shorten window_s")


def fitted_otherwise(rig: RigParameters, recording: RigRecording) -> Linearisation | None:
    """The fit of the rig with its inputs taken the other way between rows; None where it runs away so."""
    try:
        return _fit(rig.model_copy(update={"hold": "linear" if rig.hold == "held" else "held"}), recording)
    except np.linalg.LinAlgError:
        return None


def _std(at: Linearisation) -> Array:
    """Standard deviations of a fit's parameters, (P,), with initial states that may be anything.

    A fit holds them within a scale of where they are from step to step. As a belief that would tell how large a state
    is that no sensor reads (a tank above another one), and with it all that scales with that state.
    """
    metric = Metric(at.whitening, at.twin.starts, at.local_response, _ANYWHERE * at.twin.state_scales)
    projected = metric.project(at.jacobian)
    return std_of(covariance_of(projected @ projected.T + np.diag(at.precision)))


def _fit(rig: RigParameters, recording: RigRecording) -> Linearisation:
    """Parameters, sizes of terms and first states, in the metric of the misfit that they leave."""
    twin = RigTwin(rig, recording, rig.window_s)
    start = first_fit(twin)
    start = replace(start, local=first_states(twin, start.parameters))
    rough = fit_fully(twin, twin.whitening(), start, rounds=ROUNDS)
    twin = twin.about(rough.residual)
    return fit_fully(twin, twin.whitening(), rough.fit, rounds=ROUNDS)


def times_noise(at: Linearisation, left: Array) -> Array:
    """Errors (..., C) in the noise of the recording's readings, or their resolution where that is more [-]."""
    twin = cast(RigTwin, at.twin)
    return np.asarray(left / np.maximum(estimate_noise(twin.measured).sigma, twin.floors))


def rms_left(at: Linearisation) -> Array:
    """Root mean square of what a fit leaves of every reading, (C,), NaN for one that is absent."""
    return np.asarray(np.sqrt(np.nanmean(at.residual**2, axis=0)))


def checked_rows(recording: RigRecording, share: float, onset_s: float | None = None) -> slice:
    """The last share of a recording, or of what comes after an onset: it judges what was found."""
    n = len(recording.time_s)
    first = 0 if onset_s is None else int(np.searchsorted(recording.time_s, onset_s))
    return slice(first + round((1.0 - share) * (n - first)), None)


def foretold(rig: RigParameters, recording: RigRecording, last: slice) -> tuple[Array, RigParameters | None]:
    """Errors of free runs over the last rows of the recording, fitted to what comes before, and the machine so
    fitted; (C,), infinite where it runs away."""
    try:
        early, _ = fitted(rig, recording.part(slice(0, last.start)))
        return run_error(early, recording.part(last)), early
    except np.linalg.LinAlgError:
        return np.full(len(rig.readings), np.inf), None
