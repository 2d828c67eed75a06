"""Recordings -> what physics the twin left out: reports, MLflow. Without a recording: a concealed machine."""

from __future__ import annotations

import sys

from prefect import flow

from tasks import discover as steps
from tasks import prove
from tasks import records_discovery as records
from tasks.cluster import task_runner
from tasks.launch import run_alone
from tasks.prefect_task import submit
from tasks.publish import publish
from tasks.run_context import WORKERS, Pending, current
from tasks.settings import load_settings


@flow(name="discover", description=__doc__, task_runner=task_runner())
def discover(
    profile: str,
    recordings: list[str] | None = None,
    engine: str | None = None,
    sensors: list[str] | None = None,
) -> list[str]:
    """Discover in each recording. Returns the names of those that gave a verdict."""
    context = current()
    settings = load_settings(profile)
    if recordings:
        inputs = steps.named_recordings(recordings)
    else:
        made = submit(
            prove.benchmark,
            cases=1,
            seed=settings["discover"]["concealed_seed"],
            tier="main",
            sensors=settings["proof"]["sensors"],
            duration_s=settings["proof"]["duration_s"],
            jobs=WORKERS,
        ).result()
        inputs = {"concealed": prove.recording_of(made, prove.cases_of(made)[0])}
    known = steps.engine_file(engine)
    asked: dict[tuple[str, str], Pending] = {}
    for name, recording in inputs.items():
        content = recording.sha256, recording.path.suffix
        if content not in asked:  # a copy among them is discovered once
            asked[content] = submit(
                steps.discover,
                recording=recording,
                kind=name,
                ending=recording.path.suffix,
                concealed=not recordings,
                sensors=sensors,
                sections=steps.discover.sections_of(settings),
                **known,
            )
    pending = {name: asked[recording.sha256, recording.path.suffix] for name, recording in inputs.items()}
    found, refused = steps.gathered(pending)
    if found and not recordings:
        publish(context.workspace.root / "discoveries", steps.files_to_publish(found, inputs))
    for name, artifact in found.items():
        publish(context.workspace.reports / "discover" / name, steps.files_to_show(artifact))
    records.discovered(found, inputs, known.get("engine"), sensors, settings)
    steps.show(found, refused, context.workspace.reports / "discover")
    return list(found)


if __name__ == "__main__":
    sys.exit(run_alone(discover, options=steps.options, check=steps.check))
