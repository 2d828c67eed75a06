"""The cases: what is written beside the good files, and the command that is given it."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.bad_inputs.case import Case, plain
from benchmarks.bad_inputs.later import later_cases
from benchmarks.bad_inputs.texts import (
    ADDRESSES,
    CONTENTS,
    ENGINE_VALUES,
    LONG,
    MANIFESTS,
    MAPS,
    OPTIONS,
    YAML,
)  # fmt: skip

REFERENCE = Path(__file__).resolve().parents[2] / "tests" / "reference" / "field_random_300s.csv"
SENSORS = ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k")
INPUTS = ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")


def good_files(folder: Path) -> None:
    """A recording of a minute, settled points and the smallest files of every other kind."""
    trace = pd.read_csv(REFERENCE)
    trace.loc[trace["time_s"] <= 60.0, [*INPUTS, *SENSORS]].to_csv(folder / "drive.csv", index=False)
    points = trace.loc[::10, [*INPUTS[1:], *SENSORS, "w_c_kg_s"]].assign(p_amb_pa=1.011e5, t_amb_k=298.46)
    points.to_csv(folder / "points.csv", index=False)
    (folder / "engine.yaml").write_text("V_d: 0.0127\n")
    (folder / "map.yaml").write_text("t: time_s\n")


def _written(name: str, content: str | bytes, arguments: Callable[[str, str], list[str]]) -> Callable[..., list[str]]:
    def make(folder: Path) -> list[str]:
        path = folder / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
        return arguments(str(path), str(folder))

    return make


def _table(change: Callable[[pd.DataFrame], pd.DataFrame], arguments: Callable[[str, str], list[str]],
           source: str = "drive.csv") -> Callable[[Path], list[str]]:  # fmt: skip
    def make(folder: Path) -> list[str]:
        path = folder / "bad.csv"
        change(pd.read_csv(folder / source)).to_csv(path, index=False)
        return arguments(str(path), str(folder))

    return make


YAML_TAKERS: dict[str, Callable[[str, str], list[str]]] = {
    "engine": lambda path, _: ["engine", "show", "--engine", path],
    "channels": lambda path, folder: ["simulate", f"{folder}/drive.csv", "--channels", path, "--out",
                                      f"{folder}/o.csv"],
    "params": lambda path, _: ["params", "show", "--params", path],
    "geometry": lambda path, folder: ["calibrate", f"{folder}/points.csv", "--geometry", path, "--out",
                                      f"{folder}/o.yaml"],
}  # fmt: skip



def _with_engine(command: str, out: str, path: str, folder: str) -> list[str]:
    return [command, f"{folder}/drive.csv", "--engine", path, "--out", f"{folder}/{out}"]


def engine_cases() -> Iterator[Case]:
    """Values that no engine has."""
    for text in ENGINE_VALUES:
        yield Case(f"engine value: {text[:80]}", _written("e.yaml", text + "\n", YAML_TAKERS["engine"]))
    for text in ("J_t: 1e300", "V_d: true", "n_e_range: [2000, 500]"):
        for command in ("simulate", "identify", "discover", "learn"):
            out = {"simulate": "o.csv", "learn": "o.yaml"}.get(command, "o")
            yield Case(f"engine value: {text} in {command}", _written(
                "e.yaml", text + "\n",
                partial(_with_engine, command, out)))  # fmt: skip




def map_cases() -> Iterator[Case]:
    """Channel maps that map nothing to something, or to nonsense."""
    for text in MAPS:
        yield Case(f"channel map: {text[:80]}", _written("m.yaml", text + "\n", YAML_TAKERS["channels"]))


def _shifted(name: str, value: object, row: int = 30) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def change(table: pd.DataFrame) -> pd.DataFrame:
        column = table[name].astype(object)
        column.iloc[row] = value
        return table.assign(**{name: column})

    return change


TABLES: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "text in time_s": _shifted("time_s", "noon"),
    "all of time_s text": lambda t: t.assign(time_s=[f"row {i}" for i in range(len(t))]),
    "infinite time": _shifted("time_s", np.inf),
    "infinite end": lambda t: _shifted("time_s", np.inf, len(t) - 1)(t),
    "a time of 1e300": lambda t: _shifted("time_s", 1e300, len(t) - 1)(t),
    "missing time": _shifted("time_s", np.nan),
    "time stands": lambda t: t.assign(time_s=1.0),
    "time falls": lambda t: t.assign(time_s=t["time_s"][::-1].to_numpy()),
    "time in nanoseconds": lambda t: t.assign(time_s=1e9 * t["time_s"]),
    "infinite speed": lambda t: t.assign(n_e_rpm=np.inf),
    "all speed missing": lambda t: t.assign(n_e_rpm=np.nan),
    "text in fuel": _shifted("u_delta_mg", "much"),
    "all text": lambda t: t.astype(str) + "x",
    "booleans": lambda t: t.assign(n_e_rpm=True),
    "one row": lambda t: t.iloc[:1],
    "no rows": lambda t: t.iloc[:0],
    "one column": lambda t: t[["time_s"]],
    "no names": lambda t: t.set_axis([str(i) for i in range(t.shape[1])], axis=1),
    "fuel of 1e300": lambda t: t.assign(u_delta_mg=1e300),
    "speed of -5": lambda t: t.assign(n_e_rpm=-5.0),
    "complex numbers": _shifted("n_e_rpm", "1+2j"),
}


TABLE_TAKERS: dict[str, Callable[[str, str], list[str]]] = {
    "simulate": lambda path, folder: ["simulate", path, "--out", f"{folder}/o.csv"],
    "identify": lambda path, folder: ["identify", path, "--out", f"{folder}/o"],
    "discover": lambda path, folder: ["discover", path, "--out", f"{folder}/o"],
    "calibrate": lambda path, folder: ["calibrate", path, "--out", f"{folder}/o.yaml"],
    "learn": lambda path, folder: ["learn", path, "--out", f"{folder}/o.yaml"],
}
SOME = ("simulate", "identify", "calibrate")

POINTS: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "60 identical": lambda t: pd.concat([t.iloc[[5]]] * 60),
    "two distinct": lambda t: pd.concat([t.iloc[[5, 40]]] * 30),
    "w_egr and w_c swapped": lambda t: t.rename(columns={"w_egr_kg_s": "w_c_kg_s", "w_c_kg_s": "w_egr_kg_s"}),
    "p_im and p_em swapped": lambda t: t.rename(columns={"p_im_pa": "p_em_pa", "p_em_pa": "p_im_pa"}),
    "u_egr and u_vgt swapped": lambda t: t.rename(columns={"u_egr_pct": "u_vgt_pct", "u_vgt_pct": "u_egr_pct"}),
    "no air": lambda t: t.assign(w_c_kg_s=0.0),
    "infinite air": lambda t: t.assign(w_c_kg_s=np.inf),
    "no sensors": lambda t: t.drop(columns=[*SENSORS, "w_c_kg_s"]),
    "five points": lambda t: t.iloc[:5],
    "a constant sensor": lambda t: t.assign(omega_t_rad_s=5000.0),
    "no fuel": lambda t: t.assign(u_delta_mg=0.0),
}


def table_cases() -> Iterator[Case]:
    """Recordings and points that are none."""
    for number, (name, change) in enumerate(TABLES.items()):
        for command in ("simulate", ("identify", "discover", "learn")[number % 3]):
            yield Case(f"{command}: {name}", _table(change, TABLE_TAKERS[command]))
    for number, (name, content) in enumerate(CONTENTS.items()):
        for command in (SOME[number % 3], ("discover", "learn")[number % 2]):
            yield Case(f"{command}: {name}", _written("bad.csv", content, TABLE_TAKERS[command]))
        if name not in ("header only", "ten thousand columns", "a name of 10,000 characters", "ragged rows"):
            yield Case(f"channels: {name}", _written("bad.csv", content, lambda path, folder: [
                "channels", path, "--out", f"{folder}/o.yaml"]))  # fmt: skip
    for name, change in POINTS.items():
        yield Case(f"calibrate points: {name}", _table(change, TABLE_TAKERS["calibrate"], "points.csv"))


def path_cases() -> Iterator[Case]:
    """Names that no file can have, links to nowhere, folders for files and files for folders."""
    takers = {"simulate": "o.csv", "identify": "o", "discover": "o", "calibrate": "o.yaml", "learn": "o.yaml",
              "channels": "o.yaml"}  # fmt: skip
    for command, out in takers.items():
        suffix = Path(out).suffix
        source = "{}/points.csv" if command == "calibrate" else "{}/drive.csv"
        for name, path in (("name of 300 characters", f"{{}}/{LONG}{suffix}"), ("dangling link", "{}/link" + suffix),
                           ("below a file", "{}/drive.csv/o" + suffix), ("link to itself", "{}/loop" + suffix),
                           ("zero byte", "{}/a\0b" + suffix)):  # fmt: skip
            yield Case(f"{command} --out: {name}", plain(command, source, "--out", path, prepare=_links))
        for name, path in (("name of 300 characters", f"{{}}/{LONG}.csv"), ("dangling link", "{}/link.csv"),
                           ("a folder", "{}/folder.csv"), ("link to itself", "{}/loop.csv"), ("a pipe", "{}/pipe.csv"),
                           ("zero byte", "{}/a\0b.csv"), ("nothing", "")):  # fmt: skip
            yield Case(f"{command} input: {name}", plain(command, path, "--out", "{}/" + out, prepare=_links))
        if suffix:
            yield Case(f"{command} --out: a folder", plain(
                command, source, "--out", "{}/folder" + suffix, prepare=_links))  # fmt: skip
            yield Case(f"{command} --out: another ending", plain(command, source, "--out", "{}/o.exe"))
    for path in (f"{{}}/{LONG}.yaml", "{}/link.yaml", "{}/folder.yaml", "{}/loop.yaml", "{}/pipe.yaml", "", "\0"):
        for option in (("engine", "show", "--engine"), ("params", "show", "--params")):
            yield Case(f"{' '.join(option)} {path[:20]!r}", plain(*option, path, prepare=_links))
    yield Case("simulate X --out X", plain("simulate", "{}/drive.csv", "--out", "{}/drive.csv"))
    yield Case("simulate X --out ./X", plain("simulate", "{}/drive.csv", "--out", "{}/folder/../drive.csv",
                                              prepare=_links))  # fmt: skip
    yield Case("simulate X --out a link to X", plain(
        "simulate", "{}/drive.csv", "--out", "{}/same.csv",
        prepare=lambda folder: (folder / "same.csv").symlink_to(folder / "drive.csv")))  # fmt: skip
    yield Case("channels X --out its own map", plain("channels", "{}/map.yaml", "--out", "{}/map.yaml"))
    yield Case("calibrate --base X --out X", plain("calibrate", "{}/points.csv", "--base", "{}/engine.yaml", "--out",
                                                    "{}/engine.yaml"))  # fmt: skip
    yield Case("identify --out the recording", plain("identify", "{}/drive.csv", "--out", "{}/drive.csv"))


def _links(folder: Path) -> None:
    for suffix in ("", ".csv", ".yaml"):
        (folder / f"link{suffix}").symlink_to(folder / "nowhere" / "file")
        (folder / f"loop{suffix}").symlink_to(folder / f"loop{suffix}")
        (folder / f"folder{suffix}").mkdir()
        os.mkfifo(folder / f"pipe{suffix}")




def option_cases() -> Iterator[Case]:
    """Options that are negative, absurd, unknown or missing."""
    short = {"D": "{}/drive.csv", "P": "{}/points.csv", "O": "{}/o", "O.csv": "{}/o.csv", "O.yaml": "{}/o.yaml"}
    for line in OPTIONS:
        yield Case(f"options: {line[:80]}", plain(*(short.get(word, word) for word in line.split())))




def _of_challenge(command: str, _path: str, folder: str) -> list[str]:
    return ["challenge", command, folder, "--jobs", "1"]


def manifest_cases() -> Iterator[Case]:
    """Benchmarks with a broken manifest."""
    for name, text in MANIFESTS.items():
        for command in ("run", "score"):
            yield Case(f"challenge {command}: manifest {name}", _written(
                "manifest.json", text, partial(_of_challenge, command)))  # fmt: skip
    yield Case("challenge run: manifest not text", _written("manifest.json", b"\xff\xfe\xfa", lambda _, folder: [
        "challenge", "run", folder]))  # fmt: skip




def address_cases() -> Iterator[Case]:
    """Mirrors that are none."""
    for address in ADDRESSES:
        yield Case(f"data fetch from {address[:40]!r}", plain("data", "fetch", "emps/emps_train.csv"), (
            ("DIESELTWIN_DATA_URL", address), ("DIESELTWIN_DATA", "/nonexistent"),
            ("DIESELTWIN_CACHE", "{}/cache")))  # fmt: skip
    yield Case("data fetch into a file", plain("data", "fetch", "emps/emps_train.csv"), (
        ("DIESELTWIN_DATA_URL", "http://127.0.0.1:1"), ("DIESELTWIN_DATA", ""),
        ("DIESELTWIN_CACHE", "{}/drive.csv/cache")))  # fmt: skip
    yield Case("data path in a name of 300 characters", plain("data", "path", "emps/emps_train.csv"), (
        ("DIESELTWIN_DATA", "/" + LONG), ("DIESELTWIN_CACHE", "{}/cache")))  # fmt: skip


def _learned(content: bytes, fits: bool = True) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        (folder / "mine.learned.parquet").write_bytes(content)
        digest = hashlib.sha256(content).hexdigest() if fits else "0" * 64
        (folder / "mine.yaml").write_text(f"learned: mine.learned.parquet\nlearned_sha256: '{digest}'\n")
        return ["engine", "show", "--engine", str(folder / "mine.yaml")]

    return make


def _parquet(table: pd.DataFrame) -> bytes:
    sink = io.BytesIO()
    table.to_parquet(sink, index=False)
    return sink.getvalue()


def learned_cases() -> Iterator[Case]:
    """Learned engines whose second file is missing, changed or another one."""
    yield Case("learned: changed", _learned(b"PAR1", fits=False))
    yield Case("learned: empty", _learned(b""))
    yield Case("learned: no parquet", _learned(b"hello" * 100))
    yield Case("learned: other columns", _learned(_parquet(pd.DataFrame({"a": [1.0]}))))
    yield Case("learned: other corrections", _learned(_parquet(pd.DataFrame({"name": ["a"], "mean": [1.0]}))))
    yield Case("learned: names twice", _learned(_parquet(pd.DataFrame({"name": ["a", "a"], "mean": [1.0, 2.0]}))))
    yield Case("learned: text for means", _learned(_parquet(pd.DataFrame({"name": ["a"], "mean": ["b"]}))))
    yield Case("learned: a missing second file", _written(
        "mine.yaml", "learned: mine.learned.parquet\nlearned_sha256: abc\n", YAML_TAKERS["engine"]))  # fmt: skip
    yield Case("learned: no hash", _written("mine.yaml", "learned: drive.csv\n", YAML_TAKERS["engine"]))


def cases() -> list[Case]:
    """All of them."""
    found = [
        Case(f"yaml as {taker}: {name}", _written("bad.yaml", content, arguments))
        for number, (name, content) in enumerate(YAML.items())
        for place, (taker, arguments) in enumerate(YAML_TAKERS.items())
        if taker in ("engine", "channels") or number % 2 == place % 2
    ]
    for group in (engine_cases, map_cases, table_cases, path_cases, option_cases, manifest_cases, address_cases,
                  learned_cases, later_cases):  # fmt: skip
        found.extend(group())
    return found
