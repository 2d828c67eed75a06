"""Where the page keeps things, and how much of anything it takes."""

from __future__ import annotations

import fcntl
import os
import re
import secrets
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from dieseltwin.errors import InputError

MEGABYTE = 1_000_000
MOST_RECORDINGS = 20  # that one analysis takes
GIGABYTE = 1_000_000_000
NEW_ID = 8  # random bytes: 2**64 names can't be guessed
_ID = re.compile(r"[0-9a-f]{16}")
LONGEST_NAME = 100


@dataclass(frozen=True)
class Limits:
    """What one server takes.

    Attributes:
        upload_mb: largest file.
        folder_gb: of everything that is kept.
        workers: analyses at a time.
        memory_gb: of one worker process, address space included.
        look_s, analysis_s: a worker that takes longer is ended [s].
    """

    upload_mb: int = 500
    folder_gb: int = 20
    workers: int = 1
    memory_gb: int = 8
    look_s: float = 300.0
    analysis_s: float = 3600.0


@dataclass(frozen=True)
class Workplace:
    """Folder, limits and names of one server.

    Attributes:
        folder: of everything that is kept.
        limits: see `Limits`.
        hosts: names under which a browser may call it, besides localhost and addresses of numbers.
    """

    folder: Path
    limits: Limits = Limits()
    hosts: tuple[str, ...] = ()

    @property
    def recordings(self) -> Path:
        """A folder for each recording."""
        return self.folder / "recordings"

    @property
    def engines(self) -> Path:
        """A folder for each engine."""
        return self.folder / "engines"

    @property
    def jobs(self) -> Path:
        """A folder for each job."""
        return self.folder / "jobs"

    def prepare(self) -> None:
        """Make the folders, for this user alone.

        Raises:
            InputError: a place that can't be written to.
        """
        try:
            for folder in (self.folder, self.recordings, self.engines, self.jobs):
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--folder {self.folder}", (error.strerror or str(error)).lower(),
                             "a folder you may write to", "choose another") from None

    def lock(self) -> IO[str]:
        """Hold the folder for this process; released when it ends, however it does.

        Raises:
            InputError: another server works there.
        """
        handle = (self.folder / ".lock").open("w")
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            handle.close()
            raise InputError(f"--folder {self.folder}", "another server works there", "a folder of its own",
                             "choose another, or use the one that runs") from None
        return handle

    def used_bytes(self) -> int:
        """Size of everything that is kept."""
        total = 0
        for folder, _, names in os.walk(self.folder):
            for name in names:
                try:
                    total += os.lstat(os.path.join(folder, name)).st_size
                except OSError:  # removed meanwhile
                    continue
        return total

    def room_for(self, size: int) -> bool:
        """Whether a file of that many bytes fits: into what may be kept, and twice into the free disk."""
        free = shutil.disk_usage(self.folder).free
        return self.used_bytes() + size <= self.limits.folder_gb * GIGABYTE and 2 * size <= free


def new_id() -> str:
    """A name for something that is kept."""
    return secrets.token_hex(NEW_ID)


def is_id(text: str) -> bool:
    """Whether a text could be one of `new_id`; nothing else ever becomes part of a path."""
    return _ID.fullmatch(text) is not None


def shown_name(text: str | None) -> str:
    """A browser's file name for people: its last part, printable, not too long. It never names a file here."""
    last = re.split(r"[/\\]", text or "")[-1]
    clean = "".join(c for c in last if c.isprintable()).strip()
    return clean[:LONGEST_NAME] or "without a name"
