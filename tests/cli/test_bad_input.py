"""Bad input through the command line: one line (what, got, allowed, what to do), exit code 2, nothing written."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dieseltwin.cli.app import main

SENSORS = ["p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k"]
COLUMNS = ["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", *SENSORS]
KELVIN = 273.15


@pytest.fixture(scope="module")
def good(trace: pd.DataFrame) -> pd.DataFrame:
    """Two minutes of a reference trace as a recording."""
    return trace.loc[trace["time_s"] <= 120.0, COLUMNS].copy()


@dataclass(frozen=True)
class Refusal:
    """What the command line said."""

    code: int
    line: str


@pytest.fixture
def refuse(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Callable[..., Refusal]:
    """Run a command that must be refused; checks exit code, one line, nothing on stdout, nothing written."""

    def run(*arguments: str | Path) -> Refusal:
        before = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*")}
        capfd.readouterr()
        code = main([str(a) for a in arguments])
        said = capfd.readouterr()
        assert code == 2, said.err
        assert said.out == ""
        assert len(said.err.splitlines()) == 1, said.err
        assert {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*")} == before
        return Refusal(code, said.err.strip())

    return run


def has_four_parts(line: str) -> bool:
    return line.startswith("dieseltwin: ") and ": got " in line and "; allowed: " in line and line.count("; ") >= 2


def no_w_egr(t: pd.DataFrame) -> pd.DataFrame:
    return t.drop(columns="w_egr_kg_s")


def no_speed(t: pd.DataFrame) -> pd.DataFrame:
    return t.drop(columns="n_e_rpm")


def p_im_in_kpa(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(p_im_pa=t["p_im_pa"] / 1e3)


def p_im_in_bar(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(p_im_pa=t["p_im_pa"] / 1e5)


def p_em_in_kpa(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(p_em_pa=t["p_em_pa"] / 1e3)


def t_em_in_celsius(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(t_em_k=t["t_em_k"] - KELVIN)


def t_amb_in_celsius(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(t_amb_k=25.0)


def positions_as_fractions(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(u_egr_pct=t["u_egr_pct"] / 100, u_vgt_pct=t["u_vgt_pct"] / 100)


def only_u_egr_as_fraction(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(u_egr_pct=t["u_egr_pct"] / 100)


def only_u_vgt_as_fraction(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(u_vgt_pct=t["u_vgt_pct"] / 100)


def w_egr_negative(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(w_egr_kg_s=-t["w_egr_kg_s"])


def w_egr_in_kg_per_hour(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(w_egr_kg_s=3600 * t["w_egr_kg_s"])


def turbo_in_rpm(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(omega_t_rad_s=t["omega_t_rad_s"] * 30 / np.pi)


def channel_all_nan(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(p_em_pa=np.nan)


def input_all_nan(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(u_delta_mg=np.nan)


def time_goes_back(t: pd.DataFrame) -> pd.DataFrame:
    time = t["time_s"].to_numpy().copy()
    time[300] = time[298]
    return t.assign(time_s=time)


def time_repeats(t: pd.DataFrame) -> pd.DataFrame:
    time = t["time_s"].to_numpy().copy()
    time[300] = time[299]
    return t.assign(time_s=time)


def time_in_milliseconds(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(time_s=t["time_s"] * 1e3)


def engine_never_runs(t: pd.DataFrame) -> pd.DataFrame:
    return t.assign(n_e_rpm=np.linspace(0.0, 299.0, len(t)))


def words_in_a_cell(t: pd.DataFrame) -> pd.DataFrame:
    column = t["t_em_k"].astype(object)
    column.iloc[7] = "n/k"
    return t.assign(t_em_k=column)


def header_only(t: pd.DataFrame) -> pd.DataFrame:
    return t.iloc[:0]


def too_short(t: pd.DataFrame) -> pd.DataFrame:
    return t[t["time_s"] <= 20.0]


# damage -> words that the line must hold
DAMAGES: dict[Callable[[pd.DataFrame], pd.DataFrame], tuple[str, ...]] = {
    no_w_egr: ("w_egr_kg_s",),
    no_speed: ("n_e_rpm",),
    p_im_in_kpa: ("p_im_pa", "kPa", "convert"),
    p_im_in_bar: ("p_im_pa", "bar", "convert"),
    p_em_in_kpa: ("p_em_pa", "kPa"),
    t_em_in_celsius: ("t_em_k", "degC"),
    t_amb_in_celsius: ("t_amb_k", "degC"),
    positions_as_fractions: ("u_vgt_pct", "%"),
    only_u_egr_as_fraction: ("u_egr_pct", "%"),
    only_u_vgt_as_fraction: ("u_vgt_pct", "%"),
    w_egr_negative: ("w_egr_kg_s", "kg/s"),
    w_egr_in_kg_per_hour: ("w_egr_kg_s", "kg/h"),
    turbo_in_rpm: ("omega_t_rad_s", "rpm"),
    channel_all_nan: ("p_em_pa", "no value at all"),
    input_all_nan: ("u_delta_mg", "no value at all"),
    time_goes_back: ("time_s", "increasing", "row"),
    time_repeats: ("time_s", "increasing", "row"),
    time_in_milliseconds: ("time_s", "rows per second"),
    engine_never_runs: ("n_e_rpm", "300 rpm"),
    words_in_a_cell: ("t_em_k", "row 8", "n/k"),
    header_only: ("no rows",),
    too_short: ("20 s", "60 s"),
}
ONLY_CSV = {words_in_a_cell}  # a Parquet column has one type
FILES = [(damage, suffix) for damage in DAMAGES for suffix in (".csv", ".parquet")
         if suffix == ".csv" or damage not in ONLY_CSV]  # fmt: skip


@pytest.mark.parametrize(("damage", "suffix"), FILES, ids=lambda v: v if isinstance(v, str) else v.__name__)
def test_identify_refuses(
    tmp_path: Path, good: pd.DataFrame, refuse: Callable[..., Refusal], damage: Callable, suffix: str
) -> None:
    path = tmp_path / f"drive{suffix}"
    damaged = damage(good)
    damaged.to_csv(path, index=False) if suffix == ".csv" else damaged.to_parquet(path, index=False)
    said = refuse("identify", path, "--out", tmp_path / "out", "--runs", "1")
    assert has_four_parts(said.line), said.line
    assert str(path) in said.line
    for word in DAMAGES[damage]:
        assert word in said.line, said.line


BAD_INPUTS = [no_speed, positions_as_fractions, input_all_nan, time_goes_back, engine_never_runs]


@pytest.mark.parametrize("damage", BAD_INPUTS, ids=lambda f: f.__name__)
def test_simulate_refuses(tmp_path: Path, good: pd.DataFrame, refuse: Callable[..., Refusal], damage: Callable) -> None:
    path = tmp_path / "inputs.csv"
    damage(good).to_csv(path, index=False)
    said = refuse("simulate", path, "--out", tmp_path / "out.parquet")
    assert has_four_parts(said.line) and DAMAGES[damage][0] in said.line


COMMANDS = {
    "identify": lambda path, folder: ("identify", path, "--out", folder / "out", "--runs", "1"),
    "simulate": lambda path, folder: ("simulate", path, "--out", folder / "out.csv"),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_empty_file(tmp_path: Path, refuse: Callable[..., Refusal], command: str, suffix: str) -> None:
    path = tmp_path / f"drive{suffix}"
    path.touch()
    said = refuse(*COMMANDS[command](path, tmp_path))
    assert has_four_parts(said.line) and "empty file" in said.line


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("kept", [0.1, 0.6, 0.999])
def test_truncated_parquet(
    tmp_path: Path, good: pd.DataFrame, refuse: Callable[..., Refusal], command: str, kept: float
) -> None:
    path = tmp_path / "drive.parquet"
    good.to_parquet(path, index=False)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    said = refuse(*COMMANDS[command](path, tmp_path))
    assert has_four_parts(said.line) and "Parquet" in said.line and str(path) in said.line


def test_a_column_given_twice(tmp_path: Path, good: pd.DataFrame, refuse: Callable[..., Refusal]) -> None:
    text = good.assign(again=good["p_im_pa"]).to_csv(index=False)
    path = tmp_path / "drive.csv"
    path.write_text(text.replace("again", "p_im_pa", 1))
    said = refuse(*COMMANDS["identify"](path, tmp_path))
    assert has_four_parts(said.line) and "p_im_pa" in said.line and "twice" in said.line


@pytest.mark.parametrize("command", ["imply", "calibrate", "learn", "channels", "simulate"])
def test_an_ending_that_can_not_be_written_is_refused_before_the_work(
    tmp_path: Path, good: pd.DataFrame, refuse: Callable[..., Refusal], command: str
) -> None:
    """`imply` said it after the work, and three commands in three ways."""
    good.to_csv(tmp_path / "drive.csv", index=False)
    engine = ("--engine", str(tmp_path / "none.yaml")) if command == "imply" else ()
    said = refuse(command, str(tmp_path / "drive.csv"), *engine, "--out", str(tmp_path / "a.pdf"))
    assert f"--out {tmp_path / 'a.pdf'}: got ending .pdf; allowed: ." in said.line


@pytest.mark.parametrize("content", [b"\x00\x01\x02\xff" * 200, b'time_s,n_e_rpm\n1,2,3,4\n"unclosed', b"\n\n\n"])
def test_a_file_that_is_no_csv(tmp_path: Path, refuse: Callable[..., Refusal], content: bytes) -> None:
    path = tmp_path / "drive.csv"
    path.write_bytes(content)
    assert has_four_parts(refuse(*COMMANDS["identify"](path, tmp_path)).line)


def test_no_such_file_a_folder_and_another_kind(tmp_path: Path, refuse: Callable[..., Refusal]) -> None:
    assert "no such file" in refuse(*COMMANDS["identify"](tmp_path / "none.csv", tmp_path)).line
    (tmp_path / "folder.csv").mkdir()
    assert "a folder" in refuse(*COMMANDS["identify"](tmp_path / "folder.csv", tmp_path)).line
    (tmp_path / "drive.pdf").write_text("%PDF-1.7")
    assert "Parquet" in refuse(*COMMANDS["identify"](tmp_path / "drive.pdf", tmp_path)).line


# --- settings and options


@pytest.fixture
def drive(tmp_path: Path, good: pd.DataFrame) -> Path:
    path = tmp_path / "drive.parquet"
    good.to_parquet(path, index=False)
    return path


def test_unknown_key_in_params(tmp_path: Path, project_root: Path, drive: Path, refuse: Callable[..., Refusal]) -> None:
    text = (project_root / "params.yaml").read_text(encoding="utf-8")
    path = tmp_path / "params.yaml"
    path.write_text(text.replace("segment_s: 60.0", "segmnet_s: 60.0", 1), encoding="utf-8")
    for command in (("identify", drive, "--out", tmp_path / "out"), ("params", "show")):
        said = refuse(*command, "--params", path)
        assert has_four_parts(said.line) and "segmnet_s" in said.line and "did you mean segment_s?" in said.line
    path.write_text(text.replace("alarm_gain: 18.0", "alarm_gian: 18.0", 1), encoding="utf-8")
    said = refuse("discover", drive, "--out", tmp_path / "out", "--params", path)
    assert has_four_parts(said.line) and "discover.search.driving" in said.line and "mean alarm_gain" in said.line


def test_unknown_profile(tmp_path: Path, drive: Path, refuse: Callable[..., Refusal]) -> None:
    said = refuse("identify", drive, "--out", tmp_path / "out", "--profile", "quik")
    assert "did you mean quick?" in said.line


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("A_egrmaxx: 4.0e-4", ("A_egrmaxx", "did you mean", "A_egrmax")),
        ("A_egrmax: -1.0", ("A_egrmax", "-1.0")),
        ("A_egrmax: large", ("A_egrmax", "large")),
        ("V_d: 12.7", ("V_d", "12.7", "less than 10", "displacement [m3]")),
        ("- a\n- list", ("mapping",)),
        ("a: [1", ("YAML",)),
    ],
)
def test_engine_file(
    tmp_path: Path, drive: Path, refuse: Callable[..., Refusal], command: str, content: str, words: tuple[str, ...]
) -> None:
    engine = tmp_path / "engine.yaml"
    engine.write_text(content)
    said = refuse(*COMMANDS[command](drive, tmp_path), "--engine", engine)
    assert has_four_parts(said.line) and str(engine) in said.line
    assert all(word in said.line for word in words), said.line


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("P_boost: p_im_pa", ("P_boost",)),
        ("p_im_pa: {column: p_im_pa, unit: furlong}", ("furlong",)),
        ("p_im_pa: {column: p_im_pa, scal: 2}", ("did you mean scale?",)),
    ],
)
def test_channel_map(
    tmp_path: Path, drive: Path, refuse: Callable[..., Refusal], content: str, words: tuple[str, ...]
) -> None:
    channels = tmp_path / "map.yaml"
    channels.write_text(content)
    said = refuse(*COMMANDS["identify"](drive, tmp_path), "--channels", channels)
    assert has_four_parts(said.line) and all(word in said.line for word in words), said.line


def test_options(tmp_path: Path, drive: Path, refuse: Callable[..., Refusal]) -> None:
    out = tmp_path / "out"
    assert "did you mean classical?" in refuse("identify", drive, "--out", out, "--method", "clasical").line
    assert "1 or more" in refuse("identify", drive, "--out", out, "--runs", "0").line
    assert "10 to 3600 s" in refuse("identify", drive, "--out", out, "--segment", "1").line
    assert "did you mean paper?" in refuse("identify", drive, "--out", out, "--maps", "papper").line
    assert ".parquet" in refuse("simulate", drive, "--out", tmp_path / "out.xlsx").line
    assert "--out" in refuse("simulate", drive).line
    assert "--runs" in refuse("identify", drive, "--out", out, "--runs", "many").line
    assert "--help" in refuse("identify", drive, "--oot", out).line
    assert "identify" in refuse("identifi", drive).line


@pytest.mark.parametrize(
    ("command", "document", "of"),
    [("identify", "discrepancy.json", "discover"), ("discover", "identification.json", "identify")],
)
def test_a_folder_with_another_commands_results(
    tmp_path: Path, drive: Path, refuse: Callable[..., Refusal], command: str, document: str, of: str
) -> None:
    """Both write `report.html`: the other's page would be lost without a word."""
    out = tmp_path / "out"
    out.mkdir()
    (out / document).write_text("{}")
    said = refuse(command, drive, "--out", out)
    assert has_four_parts(said.line) and f"the results of {of}," in said.line


@pytest.mark.parametrize("words", [("--out", ""), ("--out="), ("--out", " "), ("--channels", "", "--out", "there")])
def test_an_empty_text_is_no_folder(
    tmp_path: Path, drive: Path, refuse: Callable[..., Refusal], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    """A variable of the shell that isn't set would be the current folder."""
    monkeypatch.chdir(tmp_path)
    words = (words,) if isinstance(words, str) else words
    for command in ("identify", "simulate"):
        said = refuse(command, drive, *words)
        assert has_four_parts(said.line) and words[0].rstrip("=") in said.line and "an empty text" in said.line
    assert "an argument" in refuse("discover", "", "--out", "there").line


METHODS_WITH_NETWORKS = [
    ("--method", "few-shot-adam"),
    ("--method", "few-shot-newton"),
    ("--method", "multi-stage"),
    ("--maps", "improved"),
]


@pytest.mark.parametrize("option", METHODS_WITH_NETWORKS, ids=lambda o: o[1])
def test_models(tmp_path: Path, drive: Path, refuse: Callable[..., Refusal], option: tuple[str, str]) -> None:
    command = ("identify", drive, "--out", tmp_path / "out", *option)
    assert "no such folder" in refuse(*command, "--models", tmp_path / "none").line
    (tmp_path / "models").mkdir()
    said = refuse(*command, "--models", tmp_path / "models")
    assert has_four_parts(said.line) and ".pt" in said.line and "make run" in said.line
    for name in ("maps_paper.pt", "maps_improved.pt", "operators.pt", "bodies_paper.pt", "bodies_conditioned.pt"):
        (tmp_path / "models" / name).write_bytes(b"no network")
    said = refuse(*command, "--models", tmp_path / "models")
    assert has_four_parts(said.line) and ".pt" in said.line


# --- places that cannot be written to


def cli(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", "dieseltwin", *[str(a) for a in arguments]]


def can_mount() -> bool:
    if shutil.which("unshare") is None or os.geteuid() != 0:
        return False
    return subprocess.run(["unshare", "-m", "true"], capture_output=True, check=False).returncode == 0


needs_mount = pytest.mark.skipif(not can_mount(), reason="needs root and its own mount namespace")


RUN_ALL = """
import contextlib, io, json, os, sys
from dieseltwin.cli.app import main
done = []
for command in json.load(sys.stdin):
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        code = main(command)
    done.append([code, said.getvalue().splitlines()])
print(json.dumps(done))
"""
"""A program that runs several commands: the libraries are imported once."""
Said = tuple[int, list[str]]


def run_all(commands: list[list[str]], before: Sequence[str] = (), **options: Any) -> list[Said]:
    """Exit code and lines on stderr of each command, all in one process that is begun by `before`."""
    done = subprocess.run([*before, sys.executable, "-c", RUN_ALL], input=json.dumps(commands), capture_output=True,
                          text=True, check=False, timeout=240, **options)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return [(code, said) for code, said in json.loads(done.stdout)]


PLACES = {"full": ("size=16k", "no space left"), "read-only": ("ro", "read-only"),
          "with an old result": ("size=16k", "no space left")}  # fmt: skip
"""Name -> options of the mount, what is said there."""
MOUNTED = """
while [ "$1" != -- ]; do mount -t tmpfs -o "$1" tmpfs "$2" || exit 99; shift 2; done
shift; old="$1"; log="$2"; shift 2; echo old > "$old"
"$@"; code=$?
find "$(dirname "$(dirname "$old")")"/disk-* -type f > "$log"; cat "$old" >> "$log"
exit $code
"""


@needs_mount
def test_full_disk_and_read_only_folder(tmp_path: Path, drive: Path) -> None:
    """Commands into mounts that only they see: said in a line, nothing is left, and an old result is kept."""
    commands, mounts = [], []
    for k, (options, _) in enumerate(PLACES.values()):
        for name in ("simulate", "simulate-csv", "identify") if k < 2 else ("simulate-csv",):
            folder = tmp_path / f"disk-{k}-{name}"
            folder.mkdir()
            commands.append({
                "simulate": ["simulate", str(drive), "--out", str(folder / "out.parquet")],
                "simulate-csv": ["simulate", str(drive), "--out", str(folder / "out.csv")],
                "identify": ["identify", str(drive), "--out", str(folder), "--runs", "1"],
            }[name])  # fmt: skip
            mounts += [options, str(folder)]
    old, log = tmp_path / "disk-2-simulate-csv" / "out.csv", tmp_path / "left.txt"
    begun = ["unshare", "-m", "sh", "-c", MOUNTED, "sh", *mounts, "--", str(old), str(log)]
    answers = run_all(commands, begun)
    for (code, said), words in zip(answers, [w for _, w in PLACES.values() for _ in range(3)], strict=False):
        assert code == 2, said
        assert len(said) == 1 and words in said[0] and has_four_parts(said[0]), said
    assert log.read_text().splitlines() == [str(old), "old"]


def test_disk_full_for_this_user(tmp_path: Path, drive: Path) -> None:
    """A limit on file size: the one kind of full disk that any user can make."""
    limited = ["sh", "-c", 'ulimit -f 8; "$@"', "sh", *cli("simulate", drive, "--out", tmp_path / "out.csv")]
    done = subprocess.run(limited, capture_output=True, text=True, check=False, timeout=240)
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1 and "no space left" in done.stderr
    assert {p.name for p in tmp_path.iterdir()} == {drive.name}


def test_folder_without_permission(tmp_path: Path, drive: Path) -> None:
    closed = tmp_path / "closed"
    closed.mkdir()
    tmp_path.chmod(0o755)
    for parent in tmp_path.parents:  # down from pytest's own folder, one level deeper under xdist
        parent.chmod(parent.stat().st_mode | 0o055)
        if parent.name.startswith("pytest-of-"):
            break
    closed.chmod(0o555)
    drop = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"] if os.geteuid() == 0 else []
    if drop and (shutil.which("setpriv") is None or subprocess.run(
        [*drop, sys.executable, "-c", "import dieseltwin"], capture_output=True, check=False
    ).returncode != 0):  # fmt: skip
        pytest.skip("root may write anywhere, and another user cannot run this interpreter")
    home = tmp_path / "home"  # the compiled simulator is cached somewhere
    home.mkdir(mode=0o777)
    home.chmod(0o777)
    outs = {"simulate": closed / "out.csv", "identify": closed / "out"}
    commands = [[name, str(drive), "--out", str(out)] for name, out in outs.items()]
    for code, said in run_all(commands, drop, env={**os.environ, "HOME": str(home)}):
        assert code == 2 and len(said) == 1 and "permission denied" in said[0], said
    assert list(closed.iterdir()) == []


@pytest.mark.parametrize("name", ["simulate", "identify"])
def test_unreadable_recording(tmp_path: Path, monkeypatch, capsys, name: str) -> None:  # type: ignore[no-untyped-def]
    """Folders above a file can be closed: even asking whether it exists is refused then."""
    source = tmp_path / "drive.parquet"

    there = os.stat

    def refused(path: Any, *arguments: Any, **options: Any) -> os.stat_result:
        if Path(str(path)).name != source.name:
            return there(path, *arguments, **options)
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(os, "stat", refused)
    arguments = ["simulate", str(source), "--out", str(tmp_path / "o.csv")]
    assert main(arguments if name == "simulate" else ["identify", str(source), "--out", str(tmp_path / "o")]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and "drive.parquet" in said[0] and "permission denied" in said[0]
