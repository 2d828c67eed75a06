"""`dieseltwin data`: a checked copy or a clear refusal; a download never leaves a wrong file behind."""

from __future__ import annotations

import hashlib
import socket
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from dieseltwin.cli.app import main
from dieseltwin.errors import InputError
from dieseltwin.recordings import public_data
from dieseltwin.recordings.public_data import FILES, SETS, DataFile, checked, fetch, path_of, wanted

CONTENT = b"time_s,x\n0,1\n1,2\n"
FILE = DataFile("liu_ice", "made_up.csv", hashlib.sha256(CONTENT).hexdigest(), len(CONTENT))


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        return


@pytest.fixture(autouse=True)
def clean(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """No local copy, no mirror, an empty cache."""
    monkeypatch.delenv(public_data.LOCAL, raising=False)
    monkeypatch.delenv(public_data.MIRROR, raising=False)
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(public_data.CACHE, str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def mirror(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    """A folder that is served over http as the mirror."""
    folder = tmp_path / "served"
    (folder / "liu_ice").mkdir(parents=True)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    monkeypatch.setenv(public_data.MIRROR, f"http://127.0.0.1:{server.server_port}")
    yield folder
    server.shutdown()
    server.server_close()


def test_fetched_once_then_found(mirror: Path, clean: Path) -> None:
    (mirror / FILE.name).write_bytes(CONTENT)
    path, loaded = fetch(FILE)
    assert loaded and path == clean / FILE.name and path.read_bytes() == CONTENT
    (mirror / FILE.name).unlink()
    assert fetch(FILE) == (path, False)
    assert path_of(FILE) == path


@pytest.mark.parametrize("served", [CONTENT.replace(b"2", b"3"), CONTENT[:-2], CONTENT + b"more"])
def test_wrong_bytes_are_refused_and_not_kept(mirror: Path, clean: Path, served: bytes) -> None:
    (mirror / FILE.name).write_bytes(served)
    with pytest.raises(InputError, match="nothing was kept"):
        fetch(FILE)
    assert [p for p in clean.rglob("*") if p.is_file()] == []


def test_missing_on_the_mirror(mirror: Path) -> None:
    with pytest.raises(InputError, match="HTTP 404"):
        fetch(FILE)


@pytest.mark.parametrize("reply", [
    b"SSH-2.0-OpenSSH_9\r\n\r\n", b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n1000\r\nabc",
])  # fmt: skip
def test_an_answer_that_is_none_of_the_web_is_refused(
    monkeypatch: pytest.MonkeyPatch, clean: Path, reply: bytes
) -> None:
    """Another service at the mirror's port, and a body that was cut off, ended in a traceback."""

    def answer(listening: socket.socket) -> None:
        with listening.accept()[0] as connection:
            connection.recv(4096)
            connection.sendall(reply)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        monkeypatch.setenv(public_data.MIRROR, f"http://127.0.0.1:{listening.getsockname()[1]}")
        thread = threading.Thread(target=answer, args=(listening,))
        thread.start()
        with pytest.raises(InputError, match=r"the connection broke.*DIESELTWIN_DATA"):
            fetch(FILE)
        thread.join()
    assert not any(p.is_file() for p in clean.rglob("*"))


def test_no_network(monkeypatch: pytest.MonkeyPatch, clean: Path) -> None:
    monkeypatch.setenv(public_data.MIRROR, "http://127.0.0.1:9")  # the discard port: refused at once
    with pytest.raises(InputError, match=r"no connection.*DIESELTWIN_DATA"):
        fetch(FILE)
    assert not any(p.is_file() for p in clean.rglob("*"))


def test_no_public_address_says_where_the_publisher_is() -> None:
    with pytest.raises(InputError, match=r"vehsys.*DIESELTWIN_DATA") as caught:
        fetch(FILE)
    assert caught.value.exit_code == 2


def test_a_mirror_is_http_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(public_data.MIRROR, "ftp://somewhere")
    with pytest.raises(InputError, match="http or https"):
        fetch(FILE)


def test_a_local_copy_is_checked_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(public_data.LOCAL, str(tmp_path))
    target = tmp_path / FILE.name
    target.parent.mkdir()
    target.write_bytes(CONTENT)
    assert path_of(FILE) == target
    target.write_bytes(CONTENT + b"x")
    with pytest.raises(InputError, match="SHA-256"):
        path_of(FILE)


def test_schedules_are_carried() -> None:
    for name in public_data.CARRIED:
        assert path_of(FILES[name]).parent.name == "data"


def test_registry_is_complete() -> None:
    for file in FILES.values():
        assert file.set_name in SETS and len(file.sha256) == 64 and file.size > 0
    assert all(s.licence and s.citation and s.address for s in SETS.values())
    assert {f.name for f in wanted("liu_ice")} == {n for n in FILES if n.startswith("liu_ice/")}


def test_unknown_name_says_what_was_meant(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "path", "liu_ise"]) == 2
    assert "did you mean liu_ice" in capsys.readouterr().err


def test_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "list"]) == 0
    assert "arXiv 2408.13269" in capsys.readouterr().out
    assert main(["data", "path", "duty_cycles/whsc.csv"]) == 0
    assert Path(capsys.readouterr().out.strip()).is_file()
    assert main(["data", "path", "emps"]) == 2
    assert main(["data", "fetch", "duty_cycles/whtc.csv"]) == 0
    assert "was here" in capsys.readouterr().out


def test_local_copies_are_the_known_ones(project_root: Path) -> None:
    folder = project_root.parent / "shared" / "data"
    here = [file for file in FILES.values() if (folder / file.name).is_file()]
    if not here:
        pytest.skip("no recording in ../shared/data")
    for file in here:
        assert checked(folder / file.name, file)
