"""A file is the old one or the whole new one; a folder gets all results or none."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest

from dieseltwin.atomic import (
    PARTIAL_PREFIX,
    atomic_folder,
    atomic_path,
    check_writable,
    write_bytes,
    write_json,
    write_problem,
    write_text,
)
from dieseltwin.errors import InputError


class Interrupted(BaseException):
    """Stands for Ctrl-C."""


def names(folder: Path) -> set[str]:
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def test_write_and_replace(tmp_path: Path) -> None:
    path = write_text(tmp_path / "a.txt", "old")
    write_bytes(path, b"new")
    assert path.read_text() == "new" and names(tmp_path) == {"a.txt"}
    write_json(path, {"x": [1.5, None]})
    assert json.loads(path.read_text()) == {"x": [1.5, None]}


def test_the_temporary_file_keeps_the_suffix(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "a.parquet") as temporary:
        assert temporary.suffix == ".parquet" and temporary.parent == tmp_path
        assert temporary.name.startswith(PARTIAL_PREFIX)
        temporary.write_bytes(b"x")


def test_a_name_of_few_letters_and_many_bytes(tmp_path: Path) -> None:
    path = tmp_path / ("検" * 83 + ".csv")  # 253 bytes of at most 255
    assert write_text(path, "a").read_text() == "a" and os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("error", [ValueError, Interrupted])
def test_an_error_leaves_the_old_file(tmp_path: Path, error: type[BaseException]) -> None:
    path = write_text(tmp_path / "a.txt", "old")
    with pytest.raises(error), atomic_path(path) as temporary:
        temporary.write_text("half of the ne")
        raise error
    assert path.read_text() == "old" and names(tmp_path) == {"a.txt"}


def test_nan_is_no_json(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(tmp_path / "a.json", {"x": float("nan")})
    assert names(tmp_path) == set()


def test_missing_folder_and_folder_as_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file or directory"):
        write_text(tmp_path / "none" / "a.txt", "x")
    with pytest.raises(InputError, match="is a directory"):
        write_text(tmp_path, "x")
    assert names(tmp_path) == set()


def test_folder_is_created_with_all_files(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "deep" / "out") as folder:
        (folder / "a.json").write_text("1")
        (folder / "figures").mkdir()
        (folder / "figures" / "b.svg").write_text("2")
        assert not (tmp_path / "deep" / "out").exists()
    assert names(tmp_path) == {"deep/out/a.json", "deep/out/figures/b.svg"}


def test_folder_replaces_same_names_and_keeps_others(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "a").write_text("old")
    (out / "mine").write_text("kept")
    with atomic_folder(out) as folder:
        (folder / "a").write_text("new")
    assert (out / "a").read_text() == "new" and (out / "mine").read_text() == "kept"
    assert names(out) == {"a", "mine"}


def test_leftovers_of_an_earlier_result_go_where_they_would_mislead(tmp_path: Path) -> None:
    (tmp_path / "figures").mkdir()
    for name in ("curves", "figures/old.svg", "figures/a.svg", "mine", "a"):
        (tmp_path / name).write_text("old")
    with atomic_folder(tmp_path, owned=("curves", "figures", "none")) as folder:
        (folder / "figures").mkdir()
        (folder / "figures" / "a.svg").write_text("new")
        (folder / "a").write_text("new")
    assert names(tmp_path) == {"figures/a.svg", "mine", "a"}
    assert (tmp_path / "figures" / "a.svg").read_text() == "new" and (tmp_path / "mine").read_text() == "old"


@pytest.mark.parametrize("error", [ValueError, Interrupted])
def test_an_error_leaves_no_new_folder_and_no_new_file(tmp_path: Path, error: type[BaseException]) -> None:
    with pytest.raises(error), atomic_folder(tmp_path / "deep" / "out") as folder:
        (folder / "a").write_text("x")
        raise error
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "a").write_text("old")
    with pytest.raises(error), atomic_folder(tmp_path) as folder:
        (folder / "a").write_text("new")
        raise error
    assert (tmp_path / "a").read_text() == "old" and names(tmp_path) == {"a"}


def test_a_file_in_the_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(InputError, match="not a directory"), atomic_folder(tmp_path / "out"):
        pytest.fail("the folder must not be opened")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), "no space left"),
        (OSError("Error writing bytes to file. Detail: [errno 28] No space left on device"), "no space left"),
        (OSError(errno.EDQUOT, "quota"), "no space left"),
        (OSError(errno.EROFS, "ro"), "read-only file system"),
        (PermissionError(errno.EACCES, "no"), "permission denied"),
    ],
)
def test_what_the_user_can_mend_becomes_an_input_error(tmp_path: Path, error: OSError, words: str) -> None:
    problem = write_problem(error, "results/a.csv")
    assert problem is not None and words in str(problem) and "results/a.csv" in str(problem)
    with pytest.raises(InputError, match=words), atomic_path(tmp_path / "a.csv") as temporary:
        temporary.write_text("half")
        raise error
    assert names(tmp_path) == set()


def test_a_defect_stays_what_it_is(tmp_path: Path) -> None:
    assert write_problem(OSError(errno.EIO, "disk broken"), "a") is None
    with pytest.raises(OSError, match="disk broken"), atomic_path(tmp_path / "a"):
        raise OSError(errno.EIO, "disk broken")


def test_check_writable_leaves_nothing_and_keeps_the_old_file(tmp_path: Path) -> None:
    check_writable(tmp_path / "a.txt")
    assert names(tmp_path) == set()
    write_text(tmp_path / "a.txt", "old")
    check_writable(tmp_path / "a.txt")
    assert (tmp_path / "a.txt").read_text() == "old" and names(tmp_path) == {"a.txt"}
    with pytest.raises(InputError, match="no such file"):
        check_writable(tmp_path / "none" / "a.txt")


@pytest.mark.parametrize("writing", [atomic_path, atomic_folder])
def test_an_empty_name_is_not_the_current_folder(writing, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="an empty text"), writing(""):
        pass
    assert not list(tmp_path.iterdir())
