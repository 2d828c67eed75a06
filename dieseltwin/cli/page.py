"""`dieseltwin app`: the page to work with, in a browser."""

from __future__ import annotations

import errno
import ipaddress
import socket
from pathlib import Path
from typing import Annotated

import typer

from dieseltwin.errors import InputError

PORT = 8765


def app_command(
    port: Annotated[int, typer.Option("--port", metavar="N", min=1, max=65535, help="Port.")] = PORT,
    host: Annotated[
        str, typer.Option("--host", metavar="ADDRESS", help="Address to listen on; only this machine without it.")
    ] = "127.0.0.1",
    folder: Annotated[
        Path, typer.Option("--folder", metavar="DIR", help="Where recordings, engines and results are kept.")
    ] = Path("dieseltwin-app"),
    name: Annotated[
        list[str] | None,
        typer.Option("--name", metavar="NAME", help="Name by which browsers may call it besides; repeatable."),
    ] = None,
    largest: Annotated[
        int, typer.Option("--largest", metavar="MB", min=1, max=10_000, help="Largest file that is taken [MB].")
    ] = 500,
    workers: Annotated[
        int, typer.Option("--workers", metavar="N", min=1, max=16, help="Analyses at a time; the others wait.")
    ] = 1,
    memory: Annotated[
        int, typer.Option("--memory", metavar="GB", min=2, max=512, help="Most memory of one analysis [GB].")
    ] = 8,
) -> None:
    """Open a page to work with: drop a recording, map its channels, choose an engine, read the verdict."""
    from dieseltwin.settings.extras import require

    for package in ("fastapi", "uvicorn", "python_multipart"):
        require(package, "app", "dieseltwin app")
    _check_port(host, port)
    from dieseltwin.app.server import serve
    from dieseltwin.app.workplace import Limits, Workplace

    limits = Limits(upload_mb=largest, workers=workers, memory_gb=memory)
    names = [host, *(name or ())] if not _is_address(host) else list(name or ())
    try:
        place = folder.resolve()
    except RuntimeError:  # a link that leads to itself
        raise InputError("--folder", str(folder), "a folder you may write to", "choose another") from None
    workplace = Workplace(place, limits, tuple(names))
    workplace.prepare()
    where = f"[{host}]" if ":" in host else host
    typer.echo(f"http://{where}:{port}  (files in {folder}; Ctrl-C ends it)")
    if not _is_loopback(host):
        typer.echo("Anyone who reaches this address can see, add and remove everything: there are no accounts.")
    serve(workplace, host, port)


def _check_port(host: str, port: int) -> None:
    if not host.isascii() or not host.strip():  # nothing would mean every address of this machine
        raise InputError("--host", repr(host), "an address or a name of this machine", "leave it out for 127.0.0.1")
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind((host, port))
    except OSError as error:
        taken = error.errno == errno.EADDRINUSE
        got = "taken by another program" if taken else (error.strerror or str(error)).lower()
        raise InputError(f"--host {host} --port {port}", got, "an address of this machine and a free port",
                         "choose another --port" if taken else "check --host and --port") from None


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _is_loopback(host: str) -> bool:
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)
