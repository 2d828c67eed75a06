"""Recordings of other people: where they are published, under which terms, and a checked local copy of each.

A file is looked for in the folder that DIESELTWIN_DATA names, in the package (the two regulation schedules), then in
the cache. Its SHA-256 is checked at every place, so that a result always rests on the bytes that it was found on. The
files are tables that were made from the published ones; where the publisher has no file with just these bytes, a
mirror (DIESELTWIN_DATA_URL, a folder that holds the same tree) is needed to fetch one.
"""

from __future__ import annotations

import http.client
import os
import sys
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from dieseltwin.atomic import atomic_path, write_problem
from dieseltwin.errors import InputError
from dieseltwin.paths import file_sha256, xdg_cache_folder
from dieseltwin.settings.names import unknown_name

LOCAL, MIRROR, CACHE = "DIESELTWIN_DATA", "DIESELTWIN_DATA_URL", "DIESELTWIN_CACHE"
TIMEOUT_S = 30.0
CHUNK = 1 << 16
SCHEMES = ("http", "https")


@dataclass(frozen=True)
class DataSet:
    """A set of files of one origin.

    Attributes:
        name: folder and first part of the files' names.
        address: page where the publisher offers it.
        licence: terms as far as known; none of them allows us to hand the files on unless it says so.
        citation: what to cite.
    """

    name: str
    address: str
    licence: str
    citation: str


@dataclass(frozen=True)
class DataFile:
    """One file: set, name within it, SHA-256, size [bytes], direct address if one with these bytes is known."""

    set_name: str
    file: str
    sha256: str
    size: int
    url: str | None = None

    @property
    def name(self) -> str:
        """Name for the commands, also the path below a data folder."""
        return f"{self.set_name}/{self.file}"


SETS: Mapping[str, DataSet] = {s.name: s for s in (
    DataSet("duty_cycles", "https://unece.org/transport/vehicle-regulations",
            "WHTC, WHSC: figures of a regulation, in the package; vehicle cycles: terms unclear, not to be handed on",
            "UN GTR No. 4 (WHDC); 40 CFR part 86, appendix I (UDDS); CARB HHDDT; EU 2017/2400 (VECTO)"),
    DataSet("uw_hd_diesel", "not known to us: ask whoever gave you the recordings",
            "research use or unclear: not to be handed on",
            "measured points of a 12.9 l heavy-duty diesel engine with VGT, cooled EGR and exhaust flap"),
    DataSet("liu_ice", "https://vehsys.gitlab-pages.liu.se/diagnostic_competition/",
            "research use or unclear: not to be handed on",
            "D. Jung, E. Frisk, M. Krysander: The LiU-ICE Benchmark. arXiv 2408.13269 (2024)"),
    DataSet("emps", "https://www.nonlinearbenchmark.org/", "research use or unclear: not to be handed on",
            "A. Janot, M. Gautier, M. Brunot: Data set and reference models of EMPS. Workshop on Nonlinear System "
            "Identification Benchmarks (2019)"),
    DataSet("cascaded_tanks", "https://www.nonlinearbenchmark.org/", "research use or unclear: not to be handed on",
            "M. Schoukens, J. P. Noel: Three benchmarks addressing open challenges in nonlinear system identification. "
            "IFAC PapersOnLine 50 (2017) 446-451"),
)}  # fmt: skip

FILES: Mapping[str, DataFile] = {f.name: f for f in (
    DataFile("duty_cycles", "whtc.csv", "c0660f91e9a1045f804a81e1becc4050ba56d5193e1da44ef08848a26d485870", 28314),
    DataFile("duty_cycles", "whsc.csv", "41da16b9619ceb05431be5f39fc26eebba810a41b6610917b04f8e5a2965cd60", 24056),
    DataFile("duty_cycles", "vehicle_uddshdv.csv",
             "b5e5ed9bb31a272434beae770d0b41d1d5eed3448b38eb2ee80ebea4196b3087", 10510),
    DataFile("duty_cycles", "vehicle_hhddt65.csv",
             "333a4e4353594c5debbb4a136428d080590348b0b28445a92a36dbe617cd139e", 262227),
    DataFile("duty_cycles", "vecto_regionaldelivery.csv",
             "2047c0590d9acffebf12cf7f88fa582fef71131d12e619b2915b472e5032ff84", 54087),
    DataFile("uw_hd_diesel", "steady_state_points.csv",
             "e475b690be27696abc6672ffa7c491b2e2496f6300298375d9b09a7940a8efe9", 20972),
    DataFile("liu_ice", "wltp_NF.csv", "9d362d9c70c28cda2df547156364da6fdd9662fd84846c98b5bbdd71f2463842", 4404299),
    DataFile("liu_ice", "wltp_f_pic_110.csv",
             "8b54ca44506a66f3aff2fc155a16de64cfaa4f239298201c147a9d624f6bd86d", 4425976),
    DataFile("liu_ice", "wltp_f_pim_090.csv",
             "f0022c3eec8ce763ea23c297f98a465e7bf09b322660268e30d112bc171c67f3", 4418337),
    DataFile("liu_ice", "wltp_f_waf_110.csv",
             "6d4c57751a40c642c08f2c11f423ca6954824b09f25c30e92ef4b7570cb120d0", 4399124),
    DataFile("emps", "emps_train.csv", "cc29d0d5a96d08845d5f0eaa8dfefbc8f12ccadf5c7315c460f61a569d0bf6f4", 1388476),
    DataFile("cascaded_tanks", "estimation.csv",
             "b1c0adcfd6b708567fb33c03c72ed7d0d7619b1b9379d01f16f25f8941d15ba4", 20943),
)}  # fmt: skip

CARRIED = ("duty_cycles/whtc.csv", "duty_cycles/whsc.csv")  # the only ones in the package


def cache_folder() -> Path:
    """Folder of fetched files: DIESELTWIN_CACHE, else the user's cache folder of the platform."""
    if os.environ.get(CACHE):
        return Path(os.environ[CACHE])
    if sys.platform == "win32" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"]) / "dieseltwin" / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "dieseltwin"
    return xdg_cache_folder()


def wanted(name: str) -> list[DataFile]:
    """The file of that name, or all files of the set of that name.

    Raises:
        InputError: neither is known.
    """
    if name in FILES:
        return [FILES[name]]
    found = [f for f in FILES.values() if f.set_name == name]
    if not found:
        known = [*dict.fromkeys(f.set_name for f in FILES.values()), *FILES]
        raise unknown_name("NAME", name, known)
    return found


def checked(path: Path, file: DataFile) -> Path:
    """`path`, if it holds the bytes that are known for `file`.

    Raises:
        InputError: another SHA-256, or a file that can't be read.
    """
    try:
        digest = file_sha256(path)
    except OSError as error:
        raise InputError(str(path), error.strerror or error, "a file you may read", "check it") from None
    if digest != file.sha256:
        raise InputError(f"{path}: SHA-256", digest, file.sha256,
                         "this is not the file that results rest on: take it away or replace it")  # fmt: skip
    return path


def places(file: DataFile) -> Iterable[tuple[str, Path]]:
    """Where a copy may lie, in the order in which they are looked at: (word, path)."""
    if os.environ.get(LOCAL):
        yield LOCAL, Path(os.environ[LOCAL]) / file.name
    if file.name in CARRIED:
        yield "package", Path(__file__).parents[1] / "data" / file.file
    yield "cache", cache_folder() / file.name


def find(file: DataFile) -> tuple[str, Path] | None:
    """The first place that has the file, checked: (word, path); None if none has.

    Raises:
        InputError: that copy is not what it should be.
    """
    for word, path in places(file):
        if os.path.isfile(path):  # a name that is too long is no file
            return word, checked(path, file)
    return None


def path_of(file: DataFile) -> Path:
    """Local path of a file, checked.

    Raises:
        InputError: no copy, or a wrong one.
    """
    found = find(file)
    if found is None:
        looked = ", ".join(str(path) for _, path in places(file))
        raise InputError(file.name, f"no copy at {looked}", "a local copy", f"run `dieseltwin data fetch {file.name}` "
                         f"or set {LOCAL} to the folder that holds {file.name}")  # fmt: skip
    return found[1]


def fetch(file: DataFile) -> tuple[Path, bool]:
    """A checked local copy, downloaded into the cache if there is none: (path, whether it was downloaded).

    Raises:
        InputError: no address, no network, another checksum (nothing is kept then), a place that can't be written.
    """
    found = find(file)
    if found is not None:
        return found[1], False
    address = _address(file)
    target = cache_folder() / file.name
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(str(target.parent), error.strerror or error, "a folder you may write to",
                         f"set {CACHE} to another folder") from None  # fmt: skip
    with atomic_path(target) as partial:  # a wrong or broken download never gets the file's name
        _download(address, partial, file)
        checked_download(partial, address, file)
    return target, True


def _address(file: DataFile) -> str:
    origin = SETS[file.set_name].address if file.set_name in SETS else "unknown"
    mirror = os.environ.get(MIRROR)
    if mirror:
        address = _mirrored(mirror, file)
    elif file.url is not None:
        address = file.url
    else:
        raise InputError(file.name, "no public address with just these bytes", "a copy or a mirror",
                         f"get it from its publisher ({origin}) and set {LOCAL} to the folder that holds {file.name}, "
                         f"or set {MIRROR} to a mirror")  # fmt: skip
    if urllib.parse.urlsplit(address).scheme not in SCHEMES:
        raise InputError(f"{MIRROR}", address, "an http or https address", f"for a folder set {LOCAL}")
    return address


def _mirrored(mirror: str, file: DataFile) -> str:
    """Address of a file on a mirror.

    Raises:
        InputError: the mirror's address is none.
    """
    try:
        parts = urllib.parse.urlsplit(mirror)
        host = (parts.hostname or "").encode("idna")
        possible = bool(host or parts.scheme not in SCHEMES) and (parts.port is None or parts.port > 0)
    except ValueError:  # brackets, a port that is no number, a part of the name over 63 characters
        possible = False
    if not possible or not mirror.isascii() or not mirror.isprintable() or " " in mirror:
        raise InputError(MIRROR, repr(mirror), "an http or https address", "correct the variable")
    return mirror.rstrip("/") + "/" + urllib.parse.quote(file.name)


def _download(address: str, target: Path, file: DataFile) -> None:
    elsewhere = f"check the network, or set {LOCAL} to a folder that holds {file.name}"
    try:
        with urllib.request.urlopen(address, timeout=TIMEOUT_S) as source, target.open("wb") as sink:
            total = 0
            while block := source.read(CHUNK):
                total += len(block)
                if total > file.size:
                    raise InputError(address, f"more than {file.size} bytes", f"{file.size} bytes",
                                     "another file is there: nothing was kept")  # fmt: skip
                sink.write(block)
    except urllib.error.HTTPError as error:
        raise InputError(address, f"HTTP {error.code} {error.reason}", "the file", elsewhere) from None
    except urllib.error.URLError as error:
        raise InputError(address, f"no connection ({error.reason})", "a reachable address", elsewhere) from None
    except (OSError, http.client.HTTPException) as error:  # what answers needn't be a web server
        if isinstance(error, OSError) and write_problem(error, target) is not None:
            raise  # of the disk, for `atomic_path`
        raise InputError(address, f"the connection broke ({error})", "the whole file", elsewhere) from None


def checked_download(path: Path, address: str, file: DataFile) -> None:
    """Refuse a download with another checksum.

    Raises:
        InputError: another SHA-256.
    """
    digest = file_sha256(path)
    if digest != file.sha256:
        raise InputError(f"{address}: SHA-256", digest, file.sha256,
                         "the file there is another one or was damaged on the way: nothing was kept")  # fmt: skip
