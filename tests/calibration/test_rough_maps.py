"""What has no name on points without a reference: whether maps that are further off would explain it as well."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dieseltwin.calibration import calibrate as module
from dieseltwin.calibration.calibrate import calibrate
from dieseltwin.calibration.discover import Options, PointsDiscovery, discover_points
from dieseltwin.calibration.rough_maps import Rough, rough_maps_notes, wider
from dieseltwin.calibration.steady_twin import SteadyTwin
from dieseltwin.calibration.told_apart import unseen
from dieseltwin.calibration.verdict import document
from dieseltwin.settings.defaults import default_search
from tests.calibration.simulated import GEOMETRY, TRUTH, made_points


def _found(**waves: float) -> PointsDiscovery:
    """Of an engine with a map or formula that waves, relative, over engine speed."""
    data = made_points(TRUTH, count=90, noise=0.002, u_flap_pct=100.0, **waves)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 0)
        return discover_points(calibrate(data, TRUTH, GEOMETRY), Options(law_search=False))


@pytest.fixture(scope="module")
def bent() -> PointsDiscovery:
    """A filling that waves by 3 % over engine speed, which no coefficient of its map has."""
    return _found(filling_wave=0.03)


def test_errors_of_maps_that_would_explain_it_are_said(bent: PointsDiscovery) -> None:
    assert bent.more_is_missing and bent.rough is not None
    assert bent.rough.times in default_search().points.rough_maps
    (note,) = (note for note in document(bent).warnings if note.code == "rough_maps")
    assert "% would explain what has no name as well" in note.text and "--reference" in note.text


def test_what_is_tried_is_said_by_the_settings(bent: PointsDiscovery) -> None:
    """The smallest that does is given, whatever the order; none is tried where none is asked."""
    last = bent.rounds[-1].found
    twin = SteadyTwin(bent.repaired, default_search().points)
    for tried, told in (((), None), ((5.0, 1.001), 5.0)):
        twin.settings = default_search().points.model_copy(update={"rough_maps": tried})
        assert wider(last, twin).times == told


def test_nothing_is_said_where_they_would_not(bent: PointsDiscovery) -> None:
    assert not [note for note in document(replace(bent, rough=None)).warnings if note.code == "rough_maps"]


def test_the_errors_are_those_of_the_settings() -> None:
    (note,) = rough_maps_notes(Rough(2.0), {}, default_search().points)
    assert "of 1.1 to 2.8 % would explain what has no name" in note


def test_a_name_that_rougher_maps_explain_says_so() -> None:
    """A foreign engine whose maps are 2 % off was a gain of p_em's reading of -3.7 %, without doubt."""
    (note,) = rough_maps_notes(None, {"p_em_gain": Rough(3.0)}, default_search().points)
    assert "of 1.7 to 4.2 % would explain p_em_gain as well" in note and "may be no fault" in note


def test_names_that_are_as_good_beside_rougher_maps_are_said() -> None:
    (note,) = rough_maps_notes(None, {"w_c_gain": Rough(None, ("w_c_gain", "boost_leak"))}, default_search().points)
    assert "w_c_gain may also be boost_leak" in note
    assert not rough_maps_notes(None, {"w_c_gain": Rough(None, ("w_c_gain",))}, default_search().points)


@pytest.fixture(scope="module")
def warm() -> PointsDiscovery:
    """An exhaust temperature whose formula waves by 3 % over engine speed."""
    return _found(exhaust_wave=0.03)


def test_an_exhaust_temperature_that_errs_smoothly_is_no_fault(warm: PointsDiscovery) -> None:
    """Without a reference its formula had no smooth error at all, and five of five foreign engines that were well
    were said to miss something there."""
    assert not warm.mismatch


def test_what_health_takes_up_is_said(warm: PointsDiscovery) -> None:
    (line,) = unseen(document(warm))
    assert "t_em_gain below" in line and "eta_sc" in line.split("t_em_gain", 1)[1].split(")")[0]
    assert "--reference" in line
    assert not unseen(document(warm).model_copy(update={"minimum_detectable": {"t_em_gain": 0.02}}))
