"""The flow that takes new recordings of a folder into the history of their engine."""

from __future__ import annotations

import importlib
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import tiny_settings

import dieseltwin as dt
from dieseltwin.api.histories import remove
from dieseltwin.api.watch import begun
from dieseltwin.errors import InputError
from dieseltwin.learning.history import to_json
from dieseltwin.learning.sketches import sketch
from tasks import run_context
from tasks import watch as steps
from tasks.failures import InputChanged, StepFailed
from tasks.progress import Display
from tasks.run_context import RunContext
from tasks.settings import load_settings
from tasks.store import Artifact
from tasks.workspace import Workspace
from tests.api.learned import learned_file
from tests.api.simulated import drive
from tests.learning.test_history import driving, entry, part

LONG_AGO = 1.7e9


@pytest.fixture
def fresh(tmp_path: Path) -> Iterator[Callable[[], None]]:
    """A workspace with small settings; call it for a context that has run nothing yet."""
    tiny_settings.write_params(tmp_path)
    codes: dict = {}

    def made() -> None:
        display = Display(tmp_path / ".cache" / "expected_seconds.json")
        display.console.quiet = True
        run_context.use(RunContext(Workspace(tmp_path), display, codes=codes))

    yield made
    run_context.use(None)


def arrived(folder: Path, name: str, seconds: float = 90.0, *, settled: bool = True) -> None:
    folder.mkdir(exist_ok=True)
    drive(seconds, seed=len(list(folder.iterdir())) + 40).to_csv(folder / name, index=False)
    if settled:
        os.utime(folder / name, (LONG_AGO, LONG_AGO))


def test_what_is_new_is_what_the_history_does_not_hold(tmp_path: Path) -> None:
    mine = learned_file(tmp_path)
    arrived(tmp_path / "in", "2026-01-01.csv", 20.0)
    arrived(tmp_path / "in", "2026-02-01.csv", 20.0, settled=False)
    (tmp_path / "in" / "notes.pdf").write_text("not a recording")
    (tmp_path / "in" / ".2026-03-01.csv.part").write_text("being copied")
    (tmp_path / "in" / "2026-04-01.csv").symlink_to(tmp_path / "moved away.csv")
    copy = Path(shutil.copy2(tmp_path / "in" / "2026-01-01.csv", tmp_path / "in" / "copy of 2026-01-01.txt"))
    found = steps.arrived(str(tmp_path / "in"), str(mine), str(tmp_path / "history"))
    assert list(found.new) == ["2026-01-01.csv"]
    assert found.left.keys() == {"2026-02-01.csv", "2026-04-01.csv", "notes.pdf", copy.name}  # and each says why
    assert "s after the last change" in found.left["2026-02-01.csv"] and "ending .pdf" in found.left["notes.pdf"]
    assert found.left["2026-04-01.csv"] == "a link to a file that isn't there"
    assert found.left[copy.name] == "the same as 2026-01-01.csv"


def test_what_was_taken_out_of_the_history_is_left(tmp_path: Path) -> None:
    mine, history = learned_file(tmp_path), tmp_path / "history"
    arrived(tmp_path / "in", "2026-01-01.csv", 20.0)
    sha256 = Artifact.of(tmp_path / "in" / "2026-01-01.csv").sha256
    begun(history, mine).add(replace(entry(0), sha256=sha256))
    remove(history, tmp_path / "in" / "2026-01-01.csv", "the wrong lorry")
    found = steps.arrived(str(tmp_path / "in"), str(mine), str(history))
    assert not found.new
    assert found.left["2026-01-01.csv"].startswith("got what was taken out of the history (0.csv, on ")


def test_a_recording_whose_clock_is_ahead_is_taken_once_it_has_lain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = learned_file(tmp_path)
    arrived(tmp_path / "in", "2026-01-01.csv", 20.0)
    os.utime(tmp_path / "in" / "2026-01-01.csv", (4e9, 4e9))  # 2096
    where = str(tmp_path / "in"), str(mine), str(tmp_path / "history")
    assert list(steps.arrived(*where).left) == ["2026-01-01.csv"]
    monkeypatch.setattr(steps, "_SETTLED_S", 0.0)
    assert list(steps.arrived(*where).new) == ["2026-01-01.csv"]


def test_the_day_of_a_file_counts_where_its_name_says_none(tmp_path: Path) -> None:
    for name in ("drive.csv", "2026-01-01.csv"):
        arrived(tmp_path / "in", name, 20.0)
    assert steps.modified_s(tmp_path / "in" / "drive.csv", "drive.csv") == LONG_AGO
    assert steps.modified_s(tmp_path / "in" / "2026-01-01.csv", "2026-01-01.csv") is None


def test_wrong_arguments_are_one_line_before_anything_starts(tmp_path: Path) -> None:
    mine = learned_file(tmp_path)
    good = {"folder": str(tmp_path), "engine": str(mine), "history": str(tmp_path / "history")}
    steps.check(good)
    assert not (tmp_path / "history").exists()  # the first recording makes it
    with pytest.raises(StepFailed, match="no such folder"):
        steps.check({**good, "folder": str(tmp_path / "none")})
    (tmp_path / "plain.yaml").write_text("J_t: 2.0e-4\n")
    with pytest.raises(StepFailed, match="no learned engine"):
        steps.check({**good, "engine": str(tmp_path / "plain.yaml")})
    (tmp_path / "broken.yaml").write_text("J_t: [2.0e-4,\n")
    with pytest.raises(InputError, match="allowed: YAML of text and numbers"):
        steps.check({**good, "engine": str(tmp_path / "broken.yaml")})
    (tmp_path / "history").mkdir()
    (tmp_path / "history" / "history.sqlite").write_text("no database at all" * 100)
    with pytest.raises(InputError, match="a history as"):
        steps.check(good)


@pytest.mark.parametrize(
    ("flow", "arguments"), [("watch", ["in", "--engine", "mine.yaml", "--history", "lorry_7"]), ("retrain", [])]
)
def test_a_schedule_without_serve_is_refused(
    flow: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", [flow, *arguments, "--cron", "0 * * * *", "--profile", "none"])
    with pytest.raises(SystemExit, match="2"):
        importlib.import_module(f"flows.{flow}").main()
    assert "--cron: a schedule needs --serve" in capsys.readouterr().err


def test_a_first_batch_without_a_good_recording_says_why(
    fresh: Callable[[], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = learned_file(tmp_path)
    (tmp_path / "lorry_7").mkdir()
    monkeypatch.chdir(tmp_path / "lorry_7")
    fresh()
    batch = steps.add({}, str(mine), ".", load_settings("tiny")["watch"])
    assert batch.history == "lorry_7" and batch.page is None and "no recording" in batch.sentence
    arrived(tmp_path / "in", "2026-01-01.csv", 20.0)
    asked = steps.asked(new_in(tmp_path), str(mine), ".", load_settings("tiny"))
    with pytest.raises(StepFailed, match="too short"):
        steps.show(batch, asked, [], {"2026-01-01.csv": StepFailed("too short", 2)}, {})


def new_in(tmp_path: Path) -> Mapping[str, Artifact]:
    return steps.arrived(str(tmp_path / "in"), str(tmp_path / "mine.yaml"), str(tmp_path / "lorry_7")).new


def test_a_refusal_is_told_once_for_a_content_a_name_and_settings(fresh: Callable[[], None], tmp_path: Path) -> None:
    mine, history, folder = learned_file(tmp_path), tmp_path / "lorry_7", tmp_path / "in"
    fresh()
    settings = load_settings("tiny")
    for name in ("2026-01-01.csv", "2026-02-01.csv", "2026-03-01.csv"):
        arrived(folder, name, 20.0)
    batch = steps.add({}, str(mine), str(history), settings["watch"])
    said = {
        "2026-01-01.csv": StepFailed("2026-01-01.csv: too short", 2),
        "2026-02-01.csv": StepFailed("the tool broke down", 1),
        "2026-03-01.csv": StepFailed("in part one of the history", 2),
    }
    batch = replace(batch, refused={"2026-03-01.csv": said["2026-03-01.csv"]})

    def told() -> steps.Asked:
        return steps.asked(new_in(tmp_path), str(mine), str(history), settings)

    first = told()
    assert list(first.arguments) == list(first.new(said)) == list(said)
    with pytest.raises(StepFailed, match="too short"):
        steps.show(batch, first, [], said, {})
    again = told()
    assert again.before == ("2026-01-01.csv",)
    assert list(again.arguments) == ["2026-02-01.csv", "2026-03-01.csv"]  # of the history another one may have gone
    del said["2026-01-01.csv"]
    assert list(again.new(said)) == ["2026-02-01.csv"]  # what went wrong with the tool is told every time
    steps.show(batch, again, [], {"2026-03-01.csv": said["2026-03-01.csv"]}, {})

    (folder / "2026-01-01.csv").rename(folder / "2026-01-02.csv")  # its date may have been what was wrong
    other = settings | {"learn": settings["learn"] | {"changed": 1}}
    assert "2026-01-02.csv" in told().arguments
    (folder / "2026-01-02.csv").rename(folder / "2026-01-01.csv")
    assert "2026-01-01.csv" in steps.asked(new_in(tmp_path), str(mine), str(history), other).arguments
    (history / steps.REFUSED).write_text("damaged")
    assert not told().before


def test_a_recording_that_is_in_part_in_the_history_stops_none(fresh: Callable[[], None], tmp_path: Path) -> None:
    mine, found = learned_file(tmp_path), {}
    for k, rows in enumerate((part(driving(1, 600), slice(250)), driving(1, 600), driving(2, 600))):
        name = f"2026-0{k + 1}-01.csv"
        (tmp_path / name).mkdir()
        row = to_json(replace(entry(k), path=name, rows_sketch=sketch(rows)))
        (tmp_path / name / steps.ENTRY).write_text(row, encoding="utf-8")
        found[name] = Artifact(tmp_path / name, str(k))
    fresh()
    batch = steps.add(found, str(mine), str(tmp_path / "lorry_7"), load_settings("tiny")["watch"])  # nothing is judged
    assert batch.added == ("2026-01-01.csv", "2026-03-01.csv")
    assert "driving of 2026-01-01.csv in the history" in str(batch.refused["2026-02-01.csv"])


def test_histories_in_folders_of_one_name_have_reports_of_their_own(fresh: Callable[[], None], tmp_path: Path) -> None:
    fresh()
    mine, settings = learned_file(tmp_path), load_settings("tiny")["watch"]
    elsewhere = tmp_path.with_name(f"{tmp_path.name}-elsewhere")
    places = [tmp_path / "lorry_7", tmp_path / "trucks" / "lorry_7", elsewhere / "lorry_7", elsewhere / "b" / "lorry_7"]
    called = [steps.add({}, str(mine), str(place), settings).history for place in places]
    assert called[:2] == ["lorry_7", "trucks-lorry_7"] and len(set(called)) == 4
    assert all(name.startswith("lorry_7-") for name in called[2:])


def test_a_recording_that_grows_while_it_is_read_is_left_for_the_next_time() -> None:
    grown, short = InputChanged("watched: input recording (a.csv) changed"), StepFailed("too short", 2)
    assert steps.parted({"a.csv": grown, "b.csv": short}) == ({"b.csv": short}, {"a.csv": str(grown)})


@pytest.mark.flow
def test_a_batch_is_added_once_and_logged_once(
    prefect: None, fresh: Callable[[], None], tmp_path: Path
) -> None:
    from flows.watch import watch
    from tasks.tracking import Tracker

    mine, folder, history = learned_file(tmp_path), tmp_path / "in", tmp_path / "lorry_7"
    arrived(folder, "2026-01-01.csv")
    arrived(folder, "2026-02-01.csv", 20.0)  # too short
    fresh()
    with pytest.raises(StepFailed, match=r"^2026-02-01\.csv") as refused:
        watch("tiny", str(folder), str(mine), str(history))
    assert refused.value.exit_code == 2
    fresh()
    assert watch("tiny", str(folder), str(mine), str(history)) == []  # it was told, and isn't judged again
    assert not run_context.current().timings
    assert [entry.path for entry in dt.history(history).entries] == ["2026-01-01.csv"]
    page = tmp_path / "reports" / "watch" / "lorry_7" / "history.html"
    assert "2026-01-01.csv" in page.read_text()
    (folder / "2026-02-01.csv").unlink()
    fresh()
    assert watch("tiny", str(folder), str(mine), str(history)) == []
    client = Tracker(Workspace(tmp_path)).client
    experiment = client.get_experiment_by_name("watch")
    run, = client.search_runs([experiment.experiment_id])

    here, = dt.history(history).entries
    later = replace(here, sha256="7" * 64, rows_sha256="8" * 64, rows_sketch="", date="2026-03-01T00:00:00+00:00")
    begun(history, mine).add(later)  # as a run leaves it that is killed behind that
    fresh()
    assert watch("tiny", str(folder), str(mine), str(history)) == []
    second, first = client.search_runs([experiment.experiment_id])
    assert first.info.run_id == run.info.run_id
    assert second.data.metrics["added"] == 1.0 and second.data.metrics["recordings"] == 2.0
    given, = second.inputs.dataset_inputs
    assert given.dataset.digest == later.sha256[:12]

    assert run.data.metrics["added"] == run.data.metrics["refused"] == run.data.metrics["recordings"] == 1.0
    assert run.data.metrics["alarm"] == 0.0 and run.data.params["history"] == "lorry_7"
