"""`dieseltwin challenge make | run | score`: the concealed benchmark (DISCOVERY.md, "Proof")."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

challenge_app = typer.Typer(help="Concealed benchmark: recordings with sealed answers, run the tool, open and score.")

Jobs = Annotated[int | None, typer.Option("--jobs", metavar="J", min=1, help="Processes; one per core by default.")]
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of `challenge make`.")]


def _progress(done: int, total: int, note: str = "") -> None:
    end = "\n" if not sys.stderr.isatty() or done == total else "\r"
    print(f"{done}/{total} {note}".rstrip(), end=end, file=sys.stderr, flush=True)


def _cores() -> int:
    return len(os.sched_getaffinity(0))


@challenge_app.callback(invoke_without_command=True)
def _help(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@challenge_app.command()
def make(
    n: Annotated[int, typer.Option("--n", metavar="N", help="Number of cases.")],
    seed: Annotated[int, typer.Option("--seed", metavar="S", min=0, help="Seed; kept in the sealed part only.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="New folder for the benchmark.")],
    tier: Annotated[str, typer.Option("--tier", metavar="T", help="main (maps off by 0.3 %) or one-percent.")] = "main",
    sensors: Annotated[int, typer.Option("--sensors", metavar="K", help="5 (the paper's) or 6 (with w_c).")] = 6,
    healthy_only: Annotated[bool, typer.Option("--healthy-only", help="Healthy machines only.")] = False,
    duration: Annotated[float, typer.Option("--duration", metavar="S", min=60.0, help="Seconds of each.")] = 600.0,
    jobs: Jobs = None,
) -> None:
    """Make recordings, seal the answers apart and publish their salted hashes."""
    from dieseltwin.discovery.challenge.make import make_challenge

    manifest = make_challenge(
        out, n, seed, tier=tier, sensors=sensors, healthy_only=healthy_only, duration_s=duration,  # type: ignore[arg-type]
        jobs=jobs or _cores(), progress=_progress,
    )  # fmt: skip
    typer.echo(f"{out}: {manifest['n']} recordings; answers in {out / 'sealed'}, their salted hashes in manifest.json")
