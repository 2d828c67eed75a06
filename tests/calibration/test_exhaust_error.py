"""The formula of the exhaust's temperature errs smoothly, alike in points of a reference and those that are judged."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.calibration import calibrate as module
from dieseltwin.calibration.calibrate import Calibration, calibrate
from dieseltwin.calibration.discover import Options, PointsDiscovery, discover_points
from dieseltwin.calibration.lasting_errors import EXHAUST, map_corrections
from dieseltwin.calibration.steady_model import MAP_MODE
from dieseltwin.calibration.verdict import document
from dieseltwin.recordings.steady_points import beside_reference
from dieseltwin.settings.defaults import default_search
from tests.calibration.simulated import GEOMETRY, TRUTH, WAVE_RPM, made_points

WAVE = 0.015
HOTTER_K = 15.0  # that the judged points' thermocouple reads too much
SEARCH = default_search().points.model_copy(update={"most_effects": 1})


def calibrated(hotter_k: float) -> Calibration:
    """Points beside those of when the engine was well, both with the same wave of the exhaust's temperature."""
    well = made_points(TRUTH, 150, 0.002, 5, exhaust_wave=WAVE, u_flap_pct=100.0)
    now = made_points(TRUTH, 120, 0.002, 6, exhaust_wave=WAVE, u_flap_pct=100.0)
    now = now.with_columns(t_em_k=now["t_em_k"] + hotter_k)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 0)
        return calibrate(beside_reference(now, [well]), TRUTH, GEOMETRY, believed=SEARCH)


def discovered(calibration: Calibration) -> PointsDiscovery:
    return discover_points(calibration, Options(law_search=False, search=SEARCH))


@pytest.fixture(scope="module")
def healthy() -> Calibration:
    return calibrated(0.0)


def test_the_error_is_told_and_stays_out_of_the_files_corrections(healthy: Calibration) -> None:
    values = {k: v for k, v in healthy.start.items() if k.startswith(f"{MAP_MODE}{EXHAUST}:")}
    assert 2 < len(values) < 20
    told = np.sum([value * healthy.points[name] for name, value in values.items()], axis=0)
    wave = WAVE * np.sin(healthy.points["n_e_rpm"] / WAVE_RPM)
    rest = np.stack([np.ones_like(wave), healthy.points["n_e_rpm"], healthy.points["u_delta_mg"]], axis=1)
    told, wave = (y - rest @ np.linalg.lstsq(rest, y, rcond=None)[0] for y in (told, wave))  # coefficients do these
    assert np.sqrt(np.mean((told - wave) ** 2)) < 0.3 * np.sqrt(np.mean(wave**2))
    others = {k: 0.0 if k.startswith(MAP_MODE) and k not in values else v for k, v in healthy.start.items()}
    assert not np.any(map_corrections(healthy.points, healthy.model, others, SEARCH))


@pytest.mark.thorough
def test_no_term_without_a_name_follows_it(healthy: Calibration) -> None:
    """Without coefficients of its own the best of them gained 15."""
    found = discovered(healthy)
    assert not found.mismatch, found.effects
    (only,) = found.rounds
    assert max(item.gain for item in only.found.everything_unnamed()) < SEARCH.chance_leaves


@pytest.mark.thorough
def test_a_thermocouple_that_went_off_since_is_found_beside_it_with_its_deviation() -> None:
    found = discovered(calibrated(HOTTER_K))
    assert tuple(found.effects) == ("t_em_k:offset",)
    size, std = found.effects["t_em_k:offset"]
    assert size == pytest.approx(HOTTER_K, abs=3.0 * std)
    assert f"reading {size:+.4g} ± {std:.2g} K" in str(document(found).effects[-1].law)
