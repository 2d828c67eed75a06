"""`dieseltwin app`: the page to work with, in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dieseltwin.addresses import check_address, is_address, is_loopback
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
    check_address(host, port)
    from dieseltwin.app.server import serve
    from dieseltwin.app.workplace import Limits, Workplace

    limits = Limits(upload_mb=largest, workers=workers, memory_gb=memory)
    names = [host, *(name or ())] if not is_address(host) else list(name or ())
    try:
        place = folder.resolve()
    except RuntimeError:  # a link that leads to itself
        raise InputError("--folder", str(folder), "a folder you may write to", "choose another") from None
    workplace = Workplace(place, limits, tuple(names))
    workplace.prepare()
    where = f"[{host}]" if ":" in host else host
    typer.echo(f"http://{where}:{port}  (files in {folder}; Ctrl-C ends it)")
    if not is_loopback(host):
        typer.echo("Anyone who reaches this address can see, add and remove everything: there are no accounts.")
    serve(workplace, host, port)
