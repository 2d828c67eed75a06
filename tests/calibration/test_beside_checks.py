"""Judged points and those of their reference are checked apart, and beside each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.calibration.beside_checks import terms_of_then
from dieseltwin.calibration.checks import check_points
from dieseltwin.engine.terms import Term
from dieseltwin.errors import InputError
from dieseltwin.notes import Note
from dieseltwin.recordings.steady_points import SteadyPoints, beside_reference
from tests.calibration.simulated import TRUTH, made_points

SWAPS = [("p_im_pa", "p_em_pa"), ("w_c_kg_s", "w_egr_kg_s"), ("u_egr_pct", "u_vgt_pct")]


@pytest.fixture(scope="module")
def well() -> SteadyPoints:
    return made_points(TRUTH, 60, 0.005, 5)


@pytest.fixture(scope="module")
def judged() -> SteadyPoints:
    return made_points(TRUTH, 40, 0.005, 6)


def swapped(points: SteadyPoints, a: str, b: str) -> SteadyPoints:
    return points.with_columns(**{a: points[b], b: points[a]})


@pytest.mark.parametrize(("a", "b"), SWAPS)
def test_columns_that_are_swapped_in_one_of_both_are_refused(well: SteadyPoints, judged: SteadyPoints,
                                                             a: str, b: str) -> None:  # fmt: skip
    with pytest.raises(InputError, match=f"points.csv: columns {a} and {b}"):
        check_points(beside_reference(swapped(judged, a, b), [well]), "points.csv")
    with pytest.raises(InputError, match=f"points.csv: its reference: columns {a} and {b}"):
        check_points(beside_reference(judged, [swapped(well, a, b)]), "points.csv")


def test_few_points_are_judged_beside_a_reference_and_one_is_not(well: SteadyPoints, judged: SteadyPoints) -> None:
    assert check_points(beside_reference(judged.take(np.arange(10)), [well]), "points.csv").size == 70
    with pytest.raises(InputError, match="1 usable points; allowed: at least 10 beside a reference"):
        check_points(beside_reference(judged.take(np.arange(1)), [well]), "points.csv")
    with pytest.raises(InputError, match="its reference: got 5 usable points; allowed: at least 20"):
        check_points(beside_reference(judged, [well.take(np.arange(5))]), "points.csv")


def test_a_sensor_that_stands_still_is_refused(well: SteadyPoints, judged: SteadyPoints) -> None:
    still = judged.with_columns(omega_t_rad_s=np.full(judged.size, 9000.0))
    for points in (still, beside_reference(still, [well])):
        with pytest.raises(InputError, match="column omega_t_rad_s: got 9000 in every point"):
            check_points(points, "points.csv")


def test_another_unit_than_the_reference_has_is_said(well: SteadyPoints, judged: SteadyPoints) -> None:
    def notes(points: SteadyPoints) -> list[str]:
        found = check_points(beside_reference(points, [well]), "points.csv").notes
        return [note for note in found if isinstance(note, Note) and note.code == "wrong_engine"]

    assert not notes(judged)
    assert not notes(judged.with_columns(w_c_kg_s=1.15 * judged["w_c_kg_s"], w_egr_kg_s=0.5 * judged["w_egr_kg_s"]))
    in_hertz = judged.with_columns(omega_t_rad_s=judged["omega_t_rad_s"] / (2.0 * np.pi))
    assert "omega_t_rad_s is 0.16 times what the reference reads" in notes(in_hertz)[0]


def test_weather_that_one_of_both_files_has_is_said(well: SteadyPoints, judged: SteadyPoints) -> None:
    """The engine file's stood in the other, 20 K from the day, without a word."""
    (read, other), (lacking, well_lacking) = (
        [replace(one, assumed=assumed) for one in (judged, well)] for assumed in ((), ("t_amb_k",))
    )  # fmt: skip
    known = beside_reference(read, [other])
    for found in (beside_reference(lacking, [other]), beside_reference(read, [well_lacking])):
        told, = set(found.notes) - set(known.notes)
        assert "t_amb_k is there in some of the files only" in told and found.assumed == ("t_amb_k",)
    both = beside_reference(lacking, [well_lacking])
    assert both.notes == known.notes and both.assumed == ("t_amb_k",)


def test_a_reading_that_many_points_lack_is_said(judged: SteadyPoints) -> None:
    rows = np.arange(judged.size)
    left = check_points(judged.with_columns(p_em_pa=np.where(rows % 2, np.nan, judged["p_em_pa"])), "points.csv")
    assert "p_em_pa is missing in 20 of 40 points" in left.notes[-1]
    two = judged.with_columns(p_em_pa=np.where(rows < 3, np.nan, judged["p_em_pa"]),
                              t_em_k=np.where(rows < 3, np.nan, judged["t_em_k"]))  # fmt: skip
    assert "3 points left out: more than one reading is missing" in check_points(two, "points.csv").notes[-1]


def test_a_rounded_copy_of_the_reference_is_refused(well: SteadyPoints, judged: SteadyPoints) -> None:
    rounded = well.with_columns(**{name: np.round(well[name], 3) for name in well.columns})
    with pytest.raises(InputError, match="60 of 60 points whose readings are the reference's but for rounding"):
        check_points(beside_reference(rounded, [well]), "points.csv")
    assert check_points(beside_reference(judged, [well]), "points.csv").size == 100


def test_effects_of_the_engine_file_are_taken_as_there_in_the_reference(
    judged: SteadyPoints, well: SteadyPoints
) -> None:
    leaking = TRUTH.replace(terms=(Term(effect="exhaust_leak", magnitude=5e-5),))
    beside = beside_reference(judged, [well])
    assert "the engine file has exhaust_leak" in terms_of_then(beside, leaking)[0]
    assert not terms_of_then(beside, TRUTH) and not terms_of_then(judged, leaking)
