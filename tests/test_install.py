"""Set-up installs by uv from where pip is told that packages are, and by pip where uv can't."""

from __future__ import annotations

import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from tasks import install

CONFIGURATION = """\
:env:.default-timeout='180'
global.cert='/etc/ca.crt'
global.extra-index-url='file:///one/simple\\nfile:///two/simple'
global.find-links='/wheels'
global.progress-bar='off'
user.find-links='/a /b'
not a setting
"""


def test_uv_is_told_what_pip_is_told() -> None:
    assert install.uv_settings(CONFIGURATION) == {
        "UV_HTTP_TIMEOUT": "180", "SSL_CERT_FILE": "/etc/ca.crt", "UV_INDEX": "file:///one/simple file:///two/simple",
        "UV_FIND_LINKS": "/a,/b",
    }  # fmt: skip
    assert install.uv_settings("") == {}


@pytest.mark.parametrize("fails", [None, "uv", "uv==1.2.3"])
def test_pip_installs_what_uv_can_not(
    fails: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    begun: list[list[str]] = []

    def run(command: list[str], **given: object) -> SimpleNamespace:
        begun.append(command)
        return SimpleNamespace(returncode=int(fails in command), stdout=CONFIGURATION, stderr="no such version")

    monkeypatch.setattr(subprocess, "run", run)
    lock = tmp_path / "requirements.lock"
    lock.write_text("six==1.17.0\nuv==1.2.3\n")
    install.install(lock)
    assert "uv==1.2.3" in begun[0]
    assert ("--no-compile" in begun[-1]) == (fails is not None) and str(lock) in begun[-1]
    assert ("no such version" in capsys.readouterr().err) == (fails == "uv")
