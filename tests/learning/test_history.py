"""The history of an engine: nothing lost, nothing double, nothing damaged unseen."""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dieseltwin.api.histories import remove, restore
from dieseltwin.errors import InputError
from dieseltwin.learning.alarm import Alarm, Course, Score
from dieseltwin.learning.history import FILE_NAME, Entry, History, from_json, to_json
from dieseltwin.learning.sketches import shared, sketch
from dieseltwin.recordings.channels import INPUTS
from dieseltwin.recordings.reader import Recording
from dieseltwin.report.history import evidence, page, sentence, table
from tests.disk import full_beyond

ENGINE = "e" * 64


def entry(k: int) -> Entry:
    rng = np.random.default_rng(k)
    score = Score("boost_leak", "intake_mass_balance", "m2", 4e-6, True, 1e-6 * k, 1e-6, rng.standard_normal(5))
    health = rng.uniform(1.0, 2.0, 4)
    return Entry(
        f"{k:064d}", f"{k}.csv", f"2026-01-{k + 1:02d}T00:00:00+00:00", "file name", 0.1, 1e5, 298.0, health,
        np.diag(health), health, 0.1 * health, (score,), "healthy", "Nothing.",
    )  # fmt: skip


def test_an_entry_comes_back_bit_for_bit():
    before = entry(3)
    after = from_json(to_json(before))
    assert after is not None and to_json(after) == to_json(before)
    assert np.array_equal(after.scores[0].shared, before.scores[0].shared)
    assert from_json("{}") is None and from_json("no JSON") is None


def test_order_and_repetition_of_adding_do_not_matter(tmp_path: Path):
    forth, back = History(tmp_path / "a", ENGINE), History(tmp_path / "b", ENGINE)
    for k in range(4):
        assert forth.add(entry(k))
        assert back.add(entry(3 - k))
    assert not forth.add(entry(2)) and forth.holds(entry(2).sha256) and not forth.holds("f" * 64)
    assert [to_json(e) for e in forth.entries()] == [to_json(e) for e in back.entries()]
    assert [e.path for e in History(tmp_path / "a").entries()] == ["0.csv", "1.csv", "2.csv", "3.csv"]


KILLED = """
import os, sqlite3, sys
sys.path[:0] = {path!r}
from tests.learning.test_history import ENGINE, entry
from dieseltwin.learning.history import History
store = History({folder!r}, ENGINE)
store.add(entry(0))
with store._opened() as connection:
    connection.execute("INSERT INTO recordings SELECT 'x', date, hours, p_amb_pa, t_amb_k, verdict, row, checksum "
                       "FROM recordings")
    os.kill(os.getpid(), 9)
"""


def test_a_kill_in_the_middle_loses_what_was_being_added_alone(tmp_path: Path):
    code = KILLED.format(path=sys.path, folder=str(tmp_path))
    assert subprocess.run([sys.executable, "-c", code], check=False, env=dict(os.environ)).returncode == -9
    store = History(tmp_path, ENGINE)
    assert [e.path for e in store.entries()] == ["0.csv"]
    assert store.add(entry(1)) and len(store.entries()) == 2


@pytest.mark.parametrize("damage", ["row", "number", "no text", "no row", "truncated", "other", "foreign"])
def test_a_damaged_history_is_refused_in_one_line(tmp_path: Path, damage: str):
    store, path = History(tmp_path, ENGINE), tmp_path / FILE_NAME
    for k in range(3):
        store.add(entry(k))
    changes = {"row": "row = replace(row, '1.csv', '9.csv')", "number": "checksum = 'no'",
               "no text": "row = CAST(CAST(substr(row, 1, 90) AS BLOB) || x'ff3e' || substr(row, 93) AS TEXT)",
               "no row": "row = substr(row, 2)"}  # fmt: skip
    if change := changes.get(damage):
        with sqlite3.connect(path) as connection:
            connection.execute(f"UPDATE recordings SET {change}")
        connection.close()
    elif damage == "truncated":
        path.write_bytes(path.read_bytes()[:5000])
    elif damage == "other":
        path.write_bytes(b"no database at all, but some text that is long enough to be looked at " * 20)
    else:
        path.unlink()
        with sqlite3.connect(path) as connection:
            connection.execute("CREATE TABLE about (key TEXT, value TEXT)")
        connection.close()
    with pytest.raises(InputError, match=FILE_NAME) as refused:
        damaged = History(tmp_path, ENGINE)
        damaged.holds("f" * 64)
        damaged.entries()
    said = str(refused.value)
    assert "\n" not in said and "watch add" in said


def test_a_file_that_was_emptied_is_refused_and_none_is_ever_begun_empty(tmp_path: Path):
    store = History(tmp_path / "new", ENGINE)
    assert not store.entries() and not store.holds("f" * 64) and not (tmp_path / "new").exists()
    assert store.add(entry(0)) and [item.name for item in (tmp_path / "new").iterdir()] == [FILE_NAME]
    store.path.write_bytes(b"")
    for engine in (ENGINE, None):
        with pytest.raises(InputError, match="an empty file"):
            History(tmp_path / "new", engine)


def test_a_history_begins_where_the_file_system_knows_no_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refused(*_: object) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refused)
    assert History(tmp_path, ENGINE).add(entry(0)) and len(History(tmp_path).entries()) == 1
    assert [item.name for item in tmp_path.iterdir()] == [FILE_NAME]


def test_a_full_disk_leaves_no_half_of_a_history(tmp_path: Path):
    with full_beyond(4096), pytest.raises(InputError, match="a history that can be written to"):  # its tables need more
        History(tmp_path, ENGINE).add(entry(0))
    assert list(tmp_path.iterdir()) == []
    with full_beyond(4096), pytest.raises(InputError, match="a history that can be written to"):
        History(tmp_path / "new", ENGINE).add(entry(0))
    assert list(tmp_path.iterdir()) == []  # nor an empty folder


def test_the_same_rows_in_another_file_are_the_same_recording(tmp_path: Path):
    store, rows = History(tmp_path, ENGINE), "a" * 64
    assert store.add(replace(entry(0), rows_sha256=rows)) and store.holds(rows)
    assert not store.add(replace(entry(1), rows_sha256=rows)) and len(store.entries()) == 1
    assert store.add(entry(1)) and store.add(entry(2))  # of before rows were told apart


def driving(seed: int, n: int, resting: int = 0) -> Recording:
    """Rows of which the first stand still at what every engine rests at."""
    readings = np.random.default_rng(seed).uniform(1.0, 2.0, (n, 2))
    readings[:resting] = 1.0
    columns = {**dict.fromkeys(INPUTS, readings[:, 0]), "p_im_pa": readings[:, 1], "time_s": np.arange(n) + 0.2 * seed}
    return Recording(columns["time_s"], columns, 1e5, 298.0)


def part(of: Recording, rows: slice) -> Recording:
    columns = {name: values[rows] for name, values in of.columns.items()}
    return Recording(columns["time_s"], columns, 1e5, 298.0)


@pytest.mark.parametrize("n", [600, 30000])
def test_shared_driving_is_told_from_sketches(n: int):
    whole = driving(1, n)
    for rows in (slice(0, n // 2), slice(n // 3, None), slice(None, None, 2)):  # half-copied, cut, at half the rate
        share = shared(sketch(part(whole, rows)), sketch(whole))
        assert share == pytest.approx(1.0) and share == shared(sketch(whole), sketch(part(whole, rows)))
    later, half = driving(2, n).columns, n // 2
    mixed = {name: np.r_[values[:half], later[name][half:]] for name, values in whole.columns.items()}
    assert shared(sketch(Recording(np.arange(n), mixed, 1e5, 298.0)), sketch(whole)) == pytest.approx(0.5, abs=0.06)
    assert shared(sketch(driving(2, n)), sketch(whole)) == 0.0
    assert shared(sketch(driving(2, n, n // 2)), sketch(driving(1, n, n // 2))) == 0.0  # one row, over and over
    assert shared("", sketch(whole)) == 0.0  # of before sketches were kept
    assert len(sketch(whole)) < 12000


def test_a_half_copied_recording_and_the_whole_one_do_not_both_count(tmp_path: Path):
    store, whole = History(tmp_path, ENGINE), driving(1, 600)
    half = replace(entry(0), rows_sketch=sketch(part(whole, slice(0, 250))))
    assert store.add(half)
    with pytest.raises(InputError, match=r"1\.csv: got driving of 0\.csv in the history \(100 %.*without 0\.csv"):
        store.add(replace(entry(1), rows_sketch=sketch(whole)))
    with pytest.raises(InputError, match=r"whole\.csv: got driving of 0"):
        store.refuse_shared(sketch(whole), "whole.csv")
    assert not store.add(half)  # was there already, which is no mistake
    assert store.add(replace(entry(2), rows_sketch=sketch(driving(2, 600)))) and len(store.entries()) == 2


def test_a_history_belongs_to_one_engine(tmp_path: Path):
    History(tmp_path, ENGINE).add(entry(0))
    with pytest.raises(InputError, match="another engine file"):
        History(tmp_path, "f" * 64)
    with pytest.raises(InputError, match="no such file"):
        History(tmp_path / "none")


def test_dates_are_compared_as_moments():
    assert replace(entry(0), date="2026-01-01T01:00:00+01:00").moment == entry(0).moment


def test_an_alarm_says_where_the_last_recording_by_itself_says_another_name() -> None:
    entries = [entry(0), entry(1)]
    alarm = Alarm(1, "exhaust_leak", "exhaust_mass_balance", "m2", 1.0, (), 13e-6, 1e-6, True, entries[0].moment,
                  entries[0].moment, entries[1].moment, np.array([0.0, 13e-6]), np.full(2, 1e-6))  # fmt: skip
    told = Course(np.array([0.3, 400.0]), 50.0, alarm)
    for verdict, said in (("boost_leak", True), ("healthy", False), ("exhaust_leak", False)):
        words = sentence([entries[0], replace(entries[1], verdict=verdict)], told, 0.02)
        assert ("by itself shows boost_leak" in words) is said and "most likely exhaust_leak" in words
        first, second = (f"{item.moment:%Y-%m-%d}" for item in entries)
        assert f"by then, growing since {first} (at the earliest {first}, at the latest {second})" in words
    sure = replace(told, alarm=replace(alarm, latest=alarm.earliest))
    assert "at the latest" not in sentence(entries, sure, 0.02)


def test_an_alarm_says_what_became_of_it() -> None:
    entries = [entry(k) for k in range(4)]
    sizes = np.array([0.0, 13e-6, 13e-6, 0.2e-6])
    alarm = Alarm(1, "exhaust_leak", "exhaust_mass_balance", "m2", 1.0, (), 13e-6, 1e-6, False, entries[1].moment,
                  entries[0].moment, entries[1].moment, sizes, np.full(4, 1e-6), 3)  # fmt: skip
    told = Course(np.full(4, 400.0), 50.0, alarm)
    words = sentence(entries, told, 0.02)
    assert f"since the recording of {entries[3].moment:%Y-%m-%d} it isn't there any more (0.2 ± 1.0 mm²" in words
    there = replace(alarm, sizes=np.array([0.0, 13e-6, 13e-6, 15e-6]), gone=None)
    both = replace(entries[3], verdict="exhaust_leak + w_c_gain")
    words = sentence([*entries[:3], both], replace(told, alarm=there), 0.02)
    assert ", about 15.0 ± 1.0 mm² in the last recording" in words and "any more" not in words
    assert "by itself shows exhaust_leak + w_c_gain" in words
    told_alone = replace(both, sizes={"exhaust_leak": (15e-6, 1e-6)})  # refitted: no longer about
    assert ", 15.0 ± 1.0 mm² in the last" in sentence([*entries[:3], told_alone], replace(told, alarm=there), 0.02)


def test_what_is_taken_out_counts_no_more_is_kept_and_comes_back(tmp_path: Path) -> None:
    store = History(tmp_path, ENGINE)
    half, whole = (replace(entry(k), rows_sketch=sketch(driving(1, 600 - 300 * (1 - k)))) for k in (0, 1))
    store.add(half)
    with pytest.raises(InputError, match=r"driving of 0\.csv in the history"):
        store.add(whole)
    store.take_out(half.sha256, "half copied")
    assert store.add(whole) and [e.path for e in store.entries()] == ["1.csv"]
    taken, = History(tmp_path).taken_out()
    assert to_json(taken.entry) == to_json(half) and str(taken).endswith(": half copied")
    assert not store.holds(half.sha256)
    with pytest.raises(InputError, match=r"taken out of the history \(0.csv, on 20..-..-..: half copied\)"):
        store.add(half)
    with pytest.raises(InputError, match=r"driving of 1\.csv in the history"):
        store.put_back(taken)
    store.take_out(whole.sha256, "once more")
    dated = replace(half, date="2026-02-11T00:00:00+00:00")
    assert store.add(dated) and [t.entry.path for t in store.taken_out()] == ["1.csv"]  # of another day: no double
    store.take_out(dated.sha256, "it was the day before")
    store.put_back(taken)
    assert [e.path for e in store.entries()] == ["0.csv"] and [t.entry.path for t in store.taken_out()] == ["1.csv"]
    with sqlite3.connect(tmp_path / FILE_NAME) as connection:
        connection.execute("UPDATE taken_out SET reason = 'of no interest'")
    connection.close()
    with pytest.raises(InputError, match="taken out, is not as it was written"):
        store.taken_out()


def test_two_who_take_a_recording_out_or_back_at_once_are_no_damage(tmp_path: Path) -> None:
    """The second had a traceback, or was told of a damaged history."""
    store = History(tmp_path, ENGINE)
    store.add(entry(0))
    store.take_out(entry(0).sha256, "on another lorry")
    store.take_out(entry(0).sha256, "of no interest")
    taken, = store.taken_out()
    assert taken.reason == "on another lorry"
    for _ in range(2):
        store.put_back(taken)
        assert [e.path for e in store.entries()] == ["0.csv"] and store.taken_out() == ()


def test_a_recording_is_meant_by_the_beginning_of_its_name_and_one_that_is_out_already_is_said(tmp_path: Path) -> None:
    store = History(tmp_path, ENGINE)
    for k, name in enumerate(("a_1.csv", "a_2.csv", "b.csv")):
        store.add(replace(entry(k), path=name))
    with pytest.raises(InputError, match=r"2 recordings in the history: a_1\.csv"):
        remove(tmp_path, "a_", "on another lorry")
    assert [e.path for e in remove(tmp_path, "b", "on another lorry").entries] == ["a_1.csv", "a_2.csv"]
    with pytest.raises(InputError, match=r"what is taken out already \(b.csv, on .*watch restore"):
        remove(tmp_path, "b.csv", "once more")
    assert len(restore(tmp_path, "b").entries) == 3


def test_sizes_of_a_verdict_are_kept_shown_and_told(tmp_path: Path) -> None:
    """The last recording's leak of 14.7 mm2 stood as 8.7 +- 0.5 mm2, its linear estimate, in the sentence."""
    found = replace(entry(1), verdict="boost_leak or blow_by", sizes={"boost_leak": (14.7e-6, 0.5e-6)})
    after = from_json(to_json(found))
    assert after is not None and after.sizes["boost_leak"][0] == 14.7e-6
    assert after.shown.names == ("boost_leak", "blow_by") and entry(1).shown.names == ()
    old = json.loads(to_json(entry(1)))
    del old["sizes"]  # as histories of before hold it
    without = from_json(json.dumps(old))
    assert without is not None and without.sizes == {}
    course = Course(np.zeros(2), 50.0, None)
    assert table([entry(0), after], course)["size:boost_leak"].tolist()[1] == 14.7e-6
    said = page([entry(0), after], course, "No alarm.")
    assert said.title == "No alarm, but the last recording shows something" and said.alarm
    assert page([after, entry(2)], course, "No alarm.").title == "No change but wear"  # of the last one alone
    words = sentence([entry(0), after], course, 0.02)
    assert "shows boost_leak or blow_by, 14.70 ± 0.50 mm², and one recording alone raises no alarm" in words
    told = said.sections[1].tables[0].rows
    assert told[0][-1] == "healthy" and told[1][-1] == "boost_leak or blow_by, 14.70 ± 0.50 mm²"


def test_the_page_of_an_alarm_shows_its_size_and_no_look_alikes() -> None:
    entries = [entry(k) for k in range(3)]
    other = Score("blow_by", "exhaust_mass_balance", "-", 0.01, True, 0.9, 0.01, np.zeros(5))  # 90 deviations
    entries = [replace(one, scores=(*one.scores, other)) for one in entries]
    alarm = Alarm(1, "boost_leak", "intake_mass_balance", "m2", 1.0, (), 13e-6, 1e-6, False, entries[1].moment,
                  entries[0].moment, entries[1].moment, np.array([0.0, 13e-6, 15e-6]),
                  np.full(3, 1e-6))  # fmt: skip

    def titles(course: Course) -> list[str]:
        figure = evidence(entries, course)
        assert figure is not None
        return [axes.get_title("left") for axes in figure.figure.axes if axes.get_visible()]

    course = Course(np.full(3, 400.0), 50.0, alarm)
    assert titles(course) == ["evidence of a change, log10", "boost leak [mm²]"]
    assert "blow by [standard deviations]" in titles(replace(course, alarm=replace(alarm, others=("blow_by",))))
    assert "blow by [standard deviations]" in titles(replace(course, alarm=None))
