"""Files that the user names: found, readable, and no folder, before anything is made of them; the cache's folder."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from pathlib import Path

from dieseltwin.errors import InputError

_NOT_THERE = {errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG}

YAML_ENDINGS = (".yaml", ".yml")
"""Of engine files and channel maps."""


def refuse_unreadable(path: str | Path | None, allowed: str = "a recording") -> None:
    """Refuse a path that no content can be read from; None (an option that wasn't given) passes.

    Args:
        allowed: what was expected there, for the message.

    Raises:
        InputError: nothing there (or a link to nowhere), a folder, a pipe or device, no permission, an impossible name.
    """
    if path is None:
        return
    try:
        mode = os.stat(path).st_mode
    except ValueError:  # a zero byte
        raise InputError(repr(str(path)), "an impossible name", allowed, "check the path") from None
    except OSError as error:
        missing = error.errno in (errno.ENOENT, errno.ENOTDIR)
        got = "no such file" if missing else (error.strerror or str(error)).lower()
        do = "check the path" if error.errno in _NOT_THERE else "change its permissions"
        raise InputError(str(path), _link(path) or got, allowed, do) from None
    if stat.S_ISDIR(mode):
        raise InputError(str(path), "a folder", allowed, "name a file")
    if not stat.S_ISREG(mode):
        raise InputError(str(path), "a pipe or a device", f"{allowed} in a regular file", "write it to a file first")
    if not os.access(path, os.R_OK):
        raise InputError(str(path), "permission denied", "a file you may read", "change its permissions")


def _link(path: str | Path) -> str:
    """A link to nowhere in words, "" for anything else."""
    try:
        return f"a link to {os.readlink(path)}, which isn't there"
    except OSError:
        return ""


def same_file(a: str | Path, b: str | Path) -> bool:
    """Whether two paths are one file, by whatever links."""
    try:
        return os.path.samefile(a, b)
    except (OSError, ValueError):
        return Path(a) == Path(b)


def file_sha256(path: str | Path) -> str:
    """SHA-256 of a file's bytes as hex digits; the file is read block by block."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def xdg_cache_folder() -> Path:
    """This program's folder in the user's cache: in XDG_CACHE_HOME, else in ~/.cache.

    Raises:
        RuntimeError: the user has no home.
    """
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "dieseltwin"
