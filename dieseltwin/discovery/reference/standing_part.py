"""Settled points of a healthy engine as a likelihood over the coordinates of `learning.belief`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dieseltwin.arrays import rms_of_most
from dieseltwin.discovery.likelihood.metric import ModelScatter, Whitening
from dieseltwin.discovery.reference.part import Linear, Part
from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin
from dieseltwin.discovery.twins.diesel_standing import StandingTwin
from dieseltwin.discovery.twins.interface import Array, Lanes
from dieseltwin.engine import EngineParameters
from dieseltwin.learning.belief import Belief
from dieseltwin.recordings.noise import SETTLED_NOISE, Noise, flat_below
from dieseltwin.recordings.reader import Recording
from dieseltwin.settings.search import CircumstanceSettings

_LEAST, _LARGEST = 0.5, 3.0  # times `SETTLED_NOISE`; where points differ by more, it is no noise
_AS_SURE_AS = 3.0  # readings that tell as much of the noise as is known before: two beds of three within 1.5 of usual
_FROM_EACH = 2.0  # times these, for the noise of six channels, each told apart: 600,000 draws of six readings that had
# 6 to 30 others beyond F(6, that) at 0.001 were there in 0.4 to 0.9 of a thousand, beyond F(6, 3 times) in 1.4 to 1.8
_LEAST_FREE = 1e-9  # readings, where the fit follows all of them
_LEAST_SHARE = 1e-3  # of the freedom that other recordings have: noise is as good as certain for a recording alone
_FREE = 0.05  # of a reading, that the fit leaves to its noise at least: what it takes up says nothing of noise


class StandingPart(Part):
    """As `Part`, of points. They have no rows that tell noise: it is what is usual, and what all points of the engine
    leave behind a fit.

    Attributes:
        flat: column -> reading below which its error no longer falls with it [unit of the column].
        relative: column -> noise over what is usual [-].
        noise_freedom: degrees of freedom from which that is known.
    """

    def __init__(
        self, recording: Recording, engine: EngineParameters, prior: Belief, map_rms: float,
        beliefs: CircumstanceSettings | None, between_rows: bool | None, flat: Mapping[str, float],
    ) -> None:  # fmt: skip
        self.flat, self.relative = flat, dict.fromkeys(flat, 1.0)
        self.noise_freedom = _FROM_EACH * _AS_SURE_AS
        super().__init__(recording, engine, prior, map_rms, beliefs, between_rows)

    def _bound(
        self, recording: Recording, engine: EngineParameters, map_rms: float, beliefs: CircumstanceSettings | None,
        between_rows: bool | None,
    ) -> LoggedTwin:  # fmt: skip
        return StandingTwin(recording, engine, map_tolerance=map_rms, beliefs=beliefs)

    def _scatter_about(self, twin: LoggedTwin, lanes: Lanes) -> ModelScatter:
        return ModelScatter()

    def whiten_anew(self, here: Linear, x: Array, residual: Array) -> None:
        """By the noise that was told last (`tell_noise`), for which no simulation is needed."""
        del here, x, residual
        self.whitening = self._whitening()

    def _whitening(self, explained: Array | None = None) -> Whitening:
        """By the noise that was told last, times what is usual; whatever a model explains."""
        measured = self.twin.measured
        unit = np.maximum(np.abs(measured), [self.flat[name] for name in self.twin.channels])
        relative = np.array([self.relative[name] * SETTLED_NOISE[name] for name in self.twin.channels])
        sigma = np.where(np.isfinite(measured), relative * unit, 1.0)
        return Whitening.of(measured, Noise(sigma, np.zeros_like(sigma)), self.twin.starts)

    def left(self, here: Linear, residual: Array, covariance: Array) -> tuple[Array, Array]:
        """Of every reading, what a fit leaves of it in usual standard deviations, and which share of its variance is
        its own, (n, C) each [-]; 0 where there is no reading.

        A reading that the fit follows leaves less than its noise. Nothing is taken off for where a point begins, which
        is forgotten where it is read.

        Args:
            here, residual: of the fit.
            covariance: (D, D) of the coordinates, in prior standard deviations.
        """
        shape = self.twin.measured.shape
        count = shape[0] * shape[1]
        followed = np.einsum("di,dk,ki->i", here.projected[:, :count], covariance, here.projected[:, :count],
                             optimize=True)  # fmt: skip
        if here.metric.nuisance_basis is not None:
            followed = followed + (here.metric.nuisance_basis[:, :count] ** 2).sum(axis=0)
        relative = np.array([self.relative[name] for name in self.twin.channels])
        rest = here.rest(residual)[:count].reshape(shape) * relative
        own = np.where(self.whitening.present & np.isfinite(self.twin.measured), 1.0 - followed.reshape(shape), 0.0)
        return rest, np.where(own > _FREE, own, 0.0)


def tell_noise(
    parts: Sequence[Part], linear: Sequence[Linear], residuals: Sequence[Array], covariance: Array
) -> None:
    """Tell all settled points of an engine what their readings' noise is: as all of them together show it, in whatever
    weather, beside what is usual. Points of one day alone may be one, whose own residuals say nothing of noise.

    Args:
        parts: of the engine, some of them settled points; the others count for nothing.
        linear, residuals: of each, at the fit; covariance: as of `StandingPart.left`.
    """
    settled = [(part, part.left(here, residual, covariance))
               for part, here, residual in zip(parts, linear, residuals, strict=True)
               if isinstance(part, StandingPart)]  # fmt: skip
    free = np.array([own.sum() for _, (_, own) in settled])
    for name in SETTLED_NOISE:
        of_channel = [(rest[:, part.twin.channels.index(name)], own[:, part.twin.channels.index(name)])
                      for part, (rest, own) in settled if name in part.twin.channels]  # fmt: skip
        if not of_channel:
            continue
        rest, own = (np.concatenate(columns) for columns in zip(*of_channel, strict=True))
        size = rms_of_most(rest[own > 0.0], own[own > 0.0], _AS_SURE_AS)
        for part, _ in settled:  # not into the mapping: copies beside a fault share it
            part.relative = {**part.relative, name: float(np.clip(size, _LEAST, _LARGEST))}
    of_a_channel = _AS_SURE_AS + free.sum() / max(len(settled[0][0].relative), 1)
    for (part, _), own in zip(settled, free, strict=True):
        # what a recording tells of the noise by itself makes its misfit no less sure
        by_others = 1.0 - float(own) / max(float(free.sum()), _LEAST_FREE)
        part.noise_freedom = _FROM_EACH * of_a_channel / max(by_others, _LEAST_SHARE)


def parts_of(
    recordings: Sequence[Recording], engine: EngineParameters, prior: Belief, map_rms: float,
    beliefs: CircumstanceSettings, between_rows: Sequence[bool | None],
) -> list[Part]:  # fmt: skip
    """The part of each recording, driving or settled points; arguments as of `Part`, `between_rows` of each.

    How large a reading must be for its error to go with it is asked of all points: of one alone with its EGR valve
    shut, 2 % of next to nothing would count as noise.
    """
    flat = {}
    for name in SETTLED_NOISE:
        columns = [item.columns[name] for item in recordings if item.standing and name in item.columns]
        if columns and np.isfinite(readings := np.concatenate(columns)).any():
            flat[name] = float(flat_below(readings[:, None])[0])
    return [
        StandingPart(item, engine, prior, map_rms, beliefs, moved, flat) if item.standing
        else Part(item, engine, prior, map_rms, beliefs, moved)
        for item, moved in zip(recordings, between_rows, strict=True)
    ]  # fmt: skip
