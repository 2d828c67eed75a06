"""Recordings and engine files that can't be used are one clear line; the commands write a document that can be read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.api.discovery import ask
from dieseltwin.api.petrol import PetrolCalibrated, PetrolQuestion
from dieseltwin.challenge.petrol_plant import drive
from dieseltwin.cli.app import main
from dieseltwin.discovery.verdict.document import load_discrepancy
from dieseltwin.errors import InputError
from dieseltwin.petrol.calibrate import calibrate, fit_maps
from dieseltwin.petrol.model import IDLE_RAD_S, SHUT_PCT
from dieseltwin.petrol.parameters import FaultFreePiece, PetrolParameters, PetrolTerm, load_petrol, save_petrol
from dieseltwin.petrol.recording import COLUMNS, PetrolRecording, pooled, read_petrol
from dieseltwin.recordings.channels import channel_map
from tests.pages import check_page

pytestmark = pytest.mark.usefixtures("no_pictures")  # drawn in end_to_end/test_petrol.py
Recorder = Callable[..., PetrolRecording]


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return drive(90.0, 8)


def _written(frame: pd.DataFrame, tmp_path: Path) -> Path:
    path = tmp_path / "drive.csv"
    frame.to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.drop(columns="p_ic_Pa"), "no p_ic_pa"),
        (lambda t: t.assign(p_im_Pa=t.p_im_Pa / 1e3), "p_im_pa.*convert to Pa"),
        (lambda t: t.assign(T_ic_K=t.T_ic_K - 273.15), "t_ic_k.*convert to K"),
        (lambda t: t.assign(W_af_kg_s=t.W_af_kg_s * 3600), "w_af_kg_s"),
        (lambda t: t.assign(alpha_th_pct=t.alpha_th_pct / 100), "alpha_th_pct.*looks like a fraction"),
        (lambda t: t.iloc[::-1], "no rise at data row 2"),
        (lambda t: t.iloc[:300], "at least 60 s"),
    ],
)
def test_unfit_recordings(table: pd.DataFrame, tmp_path: Path, change, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=words):
        read_petrol(_written(change(table.copy()), tmp_path))


def test_any_format_and_a_table_say_the_same(table: pd.DataFrame, tmp_path: Path) -> None:
    known = read_petrol(_written(table, tmp_path)).signals
    german = tmp_path / "german.csv"
    table.to_csv(german, index=False, sep=";", decimal=",", encoding="utf-16")
    table.to_excel(tmp_path / "drive.xlsx", index=False)
    table.to_parquet(tmp_path / "drive.parquet", index=False)
    foreign = table.rename(columns={"p_im_Pa": "MAP"}).assign(MAP=table["p_im_Pa"] / 1e3)
    in_kpa = channel_map({"MAP": {"column": "p_im_pa", "unit": "kPa"}})
    sources = (german, tmp_path / "drive.xlsx", tmp_path / "drive.parquet", table)
    in_our_names = [dt.read(source, engine=PetrolParameters()) for source in sources]
    for found in (*in_our_names, dt.read(foreign, in_kpa, engine=PetrolParameters())):
        assert isinstance(found, PetrolRecording)
        np.testing.assert_allclose(found.signals.p_im, known.p_im, rtol=1e-12)
        np.testing.assert_allclose(found.signals.W_af, known.W_af, rtol=1e-12)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_petrol(tmp_path / "no.csv")


def test_holes_are_bridged(table: pd.DataFrame, tmp_path: Path) -> None:
    holed = table.copy()
    holed.loc[200:230, "p_im_Pa"] = float("nan")
    assert len(read_petrol(_written(holed, tmp_path)).signals.time_s) == len(table) - 31


@pytest.mark.thorough
def test_learned_from_two_recordings_in_any_order(
    record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = (record(seed, 310.0) for seed in (21, 22))
    files = []
    for k, order in enumerate([(first, second), (second, first, second)]):
        files.append(tmp_path / f"mine_{k}.yaml")
        options = ["--engine", "liu_petrol", "--out", str(files[-1])]
        assert main(["learn", *(r.path for r in order), *options]) == 0
    assert files[0].read_bytes() == files[1].read_bytes()
    assert load_petrol(files[0]).calibrated and "takes it\n" in capsys.readouterr().out
    assert main(["learn", first.path, "--engine", str(files[0]), "--out", str(tmp_path / "more.yaml")]) == 2
    said = capsys.readouterr().err
    assert f"got {files[0]}, which has its maps" in said and "all recordings at once" in said


def test_rows_of_a_reference_count_once(record: Recorder, tmp_path: Path) -> None:
    first, second = record(21, 120.0), record(22, 120.0)
    crlf = tmp_path / "crlf.csv"
    crlf.write_bytes(Path(first.path).read_bytes().replace(b"\n", b"\r\n"))
    together, copied = pooled([first, second]), pooled([read_petrol(crlf), second, first])
    assert len(copied.signals.time_s) == len(together.signals.time_s)
    piece = read_petrol(_written(pd.read_csv(first.path).iloc[:1800], tmp_path))
    with pytest.raises(InputError, match="of its rows in another of the recordings"):
        pooled([first, second, piece])


def test_an_alarm_in_the_reference_is_said_by_every_discovery(engine: PetrolParameters, record: Recorder) -> None:
    alarmed = FaultFreePiece(start_s=0.0, end_s=300.0, gain=551.0, name="w_af_gain", alarm=True)
    doubted = engine.model_copy(update={"pieces": (alarmed, alarmed.model_copy(update={"alarm": False}))})
    question = ask(record(23, 120.0), doubted)
    assert isinstance(question, PetrolQuestion)
    assert "1 of 2 pieces that the engine was learned from raises an alarm" in " ".join(question.notes)
    sure = ask(record(23, 120.0), engine)
    assert isinstance(sure, PetrolQuestion) and sure.notes == ()


@pytest.mark.thorough
def test_learned_from_references_in_one_go(
    record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    healthy = record(1, 620.0)
    faulty = record(10, 240.0, onset_s=100.0, W_af_kg_s=0.12)
    base = ["discover", faulty.path, "--engine", "liu_petrol", "--out", str(tmp_path / "out")]
    assert main([*base, "--reference", healthy.path]) == 0
    assert load_discrepancy(tmp_path / "out").effects[0].name == "w_af_gain"
    assert load_petrol(tmp_path / "out" / "engine.yaml").calibrated
    capsys.readouterr()
    assert main([*base[:-1], str(tmp_path / "same"), "--reference", faulty.path]) == 2
    assert "the reference itself" in capsys.readouterr().err
    piece = pd.read_csv(healthy.path).iloc[2000:6000]
    cut = _written(piece, tmp_path)
    assert main(["discover", str(cut), *base[2:], "--reference", healthy.path]) == 2
    assert "of its rows are in the reference" in capsys.readouterr().err
    mine = save_petrol(load_petrol(tmp_path / "out" / "engine.yaml"), tmp_path / "mine.yaml")
    assert main([*base[:3], str(mine), *base[4:], "--reference", healthy.path]) == 2
    assert f"--reference: got beside {mine}, which has its maps already" in capsys.readouterr().err


@pytest.mark.thorough
def test_calibrated_anew_is_learned(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`calibrate` takes a channel map as `learn` does, and the effects that its base holds aren't in the new engine."""
    table = pd.read_csv(record(1, 900.0).path)
    foreign = _written(table.rename(columns={"p_im_Pa": "MAP"}).assign(MAP=table.p_im_Pa / 1e3), tmp_path)
    (tmp_path / "map.yaml").write_text("MAP: {column: p_im_pa, unit: kPa}\n", encoding="utf-8")
    faulty = engine.model_copy(update={"terms": (PetrolTerm(effect="w_af_gain", magnitude=0.1, std=0.01),)})
    base = save_petrol(faulty, tmp_path / "base.yaml")
    channels = ["--channels", str(tmp_path / "map.yaml")]
    assert main(["calibrate", str(foreign), "--base", str(base), *channels, "--out", str(tmp_path / "new.yaml")]) == 0
    assert "w_af_gain among the terms" in capsys.readouterr().out
    found = load_petrol(tmp_path / "new.yaml")
    assert found.terms == () and found.cylinder is not None and engine.cylinder is not None
    np.testing.assert_allclose(found.cylinder.coefficients, engine.cylinder.coefficients, atol=0.01)


def test_too_short_to_calibrate(record: Recorder) -> None:
    with pytest.raises(InputError, match="at least 600 s"):
        calibrate(record(9, 120.0).signals, PetrolParameters(), "")


@pytest.mark.parametrize("column", ["omega_e_rad_s", "alpha_th_pct", "p_im_Pa"])
def test_a_reference_in_which_nothing_moves_is_refused(record: Recorder, column: str) -> None:
    table = pd.read_csv(record(1, 900.0).path)
    still = read_petrol(table.assign(**{column: float(table[column].median())})).signals
    with pytest.raises(InputError, match=f"{column.lower()}: got the same reading"):
        fit_maps(still, PetrolParameters())


def test_signals_of_a_standing_engine_are_refused(record: Recorder) -> None:
    """The reader leaves such rows out; signals from elsewhere may hold them."""
    s = record(1, 900.0).signals
    standing = replace(s, omega_e=np.where((s.time_s >= 300.0) & (s.time_s < 305.0), 0.0, s.omega_e))
    with np.errstate(divide="ignore"), pytest.raises(InputError, match="5 s without a cylinder's balance"):
        fit_maps(standing, PetrolParameters())


def test_a_throttle_that_reads_below_nothing_is_shut(record: Recorder, engine: PetrolParameters) -> None:
    table = pd.read_csv(record(1, 900.0).path)
    table.loc[table.time_s.between(300.0, 303.0), "alpha_th_pct"] = -1.5
    found, _ = fit_maps(read_petrol(table).signals, PetrolParameters())
    assert found.throttle is not None and np.isfinite(found.throttle.coefficients).all()
    assert found.cylinder is not None and engine.cylinder is not None
    np.testing.assert_allclose(found.cylinder.coefficients, engine.cylinder.coefficients, atol=0.02)


def test_pauses_and_a_piece_that_cannot_be_judged(record: Recorder) -> None:
    """A pause as long as three pieces is no piece; without the last one nothing idles, so it isn't judged."""
    table = pd.read_csv(record(1, 1400.0).path)
    table["time_s"] += 900.0 * (table.time_s > 350.0)
    idling = (table.alpha_th_pct < SHUT_PCT) & (table.omega_e_rad_s < IDLE_RAD_S)
    paused = read_petrol(table[~idling | (table.time_s > 2140.0)])
    found, fits, unjudged = calibrate(paused.signals, PetrolParameters(), "")
    assert [piece.start_s for piece in found.pieces] == [0.0]
    result = PetrolCalibrated(found, tuple(fits), unjudged=unjudged)
    assert result.sentence.endswith(": 0 false alarms on 1 fault-free pieces; 1 more couldn't be judged.")
    assert result.lines()[-1].endswith("; 1 more couldn't be judged")
    none = replace(result, engine=found.model_copy(update={"pieces": ()}), unjudged=2)
    assert none.sentence.endswith(": false alarms aren't known, as none of 2 fault-free pieces could be judged.")


def test_engine_without_maps(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"dieseltwin learn HEALTHY --engine .*empty\.yaml"):
        load_petrol(save_petrol(PetrolParameters(), tmp_path / "empty.yaml"))


def test_discover_command(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = save_petrol(engine, tmp_path / "engine.yaml")
    recording = record(10, 240.0, onset_s=100.0, W_af_kg_s=0.12)
    out = tmp_path / "out"
    assert main(["discover", recording.path, "--engine", str(file), "--out", str(out)]) == 0
    assert "w_af_gain" in capsys.readouterr().out
    assert load_discrepancy(out).effects[0].name == "w_af_gain"
    assert {p.name for p in (out / "figures").iterdir()} == {
        "residuals_over_time.png", "over_pressure.png", "candidates.svg"
    }  # fmt: skip
    check_page(out / "report.html", "reading=Waf(1+g)")


def test_engine_of_a_discovery_is_accepted_by_the_next_and_by_simulate(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = save_petrol(engine, tmp_path / "engine.yaml")
    recording = str(record(10, 240.0, onset_s=100.0, W_af_kg_s=0.12).path)
    assert main(["discover", recording, "--engine", str(file), "--out", str(tmp_path / "one")]) == 0
    repaired = str(tmp_path / "one" / "engine.yaml")
    assert main(["discover", recording, "--engine", repaired, "--out", str(tmp_path / "two")]) == 0
    assert not load_discrepancy(tmp_path / "two").mismatch
    off = {}
    for name, used in (("before", str(file)), ("after", repaired)):
        out = tmp_path / f"{name}.parquet"
        assert main(["simulate", recording, "--engine", used, "--out", str(out)]) == 0
        table = pd.read_parquet(out)
        measured = pd.read_csv(recording)
        off[name] = float((table.w_af_kg_s - measured.W_af_kg_s).abs().median())
    assert off["after"] < 0.5 * off["before"]
    capsys.readouterr()


@pytest.mark.thorough
def test_choices_of_the_user(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = save_petrol(engine, tmp_path / "engine.yaml")
    table = pd.read_csv(record(11, 180.0, onset_s=80.0, p_im_Pa=0.1).path)
    foreign = table.rename(columns={"p_im_Pa": "MAP"}).assign(MAP=table.p_im_Pa / 1e3)
    recording = _written(foreign, tmp_path)
    (tmp_path / "map.yaml").write_text("MAP: {column: p_im_pa, unit: kPa}\n", encoding="utf-8")
    base = ["discover", str(recording), "--engine", str(file), "--channels", str(tmp_path / "map.yaml")]
    withheld = ["--withhold", "p_im_gain,p_im_offset", "--explain", "p_im_gain"]
    assert main([*base, "--out", str(tmp_path / "a"), *withheld]) == 0
    assert "withheld" in capsys.readouterr().out
    names = {n for e in load_discrepancy(tmp_path / "a").effects for n in e.names}
    assert not names & {"p_im_gain", "p_im_offset"}
    used = "p_im_pa,w_af_kg_s,omega_e_rad_s,p_ic_pa,t_ic_k,alpha_th_pct,p_amb_pa"
    chosen = ["--sensors", used, "--map-tolerance", "0.03", "--explain", "p_im_gain"]
    assert main([*base, "--out", str(tmp_path / "b"), *chosen]) == 0
    assert "chosen" in capsys.readouterr().out
    document = load_discrepancy(tmp_path / "b")
    assert "t_amb_k" not in document.recording.channels and document.effects[0].name == "p_im_gain"


@pytest.mark.thorough
def test_explained_from_what_is_there(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--explain` reads DIR where it holds the answer to the same question, and searches anew for any other."""
    file = save_petrol(engine, tmp_path / "engine.yaml")
    out = tmp_path / "out"
    recording = record(11, 180.0, onset_s=80.0, p_im_Pa=0.1)
    base = ["discover", recording.path, "--engine", str(file), "--out", str(out)]
    assert main(base) == 0
    written = (out / "runtime.json").read_bytes()
    assert main([*base, "--explain", "w_af_gain"]) == 0
    assert (out / "runtime.json").read_bytes() == written and "w_af_gain" in capsys.readouterr().out
    assert main(["discover", "--out", str(out), "--explain", "w_af_gain"]) == 0  # by the engine beside the answer
    assert "w_af_gain" in capsys.readouterr().out
    assert main([*base, "--explain", "w_af_gain", "--map-tolerance", "0.03"]) == 0
    assert (out / "runtime.json").read_bytes() != written


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--sensors", "p_im_pa"], "only p_amb_pa and t_amb_k can be left out"),
        (["--sensors", "p_im_kpa"], "p_im_pa"),
        (["--withhold", "p_im_gian"], "p_im_gain"),
        (["--explain", "w_af_gian"], "w_af_gain"),
        (["--map-tolerance", "2"], "--map-tolerance"),
    ],
)
def test_choices_that_mean_nothing(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    options: list[str], words: str,
) -> None:  # fmt: skip
    file = save_petrol(engine, tmp_path / "engine.yaml")
    out = tmp_path / "out"
    assert main(["discover", str(record(9, 120.0).path), "--engine", str(file), "--out", str(out), *options]) == 2
    assert words in capsys.readouterr().err and not out.exists()


@pytest.mark.parametrize("missing", [("T_amb_K",), ("p_amb_Pa", "T_amb_K")], ids=len)
def test_judged_without_the_surroundings(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    missing: tuple[str, ...],
) -> None:  # fmt: skip
    """A file without the columns that --sensors leaves out is judged as one with them; without --sensors it says so."""
    file = save_petrol(engine, tmp_path / "engine.yaml")
    table = pd.read_csv(record(11, 180.0, onset_s=80.0, p_im_Pa=0.1).path)
    bare = _written(table.drop(columns=list(missing)), tmp_path)
    base = ["discover", str(bare), "--engine", str(file), "--out", str(tmp_path / "out")]
    assert main(base) == 2
    assert "or leave them out with --sensors" in capsys.readouterr().err
    used = [c.lower() for c in table if c.lower() in COLUMNS and c not in missing]
    assert main([*base, "--sensors", ",".join(used)]) == 0
    assert "not recorded and taken" in capsys.readouterr().out
    effect = load_discrepancy(tmp_path / "out").effects[0]
    assert effect.name == "p_im_gain" and effect.magnitude == pytest.approx(0.1, abs=0.01)


def test_engines_that_do_not_fit_the_command(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = str(record(9, 120.0).path)
    assert main(["discover", recording, "--engine", "liu_petrol", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "liu_petrol, which isn't calibrated yet" in said and "--reference" in said
    assert main(["simulate", recording, "--engine", "liu_petrol", "--out", str(tmp_path / "out.csv")]) == 2
    assert "no maps" in capsys.readouterr().err
    file = save_petrol(engine, tmp_path / "engine.yaml")
    assert main(["imply", recording, "--engine", str(file), "--out", str(tmp_path / "out.csv")]) == 2
    assert "kind 'petrol'" in capsys.readouterr().err


def test_options_of_the_diesel_engine_are_refused(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = save_petrol(engine, tmp_path / "engine.yaml")
    recording = str(record(9, 120.0).path)
    commands = [
        ["simulate", recording, "--engine", str(file), "--effect", "egr_leak=1", "--out", str(tmp_path / "out.csv")],
        ["calibrate", recording, "--base", "liu_petrol", "--noise", "1", "--out", str(tmp_path / "new.yaml")],
    ]
    for command in commands:
        assert main(command) == 2
        assert "petrol" in capsys.readouterr().err
    assert not (tmp_path / "out.csv").exists() and not (tmp_path / "new.yaml").exists()
