"""Concealed machines -> how often discovery is right: make, run case by case, open the seal, score: ``proof/``."""

from __future__ import annotations

import sys

from prefect import flow

from tasks import prove as steps
from tasks import records_discovery as records
from tasks.cluster import task_runner
from tasks.launch import run_alone
from tasks.prefect_task import submit
from tasks.publish import publish
from tasks.run_context import WORKERS, current
from tasks.settings import load_settings


@flow(name="prove", description=__doc__, task_runner=task_runner())
def prove(profile: str) -> str:
    """Run the benchmark of a profile. Returns the hash of ``proof/``."""
    context = current()
    settings = load_settings(profile)
    config = dict(settings["proof"])
    baselines = config.pop("baseline_cases")
    made = submit(steps.benchmark, **config, jobs=WORKERS).result()
    entries = steps.cases_of(made)
    pending = {
        entry["case"]: submit(
            steps.case,
            recording=steps.recording_of(made, entry),
            kind=entry["case"],
            withhold=entry["withhold"],
            tier=config["tier"],
            sections=steps.case.sections_of(settings),
        )
        for entry in entries
    }
    opened, parts = {}, {}
    for name, waiting in pending.items():
        parts[f"result_{name}"] = waiting.result()
        opened[name] = submit(
            steps.opened,
            benchmark=made,
            result=parts[f"result_{name}"],
            kind=name,
            sections=steps.opened.sections_of(settings),
        )
    compared = {}
    if baselines:
        bands = submit(
            steps.bands, benchmark=made, jobs=WORKERS, sections=steps.bands.sections_of(settings)
        ).result()
        compared = {
            entry["case"]: submit(
                steps.baseline,
                benchmark=made,
                bands=bands,
                kind=entry["case"],
                sections=steps.baseline.sections_of(settings),
            )
            for entry in entries[:baselines]
        }
    parts |= {f"opened_{name}": waiting.result() for name, waiting in opened.items()}
    parts |= {f"baseline_{name}": waiting.result() for name, waiting in compared.items()}
    scored = submit(steps.score, benchmark=made, sections=steps.score.sections_of(settings), **parts).result()
    proof = publish(context.workspace.root / "proof", steps.files_to_publish(scored))
    publish(context.workspace.reports / "proof", steps.files_to_show(scored))
    records.proved(scored, made, settings)
    steps.show(scored, context.workspace.reports / "proof")
    return proof.sha256


if __name__ == "__main__":
    sys.exit(run_alone(prove))
