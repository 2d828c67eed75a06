"""Steps of the flow ``discover``: what the twin left out of a recording, as ``dieseltwin discover`` writes it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dieseltwin.errors import InputError
from dieseltwin.paths import refuse_unreadable
from tasks.failures import StepFailed
from tasks.run_context import Pending, Progress, current, step
from tasks.store import MANIFEST, RUNTIME, Artifact, scratch

SUMMARY = "summary.txt"

# Files that two equal runs make alike; the report shows run times.
COMPARED = ("discrepancy.json", "engine.yaml", "implied.parquet")
LEARNED = "engine.learned.parquet"  # without it the repaired engine of a learned one is refused


@step("discover", "discovery", expected_s=60.0, sections=("discover", "learn"), unkeyed=("kind",))
def discover(
    out: Path,
    progress: Progress,
    *,
    recording: Path,
    kind: str,
    ending: str,
    concealed: bool,
    sensors: list[str] | None,
    engine: Path | None = None,
) -> None:
    """discrepancy.json, report.html, figures/, engine.yaml (repaired), implied.parquet.

    ``kind`` names the recording, whose contents are what counts: under another name the result is found again, and its
    document names the one that was read. ``ending``: of its file, which says how it is read. ``concealed``: it is the
    chain's own, always of one name. ``engine``: an engine file; None is the published engine. ``sensors``: columns to
    use; None is all there are.
    """
    import shutil
    from contextlib import chdir

    from dieseltwin.api.discovery import ask
    from dieseltwin.api.findings import Asked

    source, engine = recording.resolve(), engine.resolve() if engine is not None else None
    with scratch(out) as folder:
        name = f"{kind}{ending}"
        shutil.copyfile(source, folder / name)
        # The document names the recording's path: a relative one, the same wherever the cache lies.
        with chdir(folder):
            question = ask(Path(name), engine, asked=Asked(sensors))
            lines = list(question.preview())
            found = question.answer()
            found.save("found")
            lines += found.lines()
        shutil.copytree(folder / "found", out, dirs_exist_ok=True)
    (out / SUMMARY).write_text("\n".join(lines) + "\n", encoding="utf-8")


def options(parser: argparse.ArgumentParser) -> None:
    """What the command takes beside the profile."""
    parser.add_argument("recordings", nargs="*", help="files; none: a concealed machine is made")
    parser.add_argument("--engine", help="engine file (YAML) of the recordings; default: the published engine")
    parser.add_argument("--sensors", type=lambda text: text.split(","), help="their columns to use, comma-separated")


def check(parameters: Mapping[str, Any]) -> None:
    """Raise ``InputError`` for files that can't be read, and for what is said of recordings where none is named: the
    concealed machine is the chain's own, and what is found in it is compared."""
    named_recordings(parameters["recordings"])
    engine_file(parameters["engine"])
    for option in () if parameters["recordings"] else ("engine", "sensors"):
        if parameters[option]:
            raise InputError(f"--{option}", "no recording beside it", "an option for recordings that are named",
                             "name them, or leave it out")  # fmt: skip


def named_recordings(paths: Sequence[str]) -> dict[str, Artifact]:
    """Recordings by the stem of their file (numbered where two are alike). Raises ``InputError``."""
    found: dict[str, Artifact] = {}
    for text in paths:
        refuse_unreadable(text)
        path = Path(text).resolve()
        name, number = path.stem, 2
        while name in found:
            name, number = f"{path.stem}_{number}", number + 1
        found[name] = Artifact.of(path)
    return found


def engine_file(text: str | None) -> dict[str, Artifact]:
    """The step's argument ``engine``, where an engine file is given. Raises ``InputError``."""
    if not text:
        return {}
    refuse_unreadable(text, "an engine file (YAML)")
    return {"engine": Artifact.of(Path(text).resolve())}


def gathered(pending: Mapping[str, Pending]) -> tuple[dict[str, Artifact], dict[str, StepFailed]]:
    """Wait for all of them: results, and what was refused (one bad recording doesn't stop the others)."""
    found: dict[str, Artifact] = {}
    refused: dict[str, StepFailed] = {}
    for name, waiting in pending.items():
        try:
            found[name] = waiting.result()
        except StepFailed as error:
            refused[name] = error
    return found, refused


def files_to_publish(found: Mapping[str, Artifact], inputs: Mapping[str, Artifact]) -> dict[str, Path]:
    """Names in ``discoveries/`` -> files: recordings with what was found in them."""
    files = {f"{name}/{file}": artifact.path / file for name, artifact in found.items() for file in COMPARED}
    learned = {f"{name}/{LEARNED}": artifact.path / LEARNED for name, artifact in found.items()}
    files |= {name: path for name, path in learned.items() if path.is_file()}
    return files | {f"{name}/recording{inputs[name].path.suffix}": inputs[name].path for name in found}


def files_to_show(found: Artifact) -> dict[str, Path]:
    """Names in ``reports/discover/NAME/`` -> files."""
    hidden = (RUNTIME, MANIFEST)
    top = [path for path in sorted(found.path.iterdir()) if path.is_file() and path.name not in hidden]
    return {path.name: path for path in top} | {
        f"figures/{path.name}": path for path in sorted((found.path / "figures").glob("*"))
    }


def show(found: Mapping[str, Artifact], refused: Mapping[str, StepFailed], folder: Path) -> None:
    """Print one sentence a recording; raise the first refusal, if there is one, after all is said."""
    display = current().display
    for name, artifact in found.items():
        sentence = (artifact.path / SUMMARY).read_text(encoding="utf-8").strip().splitlines()[-1]
        display.say("")
        display.say(f"{name}: {sentence}")
        display.say(f"report: {folder / name / 'report.html'}")
    for name, error in refused.items():
        display.say(f"{name}: no verdict: {error}")
    for error in refused.values():
        raise error
