"""Ctrl-C that falls where Python drops what is raised."""

import os
import signal
import sys
import time

import pytest

from dieseltwin.__main__ import interrupt_again


class Finalised:
    def __init__(self, signum: int | None) -> None:
        self.signum = signum

    def __del__(self) -> None:
        if self.signum is None:
            raise ValueError("of a finaliser")
        os.kill(os.getpid(), self.signum)
        time.sleep(1.0)


@pytest.mark.thorough
def test_an_interrupt_in_a_finaliser_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the hook Python prints it as ignored, and the command goes on to its end."""
    monkeypatch.setattr(sys, "unraisablehook", interrupt_again)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's job in the background ignores it
    try:
        made = Finalised(signal.SIGINT)
        del made
        with pytest.raises(KeyboardInterrupt):
            time.sleep(5.0)
    finally:
        signal.signal(signal.SIGINT, before)


def test_other_errors_there_are_told_as_ever(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "unraisablehook", interrupt_again)
    made = Finalised(None)
    del made
    assert "of a finaliser" in capsys.readouterr().err
