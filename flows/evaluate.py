"""The paper's tables and figures from ensembles of every method: ``evaluation/``, ``reports/evaluation/``."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from prefect import flow

from tasks import ensembles as steps
from tasks import evaluate as after
from tasks import evaluation_records as records
from tasks.cluster import task_runner
from tasks.evaluation_plan import Plan, ensembles_of
from tasks.launch import run_alone
from tasks.prefect_task import submit
from tasks.pretrain import trained_with
from tasks.publish import publish, published
from tasks.run_context import Pending, current, seed_for
from tasks.settings import about, load_settings, network_files, own_settings, source_of
from tasks.store import RUNTIME, Artifact, content_hash

LABELS = {"clean": 0.0, "noisy": 1.0}
"""Label noise of the operators' trainings, in units of ``noise.label_rel``."""

READ = ("seed", "engine", "noise", "identify", "pretrain", "evaluation")
"""Sections of params.yaml that the tables rest on."""


@flow(name="evaluate", description=__doc__, task_runner=task_runner())
def evaluate(profile: str, only: list[str] | None = None) -> str:
    """Run every ensemble, or those named by ``only``, then tables and page. Returns the hash of ``evaluation/``.

    With ``only`` nothing is trained anew and the results go to ``evaluation-part/``, beside those of the whole.
    """
    context = current()
    root = context.workspace.root
    settings = load_settings(profile)
    field = published(root / "data" / "field", "simulate")
    lab = published(root / "data" / "lab", "simulate")
    models = published(root / "models", "pretrain")

    name = "evaluation-part" if only else "evaluation"
    plans = ensembles_of(settings, only or ())
    pending = _submit_ensembles(plans, settings, field, models)
    trainings = {} if only else _submit_trainings(settings, lab, field, models)
    assembled = {}
    for plan in plans:
        parts = {f"part_{first:04d}": waiting.result() for first, waiting in pending[plan.trained_as].items()}
        assembled[plan.slug] = submit(
            after.ensemble,
            field=field,
            settings=own_settings(settings, plan.method),
            what=plan.what,
            method=plan.method,
            variant=plan.variant,
            epochs=plan.epochs,
            last_epoch=plan.last_epoch,
            kind=plan.slug,
            run_times=_times(list(parts.values())),
            **{kind: net for kind, net in network_files(plan.method, models).items() if kind in after.NETWORKS},
            **parts,
        )
    found = {f"ensemble_{i:03d}": assembled[plan.slug].result() for i, plan in enumerate(plans)}
    times = _times(list(found.values()))
    classical = own_settings(settings, "classical")
    common = submit(
        after.tables,
        errors=models / "errors",
        bootstrap=settings["evaluation"]["bootstrap"],
        field=field,
        run_times=times,
        **found,
        **{name: waiting.result() for name, waiting in trainings.items()},
    ).result()
    page = submit(
        after.page,
        field=field,
        common=common,
        settings=classical,
        about={**about(settings, field, READ), "commands": "python -m flows.evaluate"},
        run_times=[*times, *_times([common])],
        **found,
    ).result()
    results = publish(
        root / name,
        {
            "": common.path,
            **{f"ensembles/{plan.slug}": part.path for plan, part in zip(plans, found.values(), strict=True)},
        },
    )
    publish(context.workspace.reports / name, {"": page.path})
    records.evaluated(plans, found, common, page, {"field recordings": field, "models": models}, settings)
    context.display.say(f"tables: {context.workspace.relative(root / name)}")
    context.display.say(f"page: {context.workspace.relative(context.workspace.reports / name / after.PAGE)}")
    return results.sha256


def _times(parts: list[Artifact]) -> list[str]:
    """Hashes of the run times, which are no part of a result's hash but are shown."""
    return [content_hash(part.path / RUNTIME) for part in parts]


def _submit_ensembles(
    plans: list[Plan], settings: dict[str, Any], field: Artifact, models: Artifact
) -> dict[str, dict[int, Pending]]:
    """Every batch of every ensemble, the longest first; multi-stage waits for the source models of its case."""
    plans = [plan for plan in plans if not plan.last_epoch]
    pending: dict[str, dict[int, Pending]] = {plan.slug: {} for plan in plans}

    def batch(plan: Plan, first: int, runs: int) -> dict[str, Any]:
        return {
            "method": plan.method,
            "field": field,
            "settings": own_settings(settings, plan.method),
            "what": {**plan.what, "first": first, "runs": runs},
            "kind": f"{plan.slug}-m{first:03d}",
            **network_files(plan.method, models),
        }

    for plan in plans:
        if source_of(plan.method) is None:
            for first, runs in plan.batches:
                pending[plan.slug][first] = submit(steps.STEPS[plan.method], **batch(plan, first, runs))
    trained = {(plan.method, plan.case): pending[plan.slug] for plan in plans if not plan.variant}
    for plan in plans:
        source = source_of(plan.method)
        if source is not None:
            for first, runs in plan.batches:
                pending[plan.slug][first] = submit(
                    steps.STEPS[plan.method],
                    **batch(plan, first, runs), source=trained[source, plan.case][first].result()
                )
    return pending


def _submit_trainings(
    settings: dict[str, Any], lab: Artifact, field: Artifact, models: Artifact
) -> dict[str, Pending]:
    """Repeated trainings of the operators, with and without label noise, and of the bodies as printed.

    As those of ``models/`` were trained: the table says how far the parts that the ensembles used scatter.
    """
    pending = {}
    operators, bodies = trained_with(models.path, "operators"), trained_with(models.path, "bodies_paper")
    for number in range(settings["evaluation"]["trainings"]):
        for labels, share in LABELS.items():
            pending[f"training_{labels}_{number:02d}"] = submit(
                steps.operators_training,
                lab=lab,
                field=field,
                config=operators,
                engine=settings["engine"],
                seed=seed_for(settings["seed"], f"evaluation operators {number}") % 2**40,
                label_noise_rel=share * settings["noise"]["label_rel"],
                kind=f"{labels}-{number}",
            )
        pending[f"training_bodies_{number:02d}"] = submit(
            steps.bodies_training,
            lab=lab,
            config=bodies,
            seed=seed_for(settings["seed"], f"evaluation bodies {number}") % 2**40,
            kind=f"{number}",
        )
    return pending


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--only", nargs="+", metavar="CASE-METHOD", help="these ensembles alone, e.g. noisy-301-few-shot-adam"
    )


def _check(parameters: dict[str, Any]) -> None:
    ensembles_of(load_settings(parameters["profile"]), parameters["only"] or ())


if __name__ == "__main__":
    sys.exit(run_alone(evaluate, options=_options, check=_check))
