"""The start of the command line, before it is loaded."""

from __future__ import annotations

import importlib.abc
import sys

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
