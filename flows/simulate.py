"""params -> driving sets, laboratory recordings (Cases I-IV, VI, VII), field recordings (Case-V): ``data/``."""

from __future__ import annotations

import sys
from typing import Any

from prefect import flow
from prefect.task_runners import ThreadPoolTaskRunner

from tasks import records, report
from tasks import simulate as steps
from tasks.launch import run_alone
from tasks.prefect_task import submit
from tasks.publish import publish
from tasks.run_context import WORKERS, current
from tasks.settings import load_settings


@flow(name="simulate", description=__doc__, task_runner=ThreadPoolTaskRunner(max_workers=WORKERS))
def simulate(profile: str, settings: dict[str, Any] | None = None) -> str:
    """Make the data. Returns the folder's hash. ``settings``: those of the profile, where they were read already."""
    settings = settings or load_settings(profile)
    known = {name: settings[name] for name in ("driving", "engine")}
    sets = submit(steps.driving_sets, **known).result()
    pending = submit(steps.case_recordings, sets=sets, **known, noise=settings["noise"])
    pictures = submit(report.driving_pictures, sets=sets, driving=settings["driving"], dpi=settings["report"]["dpi"])
    recordings = pending.result()
    data = publish(current().workspace.root / "data", {"sets": sets.path, "": recordings.path})
    records.simulated(sets, recordings, pictures.result(), settings)
    return data.sha256


if __name__ == "__main__":
    sys.exit(run_alone(simulate))
