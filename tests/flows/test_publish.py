"""Results are copied out of the cache to where users look for them, beside what others keep there."""

from __future__ import annotations

from pathlib import Path

from tasks.publish import publish_beside


def test_the_reports_of_other_flows_and_the_users_own_files_survive(tmp_path: Path) -> None:
    page, reports = tmp_path / "page", tmp_path / "reports"
    (page / "figures").mkdir(parents=True)
    (page / "index.html").write_text("new")
    (page / "figures" / "a.svg").write_text("new")
    foreign = {"watch/lorry_7/history.html": "rows", "evaluation-part/manifest.json": "{}", "notes.txt": "mine"}
    for name, text in {**foreign, "index.html": "old", "figures/b.svg": "old"}.items():
        (reports / name).parent.mkdir(parents=True, exist_ok=True)
        (reports / name).write_text(text)
    for _ in range(2):
        publish_beside(reports, {"": page})
        files = [path for path in reports.rglob("*") if path.is_file()]
        found = {path.relative_to(reports).as_posix(): path.read_text() for path in files}
        assert found == {**foreign, "index.html": "new", "figures/a.svg": "new"}


def test_what_agrees_already_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "page" / "figures").mkdir(parents=True)
    for name in ("index.html", "figures/a.svg"):
        (tmp_path / "page" / name).write_text("text")
    publish_beside(tmp_path / "reports", {"": tmp_path / "page"})
    paths = [tmp_path / "reports" / name for name in ("index.html", "figures/a.svg")]
    before = [path.stat().st_ino for path in paths]
    publish_beside(tmp_path / "reports", {"": tmp_path / "page"})
    assert [path.stat().st_ino for path in paths] == before
