"""The folder of compiled kernels: this user's own, elsewhere when it can't be, whole or compiled again."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dieseltwin import kernel_cache
from dieseltwin.kernel_cache import alone, drop_broken, kernel_folder

SOURCES = [Path(kernel_cache.__file__)]


@pytest.fixture(autouse=True)
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installation that is no checkout, a home and a folder of temporary files."""
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name in ("home", "tmp", "site"):
        (tmp_path / name).mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr(kernel_cache, "PACKAGE", tmp_path / "site" / "dieseltwin")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))


def _place(folder: Path, tmp_path: Path) -> str:
    return folder.relative_to(tmp_path).parts[0]


def test_the_users_cache_and_what_goes_before_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = kernel_folder(SOURCES, ["1"])
    assert folder.parent == tmp_path / "home" / ".cache" / "dieseltwin" and folder.stat().st_mode & 0o777 == 0o700
    assert kernel_folder(SOURCES, ["1"]) == folder != kernel_folder(SOURCES, ["2"])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert _place(kernel_folder(SOURCES, ["1"]), tmp_path) == "cache"
    (tmp_path / "site" / "pyproject.toml").touch()
    assert kernel_folder(SOURCES, ["1"]).parent == tmp_path / "site" / ".numba_cache"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "named"))
    assert _place(kernel_folder(SOURCES, ["1"]), tmp_path) == "named"


def test_a_home_that_can_not_be_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "home" / ".cache").touch()  # a file in the way stops root as well
    folder = kernel_folder(SOURCES, ["1"])
    assert folder.parent == tmp_path / "tmp" / f"dieseltwin-{os.getuid()}"


def test_a_link_that_another_user_may_have_laid_is_not_followed(tmp_path: Path):
    (tmp_path / "home" / ".cache").touch()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "tmp" / f"dieseltwin-{os.getuid()}").symlink_to(tmp_path / "elsewhere")
    folder = kernel_folder(SOURCES, ["1"])
    assert folder.parent == tmp_path / "tmp" and folder.name.startswith("dieseltwin-") and not folder.is_symlink()
    assert list((tmp_path / "elsewhere").iterdir()) == []


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a folder to another user")
def test_a_folder_of_another_user_is_not_used(tmp_path: Path):
    folder = kernel_folder(SOURCES, ["1"])
    os.chown(folder, 12345, 12345)
    assert _place(kernel_folder(SOURCES, ["1"]), tmp_path) == "tmp"


def test_others_lose_the_right_to_write(tmp_path: Path):
    folder = kernel_folder(SOURCES, ["1"])
    folder.chmod(0o777)
    assert kernel_folder(SOURCES, ["1"]) == folder and folder.stat().st_mode & 0o022 == 0


def test_half_written_kernels_go(tmp_path: Path):
    (tmp_path / "whole.nbi").write_bytes(b"\x80\x05N.")
    (tmp_path / "empty.nbi").touch()
    (tmp_path / "cut.nbc").write_bytes(b"\x80\x05\x00\x00")
    drop_broken(tmp_path)
    assert [path.name for path in tmp_path.glob("*.nb?")] == ["whole.nbi"]


def test_a_kernel_that_a_disk_has_changed_goes_and_one_that_was_compiled_anew_stays(tmp_path: Path):
    changed, renewed = tmp_path / "changed.nbc", tmp_path / "renewed.nbc"
    for path in (changed, renewed):
        path.write_bytes(b"\x80\x05N.")
    drop_broken(tmp_path)
    date = changed.stat().st_mtime_ns
    for path in (changed, renewed):
        path.write_bytes(b"\x80\x05M.")
    os.utime(changed, ns=(date, date))
    os.utime(renewed, ns=(date + 1, date + 1))
    drop_broken(tmp_path)
    assert [path.name for path in tmp_path.glob("*.nb?")] == ["renewed.nbc"]


def test_one_process_compiles_while_another_waits(tmp_path: Path):
    lock = tmp_path / "kernel.lock"
    waits = """
import sys
from pathlib import Path
from dieseltwin.kernel_cache import alone
with alone(Path(sys.argv[1])):
    print("in")
"""
    with alone(lock):
        other = subprocess.Popen([sys.executable, "-c", waits, str(lock)], stdout=subprocess.PIPE, text=True)
        with pytest.raises(subprocess.TimeoutExpired):
            other.wait(1.0)
    assert other.communicate(timeout=20.0)[0] == "in\n"
    with alone(tmp_path / "no" / "folder" / "kernel.lock"):
        pass  # where nothing can be kept, nobody is waited for
