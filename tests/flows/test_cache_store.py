"""Results are whole or absent, and believed only while they agree with their manifest."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tasks import store as store_module
from tasks.store import Artifact, Store, content_hash, host, replace_folder, scratch
from tasks.workspace import PROJECT


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / ".cache")


def put(store: Store, key: str = "k1", text: str = "hello") -> Artifact:
    with store.writing("step", key, {"seed": 1}) as out:
        (out / "sub").mkdir()
        (out / "sub" / "a.txt").write_text(text)
        (out / "runtime.json").write_text(json.dumps({"pid": os.getpid(), "noise": os.urandom(4).hex()}))
    found = store.find("step", key)
    assert found is not None
    return found


def test_a_result_is_found_with_a_hash_of_its_contents_alone(store: Store) -> None:
    first, second, other = put(store, "k1"), put(store, "k2"), put(store, "k3", "other")
    assert first.sha256 == second.sha256 != other.sha256
    assert content_hash(first.path) == first.sha256
    assert store.manifest(first)["provenance"] == {"seed": 1}


@pytest.mark.parametrize("victim", ["sub/a.txt", "runtime.json", "manifest.json"])
def test_one_flipped_byte_is_a_miss(store: Store, victim: str) -> None:
    path = put(store).path / victim
    data = bytearray(path.read_bytes())
    place = data.rindex(b'"') - 1 if victim.endswith("json") else 2
    if victim == "manifest.json":
        place = data.index(b'"sub/a.txt": "') + 20
    data[place] = data[place] ^ 1
    path.write_bytes(data)
    assert store.find("step", "k1") is None


def test_a_missing_an_additional_and_a_truncated_file_are_misses(store: Store) -> None:
    for spoil in (
        lambda folder: (folder / "sub" / "a.txt").unlink(),
        lambda folder: (folder / "extra.txt").write_text("x"),
        lambda folder: (folder / "manifest.json").write_text("{"),
    ):
        spoil(put(store).path)
        assert store.find("step", "k1") is None


def test_an_interrupted_write_leaves_nothing_that_is_found(store: Store) -> None:
    with pytest.raises(KeyboardInterrupt), store.writing("step", "k1", {}) as out:
        (out / "a.txt").write_text("half")
        raise KeyboardInterrupt
    assert store.find("step", "k1") is None
    assert not list((store.root / "step").iterdir())


def test_a_bad_result_makes_way_and_a_concurrent_good_one_stays(store: Store) -> None:
    (put(store).path / "sub" / "a.txt").write_text("spoilt")
    assert put(store).still_agrees()
    with store.writing("step", "k1", {}) as out:
        (out / "late.txt").write_text("the same work, done twice")
    found = store.find("step", "k1")
    assert found is not None and not (found.path / "late.txt").exists()


def test_temporary_folders_of_dead_processes_are_swept(store: Store) -> None:
    dead = store.root / "step" / f".partial-k9-{host()}-999999999-abcd"
    alive = store.root / "step" / f".partial-k9-{host()}-{os.getpid()}-abcd"
    for folder in (dead, alive):
        folder.mkdir(parents=True)
    put(store)
    assert not dead.exists() and alive.exists()


def test_what_a_killed_step_was_working_on_is_swept_with_its_folder(store: Store, tmp_path: Path) -> None:
    program = (
        "import os, signal, sys\n"
        "from pathlib import Path\n"
        "from tasks.store import Store, scratch\n"
        "with Store(Path(sys.argv[1])).writing('step', 'k1', {}) as out, scratch(out) as folder:\n"
        "    (folder / 'recording.csv').write_text('secret')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(PROJECT), "TMPDIR": str(tmp_path / "elsewhere")}
    (tmp_path / "elsewhere").mkdir()
    subprocess.run([sys.executable, "-c", program, str(store.root)], env=environment, check=False)
    assert not list((tmp_path / "elsewhere").iterdir())
    assert list(store.root.glob("step/.partial-*/.scratch-*/recording.csv"))
    store.prune(3600.0)  # at the end of the next run, whatever its steps
    assert not list(store.root.glob("step/.partial-*"))
    with store.writing("step", "k3", {}) as out, scratch(out) as folder:
        (folder / "recording.csv").write_text("secret")
    found = store.find("step", "k3")
    assert found is not None and not list(found.path.rglob("recording.csv"))


def test_what_another_machine_writes_is_not_swept(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Process numbers mean nothing on another machine of a cluster, which shares the folder."""
    with monkeypatch.context() as other:
        other.setattr(store_module.platform, "node", lambda: "other-machine.local")
        other.setattr(store_module.os, "getpid", lambda: 999_999_999)
        writing = store.writing("step", "k9", {})
        out = writing.__enter__()
    published = store.root / "out.other_machine_local.999999999.partial"
    published.mkdir()
    (out / "a.txt").write_text("half")
    put(store)
    replace_folder(store.root / "out", {"a": out / "a.txt"})
    assert (out / "a.txt").exists() and published.exists()
    writing.__exit__(None, None, None)
    assert store.find("step", "k9") is not None


def test_replace_folder_holds_exactly_the_files_and_keeps_the_old_one_on_failure(tmp_path: Path) -> None:
    source = tmp_path / "a"
    source.write_text("new")
    target = tmp_path / "out"
    target.mkdir()
    (target / "old.txt").write_text("old")
    with pytest.raises(FileNotFoundError):
        replace_folder(target, {"a": source, "b": tmp_path / "missing"})
    assert [path.name for path in target.iterdir()] == ["old.txt"]
    replace_folder(target, {"x/a": source})
    assert [path.relative_to(target).as_posix() for path in target.rglob("*") if path.is_file()] == ["x/a"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "out"]


def test_prune_removes_what_was_not_asked_for(store: Store) -> None:
    old, new = put(store, "k1").path, put(store, "k2").path
    os.utime(old, (0, 0))
    assert store.prune(3600.0) == 1
    assert not old.exists() and new.exists()
    assert sorted(path.name for path in old.parent.iterdir()) == ["k2"]


def test_prune_removes_old_temporary_folders_whoever_left_them(store: Store) -> None:
    names = (".partial-k8-elsewhere-1-abcd", ".partial-k9-elsewhere-1-abcd")
    left, busy = (store.root / "step" / name for name in names)
    for folder in (left, busy):
        folder.mkdir(parents=True)
    os.utime(left, (0, 0))
    assert store.prune(3600.0) == 0
    assert not left.exists() and busy.exists()


@pytest.mark.parametrize("before", ["stat", "rename"])
def test_two_runs_prune_together(store: Store, monkeypatch: pytest.MonkeyPatch, before: str) -> None:
    """The other run removes a folder just before this one looks at it, or renames it."""
    first, second = put(store, "k1").path, put(store, "k2").path
    for folder in (first, second):
        os.utime(folder, (0, 0))
    plain = getattr(Path, before)

    def late(path: Path, *arguments, **options):
        if path == first and path.exists():
            shutil.rmtree(path)
        return plain(path, *arguments, **options)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "exists", lambda path: os.path.lexists(path))
        patched.setattr(Path, before, late)
        assert store.prune(3600.0) == 1
    assert not first.exists() and not second.exists()
