"""How a step runs in a flow: one Prefect task, whose cache key is the step's key and whose result is a path and a hash.

Prefect keeps the record of what ran, tries again what was killed, and knows by the key what need not run. What it
doesn't do by itself is ours (:mod:`tasks.run_context`, :mod:`tasks.sources`, :mod:`tasks.store`): its own keys, like
joblib's ``Memory``, see the text of the task's function and no module that this imports, and its result files are
neither written in one piece nor checked when they are read.
"""

from __future__ import annotations

from typing import Any

from prefect import task

from tasks import run_context
from tasks.failures import WorkerKilled
from tasks.run_context import Pending, Step
from tasks.store import Artifact


def _was_killed(_task: Any, _run: Any, state: Any) -> bool:
    """Whether a try ended because its process was killed from outside."""
    return isinstance(state.data, WorkerKilled)


@task(
    persist_result=True,
    result_serializer="json",
    cache_result_in_memory=False,
    retries=2,
    retry_condition_fn=_was_killed,
)
def run_step(step: str, inputs: dict[str, dict[str, str]], parameters: dict[str, Any], key: str) -> dict[str, str]:
    """Run the step of that reference and key. Returns its result as path and hash."""
    context = run_context.current()
    root = context.workspace.root
    artifacts = {name: Artifact.from_dict(value, root) for name, value in inputs.items()}
    return run_context.execute(run_context.find_step(step), context, artifacts, parameters, key).to_dict(root)


def submit(step: Step, /, **arguments: Any) -> Pending:
    """Start a step in the running flow; :meth:`Pending.result` waits for it."""
    context = run_context.current()
    inputs, parameters = run_context.split_arguments(arguments)
    key = step.key(context, inputs, parameters)
    hit = context.store.find(step.name, key)
    record = f"{step.name}-{key}"
    named = run_step.with_options(
        name=step.name,
        task_run_name=step.instance(parameters),
        cache_key_fn=lambda _context, _arguments: record,
        # Prefect's record is refused where the files it names are gone or changed.
        refresh_cache=hit is None,
    )
    plain = {name: artifact.to_dict(context.workspace.root) for name, artifact in inputs.items()}
    future = named.submit(step.reference, plain, dict(parameters), key)
    return Pending(step, dict(parameters), future, context, cached=hit is not None)
