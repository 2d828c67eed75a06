"""Learning through the front door: the engine that is learned is the one that its file holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.api.discovery import ask
from dieseltwin.api.driving import DrivingQuestion
from dieseltwin.api.identification import ask as ask_to_identify
from dieseltwin.api.learning import LearnedResult, _check_misfits, _check_told, _in_its_unit, corrected_maps
from dieseltwin.api.points import _MEAN_MAPS, PointsQuestion
from dieseltwin.api.siblings import siblings_of
from dieseltwin.discovery.fit_test import examine
from dieseltwin.discovery.reference.evidence import Learned
from dieseltwin.engine import HEALTH, MEASURED, EngineParameters, we2011
from dieseltwin.engine.terms import Term
from dieseltwin.errors import InputError
from dieseltwin.learning.belief import Belief
from dieseltwin.learning.domain import domain_of
from dieseltwin.learning.files import UNSETTLED, UNTOLD, load_learned, save_learned, seal_of
from dieseltwin.learning.levels import health_covariance
from dieseltwin.learning.weather import OfType
from dieseltwin.recordings.reader import recording
from tests.api.learned import learned_file
from tests.api.simulated import drive
from tests.calibration.simulated import made_points
from tests.pages import without_pictures


def test_an_engine_is_learned_saved_and_taken(tmp_path: Path) -> None:
    healthy = drive(100.0, we2011.PARAMETERS.replace(eta_cmax=0.72, A_egrmax=3.6e-4))
    found = dt.learn([healthy], map_error=0.02)
    table = found.table()
    assert len(table) > 0 and (table["known_to_pct"] < 0.5 * table["believed_pct"]).all()
    assert found.sentence.startswith("Learned from 1.7 minutes") and "<table" in found._repr_html_()
    assert any(line.startswith("  A_egrmax") and " mm² ±" in line for line in found.lines())
    assert len(found.plot().axes) == 1
    file = found.save(tmp_path / "mine.yaml")
    assert dt.engine(file) == dt.engine(found) == found.engine
    with pytest.raises(InputError, match="another ending"):
        found.save(tmp_path / "mine")


def test_what_learn_gave_is_as_good_as_its_file(tmp_path: Path) -> None:
    file = learned_file(tmp_path)
    judged, known = drive(120.0, seed=31), load_learned(file)
    assert known is not None
    given = LearnedResult(known, cast(Learned, None), ())
    first, second = (cast(DrivingQuestion, ask(judged, engine)) for engine in (file, given))
    assert first.known is not None and second.known is known
    assert second.parameters == first.parameters == known.engine


def test_the_recording_that_fits_worst_is_refused(tmp_path: Path) -> None:
    """It was the one whose hash came first: one of another engine bends the maps that all share."""
    known = load_learned(learned_file(tmp_path))
    assert known is not None
    named = [(f"{k}.csv", replace(known.recordings[0], sha256=str(k), path=Path(f"{k}.csv"))) for k in range(3)]
    earlier = replace(known.recordings[0], sha256="earlier", path=None)

    def refused(misfits: dict[str, float]) -> str | None:
        recordings = (earlier, *(item for _, item in named))
        try:
            _check_misfits(replace(known, recordings=recordings, misfits=misfits), [1.6] * 4)
        except InputError as error:
            # misfits are squares; "times the noise" is their root, as in what `identify` and `discover` say
            left = misfits["earlier"] if error.what == "recording" else misfits[error.what.removesuffix(".csv")]
            assert f"got {left**0.5:.2f} times the noise" in str(error) and "up to 1.26" in str(error)
            return error.what
        return None

    assert refused({"earlier": 1.0, "0": 1.7, "1": 2.0, "2": 1.1}) == "1.csv"
    assert refused({"earlier": 2.5, "0": 1.1, "1": 1.2, "2": 1.7}) == "2.csv"  # what came last made it so
    assert refused({"earlier": 2.5, "0": 1.1, "1": 1.2, "2": 1.1}) == "recording"
    assert refused({"earlier": 1.6, "0": 1.1, "1": 1.2, "2": 1.1}) is None
    with pytest.raises(InputError, match="got nan times"):  # a simulation that runs away leaves no number
        _check_misfits(replace(known, misfits={known.recordings[0].sha256: float("nan")}), [1.6])


def test_recordings_that_tell_nothing_are_refused(tmp_path: Path) -> None:
    """A fit that had run away in every window left no misfit: the base's health was saved as learned, to 30 %."""
    known = load_learned(learned_file(tmp_path))
    assert known is not None
    _check_told(known)
    with pytest.raises(InputError, match="nothing that tells health or maps"):
        _check_told(replace(known, belief=known.believed))


def test_where_a_map_is_known_is_told_by_one_measure(tmp_path: Path) -> None:
    """At the edge of known, a map was in the domain of which no node was known: its row was of NaN."""
    known = load_learned(learned_file(tmp_path))
    assert known is not None
    belief = Belief(known.belief.mean, 0.502**2 * known.believed.covariance)
    edge = replace(known, belief=belief, domain=domain_of(belief, known.errors, known.base))
    rows = corrected_maps(edge)
    assert {row.point for row in rows} == edge.domain.keys() != set()
    assert all(np.isfinite((row.believed, row.corrected, row.known_to, row.share)).all() for row in rows)


def test_a_recording_that_two_siblings_rest_on_would_count_twice(tmp_path: Path) -> None:
    """An engine as it was learned first, and further: its first recording counted as that of two engines."""
    file = learned_file(tmp_path)
    known = load_learned(file)
    assert known is not None
    more = recording(drive(30.0, seed=30))
    both = tuple(sorted((*known.recordings, more), key=lambda item: item.sha256))
    further = replace(known, recordings=both, misfits={item.sha256: 1.0 for item in both})
    save_learned(further, tmp_path / "further.yaml")
    save_learned(known, tmp_path / "copy.yaml")
    base, size = known.base, known.map_rms
    assert len(siblings_of([file, tmp_path / "copy.yaml"], base, size, [])) == 1
    for order in ([file, tmp_path / "further.yaml"], [tmp_path / "further.yaml", file]):
        with pytest.raises(InputError, match=f"a recording that {order[0]} was learned from, too"):
            siblings_of(order, base, size, [])
    copied = replace(known.recordings[0], sha256="of other line ends")
    with pytest.raises(InputError, match="a recording of the new engine itself"):
        siblings_of([file], base, size, [copied])


def test_siblings_that_are_named_now_take_the_place_of_those_before_which_is_said(tmp_path: Path) -> None:
    file = learned_file(tmp_path)
    known = load_learned(file)
    assert known is not None
    save_learned(known, tmp_path / "sibling.yaml")
    own = recording(drive(70.0, seed=30))
    told = Belief(known.believed.mean, 0.5 * known.believed.covariance)  # by other siblings
    before = replace(known, prior=told, of_type=OfType({}, own.p_amb_pa, own.t_amb_k), recordings=(own,),
                     misfits={own.sha256: 1.0})  # fmt: skip
    save_learned(before, file)
    found = dt.learn([drive(70.0, seed=33)], file, siblings=tmp_path / "sibling.yaml")
    assert isinstance(found, LearnedResult) and len(found.known.recordings) == 2
    assert any("told of it before is not counted any more" in line for line in found.lines())


def test_the_repaired_engine_keeps_what_was_learned(tmp_path: Path) -> None:
    """Its file held the corrections without their covariance: health was stated too surely, and not since then."""
    leak = Term(effect="boost_leak", magnitude=6e-5)
    worn = we2011.PARAMETERS.replace(A_vgtmax=0.9 * we2011.PARAMETERS.A_vgtmax, terms=(leak,))
    found = dt.discover(drive(150.0, worn, seed=31), learned_file(tmp_path))
    assert [effect.name for effect in found.document.effects] == ["boost_leak"]
    with without_pictures():
        found.save(tmp_path / "found")
    again = drive(120.0, worn, seed=32)
    given, file = (cast(DrivingQuestion, ask(again, one)) for one in (found, tmp_path / "found" / "engine.yaml"))
    assert given.known is not None and file.known is not None and given.known.found == file.known.found
    assert np.array_equal(file.known.belief.covariance, given.known.belief.covariance)
    assert file.parameters.A_vgtmax == given.parameters.A_vgtmax == cast(EngineParameters, found.engine).A_vgtmax
    answer = file.answer().document
    since = answer.health["A_vgtmax"].since_reference
    assert not answer.mismatch and since is not None and abs(since.value - 0.9) < 4.0 * since.std < 0.2
    said = dt.identify(again, found, runs=1)
    assert abs(said.table()["since_reference"]["A_vgtmax"] - 0.9) < 0.03


def test_corrections_that_nobody_knows_the_certainty_of_are_doubted(tmp_path: Path) -> None:
    judged, file = drive(120.0, seed=31), learned_file(tmp_path)
    bare = dt.engine(file)
    assert f"note: {UNTOLD}" in cast(DrivingQuestion, ask(judged, bare)).notes
    assert f"note: {UNTOLD}" in ask_to_identify(judged, bare).notes
    assert f"note: {UNTOLD}" not in (*_notes(judged, file), *ask_to_identify(judged, file).notes)


def test_settled_points_say_what_they_make_of_a_learned_engine(tmp_path: Path) -> None:
    table = pd.DataFrame(dict(made_points(count=12, noise=0.005).columns))
    asked, plain = cast(PointsQuestion, ask(table, learned_file(tmp_path))), cast(PointsQuestion, ask(table))
    assert [note for note in asked.points.notes if note not in plain.points.notes] == [_MEAN_MAPS]


def test_health_of_a_learned_engine_is_no_better_known_than_when_it_was_learned(tmp_path: Path) -> None:
    file = learned_file(tmp_path)
    known = load_learned(file)
    assert known is not None
    judged = recording(drive(120.0, seed=31))
    alone, learned = examine(judged, we2011.PARAMETERS, MEASURED), examine(judged, known.engine, MEASURED, known)
    assert not learned.notes
    least = np.sqrt(np.diag(health_covariance(known)))
    for name, at_least in zip(HEALTH, least, strict=True):
        told = learned.health[name]
        assert told.std >= 0.9 * at_least and told.std > alone.health[name].std
        assert abs(told.value - getattr(we2011.PARAMETERS, name)) < 4.0 * told.std
        since = told.since_reference  # nothing became of it
        assert alone.health[name].since_reference is None and since is not None
        assert abs(since.value - 1.0) < 4.0 * since.std < 1.0
    said = dt.identify(drive(120.0, seed=31), file, runs=1)
    assert "since the reference A_egrmax " in said.sentence
    assert ((said.table()["since_reference"] - 1.0).abs() < 4.0 * said.table()["since_reference_std"]).all()


@pytest.mark.thorough
def test_an_engine_without_a_flow_meter_is_learned_by_the_sensors_it_has() -> None:
    healthy = drive(150.0, we2011.PARAMETERS.replace(eta_cmax=0.72))
    used = [name for name in MEASURED if name in healthy and name != "w_egr_kg_s"]
    with pytest.raises(InputError, match=r"column w_egr_kg_s: got none.*--sensors"):
        dt.learn([healthy.drop(columns="w_egr_kg_s")])
    found = dt.learn([healthy.drop(columns="w_egr_kg_s")], sensors=used)
    assert len(found.table()) > 0
    same = dt.learn([healthy], sensors=used)  # a sensor that isn't named isn't used
    first, second = (cast(LearnedResult, item).known.belief.mean for item in (found, same))
    np.testing.assert_allclose(second, first)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [("p_im", 278_500.0, "278.5 kPa"), ("omega_t", 10_160.0, "10160 rad/s"), ("u_egr", 8.0, "8 %")],
)
def test_where_a_map_is_known_is_said_in_the_units_that_an_engineer_reads(name: str, value: float, said: str) -> None:
    assert _in_its_unit(name, value) == said


def test_what_is_doubtful_about_an_engine_is_said_when_a_recording_is_judged_by_it(tmp_path: Path) -> None:
    file = learned_file(tmp_path)
    judged = drive(120.0, seed=31)
    assert f"note: {UNSETTLED}" not in _notes(judged, file)
    known = load_learned(file)
    assert known is not None
    save_learned(replace(known, converged=False, suspected=("the reference itself looks like a leak",)), file)
    assert {f"note: {UNSETTLED}", "note: the reference itself looks like a leak"} <= set(_notes(judged, file))


def test_a_copy_counts_once_whatever_its_line_ends(tmp_path: Path) -> None:
    """It ended in a KeyError after the whole fit."""
    one, copy = tmp_path / "one.csv", tmp_path / "copy.csv"
    drive(70.0, we2011.PARAMETERS).to_csv(one, index=False)
    copy.write_bytes(one.read_bytes().replace(b"\n", b"\r\n"))
    assert len(dt.learn([one, copy]).known.recordings) == 1


def test_what_another_learned_meanwhile_is_not_lost(tmp_path: Path) -> None:
    file = learned_file(tmp_path)
    known = load_learned(file)
    assert known is not None
    mine = LearnedResult(known, cast(Learned, None), (), (file.resolve(), seal_of(file)))
    save_learned(replace(known, converged=False), file)
    with pytest.raises(InputError, match=r"mine\.yaml: got a learned engine that isn't the one read"):
        mine.save(file)
    assert mine.save(tmp_path / "other.yaml").is_file()


def test_a_file_of_a_newer_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = learned_file(tmp_path)
    known = load_learned(file)
    assert known is not None
    monkeypatch.setattr("dieseltwin.learning.files.asdict", lambda further: {"size": 1.0, "unheard": 2.0})
    save_learned(known, file)
    monkeypatch.undo()
    with pytest.raises(InputError, match="other corrections, written by version"):
        load_learned(file)


def _notes(judged: pd.DataFrame, file: Path) -> list[str]:
    question = ask(judged, file)
    assert isinstance(question, DrivingQuestion)
    return list(question.notes)


def test_recordings_that_are_together_more_than_memory_bears_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dieseltwin.discovery.verdict.checks.MOST_ROWS", 900)
    parts = [drive(120.0, we2011.PARAMETERS, seed=seed) for seed in (1, 2)]
    with pytest.raises(InputError, match=r"2 recordings: got 12\d\d rows of running engine; allowed: at most 900"):
        dt.learn(parts)


def test_one_recording_stands_for_itself(tmp_path: Path) -> None:
    file = tmp_path / "short.csv"
    short = drive(40.0, we2011.PARAMETERS)
    short.to_csv(file, index=False)
    for one in (str(file), file, short):
        with pytest.raises(InputError, match="40 s of running engine"):
            dt.learn(one)
    with pytest.raises(InputError, match="40 s of running engine"):
        dt.discover(drive(70.0, we2011.PARAMETERS), reference=str(file))
    with pytest.raises(InputError, match=r"none\.yaml: got no learned engine"):
        dt.learn(drive(70.0, we2011.PARAMETERS), siblings=str(tmp_path / "none.yaml"))
