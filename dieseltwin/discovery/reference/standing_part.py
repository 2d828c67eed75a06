"""Settled points of a healthy engine as a likelihood over the coordinates of `learning.belief`."""

from __future__ import annotations

import numpy as np

from dieseltwin.arrays import MAD_TO_STD
from dieseltwin.discovery.likelihood.metric import ModelScatter, Whitening
from dieseltwin.discovery.reference.part import Part
from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin
from dieseltwin.discovery.twins.diesel_standing import StandingTwin
from dieseltwin.discovery.twins.interface import Array, Lanes
from dieseltwin.engine import EngineParameters
from dieseltwin.learning.belief import Belief
from dieseltwin.recordings.noise import SETTLED_NOISE, Noise, flat_below
from dieseltwin.recordings.reader import Recording
from dieseltwin.settings.search import CircumstanceSettings

_LEAST, _LARGEST = 0.5, 3.0  # times `SETTLED_NOISE`; where points differ by more, it is no noise


class StandingPart(Part):
    """As `Part`, of points. They have no rows that tell noise: it is what is usual, or what is left behind a fit."""

    def _bound(
        self, recording: Recording, engine: EngineParameters, map_rms: float, beliefs: CircumstanceSettings | None,
        between_rows: bool | None,
    ) -> LoggedTwin:  # fmt: skip
        return StandingTwin(recording, engine, map_tolerance=map_rms, beliefs=beliefs)

    def _scatter_about(self, twin: LoggedTwin, lanes: Lanes) -> ModelScatter:
        return ModelScatter()

    def _whitening(self, explained: Array | None = None) -> Whitening:
        measured = self.twin.measured
        unit = np.maximum(np.abs(measured), flat_below(measured))
        relative = usual = np.array([SETTLED_NOISE[name] for name in self.twin.channels])
        if explained is not None:
            left = np.nanmedian(np.abs(measured - explained) / unit, axis=0)
            relative = np.clip(MAD_TO_STD * left, _LEAST * usual, _LARGEST * usual)
        sigma = np.where(np.isfinite(measured), relative * unit, 1.0)
        return Whitening.of(measured, Noise(sigma, np.zeros_like(sigma)), self.twin.starts)


def part_of(
    recording: Recording, engine: EngineParameters, prior: Belief, map_rms: float,
    beliefs: CircumstanceSettings | None = None, between_rows: bool | None = None,
) -> Part:  # fmt: skip
    """The part of a recording, or of settled points; arguments as of `Part`."""
    kind = StandingPart if recording.standing else Part
    return kind(recording, engine, prior, map_rms, beliefs, between_rows)
