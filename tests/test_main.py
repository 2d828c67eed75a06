"""The start of the command line, before it is loaded."""

from __future__ import annotations

import importlib.abc
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dieseltwin.__main__ import main


class Interrupted(importlib.abc.MetaPathFinder):
    """Ctrl-C while the command line is being loaded."""

    def find_spec(self, fullname: str, path: object, target: object = None) -> None:
        if fullname == "dieseltwin.cli.app":
            raise KeyboardInterrupt


def test_ctrl_c_while_the_library_is_loaded(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.delitem(sys.modules, "dieseltwin.cli.app", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    assert main() == 130
    assert capsys.readouterr().err == "dieseltwin: interrupted; nothing was begun\n"


PROGRAM = """
import atexit
from pathlib import Path
import dieseltwin.__main__ as entry

class Freed:
    def __del__(self):
        Path("freed").touch()

def main():
    atexit.register(print, "tidied up")
    print("said")
    return 3

freed = Freed()
entry.main = main
entry.program()
"""


def test_a_process_ends_with_its_words_and_its_code_before_it_is_taken_apart(tmp_path: Path) -> None:
    told = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, cwd=tmp_path)
    assert (told.returncode, told.stdout, told.stderr) == (3, "said\ntidied up\n", "")
    assert not (tmp_path / "freed").exists()


def test_who_wanted_to_tidy_up_before_the_program_began_still_does(tmp_path: Path) -> None:
    before = f"import atexit\natexit.register(print, 'tidied up last')\n{PROGRAM}"
    told = subprocess.run([sys.executable, "-c", before], capture_output=True, text=True, cwd=tmp_path)
    assert (told.returncode, told.stdout) == (3, "said\ntidied up\ntidied up last\n")


def test_an_error_of_the_program_itself_is_told_as_ever(tmp_path: Path) -> None:
    broken = PROGRAM.replace("return 3", "raise ZeroDivisionError")
    told = subprocess.run([sys.executable, "-c", broken], capture_output=True, text=True, cwd=tmp_path)
    assert told.returncode == 1
    assert "ZeroDivisionError" in told.stderr


def test_words_that_nobody_takes_are_no_success(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)  # they wait for the end
    nobody, end = os.pipe()
    os.close(nobody)
    told = subprocess.run([sys.executable, "-c", PROGRAM.replace("return 3", "return 0")],
                          stdout=end, stderr=subprocess.PIPE, cwd=tmp_path)  # fmt: skip
    os.close(end)
    assert told.returncode == 120  # Python's own


def test_a_full_device_is_one_sentence() -> None:
    with Path("/dev/full").open("w") as full:
        told = subprocess.run([sys.executable, "-m", "dieseltwin", "effects"], stdout=full, stderr=subprocess.PIPE)
    assert told.returncode == 1
    assert told.stderr.decode().startswith("dieseltwin: no space left on the device; ")
    assert b"Traceback" not in told.stderr
