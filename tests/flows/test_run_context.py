"""The cache policy: what is computed again and what isn't, with and without Prefect, and after a kill."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import psutil
import pytest
import toy_library
import toy_steps

from tasks import run_context
from tasks.failures import InputChanged
from tasks.run_context import RunContext, StepFailed
from tasks.store import Artifact
from tasks.workspace import PROJECT

HERE = Path(__file__).parent


def run_chain(scale: float = 2.0) -> tuple[Artifact, Artifact]:
    numbers = toy_steps.make(count=5, seed=1)
    return numbers, toy_steps.total(numbers=numbers, scale=scale)


def ran(context: RunContext) -> set[str]:
    return set(context.timings)


def again(context: RunContext) -> RunContext:
    """What a later process sees."""
    fresh = toy_library.fresh_context(context.workspace.root)
    run_context.use(fresh)
    return fresh


def test_the_second_run_computes_nothing_and_gives_the_same(context: RunContext) -> None:
    first = run_chain()
    assert ran(context) == {"toy-make", "toy-sum"}
    fresh = again(context)
    assert run_chain() == first
    assert ran(fresh) == set()


@pytest.mark.parametrize(
    ("changed", "text", "expected"),
    [
        ("constants.py", "FACTOR = 3.0\n", {"toy-sum"}),
        ("report.py", "COLOUR = 'blue'\n", set()),
        (
            "draw.py",
            "import numpy as np\n\ndef draw(count, seed):\n    return np.ones(count)\n",
            {"toy-make", "toy-sum"},
        ),
        # other code, same numbers: what follows isn't disturbed
        (
            "draw.py",
            "import numpy as np\n\ndef draw(n, seed):\n    return np.random.default_rng(seed).random(n)\n",
            {"toy-make"},
        ),
    ],
)
def test_changed_library_source(context: RunContext, changed: str, text: str, expected: set[str]) -> None:
    run_chain()
    (context.workspace.root / "toylib" / changed).write_text(text)
    fresh = again(context)
    run_chain()
    assert ran(fresh) == expected


def test_a_worker_that_served_an_earlier_flow_reads_edited_code_anew(context: RunContext) -> None:
    """``context`` is that of a cluster's worker, which lives on when the first flow has ended."""
    numbers, before = run_chain()
    (context.workspace.root / "toylib" / "constants.py").write_text("FACTOR = 3.0\n")
    flow = toy_library.fresh_context(context.workspace.root)
    asked = toy_steps.total, context, {"numbers": numbers}, {"scale": 2.0}
    key = toy_steps.total.key(flow, *asked[2:])
    after = run_context.execute(*asked, key)
    first, second = (float((made.path / "total.txt").read_text()) for made in (before, after))
    assert second == pytest.approx(1.5 * first)
    with pytest.raises(StepFailed, match="allowed: the same checkout"):
        run_context.execute(*asked, "0" * 32)


def test_a_step_of_a_recording_with_the_longest_name_has_its_log(
    context: RunContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_context.Step, "instance", lambda step, parameters: f"{step.name}-{'ü' * 122}")
    toy_steps.make(count=5, seed=1)
    (log,) = (context.workspace.cache / "logs").glob("toy-make-ü*.log")
    assert len(log.name.encode()) < 255


def test_changed_parameter_runs_that_step_alone(context: RunContext) -> None:
    run_chain()
    fresh = again(context)
    run_chain(scale=3.0)
    assert ran(fresh) == {"toy-sum"}


def test_flipped_byte_is_computed_again_with_the_same_result(context: RunContext) -> None:
    numbers, total = run_chain()
    path = numbers.path / "numbers.txt"
    data = bytearray(path.read_bytes())
    data[3] ^= 1
    path.write_bytes(data)
    fresh = again(context)
    assert run_chain() == (numbers, total)
    assert ran(fresh) == {"toy-make"}


def test_steps_that_share_a_function_run_by_their_names_and_rest_on_their_own_entries(context: RunContext) -> None:
    made = {name: shared(word="the same") for name, shared in toy_steps.SHARED.items()}
    assert ran(context) == {"toy-draw", "toy-report"}
    assert {(artifact.path / "word.txt").read_text() for artifact in made.values()} == {"the same"}
    (context.workspace.root / "toylib" / "report.py").write_text("COLOUR = 'blue'\n")
    fresh = again(context)
    for shared in toy_steps.SHARED.values():
        shared(word="the same")
    assert ran(fresh) == {"toy-report"}


def test_a_step_begins_with_the_heavy_libraries_that_it_imports(context: RunContext) -> None:
    found = set((toy_steps.loaded().path / "loaded.txt").read_text().split())
    assert "matplotlib.backends.backend_agg" in found and not {"torch", "torch._dynamo", "numba"} & found


@pytest.mark.parametrize(
    ("changed", "stored"),
    [("FACTOR = 3.0\n", False), ("FACTOR = (\n", False), ("FACTOR = 2.0  # in other words\n", True)],
)
def test_a_result_is_not_stored_under_the_key_of_code_that_was_edited_meanwhile(
    context: RunContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: str, stored: bool
) -> None:
    numbers = toy_steps.make(count=5, seed=1)
    hold = tmp_path / "hold"
    hold.touch()
    monkeypatch.setenv("TOY_HOLD", str(hold))
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(toy_steps.total, numbers=numbers, scale=2.0)
        wait_for(lambda: list(context.workspace.cache.glob("toy-sum/.partial-*/half.txt")))
        (tmp_path / "toylib" / "constants.py").write_text(changed)
        hold.unlink()
        if stored:
            assert running.result().path.exists()
        else:
            with pytest.raises(StepFailed, match=r"^toy-sum: code of .* changed while the run was on; run again"):
                running.result()
    assert bool(list(context.workspace.cache.glob("toy-sum/*"))) is stored


@pytest.mark.parametrize("written", ["1.0\n2.0\n", "half a nu"])
def test_an_input_that_is_written_to_meanwhile_is_neither_kept_nor_blamed(
    context: RunContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: str
) -> None:
    """A recording that is still being copied: what was read of it isn't what the key says, readable or not."""
    folder, hold = tmp_path / "arriving", tmp_path / "hold"
    folder.mkdir()
    (folder / "numbers.txt").write_text("1.0\n")
    given = Artifact.of(folder)
    hold.touch()
    monkeypatch.setenv("TOY_HOLD", str(hold))
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(toy_steps.total, numbers=given, scale=2.0)
        wait_for(lambda: list(context.workspace.cache.glob("toy-sum/.partial-*/half.txt")))
        (folder / "numbers.txt").write_text(written)
        hold.unlink()
        with pytest.raises(InputChanged, match=r"^toy-sum: input numbers \(arriving\) changed while the run was on"):
            running.result()
    assert not list(context.workspace.cache.glob("toy-sum/*"))


def test_arrays_are_refused(context: RunContext) -> None:
    with pytest.raises(TypeError, match="plain JSON values"):
        toy_steps.make(count=5, seed=np.zeros(2))


def test_a_failed_step_says_why_in_one_line_and_stores_nothing(context: RunContext) -> None:
    with pytest.raises(
        StepFailed, match=r"toy-fail: ValueError: broken \(traceback in \.cache/logs/toy-fail"
    ) as failed:
        toy_steps.fail(user=False)
    assert failed.value.exit_code == 1
    passed_on = pickle.loads(pickle.dumps(failed.value))  # a cluster's worker sends it
    assert passed_on.kinds == failed.value.kinds and passed_on.kinds[0] == "builtins.ValueError"
    with pytest.raises(StepFailed, match="wrong column") as wrong:
        toy_steps.fail(user=True)
    assert wrong.value.exit_code == 2
    assert not list(context.workspace.cache.glob("toy-fail/*"))


def test_seeds_differ_by_purpose_and_repeat() -> None:
    assert run_context.seed_for(1, "maps") == run_context.seed_for(1, "maps") != run_context.seed_for(1, "bodies")


def start(root: Path, hold: Path) -> subprocess.Popen[str]:
    environment = {
        **os.environ,
        "TOY_HOLD": str(hold),
        "PYTHONPATH": os.pathsep.join([str(PROJECT), str(HERE), str(root)]),
    }
    command = [sys.executable, str(HERE / "toy_main.py"), str(root)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)


def wait_for(condition, timeout_s: float = 60.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError
        time.sleep(0.05)


def test_kill_9_in_the_middle_then_resume_gives_the_same_hash(context: RunContext, tmp_path: Path) -> None:
    _, undisturbed = run_chain()
    root = tmp_path / "killed"
    toy_library.write_toylib(root)
    hold = tmp_path / "hold"
    hold.touch()
    process = start(root, hold)
    wait_for(lambda: list(root.glob(".cache/toy-sum/.partial-*/half.txt")))
    workers = psutil.Process(process.pid).children()
    process.send_signal(signal.SIGKILL)
    process.wait()
    # The worker doesn't outlive its parent, and its half-written folder is no result.
    wait_for(lambda: not any(worker.is_running() and worker.status() != "zombie" for worker in workers))
    assert workers
    fresh = toy_library.fresh_context(root)
    assert not [path for path in (root / ".cache" / "toy-sum").iterdir() if not path.name.startswith(".partial-")]
    run_context.use(fresh)
    hold.unlink()
    _, resumed = run_chain()
    assert ran(fresh) == {"toy-sum"}
    assert resumed.sha256 == undisturbed.sha256
    assert not list(root.glob(".cache/*/.partial-*"))


@pytest.mark.flow
def test_prefect_caches_paths_and_hashes_and_doubts_them(context: RunContext, prefect: None) -> None:
    from prefect import flow

    from tasks.prefect_task import submit

    states: list[str] = []

    @flow(name="toy-chain")
    def chain() -> list[str]:
        numbers = submit(toy_steps.make, count=5, seed=1)
        total = submit(toy_steps.total, numbers=numbers.result(), scale=2.0)
        digest = total.result().sha256
        states[:] = [numbers.future.state.name, total.future.state.name]
        return [numbers.result().sha256, digest]

    first = chain()
    assert states == ["Completed", "Completed"] and ran(context) == {"toy-make", "toy-sum"}

    fresh = again(context)
    assert chain() == first
    assert states == ["Cached", "Cached"] and ran(fresh) == set()

    # Prefect still has its records; the files they name have changed or are gone.
    numbers = Path(next(context.workspace.cache.glob("toy-make/*/numbers.txt")))
    numbers.write_text(numbers.read_text().replace("1", "2"))
    fresh = again(context)
    assert chain() == first
    assert states == ["Completed", "Cached"] and ran(fresh) == {"toy-make"}

    # A helper constant of an imported module: TASK_SOURCE gave a stale hit here.
    (context.workspace.root / "toylib" / "constants.py").write_text("FACTOR = 4.0\n")
    fresh = again(context)
    assert chain()[1] != first[1]
    assert states == ["Cached", "Completed"] and ran(fresh) == {"toy-sum"}

    records = [path for path in Path(os.environ["PREFECT_LOCAL_STORAGE_PATH"]).rglob("toy-*") if path.is_file()]
    assert records and all(path.stat().st_size < 5000 for path in records)
    assert json.loads(records[0].read_text())
