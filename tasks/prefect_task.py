"""The Prefect side of a step: one task, whose cache key is the step's key and whose result is a path and a hash."""

from __future__ import annotations

from typing import Any

from prefect import task
from prefect.cache_policies import CachePolicy

from tasks import run_context
from tasks.failures import WorkerKilled
from tasks.store import Artifact


class ContentPolicy(CachePolicy):
    """Prefect's cache key is the step's key: contents, parameters, code."""

    def compute_key(
        self, task_ctx: Any, inputs: dict[str, Any], flow_parameters: dict[str, Any], **kwargs: Any
    ) -> str | None:
        """Called by Prefect with the task's arguments."""
        step, artifacts = _resolve(inputs["step"], inputs["inputs"])
        return f"{step.name}-{step.key(run_context.current(), artifacts, inputs['parameters'])}"


def _was_killed(_task: Any, _run: Any, state: Any) -> bool:
    """Whether a try ended because its process was killed from outside."""
    return isinstance(state.data, WorkerKilled)


@task(
    cache_policy=ContentPolicy(),
    persist_result=True,
    result_serializer="json",
    cache_result_in_memory=False,
    retries=2,
    retry_condition_fn=_was_killed,
)
def run_step(step: str, inputs: dict[str, dict[str, str]], parameters: dict[str, Any]) -> dict[str, str]:
    """Run the step of that reference. Returns its result as path and hash."""
    context = run_context.current()
    found, artifacts = _resolve(step, inputs)
    return run_context.execute(found, context, artifacts, parameters).to_dict(context.workspace.root)


def _resolve(step: str, inputs: dict[str, dict[str, str]]) -> tuple[run_context.Step, dict[str, Artifact]]:
    root = run_context.current().workspace.root
    return run_context.find_step(step), {name: Artifact.from_dict(value, root) for name, value in inputs.items()}
