"""`dieseltwin app`: what can't be had is said in one line before anything is made."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from dieseltwin.cli.app import main


def test_a_taken_port_and_a_foreign_address_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "kept"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert main(["app", "--port", port, "--folder", str(folder)]) == 2
    assert "taken by another program" in capsys.readouterr().err
    assert main(["app", "--host", "192.0.2.1", "--folder", str(folder)]) == 2
    assert "--host 192.0.2.1" in capsys.readouterr().err
    assert not folder.exists()


def test_a_folder_that_is_a_file_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "kept").write_text("a file")
    with socket.create_server(("127.0.0.1", 0)) as once:
        port = str(once.getsockname()[1])
    assert main(["app", "--port", port, "--folder", str(tmp_path / "kept")]) == 2
    assert "a folder you may write to" in capsys.readouterr().err
