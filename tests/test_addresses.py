"""What no server can listen on is said before one is started."""

from __future__ import annotations

import socket
import sys

import pytest

from dieseltwin.addresses import check_address, is_loopback
from dieseltwin.errors import InputError
from tasks import serve_champion, ui


@pytest.mark.parametrize(("host", "port", "said"), [
    ("127.0.0.1", 80000, "--port: got 80000; allowed: 1 to 65535"), ("127.0.0.1", 0, "--port: got 0"),
    ("", 8765, "--host: got ''"), ("203.0.113.7", 8765, "check --host and --port"),
])  # fmt: skip
def test_it_is_refused(host: str, port: int, said: str) -> None:
    with pytest.raises(InputError, match=said):
        check_address(host, port)


def test_a_port_of_another_program_is_refused() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(InputError, match="taken by another program"):
            check_address("127.0.0.1", other.getsockname()[1])


@pytest.mark.parametrize("served", [ui, serve_champion])
def test_services_of_mlflow_are_not_begun(
    served: object, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["make", "--port", "80000"])
    assert served.main() == 2 and capsys.readouterr().err.startswith("error: --port: got 80000")  # type: ignore[attr-defined]


def test_this_machine_alone() -> None:
    assert is_loopback("localhost") and is_loopback("::1") and not is_loopback("0.0.0.0") and not is_loopback("diesel")
