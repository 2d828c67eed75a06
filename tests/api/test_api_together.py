"""Several recordings through the front door: judged together, and one after another in the history of their engine."""

from __future__ import annotations

from pathlib import Path

import pytest

import dieseltwin as dt
from dieseltwin.api.watch import begun
from dieseltwin.engine import we2011
from dieseltwin.engine.terms import Term
from dieseltwin.errors import InputError
from tests.api.learned import learned_file
from tests.api.simulated import drive

pytestmark = pytest.mark.usefixtures("no_pictures")
LEAK = Term(effect="boost_leak", magnitude=25e-6)


@pytest.fixture(scope="module")
def year(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three recordings, the last with a leak, in another order."""
    folder, files = tmp_path_factory.mktemp("year"), []
    for k, month in enumerate(("01", "05", "09")):
        engine = we2011.PARAMETERS.replace(A_egrmax=we2011.PARAMETERS.A_egrmax * (1.0 - 0.03 * k),
                                           terms=(LEAK,) if k == 2 else ())  # fmt: skip
        files.append(folder / f"2026-{month}-01.csv")
        frame = drive(90.0, engine, seed=30 + k)
        if k == 0:
            frame.loc[7, "t_em_k"] = -9999.0
        frame.to_csv(files[-1], index=False)
    return [files[2], files[0], files[1]]


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return learned_file(tmp_path_factory.mktemp("mine"))


@pytest.mark.thorough
def test_a_leak_that_began_is_named_with_its_date(year: list[Path], tmp_path: Path):
    found = dt.discover(year)
    document = found.document.to_json()
    assert [effect["name"] for effect in document["effects"]] == ["boost_leak"]
    assert document["location"]["onset_date"] == "2026-09-01" and document["location"]["onset_after"] == "2026-05-01"
    assert "began between 2026-05-01 and 2026-09-01" in found.sentence
    rows = document["recordings"]
    assert [row["date"][:10] for row in rows] == ["2026-01-01", "2026-05-01", "2026-09-01"]
    sizes = [row["magnitudes"]["boost_leak"] for row in rows]
    for size, truth in zip(sizes, (0.0, 0.0, 25e-6), strict=True):
        assert abs(size["value"] - truth) < 3.5 * size["std"] < 15e-6
    (effect,) = document["effects"]  # the size of the verdict, and that of the last recording where it is freed
    assert abs(sizes[-1]["value"] - effect["magnitude"]) < 2.0 * effect["std"]
    assert effect["std"] < sizes[-1]["std"] < 3.0 * effect["std"]  # what was there before is free, too
    worn = [row["health"]["A_egrmax"]["value"] / we2011.PARAMETERS.A_egrmax for row in rows]
    assert worn == pytest.approx([1.0, 0.97, 0.94], abs=0.025)
    assert found.engine.terms[-1].effect == "boost_leak"
    (of_reading,) = (item["text"] for item in document["warnings"] if "error code" in item["text"])
    assert of_reading.startswith(f"{year[1]}: ")
    found.save(tmp_path)
    assert "From recording to recording" in (tmp_path / "report.html").read_text()
    by_recording = found.by_recording()
    assert by_recording["size:boost_leak"].tolist() == [size["value"] for size in sizes]
    assert by_recording["A_egrmax"].tolist() == [row["health"]["A_egrmax"]["value"] for row in rows]
    assert len(found.plot("over_recordings").axes) >= 5


@pytest.mark.thorough
def test_a_leak_that_was_mended_is_named_with_its_end(year: list[Path], tmp_path: Path):
    first = tmp_path / "2025-11-01.csv"
    first.write_bytes(year[0].read_bytes())
    found = dt.discover([first, *year[1:]])
    (effect,) = found.document.to_json()["effects"]
    assert effect["name"] == "boost_leak" and effect["magnitude"] == pytest.approx(25e-6, abs=4.0 * effect["std"])
    assert "was there up to 2025-11-01 and isn't on 2026-01-01 any more" in found.sentence
    assert found.document.location is not None and found.document.location.onset_date is None
    assert not found.engine.terms  # the last recording's
    sizes = [row.magnitudes["boost_leak"] for row in found.document.recordings]
    for size, truth in zip(sizes, (25e-6, 0.0, 0.0), strict=True):
        assert abs(size.value - truth) < 3.5 * size.std < 15e-6


def test_what_cannot_be_judged_together_is_refused(year: list[Path]):
    with pytest.raises(InputError, match="the same recording twice"):
        dt.discover([year[0], year[0]])
    with pytest.raises(InputError, match="nothing"):
        dt.discover([])


def test_so_many_recordings_that_memory_runs_out_are_refused_before_they_are_judged(tmp_path: Path):
    """Each has unknowns of its own at the rows of all: memory grows with the square of their number."""
    files = [tmp_path / f"2026-01-{day:02d}.csv" for day in range(1, 29)]
    for day, file in enumerate(files):
        drive(66.0, we2011.PARAMETERS, seed=day).to_csv(file, index=False)
    with pytest.raises(InputError, match="got 28 recordings in one verdict; allowed: 25 at most"):
        dt.discover(files)


@pytest.mark.thorough
def test_a_history_grows_once_by_each_recording_in_any_order(year: list[Path], mine: Path, tmp_path: Path):
    bad = tmp_path / "2026-10-01.csv"
    bad.write_text("time_s,n_e_rpm\n0,1000\n")
    through: list[tuple[int, int, str]] = []
    found = dt.watch([year[0], bad, year[1]], mine, tmp_path / "history", progress=lambda *at: through.append(at))
    assert through == [(k, 3, path.name) for k, path in enumerate([year[0], bad, year[1]], 1)]
    assert len(found.added) == 2 and not found.known and found.refused[0][0] == str(bad)
    again = dt.watch(year, mine, tmp_path / "history")
    assert again.added == (str(year[2]),) and len(again.known) == 2
    table = again.table()
    assert list(table["date"].str[:10]) == ["2026-01-01", "2026-05-01", "2026-09-01"]
    assert table["A_egrmax_since"].is_monotonic_decreasing and list(table["verdict"])[:2] == ["healthy", "healthy"]
    other = dt.watch(year[:1], mine, tmp_path / "other")  # the last recording first
    store = begun(tmp_path / "other", mine)
    assert all(store.add(entry) for entry in again.entries[:2])
    assert not any(store.add(entry) for entry in again.entries) and other.entries[0].date == again.entries[2].date
    assert dt.history(tmp_path / "other").table().equals(table)
    again.save(tmp_path / "out")
    page = (tmp_path / "out" / "history.html").read_text()
    assert page.count("<img") == 2 and "2026-09-01.csv" in page
    assert dt.history(tmp_path / "history").sentence == again.sentence


def test_a_history_needs_a_learned_engine(year: list[Path], tmp_path: Path):
    with pytest.raises(InputError, match="no learned engine"):
        dt.watch(year, tmp_path / "none.yaml", tmp_path)
