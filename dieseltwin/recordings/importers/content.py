"""Which format a file is in, by its first bytes; the ending only decides where the content cannot."""

from __future__ import annotations

import gzip
import re
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dieseltwin.errors import InputError
from dieseltwin.paths import refuse_unreadable

HEAD_BYTES = 16384
LARGEST_UNPACKED = 4_000_000_000  # bytes of text inside a gzip file: a bigger one would not fit into memory as a table
READABLE = "CSV, Parquet, Excel (.xlsx), MATLAB (.mat), MDF (.mf4, .mdf, .dat), CAN traces (candump, .asc, .blf, .trc)"

# Endings of recordings: the content decides what a file is, except for MATLAB 4.
ENDINGS = (".csv", ".txt", ".tsv", ".parquet", ".pq", ".xlsx", ".mat", ".mf4", ".mdf", ".dat", ".asc", ".blf", ".trc",
           ".log", ".gz", ".zip", ".xls")  # fmt: skip

# first bytes -> our name of the format
_MAGIC: tuple[tuple[bytes, str], ...] = (
    (b"PAR1", "parquet"),
    (b"MDF ", "mdf"),
    (b"UnFinMF ", "mdf"),
    (b"LOGG", "blf"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
    (b"MATLAB 7.3 MAT-file", "hdf5"),
    (b"MATLAB 5.0 MAT-file", "matlab"),
)
# what people give by mistake: first bytes -> (what it is, what to do)
_STRANGERS: tuple[tuple[bytes, str, str], ...] = (
    (b"%PDF", "a PDF document", "export the numbers behind it as CSV"),
    (b"\x89PNG", "a picture", "give the recording itself"),
    (b"\xff\xd8\xff", "a picture", "give the recording itself"),
    (b"SQLite format 3", "an SQLite database", "export the table as CSV"),
    (b"version https://git-lfs", "a Git LFS pointer, not the file itself", "run `git lfs pull`"),
    (
        b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1",
        "an old Excel (.xls) or a password-protected workbook",
        "save it as .xlsx without a password, or as CSV",
    ),
    (b"Rar!", "a RAR archive", "unpack it first"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive", "unpack it first"),
    (b"BZh", "a bzip2 archive", "unpack it first"),
    (b"\xfd7zXZ", "an xz archive", "unpack it first"),
    (b"(\xb5/\xfd", "a Zstandard archive", "unpack it first"),
)
_TEXT_STRANGERS: tuple[tuple[str, str, str], ...] = (
    (r"\s*<(!doctype\s+html|html)", "a web page (a login page saved in place of the file?)", "download the file again"),
    (r"\s*<\?xml", "XML", "export the table as CSV"),
    (r"\s*[\[{]", "JSON", "export the table as CSV or Parquet"),
    (
        r"\s*VERSION\s+\"|(.*\n)*?BO_ \d+ \w+\s*:",
        "a DBC file, which describes a bus and holds no readings",
        "give the trace, and name this file in its channel map (dbc: ...)",
    ),
)
_CANDUMP_LOG = re.compile(r"^\s*\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]{1,8}#", re.MULTILINE)
_CANDUMP_TEXT = re.compile(r"^\s*(\(\d[^)]*\)\s+)?\S*can\S*\s+(?:[TRX-]+\s+)?[0-9A-Fa-f]{3,8}\s+\[\d+\]", re.MULTILINE)
_ASC = re.compile(r"^\s*base\s+(hex|dec)\s+timestamps\s+(absolute|relative)", re.MULTILINE | re.IGNORECASE)
_TRC = re.compile(r"^;\$FILEVERSION=", re.MULTILINE)


@dataclass(frozen=True)
class Content:
    """A file by its content.

    Attributes:
        format: "csv", "parquet", "excel", "matlab", "hdf5", "mdf", "blf", "candump", "asc" or "trc".
        data: the bytes inside a gzip file; None where the file itself is to be read.
    """

    format: str
    data: bytes | None = None

    def bytes_of(self, path: Path) -> bytes:
        """The content as bytes, unpacked."""
        return path.read_bytes() if self.data is None else self.data


def recognise(path: Path) -> Content:
    """Find the format of a file.

    Raises:
        InputError: no such file, an empty one, or one that holds no recording.
    """
    refuse_unreadable(path, "a recording: " + READABLE)
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise InputError(str(path), error.strerror or error, "a file you may read", "check the file") from None
    if not head:
        raise InputError(str(path), "an empty file", "a header and rows", "record again or copy it again")
    if head.startswith(b"\x1f\x8b"):
        data = _unpacked(path)
        inner = _format_of(path, data[:HEAD_BYTES])
        if inner not in ("csv", "candump", "asc", "trc"):
            raise InputError(
                str(path), f"a gzip file with {inner} inside", "gzip around text (CSV, a CAN trace)", "unpack it first"
            )
        return Content(inner, data)
    return Content(_format_of(path, head))


def _unpacked(path: Path) -> bytes:
    try:
        with gzip.open(path) as file:
            data = file.read(LARGEST_UNPACKED + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(
            str(path), f"no readable gzip ({error})", "a whole gzip file", "copy it again (is it truncated?)"
        ) from None
    if not data:
        raise InputError(str(path), "nothing inside the gzip file", "a header and rows", "record again")
    if len(data) > LARGEST_UNPACKED:
        raise InputError(
            str(path), "more than 4 GB of text", "at most 4 GB", "cut the recording or convert it to Parquet"
        )
    return data


def _format_of(path: Path, head: bytes) -> str:
    for magic, name in _MAGIC:
        if head.startswith(magic):
            return name
    for magic, what, do in _STRANGERS:
        if head.startswith(magic):
            raise InputError(str(path), what, READABLE, do)
    if head.startswith(b"PK\x03\x04"):
        return _zip_content(path)
    if path.suffix.lower() == ".mat":
        return "matlab"  # version 4 has no mark of its own
    if not head.strip(b"\0"):
        raise InputError(
            str(path), "nothing but zero bytes", READABLE, "copy it again (a broken transfer or memory card)"
        )
    return _text_format(path, head)


def _text_format(path: Path, head: bytes) -> str:
    if _looks_binary(head):
        known: Mapping[str, str] = {
            ".parquet": "Parquet",
            ".pq": "Parquet",
            ".mf4": "MDF",
            ".mdf": "MDF",
            ".blf": "BLF",
            ".xlsx": "Excel",
        }
        kind = known.get(path.suffix.lower())
        raise InputError(
            str(path),
            f"no readable {kind} (its first bytes are not those of {kind})"
            if kind
            else "binary content of an unknown kind",
            f"a whole {kind} file" if kind else READABLE,
            "copy or export it again (is it truncated?)" if kind else "export it as CSV or Parquet",
        )
    text = head.decode("latin-1")
    if _CANDUMP_LOG.search(text) or _CANDUMP_TEXT.search(text):
        return "candump"
    if _ASC.search(text):
        return "asc"
    if _TRC.search(text):
        return "trc"
    for pattern, what, do in _TEXT_STRANGERS:
        if re.match(pattern, text.removeprefix("ï»¿"), re.IGNORECASE):
            raise InputError(str(path), what, READABLE, do)
    return "csv"


def _looks_binary(head: bytes) -> bool:
    if head.startswith((b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf")):
        return False
    head = head.rstrip(b"\0")  # a logger that loses power leaves a tail of zeros
    zeros = head.count(0)
    if zeros:  # UTF-16 without a mark: every second byte of plain text is zero
        halves = (head[0::2].count(0), head[1::2].count(0))
        return not (max(halves) > 0.4 * len(head) / 2 and min(halves) < 0.02 * len(head))
    control = sum(head.count(bytes([code])) for code in (*range(1, 9), *range(14, 27), 28, 29, 30, 31))
    return control > 0.02 * len(head)


def _zip_content(path: Path) -> str:
    try:
        with zipfile.ZipFile(path) as archive:
            names = set(archive.namelist())
    except (zipfile.BadZipFile, OSError) as error:
        raise InputError(
            str(path), f"no readable Excel or zip file ({error})", "a whole file", "copy it again"
        ) from None
    if "xl/workbook.xml" in names:
        return "excel"
    if "xl/workbook.bin" in names:
        raise InputError(str(path), "a binary Excel workbook (.xlsb)", READABLE, "save it as .xlsx")
    if "mimetype" in names:
        raise InputError(str(path), "an OpenDocument file", READABLE, "save it as .xlsx or CSV")
    raise InputError(str(path), f"a zip archive of {len(names)} files", READABLE, "unpack it first")
