"""`dieseltwin challenge make | run | score`: the concealed benchmark (docs/benchmark.md)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from dieseltwin.atomic import check_writable
from dieseltwin.cli.options import check_ending, counted_progress, help_without_command, names

challenge_app = typer.Typer(help="Concealed benchmark: recordings with sealed answers, run the tool, open and score.")
challenge_app.callback(invoke_without_command=True)(help_without_command)

Jobs = Annotated[int | None, typer.Option("--jobs", metavar="J", min=1, help="Processes; one per core by default.")]
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of `challenge make`.")]


def _cores() -> int:
    return len(os.sched_getaffinity(0))


@challenge_app.command()
def make(
    n: Annotated[int, typer.Option("--n", metavar="N", help="Number of cases.")],
    seed: Annotated[int, typer.Option("--seed", metavar="S", min=0, help="Seed; kept in the sealed part only.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="New folder for the benchmark.")],
    tier: Annotated[
        str,
        typer.Option("--tier", metavar="T", help="main, one-percent, own-engine, own-engine-5, own-engine-rough, "
                     "own-engine-ratio, petrol or points."),
    ] = "main",
    sensors: Annotated[int, typer.Option("--sensors", metavar="K", help="5 (the paper's) or 6 (with w_c).")] = 6,
    healthy_only: Annotated[bool, typer.Option("--healthy-only", help="Healthy machines only.")] = False,
    duration: Annotated[float, typer.Option("--duration", metavar="S", min=60.0, help="Seconds of each.")] = 600.0,
    reference: Annotated[
        float, typer.Option("--reference-min", metavar="M", min=0.0, help="Minutes of reference of own-engine tiers.")
    ] = 20.0,
    jobs: Jobs = None,
) -> None:
    """Make recordings, seal the answers apart and publish their salted hashes."""
    from dieseltwin.challenge.make import make_challenge

    manifest = make_challenge(
        out, n, seed, tier=tier, sensors=sensors, healthy_only=healthy_only, duration_s=duration,  # type: ignore[arg-type]
        reference_min=reference, jobs=jobs or _cores(), progress=counted_progress,
    )  # fmt: skip
    typer.echo(f"{out}: {manifest['n']} recordings; answers in {out / 'sealed'}, their salted hashes in manifest.json")


@challenge_app.command()
def run(
    folder: Folder,
    only: Annotated[str, typer.Option("--only", metavar="IDS", help="Cases: case_0003,case_0007.")] = "",
    limit: Annotated[int | None, typer.Option("--limit", metavar="N", min=1, help="At most N cases now.")] = None,
    jobs: Jobs = None,
) -> None:
    """Run the tool on every case without a result; killed, it goes on where it was. Never opens the answers."""
    from dieseltwin.challenge.run import RESULTS, run_challenge

    counts = run_challenge(
        folder, only=names(only) or (), limit=limit, jobs=jobs or _cores(), progress=counted_progress
    )
    typer.echo(f"{folder / RESULTS}: " + ", ".join(f"{count} {name}" for name, count in counts.items()))
    if counts["failed"]:  # each with its failed.json; the next run tries them again
        raise typer.Exit(1)


@challenge_app.command()
def score(
    folder: Folder,
    jobs: Jobs = None,
    unrun: Annotated[bool, typer.Option("--unrun", help="Count cases that were never run as failures.")] = False,
) -> None:
    """Open the answers, check the hashes, and write the table: DIR/score."""
    from dieseltwin.challenge.score import score_challenge, write_score
    from dieseltwin.challenge.table import lines

    found = score_challenge(folder, jobs=jobs or _cores(), unrun=unrun, progress=counted_progress)
    out = write_score(found, folder)
    for line in lines(found.rows):
        typer.echo(f"{line.metric}: {line.value} (pass {line.pass_at}, aim {line.aim})")
    typer.echo(f"{out / 'score.md'}")


@challenge_app.command()
def curve(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Scored benchmarks of own engines.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Figure to write, a .png or .svg.")],
) -> None:
    """Draw names, none-of-these and health error over minutes of reference and size of the maps' errors."""
    from dieseltwin.challenge.curve import write_curve

    check_ending(out, (".png", ".svg"))
    check_writable(out)
    for place in write_curve(folders, out):
        health = "-" if place.health is None else f"{100 * place.health:.2f} %"
        typer.echo(f"maps {100 * place.map_rms:g} %, {place.minutes:.0f} min, {place.cases} cases: "
                   f"named {place.named}; false none {place.none}; health {health}")  # fmt: skip
    typer.echo(f"{out}")


@challenge_app.command()
def baselines(
    folder: Folder,
    limit: Annotated[int, typer.Option("--limit", metavar="N", min=1, help="The first N cases.")] = 60,
    only: Annotated[str, typer.Option("--only", metavar="IDS", help="Cases instead of the first N.")] = "",
    jobs: Jobs = None,
) -> None:
    """Run the baselines (health only, Kalman, neural) on a fixed part of the cases, for `score` to set beside."""
    from dieseltwin.challenge.baselines import run_baselines

    done = run_baselines(folder, only=names(only) or (), limit=limit, jobs=jobs or _cores(), progress=counted_progress)
    typer.echo(f"{folder / 'baselines'}: {done} cases")
