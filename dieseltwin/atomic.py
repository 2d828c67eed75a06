"""Writing files so that a reader sees the old file or the whole new one, never a part of it.

A file is written under a temporary name in the same folder, flushed to the disk and renamed. What a killed process
leaves behind is named `.partial-*`, which nothing reads.
"""

from __future__ import annotations

import errno
import json
import os
import re
import secrets
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from dieseltwin.errors import InputError

PARTIAL_PREFIX = ".partial-"

_NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_NOT_ALLOWED = {errno.EROFS, errno.EACCES, errno.EPERM}
_NOT_A_PLACE = {errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP}


def write_problem(error: OSError, path: str | Path) -> InputError | None:
    """The user's view of an OSError on writing `path`, or None where the error is not the user's to mend."""
    number = _errno_of(error)
    if number in _NO_SPACE:
        return InputError(f"writing {path}", "no space left on the disk", "room for the results",
                          "free some space or write elsewhere; nothing was written")
    if number in _NOT_ALLOWED:
        return InputError(f"writing {path}", f"{os.strerror(number).lower()}", "a folder you may write to",
                          "choose another --out or change its permissions; nothing was written")
    if number in _NOT_A_PLACE:
        return InputError(f"writing {path}", f"{os.strerror(number).lower()}", "a file name in an existing folder",
                          "check the path; nothing was written")
    return None


def _errno_of(error: OSError) -> int:
    if error.errno is not None:
        return int(error.errno)
    # pyarrow reports some failures as text only
    found = re.search(r"\[errno (\d+)\]", str(error), flags=re.IGNORECASE)
    return int(found.group(1)) if found else 0


@contextmanager
def _user_errors(path: str | Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        problem = write_problem(error, path)
        if problem is None:
            raise
        raise problem from error


def sync_file(path: str | Path) -> None:
    """Flush a written file (or folder entry) to the disk; a full disk shows here at the latest."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _named(path: str | Path) -> Path:
    """The path; an empty text would be the current folder."""
    if isinstance(path, str) and not path.strip():
        raise InputError("where to write", "an empty text", "a file or a folder", "name one")
    return Path(path)


def _refuse_name(path: Path) -> None:
    """Raise OSError for a name that no file can have, and for a link to nowhere or in a circle."""
    try:
        os.lstat(path)
    except FileNotFoundError:
        return
    except ValueError:
        raise OSError(errno.ENOENT, "a zero byte in the name", str(path)) from None
    os.stat(path)


def _partial(path: Path) -> str:
    """A name of its own for what becomes `path`, with its ending; a name has at most 255 bytes, not letters."""
    end = os.fsencode(path.name)[-100:].decode("utf-8", errors="ignore")
    return f"{PARTIAL_PREFIX}{secrets.token_hex(4)}-{end}"


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` (same suffix); on success it becomes `path`, on any error it vanishes.

    Raises:
        InputError: full disk, read-only or missing folder.
    """
    path = _named(path)
    with _user_errors(path):
        _refuse_name(path)
        temporary = path.with_name(_partial(path))
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "is a folder", str(path))
        try:
            yield temporary
            sync_file(temporary)
            os.replace(temporary, path)
            sync_file(path.parent)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: str | Path, owned: Collection[str] = ()) -> Iterator[Path]:
    """Yield an empty temporary folder; on success its files replace those of the same name in `path`.

    All or nothing up to the renames at the end, which need no space: an error before them leaves `path` as it was
    (not even created). Sub-folders are carried over with their files. Files of other names in `path` stay, except below
    `owned`: names (of files or whole sub-folders) in which leftovers of an earlier result would mislead.

    Raises:
        InputError: full disk, read-only folder, `path` is a file.
    """
    path = _named(path)
    with _user_errors(path):
        _refuse_name(path)
        if path.exists() and not path.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "not a folder", str(path))
        created = [p for p in [path, *path.parents] if not p.exists()]
        # inside `path` where it exists: beside it could be another file system, and renames would copy
        home = path if path.exists() else path.parent
        temporary = home / _partial(path)
        try:
            temporary.mkdir(parents=True)
            yield temporary
            files = sorted(p for p in temporary.rglob("*") if p.is_file())
            for file in files:
                sync_file(file)
            for file in files:
                target = path / file.relative_to(temporary)
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(file, target)
            new = {path / file.relative_to(temporary) for file in files}
            for name in owned:
                _remove_others(path / name, new)
            sync_file(path)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            for folder in created:
                _remove_if_empty(folder)
            raise
        shutil.rmtree(temporary, ignore_errors=True)


def _remove_others(path: Path, kept: Collection[Path]) -> None:
    for file in [path] if path.is_file() else list(path.rglob("*")):
        if file.is_file() and file not in kept:
            file.unlink()


def check_writable(path: str | Path) -> None:
    """Make sure that a file can be created beside `path`, before hours of work are spent on what goes into it.

    Raises:
        InputError: missing or read-only folder, full disk, or `path` is a folder.
    """
    with suppress(_OnlyTrying), atomic_path(path) as temporary:
        temporary.touch()
        raise _OnlyTrying


def check_folder(path: str | Path) -> None:
    """Make sure that files can be put into the folder `path`, which is made later if it isn't there.

    Raises:
        InputError: full disk, read-only folder, or `path` is a file.
    """
    with suppress(_OnlyTrying), atomic_folder(path):
        raise _OnlyTrying


class _OnlyTrying(Exception):
    """Ends `check_writable` and `check_folder` before the rename."""


def _remove_if_empty(folder: Path) -> None:
    try:
        folder.rmdir()
    except OSError:
        return


def write_bytes(path: str | Path, content: bytes) -> Path:
    """Write `content` to `path` atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
    return Path(path)


def write_text(path: str | Path, content: str) -> Path:
    """Write text in UTF-8 to `path` atomically."""
    return write_bytes(path, content.encode("utf-8"))


def write_json(path: str | Path, content: Any) -> Path:
    """Write strict JSON (NaN is refused), indented, atomically."""
    return write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")
