"""THE cache policy, and how a step runs.

A step's key is the hash of
  * the content hashes of the files it is given (never their names, never arrays),
  * its plain parameters (its sections of params.yaml, those that the library looks up by itself too, seeds),
  * the code of its own function and of the library modules that it really imports (:mod:`tasks.sources`), and the files
    that those open in the library,
  * the versions of the packages those modules import.

Results lie in ``.cache/<step>/<key>/`` (:mod:`tasks.store`); Prefect's own cache holds the path and the hash alone,
under the same key, and is believed only after the files were hashed again (:mod:`tasks.prefect_task`). Steps run in
processes of their own (:mod:`tasks.workers`), so that two heavy ones use two cores; those never need Prefect.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from tasks import workers
from tasks.failures import StepFailed, WorkerKilled
from tasks.fork_server import HEAVY
from tasks.progress import Display
from tasks.remembered import Remembered
from tasks.sources import LIBRARY, LibrarySources, Sources, function_sources
from tasks.store import RUNTIME, Artifact, Store, check_inputs
from tasks.workspace import PROJECT, Workspace

# Set for processes whose terminal is not the user's (workers of a cluster): they print nothing.
QUIET_VARIABLE = "DIESELTWIN_QUIET"

# Steps at a time: each uses one core.
WORKERS = max(1, min(2, os.cpu_count() or 1))

_LOG_STEM_BYTES = 200  # a recording's own name may be as long as a file's can be

# How long a step took, beside its result and no part of its hash.
TIMING = f"step/{RUNTIME}"

# The argument of a step that its function doesn't get: its process finds it in the environment.
_SECTIONS = "sections"

Progress = Callable[[float, float], None]
"""What a step tells of itself: how much is done, and of how much."""

STEPS: dict[str, Step] = {}


@dataclass(frozen=True)
class RunContext:
    """What every step of one process shares."""

    workspace: Workspace
    display: Display
    library_root: Path = PROJECT
    library: str = LIBRARY
    timings: dict[str, float] = field(default_factory=dict)
    codes: dict[str, Sources] = field(default_factory=dict)

    @cached_property
    def store(self) -> Store:
        """Where results lie."""
        return Store(self.workspace.cache)

    @cached_property
    def remembered(self) -> Remembered:
        """What earlier runs found in texts of the library that are still the same."""
        return Remembered(self.workspace.cache / "code.json")

    @cached_property
    def sources(self) -> LibrarySources:
        """The library's code as it is on disk when the run starts."""
        return LibrarySources(self.library_root, self.library, self.remembered)

    def forget_code(self) -> None:
        """Read the code anew when it is asked for next."""
        self.codes.clear()
        self.__dict__.pop("sources", None)


_context: RunContext | None = None


def current() -> RunContext:
    """The run context of this process, made on first use."""
    global _context
    if _context is None:
        workspace = Workspace.current()
        display = Display(workspace.cache / "expected_seconds.json")
        display.console.quiet = bool(os.environ.get(QUIET_VARIABLE))
        _context = RunContext(workspace, display)
    return _context


def use(context: RunContext | None) -> None:
    """Set (tests) or forget (None) the process's run context."""
    global _context
    _context = context


@dataclass(frozen=True)
class Step:
    """A function ``(out, progress, **inputs, **parameters) -> None`` that writes its result into the folder ``out``.

    ``progress`` (:data:`Progress`) may be called or not. Arguments given as :class:`Artifact` reach the function as
    paths; all others must be plain JSON values. The function imports what it computes with inside itself.

    ``sections`` names the sections of params.yaml that the library looks up by itself when the function runs. They are
    an argument ``sections`` of the call (:meth:`sections_of`), part of the key, and stand for the file's in the step's
    process: the file may be of another profile, or edited, and a look-up of any other section is an error there.
    ``unkeyed``: parameters that are no part of the key; a result found may have been made with others.
    """

    name: str
    label: str
    function: Callable[..., None]
    expected_s: float = 5.0
    entries: tuple[str, ...] = ()
    many: bool = False
    sections: tuple[str, ...] = ()
    unkeyed: tuple[str, ...] = ()

    @property
    def reference(self) -> str:
        """``module:name``, by which a process that never imported the module finds the step (:func:`find_step`)."""
        return f"{self.function.__module__}:{self.name}"

    def code(self, context: RunContext) -> Sources:
        """The code that the step's result rests on."""
        if self.name not in context.codes:
            known = context.sources.modules
            own, imported = function_sources(self.function, known)
            entries = {
                module: names
                for module, names in imported.items()
                if module in known and not any(entry.startswith(f"{module}.") for entry in self.entries)
            }
            entries |= {entry: {"*"} for entry in self.entries}
            context.codes[self.name] = context.sources.collect(entries, {f"step {self.name}": own})
            context.remembered.save()
        return context.codes[self.name]

    def key(self, context: RunContext, inputs: Mapping[str, Artifact], parameters: Mapping[str, Any]) -> str:
        """The cache key (first 32 digits of a sha256). Raises ``TypeError`` where the sections aren't the step's."""
        if set(parameters.get(_SECTIONS, ())) != set(self.sections):
            given = sorted(parameters.get(_SECTIONS, ()))
            raise TypeError(f"{self.name}: sections: got {given}; allowed: {sorted(self.sections)}; pass `sections_of`")
        parts = {
            "step": self.name,
            "code": self.code(context).digest,
            "inputs": {name: artifact.sha256 for name, artifact in inputs.items()},
            "parameters": {name: value for name, value in parameters.items() if name not in self.unkeyed},
        }
        text = json.dumps(parts, sort_keys=True, allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def sections_of(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """The argument ``sections`` of a call, from the settings of a profile."""
        return {name: settings[name] for name in self.sections}

    def instance(self, parameters: Mapping[str, Any]) -> str:
        """The step's name, with the kind where one step makes several."""
        return f"{self.name}-{parameters['kind']}" if "kind" in parameters else self.name

    def title(self, parameters: Mapping[str, Any]) -> str:
        """The same in words."""
        return f"{self.label}, {parameters['kind']}" if "kind" in parameters else self.label

    def __call__(self, **arguments: Any) -> Artifact:
        """Run the step now, with the cache but without Prefect."""
        context = current()
        inputs, parameters = split_arguments(arguments)
        return execute(self, context, inputs, parameters)


@dataclass(frozen=True)
class Pending:
    """A step that was submitted."""

    step: Step
    parameters: Mapping[str, Any]
    future: Any
    context: RunContext
    cached: bool
    told: list[str] = field(default_factory=list, repr=False, compare=False)

    def result(self) -> Artifact:
        """Wait; returns path and hash, checked; asked again it says nothing again. Raises :class:`StepFailed`."""
        artifact = Artifact.from_dict(self.future.result(), self.context.workspace.root)
        name, title = self.step.instance(self.parameters), self.step.title(self.parameters)
        if self.cached:
            if not self.step.many and not self.told:
                self.told.append(title)
                self.context.display.cached(title)
        elif name not in self.context.timings:  # computed by a cluster's worker
            self.context.timings[name] = seconds_of(artifact)
            self.context.display.elsewhere(name, title, self.context.timings[name])
        return artifact


def find_step(reference: str) -> Step:
    """The step of a :attr:`Step.reference`; its module is imported where it wasn't yet."""
    module, _, name = reference.rpartition(":")
    if name not in STEPS:
        importlib.import_module(module)
    return STEPS[name]


def step(
    name: str,
    label: str,
    *,
    expected_s: float = 5.0,
    entries: tuple[str, ...] = (),
    many: bool = False,
    sections: tuple[str, ...] = (),
    unkeyed: tuple[str, ...] = (),
) -> Callable[[Callable[..., None]], Step]:
    """Make a step of a function, see :class:`Step`.

    ``entries``: library modules that stand for the packages they lie in, where a package's registry would take in too
    much; ``many``: it runs hundreds of times in a flow, so that results from the cache aren't listed; ``sections``: of
    params.yaml, that the library looks up by itself.
    """

    def decorate(function: Callable[..., None]) -> Step:
        made = Step(name, label, function, expected_s, entries, many, sections, unkeyed)
        if name in STEPS and STEPS[name].function.__qualname__ != function.__qualname__:
            raise ValueError(f"two steps named {name!r}")
        STEPS[name] = made
        return made

    return decorate


def split_arguments(arguments: Mapping[str, Any]) -> tuple[dict[str, Artifact], dict[str, Any]]:
    """Artifacts and plain values. Raises ``TypeError`` for anything else: arrays hash differently every time."""
    inputs = {name: value for name, value in arguments.items() if isinstance(value, Artifact)}
    parameters = {name: value for name, value in arguments.items() if not isinstance(value, Artifact)}
    try:
        text = json.dumps(parameters, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise TypeError(f"a step takes artifacts and plain JSON values; got {sorted(parameters)}: {error}") from error
    return inputs, json.loads(text)


def execute(
    step: Step,
    context: RunContext,
    inputs: Mapping[str, Artifact],
    parameters: Mapping[str, Any],
    wanted: str | None = None,
) -> Artifact:
    """The stored result where there is a good one, else run the step's function in a worker process and store it.

    ``wanted``: the key as the flow knows it. A cluster's worker lives longer than a flow: the code that it read for an
    earlier one may have been edited since.
    """
    key = step.key(context, inputs, parameters)
    if wanted not in (None, key):
        context.forget_code()
        key = step.key(context, inputs, parameters)
        if key != wanted:
            raise StepFailed(
                f"{step.name}: got another code or other packages here than the flow has; allowed: the same "
                "checkout and environment; update the cluster's workers and start them again"
            )
    found = context.store.find(step.name, key)
    if found is not None:
        return found
    check_inputs(step.name, inputs, context.workspace.root)
    provenance = {
        "inputs": {name: artifact.to_dict(context.workspace.root) for name, artifact in inputs.items()},
        "parameters": dict(parameters),
        "modules": dict(sorted(step.code(context).modules.items())),
        "packages": dict(step.code(context).packages),
        "data": dict(step.code(context).data),
    }
    name, title = step.instance(parameters), step.title(parameters)
    context.display.start(name, step.expected_s, title)
    started = time.perf_counter()
    try:
        with context.store.writing(step.name, key, provenance) as out:
            try:
                cpu_s = _run_worker(step, context, key, out, inputs, parameters)
            except StepFailed:
                check_inputs(step.name, inputs, context.workspace.root)  # what is half written is no fault
                raise
            seconds = time.perf_counter() - started
            check_inputs(step.name, inputs, context.workspace.root)
            _check_code(step, context)
            (out / TIMING).parent.mkdir()
            (out / TIMING).write_text(
                json.dumps({"step": name, "seconds": round(seconds, 3), "cpu_seconds": cpu_s}), encoding="utf-8"
            )
    except BaseException:
        context.display.fail(name)
        raise
    context.timings[name] = seconds
    context.display.finish(name, title)
    stored = context.store.find(step.name, key)
    if stored is None:
        raise StepFailed(f"{step.name}: what was just written to {context.store.folder(step.name, key)} cannot be read")
    return stored


def _check_code(step: Step, context: RunContext) -> None:
    """Raise ``StepFailed`` where the code on disk is no longer that of the key: the worker imported it in between, so
    that nobody knows which of the two it ran."""
    before = step.code(context)
    try:
        own = function_sources(step.function, context.sources.modules)[0]
        if not context.sources.touched() and before.modules[f"step {step.name}"] == own:
            return
        now = step.code(replace(context, codes={}))  # with sources of its own, which read the files anew
        changed = _differing(before, now)
    except (SyntaxError, OSError, ImportError) as error:  # it is being edited, or a module is gone
        changed = [str(error)]
    if changed:
        names = ", ".join(changed)
        raise StepFailed(f"{step.name}: code of {names} changed while the run was on; run again")


def _differing(before: Sources, now: Sources) -> list[str]:
    """Names of the modules and folders of data that two digests don't agree about."""
    old, new = {**before.modules, **before.data}, {**now.modules, **now.data}
    return sorted(name for name in {*old, *new} if old.get(name) != new.get(name))


def seconds_of(artifact: Artifact) -> float:
    """Wall seconds [s] that the step behind a stored result took."""
    return float(json.loads((artifact.path / TIMING).read_text(encoding="utf-8"))["seconds"])


def _run_worker(
    step: Step,
    context: RunContext,
    key: str,
    out: Path,
    inputs: Mapping[str, Artifact],
    parameters: Mapping[str, Any],
) -> float:
    """Run the step's function in a process. Returns the CPU seconds it took."""
    from dieseltwin.settings.params import SECTIONS_VARIABLE

    logs = context.workspace.cache / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    stem = step.instance(parameters).encode()[:_LOG_STEM_BYTES].decode(errors="ignore")
    log = logs / f"{stem}-{key[:8]}.log"
    paths = [str(context.library_root), str(PROJECT), *(path for path in sys.path if path)]
    environment = {
        **os.environ,
        **workers.ONE_THREAD,
        "PYTHONPATH": os.pathsep.join(dict.fromkeys(paths)),
        SECTIONS_VARIABLE: json.dumps(parameters.get(_SECTIONS, {})),
    }
    specification = {
        "step": step.reference,
        "inputs": {name: str(artifact.path) for name, artifact in inputs.items()},
        "parameters": {name: value for name, value in parameters.items() if name != _SECTIONS},
        "out": str(out),
        "folder": os.getcwd(),
        "environment": environment,
    }
    libraries = [library for library in HEAVY if library.partition(".")[0] in step.code(context).packages]
    status, last = workers.run(
        specification, libraries, log, lambda fraction: context.display.update(step.instance(parameters), fraction)
    )
    if status:
        raise _failed(step, context, log, last, status)
    return float(last["cpu_s"])


def _failed(step: Step, context: RunContext, log: Path, failure: Mapping[str, Any], status: int) -> StepFailed:
    where = context.workspace.relative(log)
    if f"{context.library}.errors.InputError" in failure.get("kind", ()):
        return StepFailed(failure["error"], exit_code=2, kinds=failure["kind"])
    if failure:
        kind = failure["kind"][0].removeprefix("builtins.")
        first = str(failure["error"]).splitlines()[0]
        return StepFailed(f"{step.name}: {kind}: {first} (traceback in {where})", kinds=failure["kind"])
    tail = log.read_text(encoding="utf-8", errors="replace").splitlines()
    last = tail[-1] if tail else "no output"
    kind = WorkerKilled if status < 0 and not workers.stopping() else StepFailed
    return kind(f"{step.name}: the worker ended with status {status}: {last} (log in {where})")


def seed_for(seed: int, *names: str) -> int:
    """A seed of its own for each named purpose, derived from the run's seed."""
    return int.from_bytes(hashlib.sha256("/".join((str(seed), *names)).encode()).digest()[:4], "big")
