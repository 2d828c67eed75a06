"""Cases of the commands that read what others wrote: watch, export, app, siblings, several recordings, curves."""

from __future__ import annotations

import json
import socket
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pandas as pd

from benchmarks.bad_inputs.case import Case, plain

LISTENERS: list[socket.socket] = []
"""Ports that stay taken while this process lives."""


def learned(folder: Path) -> None:
    """mine.yaml, an engine of which nothing much is known yet, and sibling.yaml, the same under another name."""
    from dieseltwin.engine import we2011
    from dieseltwin.learning.belief import prior_belief
    from dieseltwin.learning.files import LearnedEngine, save_learned
    from dieseltwin.recordings.reader import read_recording

    recorded = read_recording(folder / "drive.csv")
    belief = prior_belief(we2011.PARAMETERS, 0.02)
    engine = LearnedEngine(we2011.PARAMETERS, belief, 0.02, (recorded,), {}, {recorded.sha256: 1.0})
    for name in ("mine", "sibling"):
        save_learned(engine, folder / f"{name}.yaml")


def _history(content: bytes | None = None, *, statements: tuple[str, ...] = ()) -> Callable[[Path], None]:
    """A learned engine, and a history that is none: a file's bytes, or an SQLite file with these tables."""

    def make(folder: Path) -> None:
        learned(folder)
        (folder / "h").mkdir()
        path = folder / "h" / "history.sqlite"
        if content is not None:
            path.write_bytes(content)
            return
        with closing(sqlite3.connect(path)) as connection, connection:
            for statement in statements:
                connection.execute(statement)

    return make


def _several(change: Callable[[pd.DataFrame], pd.DataFrame], name: str = "other.csv") -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        learned(folder)
        change(pd.read_csv(folder / "drive.csv")).to_csv(folder / name, index=False)

    return make


def _taken(folder: Path) -> None:
    listener = socket.socket()
    listener.bind(("127.0.0.1", 18_765))
    listener.listen()
    LISTENERS.append(listener)


def _scored(score: object, rows: object, tier: str = "own-engine") -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        case = {"case": "case_0000", "recording": "case_0000/recording.csv", "recording_sha256": "0" * 64,
                "withhold": [], "answers_salted_sha256": "0" * 64, "held_out_salted_sha256": "0" * 64}  # fmt: skip
        manifest = {"n": 1, "tier": tier, "sensors": 6, "duration_s": 600.0, "code_version": "0",
                    "seed_salted_sha256": "0", "cases": [case]}  # fmt: skip
        (folder / "manifest.json").write_text(json.dumps(manifest))
        (folder / "score").mkdir()
        (folder / "score" / "score.json").write_text(json.dumps(score))
        (folder / "score" / "rows.json").write_text(json.dumps(rows))

    return make


_ADD = ("watch", "add", "{}/drive.csv", "--engine", "{}/mine.yaml", "--history", "{}/h")
_PREFIX = "PRAGMA application_id = 1685354344"
_ABOUT = "CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT"


def watch_cases() -> Iterator[Case]:
    """Histories that are none, engines of which nothing is known, rates that are no probability."""
    for name, content in {"empty": b"", "text": b"hello\n" * 100, "cut": b"SQLite format 3\x00" + b"\x00" * 50,
                          "zeros": bytes(8192)}.items():  # fmt: skip
        if name != "empty":  # an empty file is a new SQLite file, into which a history is put
            yield Case(f"watch add: history {name}", plain(*_ADD, prepare=_history(content)))
        yield Case(f"watch show: history {name}", plain("watch", "show", "--history", "{}/h",
                                                        prepare=_history(content)))  # fmt: skip
    for name, statements in {
        "of something else": ("CREATE TABLE a (b)",), "without rows": (_PREFIX, _ABOUT),
        "of schema 99": (_PREFIX, _ABOUT, "INSERT INTO about VALUES ('schema', '99')"),
        "of no engine": (_PREFIX, _ABOUT, "INSERT INTO about VALUES ('schema', '1')"),
        "without tables": (_PREFIX,),
    }.items():  # fmt: skip
        yield Case(f"watch add: history {name}", plain(*_ADD, prepare=_history(statements=statements)))
        yield Case(f"watch show: history {name}", plain("watch", "show", "--history", "{}/h",
                                                        prepare=_history(statements=statements)))  # fmt: skip
    for name, engine in {"published": "we2011", "unlearned": "{}/engine.yaml", "a recording": "{}/drive.csv",
                         "missing": "{}/none.yaml", "petrol": "liu_petrol", "nothing": "", "a folder": "{}"}.items():
        yield Case(f"watch add: engine {name}", plain("watch", "add", "{}/drive.csv", "--engine", engine, "--history",
                                                      "{}/h"))  # fmt: skip
    for rate in ("0", "-1", "nan", "inf", "2", "x"):
        yield Case(f"watch add: {rate} alarms", plain(*_ADD, "--alarms-per-year", rate, prepare=learned))
        yield Case(f"watch show: {rate} alarms", plain("watch", "show", "--history", "{}/h", "--alarms-per-year", rate))
    for place in ("{}/drive.csv", "{}/drive.csv/h", "\0", f"{{}}/{'h' * 300}"):
        yield Case(f"watch add: history in {place[:20]!r}", plain(*_ADD[:-1], place, prepare=learned))
    for words in (("watch",), ("watch", "add"), ("watch", "shew"), ("watch", "add", "{}/none.csv", *_ADD[3:]),
                  ("watch", "show", "--history", "{}/nothing"), (*_ADD, "--sensors", "nothing"),
                  (*_ADD, "--channels", "{}/none.yaml"), (*_ADD, "--profile", "none")):  # fmt: skip
        if words != ("watch",):
            yield Case(f"watch: {' '.join(words[1:4])[:60]} {words[-1][:20]}", plain(*words, prepare=learned))


def export_cases() -> Iterator[Case]:
    """Engines that can't be exported, places that are none, networks that aren't there."""
    for engine in ("nothing", "{}/none.yaml", "{}/drive.csv", "{}/map.yaml", "", "{}", "\0", "e" * 3000):
        yield Case(f"export of {engine[:30]!r}", plain("export", engine, "--c", "{}/o.c"))
    for option, path in (("--c", "{}/drive.csv/o.c"), ("--c", "{}/none/o.c"), ("--c", "{}"), ("--c", "\0"),
                         ("--c", f"{{}}/{'c' * 300}.c"), ("--c", "{}/engine.yaml"), ("--c", "{}/o.exe"),
                         ("--fmu", "{}/engine.yaml"), ("--fmu", "{}/o.zip"), ("--fmu", "{}/none/o.fmu"),
                         ("--table", "{}/drive.csv"), ("--table", "{}/drive.csv/t"), ("--table", "\0"),
                         ("--onnx", "{}/drive.csv"), ("--onnx", "{}/o")):  # fmt: skip
        yield Case(f"export {option} {path[:30]!r}", plain(
            "export", "{}/engine.yaml" if path == "{}/engine.yaml" else "we2011", option, path))  # fmt: skip
    for words in (("--fmi", "1"), ("--fmi", "4"), ("--fmi", "x"), ("--models", "{}/none", "--onnx", "{}/o"),
                  ("--models", "{}/drive.csv", "--onnx", "{}/o"), ()):  # fmt: skip
        yield Case(f"export with {' '.join(words)}", plain("export", "we2011", *words,
                                                           *(("--fmu", "{}/o.fmu") if words[:1] == ("--fmi",) else ())))
    yield Case("export over a file", plain("export", "we2011", "--c", "{}/o.c",
                                           prepare=lambda folder: (folder / "o.c").write_text("mine")))  # fmt: skip


def page_cases() -> Iterator[Case]:
    """Addresses that are none, ports that are taken, folders that are files."""
    for words in (("--port", "0"), ("--port", "99999"), ("--port", "x"), ("--port", "-1"), ("--host", ""),
                  ("--host", "nowhere.invalid"), ("--host", "300.1.1.1"), ("--host", "h" * 3000), ("--host", "a b"),
                  ("--host", "\u2028"),
                  ("--largest", "0"), ("--workers", "0"), ("--workers", "1000"), ("--memory", "0"),
                  ("--folder", "{}/drive.csv"), ("--folder", "{}/drive.csv/a"), ("--folder", "\0"),
                  ("--folder", f"{{}}/{'f' * 300}"), ("--folder", "{}/loop"), ("--nothing", "1")):  # fmt: skip
        prepare = (lambda folder: (folder / "loop").symlink_to(folder / "loop")) if "{}/loop" in words else None
        port = () if words[0] == "--port" else ("--port", "18766")
        yield Case(f"app {words[0]} {words[1][:30]!r}", plain("app", *port, *words, prepare=prepare))
    yield Case("app on a port that is taken", plain("app", "--port", "18765", prepare=_taken))


def several_cases() -> Iterator[Case]:
    """Recordings that don't belong together, siblings that are none."""
    drive = "{}/drive.csv"
    for name, change in {
        "without sensors": lambda t: t[["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct"]],
        "empty": lambda t: t.iloc[:0], "of one row": lambda t: t.iloc[:1], "of text": lambda t: t.astype(str) + "x",
        "other columns": lambda t: t.add_prefix("x_"), "standing": lambda t: t.assign(n_e_rpm=0.0),
    }.items():  # fmt: skip
        yield Case(f"discover two, one {name}", plain("discover", drive, "{}/other.csv", "--out", "{}/o",
                                                      prepare=_several(change)))  # fmt: skip
        yield Case(f"learn two, one {name}", plain("learn", drive, "{}/other.csv", "--out", "{}/o.yaml",
                                                   prepare=_several(change)))  # fmt: skip
        yield Case(f"watch add: {name}", plain("watch", "add", "{}/other.csv", *_ADD[3:], prepare=_several(change)))
    for words in ((drive, drive), (drive, "{}/none.csv"), (drive, "{}"), (drive, "{}/points.csv"),
                  (drive, "--reference", "{}/none.csv"), (drive, "--reference", "{}/points.csv"),
                  (drive, "--time", "-1"), (drive, "--time", "nan"), (drive, "--time", "0"), (drive, "--time", "x"),
                  (drive, "--params", "{}/none.yaml"), (drive, "--profile", "none"), (drive, "--engine", "nothing"),
                  (drive, "--withhold", "nothing"), (drive, "--explain", "nothing")):  # fmt: skip
        yield Case(f"discover {' '.join(words).replace(drive, 'D')[:60]}", plain("discover", *words, "--out", "{}/o"))
    for name, path in {"missing": "{}/none.yaml", "an engine that learned nothing": "{}/engine.yaml",
                       "a recording": drive, "a folder": "{}", "published": "we2011", "nothing": ""}.items():
        yield Case(f"learn: sibling {name}", plain("learn", drive, "--siblings", path, "--out", "{}/o.yaml",
                                                   prepare=learned))  # fmt: skip
    yield Case("learn: sibling twice", plain("learn", drive, "--siblings", "{}/sibling.yaml", "--siblings",
                                             "{}/sibling.yaml", "--out", "{}/o.yaml", prepare=learned))  # fmt: skip
    yield Case("learn over its sibling", plain("learn", drive, "--siblings", "{}/sibling.yaml", "--out",
                                               "{}/sibling.yaml", prepare=learned))  # fmt: skip


def curve_cases() -> Iterator[Case]:
    """Benchmarks without a score, scores that are none."""
    figure = ("--out", "{}/o.svg")
    for name, score, rows in (
        ("empty", {}, {}), ("lists", [], []), ("text", "a", "b"), ("null", None, None),
        ("lines of numbers", {"cases": 1, "lines": [5]}, {"rows": []}),
        ("no such lines", {"cases": 1, "lines": []}, {"rows": []}),
        ("rows of numbers", {"cases": 1, "lines": []}, {"rows": [5]}),
        ("cases of text", {"cases": "x", "lines": [{"key": "name_in_set", "numbers": {}}]}, {"rows": []}),
    ):
        yield Case(f"challenge curve: score {name}", plain("challenge", "curve", "{}", *figure,
                                                           prepare=_scored(score, rows)))  # fmt: skip
    yield Case("challenge curve: tier main", plain("challenge", "curve", "{}", *figure,
                                                   prepare=_scored({}, {}, "main")))  # fmt: skip
    for words in (("{}", *figure), ("{}/none", *figure), ("{}/drive.csv", *figure), ("{}", "--out", "{}/o.exe"),
                  ("{}", "--out", "{}/none/o.svg"), ("{}", "--out", "\0.svg"), ("--out", "{}/o.svg"), ("{}",)):
        yield Case(f"challenge curve {' '.join(words)[:40]!r}", plain("challenge", "curve", *words))


def later_cases() -> Iterator[Case]:
    """All of this module."""
    for group in (watch_cases, export_cases, page_cases, several_cases, curve_cases):
        yield from group()
