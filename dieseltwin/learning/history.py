"""History of one engine: a row a recording in an SQLite file, each with its own checksum.

A recording is added in one transaction: a kill at any moment loses at most the one being added, and one that is there
already stays as it is. The history belongs to one learned engine file: its scores are in that file's coordinates.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from dieseltwin.atomic import check_folder
from dieseltwin.errors import InputError
from dieseltwin.learning.alarm import Array, Score, Shown
from dieseltwin.learning.sketches import shared
from dieseltwin.recordings.shared_rows import MOST_SHARED
from dieseltwin.version import __version__

SCHEMA = 1
FILE_NAME = "history.sqlite"
_APPLICATION = 0x64_74_77_68  # "dtwh": what `PRAGMA application_id` of our files says
_WAIT_S = 60.0
_NEW = "keep a copy, and add the recordings to a new folder"
_TABLES = (
    "CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT",
    "CREATE TABLE recordings (sha256 TEXT PRIMARY KEY, date TEXT NOT NULL, hours REAL NOT NULL, p_amb_pa REAL NOT NULL,"
    " t_amb_k REAL NOT NULL, verdict TEXT NOT NULL, row TEXT NOT NULL, checksum TEXT NOT NULL) STRICT",
)

_TAKEN_OUT = (  # made with the first recording that is taken out: most histories have none
    "CREATE TABLE IF NOT EXISTS taken_out (sha256 TEXT PRIMARY KEY, row TEXT NOT NULL, day TEXT NOT NULL,"
    " reason TEXT NOT NULL, checksum TEXT NOT NULL) STRICT"
)

HEALTHY, AND, OR = "healthy", " + ", " or "
"""A verdict without an effect, what stands between those of one, and between names that can't be told apart."""


@dataclass(frozen=True)
class Entry:
    """One recording of a history.

    Attributes:
        sha256, path: of the file; date: of its first row (ISO 8601, UTC); date_from: how that is known.
        hours: of running engine [h].
        p_amb_pa, t_amb_k: ambient [Pa], [K].
        health, health_covariance: (4,) and (4, 4) in the order of `HEALTH`.
        since, since_std: (4,) health over that of the reference [-].
        scores: of every effect.
        verdict: names of what the recording shows by itself, "healthy" without any; sentence: the same in words.
        rows_sha256: of what is in the file, "" in histories from before it was kept.
        rows_sketch: a sample of its rows, by which shared driving is noticed (`sketches.sketch`); "" likewise.
        sizes: size and standard deviation of each effect of the verdict, refitted beside everything else [unit of the
            effect]; none in histories from before they were kept. Scores are linear, which a strong fault bends.
    """

    sha256: str
    path: str
    date: str
    date_from: str
    hours: float
    p_amb_pa: float
    t_amb_k: float
    health: Array
    health_covariance: Array
    since: Array
    since_std: Array
    scores: tuple[Score, ...]
    verdict: str
    sentence: str
    rows_sha256: str = ""
    rows_sketch: str = ""
    sizes: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def shown(self) -> Shown:
        """What the recording shows by itself; nothing where it is healthy."""
        names = () if self.verdict == HEALTHY else tuple(self.verdict.replace(AND, OR).split(OR))
        return Shown(names, self.sizes)

    @property
    def moment(self) -> datetime:
        """The date."""
        return datetime.fromisoformat(self.date).astimezone(UTC)


@dataclass(frozen=True)
class TakenOut:
    """A recording that was in the history and doesn't count any more.

    Attributes:
        entry: as it was added; day: when it was taken out (ISO 8601, UTC); reason: why, in the words of who did it.
    """

    entry: Entry
    day: str
    reason: str

    def __str__(self) -> str:
        return f"{self.entry.path}, on {self.day[:10]}: {self.reason}"


class History:
    """The history in a folder; where there is none, the first recording that is added makes it.

    Args:
        folder: holds `history.sqlite`.
        engine_sha256: of what the engine's file knows; None reads a history whosever it is.

    Raises:
        InputError: no history to read, one of another engine or version, a file that is damaged.
    """

    def __init__(self, folder: str | Path, engine_sha256: str | None = None) -> None:
        self.folder = Path(folder)
        self.path = self.folder / FILE_NAME
        self._engine_sha256 = engine_sha256
        if self._begun():
            self._check()
        elif engine_sha256 is None:
            raise InputError(str(self.path), "no such file", "a folder with a history", "add a recording first")
        else:
            check_folder(self.folder)

    def _begun(self) -> bool:
        """Whether there is a history."""
        return self.path.is_file()

    def _make(self) -> None:
        before = self.folder.exists()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(str(self.folder), error.strerror or error, "a folder you may write to",
                             "choose another --history") from None
        made = self.path.with_name(f".{FILE_NAME}.{os.getpid()}.new")
        made.unlink(missing_ok=True)  # of a process of the same number that was killed
        try:
            with self._opened(made) as connection:
                for table in _TABLES:
                    connection.execute(table)
                about = {"schema": str(SCHEMA), "engine_sha256": str(self._engine_sha256), "code_version": __version__}
                connection.executemany("INSERT INTO about VALUES (?, ?)", about.items())
                connection.execute(f"PRAGMA application_id = {_APPLICATION}")
            try:
                os.link(made, self.path)  # whole or not at all: an empty history is a damaged one
            except FileExistsError:
                pass  # another process was first
            except OSError:  # a file system without links
                if not self.path.exists():
                    made.rename(self.path)
        finally:  # a full disk, too, leaves nothing behind
            made.unlink(missing_ok=True)
            if not before and not self._begun():
                with suppress(OSError):  # another process has begun something there
                    self.folder.rmdir()

    @contextmanager
    def _opened(self, path: Path | None = None) -> Iterator[sqlite3.Connection]:
        """One transaction, whole or not at all."""
        try:
            with closing(sqlite3.connect(path or self.path, timeout=_WAIT_S, isolation_level=None)) as connection:
                connection.text_factory = _text
                connection.execute("PRAGMA synchronous = FULL")
                connection.execute("BEGIN IMMEDIATE")
                try:
                    yield connection
                    connection.execute("COMMIT")
                except BaseException:
                    connection.rollback()
                    raise
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode == sqlite3.SQLITE_ERROR:  # of a statement that every sound history answers
                raise self._damaged(str(error)) from None
            raise InputError(str(self.path), str(error), "a history that can be written to",
                             "check the disk and the folder's permissions") from None
        except sqlite3.DatabaseError as error:
            raise self._damaged(str(error)) from None

    def _damaged(self, what: str) -> InputError:
        return InputError(str(self.path), what, "a history as `dieseltwin watch add` wrote it", _NEW)

    def _check(self) -> None:
        if not self.path.stat().st_size:
            raise self._damaged("an empty file")
        with self._opened() as connection:
            if connection.execute("PRAGMA application_id").fetchone()[0] != _APPLICATION:
                raise self._damaged("an SQLite file of something else")
            sound = connection.execute("PRAGMA integrity_check").fetchone()[0]
            if sound != "ok":
                raise self._damaged(str(sound).splitlines()[0])
            about = dict(connection.execute("SELECT key, value FROM about"))
        if about.get("schema") != str(SCHEMA):
            raise InputError(str(self.path), f"schema {about.get('schema')}", f"schema {SCHEMA}", _NEW)
        if self._engine_sha256 is not None and about.get("engine_sha256") != self._engine_sha256:
            raise InputError(
                str(self.path), "a history of another engine file, or of this one before it learned more",
                "the file that the history was begun with", "begin a new --history and add the recordings again",
            )  # fmt: skip

    def holds(self, sha256: str) -> bool:
        """Whether a recording is there already, by the hash of a file or of its rows."""
        if not self._begun():
            return False
        with self._opened() as connection:
            return _holds(connection, sha256)

    def refuse_shared(self, rows_sketch: str, where: str) -> None:
        """Refuse a recording that is in part another of the history: a half-copied file beside the whole one.

        Raises:
            InputError: more than a little of its rows are in another.
        """
        if self._begun():
            with self._opened() as connection:
                self._refuse_shared(connection, rows_sketch, where)

    def _refuse_shared(self, connection: sqlite3.Connection, rows_sketch: str, where: str) -> None:
        asked = "SELECT json_extract(row, '$.rows_sketch'), json_extract(row, '$.path') FROM recordings ORDER BY date"
        for known, path in connection.execute(asked):
            if known and (share := shared(rows_sketch, known)) > MOST_SHARED:
                got = f"driving of {path} in the history ({100 * share:.0f} % of the shorter one's rows)"
                raise InputError(where, got, "recordings that share no driving",
                                 f"leave it out, or begin a new --history without {path}")

    def add(self, entry: Entry) -> bool:
        """Add a recording; False where it is there already, which stays as it is.

        Raises:
            InputError: as `refuse_shared`, or a disk that takes nothing.
        """
        if not self._begun():
            self._make()
            self._check()
        with self._opened() as connection:
            if _holds(connection, entry.sha256) or (entry.rows_sha256 and _holds(connection, entry.rows_sha256)):
                return False
            hashes = (entry.sha256, entry.rows_sha256)
            _refuse_taken_out(connection, hashes, entry.path, entry.moment)
            self._refuse_shared(connection, entry.rows_sketch, entry.path)
            for taken in _among_taken_out(connection, hashes):
                connection.execute("DELETE FROM taken_out WHERE sha256 = ?", (taken.entry.sha256,))
            _insert(connection, entry)
            return True

    def refuse_taken_out(self, hashes: Iterable[str], where: str, date: datetime | None = None) -> None:
        """Refuse a recording that was taken out, by the hash of a file or of its rows; not one of another date by now.

        Raises:
            InputError: it was, when, and why.
        """
        if self._begun():
            with self._opened() as connection:
                _refuse_taken_out(connection, hashes, where, date)

    def take_out(self, sha256: str, reason: str) -> None:
        """Let a recording count no more. It stays in the file, with the day and the reason."""
        with self._opened() as connection:
            row = connection.execute("SELECT row FROM recordings WHERE sha256 = ?", (sha256,)).fetchone()
            if row is None:  # another process was first
                return
            connection.execute(_TAKEN_OUT)
            told = (*row, datetime.now(UTC).isoformat(timespec="seconds"), reason)
            connection.execute("INSERT INTO taken_out VALUES (?, ?, ?, ?, ?)", (sha256, *told, _checksum(*told)))
            connection.execute("DELETE FROM recordings WHERE sha256 = ?", (sha256,))

    def put_back(self, taken: TakenOut) -> None:
        """Let a recording count again.

        Raises:
            InputError: as `refuse_shared`: another one with its driving was added since.
        """
        with self._opened() as connection:
            if not _holds(connection, taken.entry.sha256):  # else another process was first
                self._refuse_shared(connection, taken.entry.rows_sketch, taken.entry.path)
                _insert(connection, taken.entry)
            connection.execute("DELETE FROM taken_out WHERE sha256 = ?", (taken.entry.sha256,))

    def taken_out(self) -> tuple[TakenOut, ...]:
        """Recordings that were taken out, by the day of that.

        Raises:
            InputError: a row that isn't what was written.
        """
        if not self._begun():
            return ()
        with self._opened() as connection:
            rows = _rows_taken_out(connection)
        out = []
        for sha256, row, day, reason, checksum in rows:
            entry = from_json(row) if _checksum(row, day, reason) == checksum else None
            if entry is None or entry.sha256 != sha256:
                raise self._damaged(f"the row of {sha256[:12]}, taken out, is not as it was written")
            out.append(TakenOut(entry, day, reason))
        return tuple(out)

    def entries(self) -> tuple[Entry, ...]:
        """All recordings by date, whatever the order in which they were added.

        Raises:
            InputError: a row that isn't what was written.
        """
        if not self._begun():
            return ()
        with self._opened() as connection:
            rows = connection.execute("SELECT sha256, row, checksum FROM recordings ORDER BY date, sha256").fetchall()
        out = []
        for sha256, row, checksum in rows:
            entry = from_json(row) if _checksum(row) == checksum else None
            if entry is None or entry.sha256 != sha256:
                raise self._damaged(f"the row of {sha256[:12]} is not as it was written")
            out.append(entry)
        return tuple(out)


def _holds(connection: sqlite3.Connection, sha256: str) -> bool:
    asked = "SELECT 1 FROM recordings WHERE sha256 = ?1 OR json_extract(row, '$.rows_sha256') = ?1"
    return connection.execute(asked, (sha256,)).fetchone() is not None


def _insert(connection: sqlite3.Connection, entry: Entry) -> None:
    row = to_json(entry)
    values = (entry.sha256, entry.date, entry.hours, entry.p_amb_pa, entry.t_amb_k, entry.verdict, row, _checksum(row))
    connection.execute("INSERT INTO recordings VALUES (?, ?, ?, ?, ?, ?, ?, ?)", values)


def _rows_taken_out(connection: sqlite3.Connection) -> list[tuple[str, str, str, str, str]]:
    if connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'taken_out'").fetchone() is None:
        return []
    asked = "SELECT sha256, row, day, reason, checksum FROM taken_out ORDER BY day, sha256"
    return connection.execute(asked).fetchall()


def _among_taken_out(connection: sqlite3.Connection, hashes: Iterable[str]) -> list[TakenOut]:
    asked = {sha256 for sha256 in hashes if sha256}
    known = [(from_json(row), day, reason) for _, row, day, reason, _ in _rows_taken_out(connection)]
    return [TakenOut(entry, day, reason) for entry, day, reason in known
            if entry is not None and asked & {entry.sha256, entry.rows_sha256}]  # fmt: skip


def _refuse_taken_out(
    connection: sqlite3.Connection, hashes: Iterable[str], where: str, date: datetime | None
) -> None:
    for taken in _among_taken_out(connection, hashes):
        if date is None or date.astimezone(UTC) == taken.entry.moment:
            raise InputError(where, f"what was taken out of the history ({taken})", "other recordings",
                             "leave it out, or let it count again: `dieseltwin watch restore`")


def _text(raw: bytes) -> str:
    """What isn't text any more is told by its checksum."""
    return raw.decode(errors="replace")


def _checksum(*parts: str) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def to_json(entry: Entry) -> str:
    """An entry as one line of JSON."""
    content = asdict(entry)
    content["scores"] = [{**asdict(score), "shared": _packed(score.shared)} for score in entry.scores]
    for name in _ARRAYS:
        content[name] = np.asarray(content[name]).tolist()
    return json.dumps(content, sort_keys=True, allow_nan=False)


_ARRAYS = ("health", "health_covariance", "since", "since_std")


def _packed(values: Array) -> str:
    return base64.b64encode(np.asarray(values, dtype="<f8").tobytes()).decode()


def _unpacked(text: str) -> Array:
    return np.frombuffer(base64.b64decode(text), dtype="<f8").copy()


def from_json(row: str) -> Entry | None:
    """An entry as `to_json` wrote it; None for what isn't one."""
    try:
        content: dict[str, Any] = json.loads(row)
        scores = tuple(Score(**{**score, "shared": _unpacked(score["shared"])}) for score in content["scores"])
        arrays = {name: np.array(content[name]) for name in _ARRAYS}
        return Entry(**{**content, **arrays, "scores": scores})
    except (ValueError, KeyError, TypeError):
        return None

