"""Where compiled kernels are kept: a folder of this user's own, named by the sources that the kernels come from."""

from __future__ import annotations

import atexit
import fcntl
import hashlib
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from dieseltwin.atomic import write_json
from dieseltwin.errors import InputError
from dieseltwin.paths import xdg_cache_folder

PACKAGE = Path(__file__).resolve().parent
_CHECKSUMS = "checksums.json"
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def kernel_folder(sources: Iterable[Path], versions: Iterable[str]) -> Path:
    """A folder for the kernels compiled from the Python files `sources`; it belongs to this user alone.

    Kernels are pickles, which run what they hold when they are loaded: a folder that another user owns or may write to
    is never used. Where no place can be written to, a temporary folder serves this process and is removed with it.

    Args:
        sources: numba's own check sees a kernel's file only, and would reuse one whose equations changed elsewhere.
        versions: of what compiles.
    """
    digest = hashlib.sha256(" ".join(versions).encode())
    for source in sources:
        digest.update(source.name.encode() + source.read_bytes())
    name = digest.hexdigest()[:16]
    named = os.environ.get("NUMBA_CACHE_DIR")  # who names a folder answers for it
    places = [(Path(named), True)] if named else []
    for place, trusted in [*places, *((place, False) for place in _places())]:
        folder = place / name
        if (trusted or _own(place)) and _own(folder):
            drop_broken(folder)
            return folder
    scratch = tempfile.mkdtemp(prefix="dieseltwin-")
    atexit.register(shutil.rmtree, scratch, ignore_errors=True)
    return Path(scratch)


def _places() -> Iterator[Path]:
    """In a checkout, in the user's cache, among temporary files."""
    if (PACKAGE.parent / "pyproject.toml").is_file():
        yield PACKAGE.parent / ".numba_cache"
    with suppress(RuntimeError):  # this user has no home
        yield xdg_cache_folder()
    yield Path(tempfile.gettempdir()) / f"dieseltwin-{os.getuid()}"


def _own(folder: Path) -> bool:
    """Make a folder, or see whether it is this user's own and nobody else's to write to; a link isn't followed."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
            return False
        if found.st_mode & _WRITABLE_BY_OTHERS:
            folder.chmod(found.st_mode & ~_WRITABLE_BY_OTHERS)
    except OSError:
        return False
    return os.access(folder, os.R_OK | os.W_OK | os.X_OK)


def drop_broken(folder: Path) -> None:
    """Remove kernels that a power cut left half-written, and those whose bytes a disk has changed: they are compiled
    again (numba writes them and renames, so that a file that is new has another date). A kernel's checksum is taken
    when a process first finds it, that is from its second use on."""
    known = _checksums(folder / _CHECKSUMS)
    found: dict[str, list[object]] = {}
    for path in (*folder.rglob("*.nbi"), *folder.rglob("*.nbc")):
        with suppress(OSError):  # another process removed it
            written, content = path.stat().st_mtime_ns, path.read_bytes()
            name, seen = str(path.relative_to(folder)), [written, hashlib.sha256(content).hexdigest()]
            before = known.get(name, seen)
            if not content.endswith(b".") or (before[0] == written and before != seen):  # what ends a pickle
                path.unlink()
            else:
                found[name] = seen
    if found != known:
        with suppress(InputError):  # a full disk: no kernel can be kept there either
            write_json(folder / _CHECKSUMS, found)


@contextmanager
def alone(lock: Path) -> Iterator[None]:
    """While no other process is inside with the same file; without waiting where there can't be one. A process that is
    killed lets go of it."""
    with ExitStack() as opened:
        with suppress(OSError):
            fcntl.flock(opened.enter_context(lock.open("w")), fcntl.LOCK_EX)
        yield


def _checksums(path: Path) -> dict[str, list[object]]:
    """Date and SHA-256 of every kernel that was there at the last start; none where that can't be read."""
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
        return {str(name): [int(seen[0]), str(seen[1])] for name, seen in known.items()}
    except (OSError, ValueError, TypeError, AttributeError, IndexError):
        return {}
