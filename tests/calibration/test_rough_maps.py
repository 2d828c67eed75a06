"""What has no name on points without a reference: whether maps that are further off would explain it as well."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dieseltwin.calibration import calibrate as module
from dieseltwin.calibration.calibrate import calibrate
from dieseltwin.calibration.discover import Options, PointsDiscovery, discover_points
from dieseltwin.calibration.rough_maps import rough_enough, rough_maps_note
from dieseltwin.calibration.steady_twin import SteadyTwin
from dieseltwin.calibration.verdict import document
from dieseltwin.settings.defaults import default_search
from tests.calibration.simulated import GEOMETRY, TRUTH, made_points


@pytest.fixture(scope="module")
def bent() -> PointsDiscovery:
    """A filling that waves by 3 % over engine speed, which no coefficient of its map has."""
    data = made_points(TRUTH, count=90, noise=0.002, u_flap_pct=100.0, filling_wave=0.03)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 0)
        return discover_points(calibrate(data, TRUTH, GEOMETRY), Options(law_search=False))


def test_errors_of_maps_that_would_explain_it_are_said(bent: PointsDiscovery) -> None:
    assert bent.more_is_missing and bent.rough in default_search().points.rough_maps
    (note,) = (note for note in document(bent).warnings if note.code == "rough_maps")
    assert "% would explain what has no name as well" in note.text and "--reference" in note.text


def test_what_is_tried_is_said_by_the_settings(bent: PointsDiscovery) -> None:
    """The smallest that does is given, whatever the order; none is tried where none is asked."""
    last = bent.rounds[-1].found
    twin = SteadyTwin(bent.repaired, default_search().points)
    for tried, told in (((), None), ((5.0, 1.001), 5.0)):
        twin.settings = default_search().points.model_copy(update={"rough_maps": tried})
        assert rough_enough(last, twin) == told


def test_nothing_is_said_where_they_would_not(bent: PointsDiscovery) -> None:
    assert not [note for note in document(replace(bent, rough=None)).warnings if note.code == "rough_maps"]


def test_the_errors_are_those_of_the_settings() -> None:
    assert "of 1.1 to 2.8 % would" in rough_maps_note(2.0, default_search().points)
