"""`dieseltwin channels`: right first guesses on foreign names, never a wrong one without a warning, maps that work."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from foreign import AMBIENT, FILES, TO, Foreign, drive, expected, without_names, written
from foreign_later import LATER
from foreign_public import AGAIN, PUBLIC
from foreign_unseen import UNSEEN

from dieseltwin.cli.app import main
from dieseltwin.recordings.channels import channel_map
from dieseltwin.recordings.guess.dictionary import translated
from dieseltwin.recordings.guess.facts import clock_of, facts_of, signals_of
from dieseltwin.recordings.guess.names import vocabulary, words_of
from dieseltwin.recordings.guess.physics import ranks_agree
from dieseltwin.recordings.guess.propose import LEAST_SCORE, Proposal, propose
from dieseltwin.recordings.guess.words import channel_lines, map_text
from dieseltwin.recordings.importers.read import read_raw
from dieseltwin.recordings.importers.signals import RawChannels, Signal, unique_names
from dieseltwin.recordings.reader import read_recording
from dieseltwin.recordings.unit_spellings import understood

REFERENCE = Path(__file__).parents[2] / "reference" / "field_random_300s.csv"
CLOSE = 0.02  # of the mean: a guess is right when its values are, unit, offset and formula included
WANTED_SHARE = 0.9
ALL = {file.title: file for file in (*FILES, *LATER, *PUBLIC, *AGAIN, *UNSEEN)}
Judged = tuple[list[str], list[str], list[str]]


@pytest.fixture(scope="module")
def known() -> dict[str, np.ndarray]:
    return drive(pd.read_csv(REFERENCE).iloc[:751])  # 150 s


def proposed(file: Foreign, known: dict[str, np.ndarray], folder: Path) -> Proposal:
    path = folder / "drive.csv"
    path.write_text(written(file, known))
    return propose(read_raw(path), cylinders=6)


def judged(file: Foreign, proposal: Proposal, known: dict[str, np.ndarray]) -> Judged:
    """Columns guessed right, guessed wrong with a warning, and wrong without."""
    right, warned, silent = [], [], []
    signals, truth = signals_of(proposal.raw), expected(file)
    for column, candidate in proposal.guesses.items():
        entry = candidate.reading.entry
        values = entry.derived(entry.converted(signals[candidate.channel].values), known)
        error = np.nanmedian(np.abs(values - known[column])) / np.abs(known[column]).mean()
        if truth.get(column) == candidate.channel and error < CLOSE:
            right.append(column)
        else:
            (warned if candidate.reading.warnings else silent).append(column)
    return right, warned, silent


@pytest.fixture(scope="module")
def verdicts(known, tmp_path_factory) -> dict[str, Judged]:
    folder = tmp_path_factory.mktemp("foreign")
    return {title: judged(file, proposed(file, known, folder), known) for title, file in ALL.items()}


@pytest.mark.parametrize("title", ALL)
def test_no_wrong_guess_without_a_warning(verdicts, title):
    assert verdicts[title][2] == []


def test_nine_of_ten_first_guesses_are_right(verdicts):
    for files in ((*FILES, *LATER), (*PUBLIC, *AGAIN, *UNSEEN)):
        right = sum(len(verdicts[file.title][0]) for file in files)
        asked = sum(len(expected(file)) for file in files)
        assert asked > 160 and right / asked >= WANTED_SHARE
    assert len(ALL) == 62


@pytest.mark.parametrize("title", ["codes of a test bench", "American units, gauge", "a generating set"])
def test_units_and_behaviour_tell_channels_without_names(tmp_path, known, title):
    """Names that say nothing, in any order: what each channel does is enough, and every guess is marked."""
    file = ALL[title]
    nameless = without_names(file)
    proposal = proposed(nameless, known, tmp_path)
    right, warned, silent = judged(nameless, proposal, known)
    assert sorted(right) == sorted(expected(file)) and not warned and not silent
    assert all(guess.reading.warnings for guess in proposal.guesses.values())
    text = map_text(proposal)
    assert text.count("told by its unit and by what it does, not by its name: check") == len(right)


def test_channels_without_names_and_units_are_left_alone(tmp_path, known):
    frame = pd.DataFrame({"time_s": known["time_s"], "ch1": known["n_e_rpm"], "ch2": known["p_im_pa"] / 1e3})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    assert propose(read_raw(tmp_path / "drive.csv")).guesses == {}


@pytest.mark.parametrize("flow", ["w_egr_kg_s", "w_c_kg_s"])
def test_a_valve_that_counts_the_other_way_is_turned_round(tmp_path, known, flow):
    """By the EGR flow, or without one by what the cylinders take in beside the air."""
    columns = {name: known[name] for name in ("time_s", "n_e_rpm", "p_im_pa", flow)}
    frame = pd.DataFrame(columns | {"EGR valve position [%]": 100.0 - known["u_egr_pct"]})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    guess = propose(read_raw(tmp_path / "drive.csv")).guesses["u_egr_pct"]
    assert (guess.reading.entry.scale, guess.reading.entry.offset) == (-1.0, 100.0)
    assert any("0 seems to be open" in warning for warning in guess.reading.warnings)


def test_a_boost_sensor_that_reads_high_makes_no_gauge_pressure_of_the_exhausts(tmp_path, known):
    frame = pd.DataFrame({name: known[name] for name in ("time_s", "n_e_rpm", "w_egr_kg_s", "w_c_kg_s")}
                         | {"boost pressure [kPa]": known["p_im_pa"] / 1e3 * 1.08,
                            "exhaust pressure [kPa]": known["p_em_pa"] / 1e3})  # fmt: skip
    frame.to_csv(tmp_path / "drive.csv", index=False)
    assert propose(read_raw(tmp_path / "drive.csv")).guesses["p_em_pa"].reading.entry.via is None


def test_channels_of_one_name_are_told_by_their_groups(known):
    time_s = known["time_s"]
    signals = unique_names([
        Signal("Speed", "rpm", time_s, known["n_e_rpm"], "Engine"),
        Signal("Pressure", "kPa", time_s, known["p_im_pa"] / 1e3, "IntakeManifold"),
        Signal("Pressure", "kPa", time_s, known["p_em_pa"] / 1e3, "ExhaustManifold"),
        Signal("Speed", "rpm", time_s, known["omega_t_rad_s"] * 30.0 / np.pi, "Turbocharger"),
    ])  # fmt: skip
    guesses = propose(RawChannels(Path("drive.mf4"), "MDF 4.10", signals)).guesses
    assert {column: guess.channel for column, guess in guesses.items()} == {
        "n_e_rpm": "Speed", "p_im_pa": "Pressure", "p_em_pa": "Pressure (ExhaustManifold)",
        "omega_t_rad_s": "Speed (Turbocharger)"}  # fmt: skip
    assert all("where it stands in the file" in str(guesses[column].reading.warnings)
               for column in ("p_im_pa", "p_em_pa", "omega_t_rad_s"))  # fmt: skip


def test_two_engines_on_a_bus_are_not_mixed(known):
    """The second engine sends a boost pressure that the first doesn't: it is no channel of the first."""
    def sent(spn: int, column: str, address: int, scale: float) -> Signal:
        name = f"SPN {spn} ({address})"
        return Signal(name, "rpm" if spn == 190 else "kPa", known["time_s"], scale * known[column],
                      f"PGN 1 from address {address}", spn)  # fmt: skip

    signals = unique_names([sent(190, "n_e_rpm", 0, 1.0), sent(190, "n_e_rpm", 1, 1.0), sent(3563, "p_im_pa", 1, 1e-3),
                            sent(1209, "p_em_pa", 61, 1e-3)])  # fmt: skip
    guesses = propose(RawChannels(Path("trace.log"), "J1939 trace", signals)).guesses
    assert guesses["n_e_rpm"].channel == "SPN 190 (0)" and "p_im_pa" not in guesses and "p_em_pa" in guesses


def test_an_oil_pressure_is_no_exhaust_pressure(tmp_path, known):
    """It lies above p_im and rises with load, but with engine speed first, as a pump does."""
    columns = {name: known[name] for name in ("time_s", "n_e_rpm", "w_c_kg_s", "p_im_pa", "omega_t_rad_s")}
    for channel, taken in (("oil pressure", False), ("p_em_pa", True)):
        frame = pd.DataFrame(columns | {"ch7 [kPa]": known[channel] / 1e3})
        frame.to_csv(tmp_path / "drive.csv", index=False)
        assert ("p_em_pa" in propose(read_raw(tmp_path / "drive.csv")).guesses) == taken


def test_exhaust_pressure_below_the_intake_is_a_reason_to_check(tmp_path, known):
    frame = pd.DataFrame({name: known[name] for name in ("time_s", "n_e_rpm", "p_im_pa")}
                         | {"exhaust_pressure [kPa]": known["p after"] / 1e3})  # fmt: skip
    frame.to_csv(tmp_path / "drive.csv", index=False)
    warnings = propose(read_raw(tmp_path / "drive.csv")).guesses["p_em_pa"].reading.warnings
    assert any("behind the turbine" in warning for warning in warnings)


FOREIGN_UNITS = {
    "Air flow": ("w_c_kg_s", {"lb/hr": 3600.0 / 0.45359237, "lb/s": 1.0 / 0.45359237, "t/h": 3.6, "kg/min": 60.0}),
    "Turbo speed": ("omega_t_rad_s", {"Hz": 0.5 / np.pi, "1/s": 0.5 / np.pi, "10^3 1/min": 0.03 / np.pi}),
    "Boost pressure": ("p_im_pa", {"mmHg": 1.0 / 133.322, "Torr": 760.0 / 101325.0, "inHg": 1.0 / 3386.389,
                                   "kgf/cm2": 1.0 / 98066.5, "kg/cm2": 1.0 / 98066.5, "atm": 1.0 / 101325.0}),
    "EGR valve position": ("u_egr_pct", {"‰": 10.0, "permille": 10.0}),
    "Injection quantity": ("u_delta_mg", {"mm^3/st": 1.0 / 0.835, "mm³/H": 1.0 / 0.835, "uL/stroke": 1.0 / 0.835}),
    "Exhaust temperature before turbine": ("t_em_k", {"R": 1.8}),
}  # fmt: skip


@pytest.mark.parametrize(("name", "unit"), [(name, unit) for name in FOREIGN_UNITS for unit in FOREIGN_UNITS[name][1]])
def test_a_stated_unit_is_converted_and_never_taken_for_another(tmp_path, known, name, unit):
    column, units = FOREIGN_UNITS[name]
    frame = pd.DataFrame({"time_s": known["time_s"], f"{name} [{unit}]": units[unit] * known[column]})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    proposal = propose(read_raw(tmp_path / "drive.csv"))
    entry = proposal.guesses[column].reading.entry
    found = entry.derived(entry.converted(frame.iloc[:, 1].to_numpy()), known)
    np.testing.assert_allclose(found, known[column], rtol=1e-4)


@pytest.mark.parametrize("unit", ["mmH2O", "inH2O", "kPa gage", "bar rel.", "kg/cm2 (g)"])
def test_gauge_pressures_in_any_unit(tmp_path, known, unit):
    factor = {"mmH2O": 9.80665, "inH2O": 249.08891, "kPa gage": 1e3, "bar rel.": 1e5, "kg/cm2 (g)": 98066.5}[unit]
    frame = pd.DataFrame({"time_s": known["time_s"], f"Boost pressure [{unit}]": (known["p_im_pa"] - 1.013e5) / factor})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    entry = propose(read_raw(tmp_path / "drive.csv")).guesses["p_im_pa"].reading.entry
    ambient = {"p_amb_pa": np.full(frame.shape[0], 1.013e5)}
    np.testing.assert_allclose(entry.derived(entry.converted(frame.iloc[:, 1].to_numpy()), ambient),
                               known["p_im_pa"], rtol=1e-4)  # fmt: skip


@pytest.mark.parametrize("unit", ["Nm3/h", "m³/h", "SCFM", "l/s"])
def test_a_volume_of_air_is_no_mass_and_says_so(tmp_path, known, unit, capsys):
    frame = pd.DataFrame({"time_s": known["time_s"], f"Air flow [{unit}]": 3600.0 / 1.29 * known["w_c_kg_s"]})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    proposal = propose(read_raw(tmp_path / "drive.csv"))
    assert "w_c_kg_s" not in proposal.guesses
    assert f"Air flow [{unit}] is in {unit}, which can't be converted without the density" in map_text(proposal)
    assert main(["channels", str(tmp_path / "drive.csv")]) == 0
    assert "can't be converted" in capsys.readouterr().out


def test_rows_of_zeros_raise_no_warnings_of_numpy(tmp_path, known):
    frame = pd.DataFrame({name: known[name] for name in ("time_s", "n_e_rpm", "p_im_pa", "omega_t_rad_s")})
    frame["p_amb_pa"] = 1.013e5
    frame.loc[:5, ["p_im_pa", "p_amb_pa"]] = 0.0
    frame.to_csv(tmp_path / "drive.csv", index=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert "p_im_pa" in propose(read_raw(tmp_path / "drive.csv")).guesses


def test_french_fuel_is_found(tmp_path, known):
    frame = pd.DataFrame({"time_s": known["time_s"], "Débit injecté [mg/cp]": known["u_delta_mg"]})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    assert propose(read_raw(tmp_path / "drive.csv")).guesses["u_delta_mg"].channel == "Débit injecté [mg/cp]"


def test_a_unit_that_nobody_knows_is_named(tmp_path, known):
    frame = pd.DataFrame({"time_s": known["time_s"], "Air flow [stone/moon]": 3600.0 * known["w_c_kg_s"]})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    texts = propose(read_raw(tmp_path / "drive.csv")).guesses["w_c_kg_s"].reading.warnings
    assert any("the unit 'stone/moon' isn't known" in text for text in texts)
    assert not any("gives no unit" in text for text in texts)


@pytest.mark.parametrize(
    ("name", "english"),
    [("Laddluftstemperatur", "charge temperature"), ("ExhMnfldPrs", "exhaust manifold pressure"),
     ("Расход воздуха", "air flow"), ("涡前排气温度", "before exhaust temperature"), ("Giri motore", "engine speed"),
     ("Ciśnienie doładowania", "boost pressure"), ("Laddtryck BÖR", "desired boost"),
     ("exhmnfldpres", "exhaust manifold pressure"), ("qwxz", "qwxz")],
)  # fmt: skip
def test_names_are_put_into_english(name, english):
    assert sorted(translated(words_of(name)).split()) == sorted(english.split())


@pytest.mark.parametrize(
    "title",
    ["a German test bench", "J1939 by number", "American units, gauge", "a generating set",
     "a service tool, VGT in percent closed", "German, flows as shares and per stroke"],
)  # fmt: skip
def test_the_map_is_one_that_the_reader_takes(tmp_path, known, title, capsys):
    file = ALL[title]
    (tmp_path / "drive.csv").write_text(written(file, known))
    assert main(["channels", str(tmp_path / "drive.csv"), "--out", str(tmp_path / "map.yaml"), "--cylinders", "6"]) == 0
    assert "channel map:" in capsys.readouterr().out
    sensors = [column for column in expected(file) if column in ("p_im_pa", "p_em_pa", "omega_t_rad_s", "t_em_k")]
    made = read_recording(tmp_path / "drive.csv", tmp_path / "map.yaml", sensors=sensors)
    for column in expected(file):
        error = np.nanmedian(np.abs(made.columns[column] - known[column])) / np.abs(known[column]).mean()
        assert error < CLOSE, column
    np.testing.assert_allclose(made.time_s, known["time_s"], atol=1e-9)


def test_a_missing_quantity_is_named_with_its_cost(tmp_path, known, capsys):
    file = ALL["an OBD app on a phone"]
    (tmp_path / "drive.csv").write_text(written(file, known))
    assert main(["channels", str(tmp_path / "drive.csv")]) == 0
    said = capsys.readouterr().out
    assert "omega_t_rad_s  not found: identify needs it to start" in said
    assert "u_vgt_pct      not found" in said and "p_em_pa        not found" in said
    assert "6 cylinders are assumed: give --cylinders" in said


def test_a_word_of_which_nothing_is_known_is_a_reason_to_check(tmp_path, known):
    """'LO' is lube oil: a vocabulary that doesn't know it must not take the rest of the name for the whole."""
    frame = pd.DataFrame({"time_s": known["time_s"], "XY INLET TEMP [degC]": known["t_im_k"] - 273.15})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    guess = propose(read_raw(tmp_path / "drive.csv")).guesses["t_im_k"].reading
    assert any("nothing is known of xy" in warning for warning in guess.warnings)


def test_noise_is_no_reason_to_take_a_pressure_for_gauge(tmp_path, known):
    """p_em some per cent above p_im, three per cent of noise on both: it is below now and then, and absolute."""
    rng = np.random.default_rng(1)
    columns = {name: known[name] for name in ("time_s", "n_e_rpm", "w_c_kg_s", "w_egr_kg_s")}
    noise = 1.0 + 0.03 * rng.standard_normal((2, known["p_im_pa"].size))
    columns |= {"Ladedruck [kPa]": noise[0] * known["p_im_pa"] / 1e3,
                "Abgasgegendruck [kPa]": noise[1] * 1.03 * known["p_im_pa"] / 1e3}  # fmt: skip
    pd.DataFrame(columns).to_csv(tmp_path / "drive.csv", index=False)
    assert propose(read_raw(tmp_path / "drive.csv")).guesses["p_em_pa"].reading.entry.via is None


def test_gauge_exhaust_pressure_is_told_by_physics(tmp_path, known):
    """Nothing in name, unit or range says gauge; absolute it would lie below the intake pressure while EGR flows."""
    loaded = known["p_em_pa"] > AMBIENT + 70e3
    frame = pd.DataFrame({
        "time_s": np.arange(np.count_nonzero(loaded)) * 0.2, "p_im_pa": known["p_im_pa"][loaded],
        "Exhaust Pressure (kPa)": (known["p_em_pa"][loaded] - AMBIENT) / 1e3, "w_egr_kg_s": known["w_egr_kg_s"][loaded],
        "w_c_kg_s": known["w_c_kg_s"][loaded], "n_e_rpm": known["n_e_rpm"][loaded],
    })  # fmt: skip
    frame.to_csv(tmp_path / "drive.csv", index=False)
    guess = propose(read_raw(tmp_path / "drive.csv")).guesses["p_em_pa"].reading
    assert guess.entry.via == "gauge" and any(
        "gauge" in warning and warning.endswith(" kPa") for warning in guess.warnings
    )


def test_a_flow_computed_by_the_control_unit_is_suspected(tmp_path, known):
    speed_density = 0.9 * known["p_im_pa"] * 12.7e-3 * known["n_e_rpm"] / (120.0 * 287.0 * known["t_im_k"])
    frame = pd.DataFrame({name: known[name] for name in ("time_s", "n_e_rpm", "p_im_pa", "t_im_k", "w_egr_kg_s")})
    for flow, suspected in ((speed_density - known["w_egr_kg_s"], True), (known["w_c_kg_s"], False)):
        frame.assign(w_c_kg_s=flow).to_csv(tmp_path / "drive.csv", index=False)
        warnings = propose(read_raw(tmp_path / "drive.csv")).guesses["w_c_kg_s"].reading.warnings
        assert any("control unit" in warning for warning in warnings) == suspected


def test_a_wrong_unit_in_the_file_is_noticed(tmp_path, known):
    frame = pd.DataFrame({"time_s": known["time_s"], "Boost pressure [kPa]": TO["mbar"](known["p_im_pa"])})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    guess = propose(read_raw(tmp_path / "drive.csv")).guesses["p_im_pa"].reading
    assert guess.entry.unit == "hPa" and any("the file says kPa" in warning for warning in guess.warnings)


@pytest.mark.parametrize(
    ("name", "column"),
    [("Abgasklappe [%]", "u_flap_pct"), ("ExhThrottlePos", "u_flap_pct"), ("Position Auspuffklappe", "u_flap_pct"),
     ("AGR-Klappe", "u_egr_pct"), ("Drosselklappe [%]", None), ("Engine throttle", None),
     ("Exhaust pressure before flap", "p_em_pa")],
)  # fmt: skip
def test_an_exhaust_flap_is_told_from_other_flaps(name, column):
    scores = {m.column: m.score(name, words_of(name), None) for m in vocabulary().meanings}
    best = max(scores, key=lambda each: scores[each])
    assert (best if scores[best] > 0.5 else None) == column


def test_the_map_of_settled_points_names_a_command_that_takes_them(tmp_path, known):
    file = ALL["an OBD app on a phone"]
    points = pd.DataFrame({"n_e_rpm": known["n_e_rpm"][::50], "p_im_pa": known["p_im_pa"][::50]})
    points.to_csv(tmp_path / "points.csv", index=False)
    assert "then: dieseltwin calibrate points.csv" in map_text(propose(read_raw(tmp_path / "points.csv")))
    assert "then: dieseltwin identify drive.csv" in map_text(proposed(file, known, tmp_path))


@pytest.mark.parametrize(
    ("name", "words"),
    [("InjCtl_qSetUnBal", "inj ctl q set un bal"), ("AGR-Ventil [%]", "agr ventil"), ("pBoost", "p boost"),
     ("EngTurbo1Speed", "eng turbo 1 speed"), ("T_31", "t 31"), ("Kühlmittel", "kuehlmittel"), ("MAF", "maf")],
)  # fmt: skip
def test_names_are_cut_into_words(name, words):
    assert words_of(name) == words


@pytest.mark.parametrize(
    ("spelling", "dimension", "ours", "gauge"),
    [("1/min", "rotation", "rpm", None), ("mg/Hub", "per cycle", "mg/cycle", None), ("psig", "pressure", "psi", True),
     ("bar(a)", "pressure", "bar", False), ("kPa abs", "pressure", "kPa", False), ("°C", "temperature", "degC", None),
     ("kg/hr", "mass flow", "kg/h", None), ("mm³/stroke", "per cycle", "mm3/cycle", None),
     ("mg/carrera", "per cycle", "mg/cycle", None), ("furlong", "unknown", "furlong", None)],
)  # fmt: skip
def test_units_are_understood(spelling, dimension, ours, gauge):
    unit = understood(spelling)
    assert unit is not None and (unit.dimension, unit.ours, unit.gauge) == (dimension, ours, gauge)
    assert understood("-") is None


def test_facts_of_a_channel():
    time = np.r_[np.arange(0.0, 10.0, 0.1), np.arange(15.0, 20.0, 0.1)]
    values = np.round(100.0 + 20.0 * np.sin(time), 0) // 2 * 2
    values[5] = np.nan
    facts = facts_of(Signal("p", "kPa", time, values))
    assert facts.step_s == pytest.approx(0.1) and facts.gaps == 1 and facts.longest_gap_s == pytest.approx(5.1)
    assert facts.resolution == pytest.approx(2.0) and not facts.frozen
    assert facts.missing == pytest.approx(1.0 / time.size)
    assert facts_of(Signal("x", None, time, np.full(time.size, 3.0))).frozen


def test_rows_of_one_value_share_a_rank():
    """Two channels that stand at 0 most of the time, each for itself, agreed by the order of their rows: 0.36."""
    rng = np.random.default_rng(0)
    one, other = (np.where(rng.random(2000) < 0.8, 0.0, rng.random(2000)) for _ in range(2))
    assert abs(ranks_agree(one, other)) < 0.06
    shut = np.arange(2000) % 5 > 0
    assert ranks_agree(np.where(shut, 0.0, one + 1.0), np.where(shut, 0.0, -one - 1.0)) == pytest.approx(-1.0, abs=0.01)
    assert ranks_agree(one, np.full(2000, 3.0)) == 0.0
    assert ranks_agree(np.r_[np.nan, 1.0, 2.0, 3.0], np.r_[5.0, 1.0, 2.0, 3.0]) == pytest.approx(1.0)


def test_milliseconds_are_told_from_seconds(tmp_path, known):
    for scale, expected_scale in ((1.0, 1.0), (1e3, 1e-3)):
        frame = pd.DataFrame({"Time": known["time_s"] * scale, "RPM": known["n_e_rpm"]})
        frame.to_csv(tmp_path / "drive.csv", index=False)
        found = clock_of(read_raw(tmp_path / "drive.csv"))
        assert found is not None and (found.name, found.unit_s) == ("Time", expected_scale)


@pytest.mark.parametrize(("name", "step", "unit"), [
    ("Time (minutes)", 1.0 / 60.0, "min"), ("Zeit [Minuten]", 0.2, "min"), ("Time (mins)", 0.01, "min"),
    ("Time (hours)", 1e-4, "h"), ("Zeit (Stunden)", 1e-4, "h"), ("Time [ns]", 2e8, "ns"), ("time_ms", 200.0, "ms"),
    ("Time", 0.2, "s"), ("Time [s]", 60.0, "s"),
])  # fmt: skip
def test_a_clock_is_in_the_unit_that_its_name_says(tmp_path, known, name, step, unit):
    frame = pd.DataFrame({name: step * np.arange(len(known["time_s"])), "RPM": known["n_e_rpm"]})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    text = map_text(propose(read_raw(tmp_path / "drive.csv")))
    assert yaml.safe_load(text)[name] == {"column": "time_s", "unit": unit} and f"CHECK: '{name}'" not in text


@pytest.mark.parametrize(("step", "unit"), [(10.0, "ms"), (60.0, "ms"), (2e5, "us"), (2e8, "ns"), (2.3e-6, "d")])
def test_a_clocks_unit_that_is_guessed_is_to_be_checked(tmp_path, known, step, unit):
    """Rows of 10 s were taken as rows of 10 ms without a word."""
    frame = pd.DataFrame({"Time": step * np.arange(len(known["time_s"])), "RPM": known["n_e_rpm"]})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    proposal = propose(read_raw(tmp_path / "drive.csv"))
    assert yaml.safe_load(map_text(proposal))["Time"]["unit"] == unit
    told = f"CHECK: 'Time' has no unit and steps by {step:.6g}, taken as {unit}"
    assert told in map_text(proposal) and any(told in line for line in channel_lines(proposal))


def test_a_map_survives_awkward_names(tmp_path, known):
    frame = pd.DataFrame({"time_s": known["time_s"], "Engine: speed, 'actual' [rpm] #1": known["n_e_rpm"]})
    frame.to_csv(tmp_path / "drive.csv", index=False)
    proposal = propose(read_raw(tmp_path / "drive.csv"))
    again = channel_map(yaml.safe_load(map_text(proposal)))
    assert again.entries["Engine: speed, 'actual' [rpm] #1"].column == "n_e_rpm"


def test_nothing_is_written_for_a_file_that_cannot_be_read(tmp_path, capsys):
    (tmp_path / "drive.csv").write_text("<html></html>")
    assert main(["channels", str(tmp_path / "drive.csv"), "--out", str(tmp_path / "map.yaml")]) == 2
    assert not (tmp_path / "map.yaml").exists()
    assert main(["channels", str(tmp_path / "drive.csv"), "--out", str(tmp_path / "map.txt")]) == 2
    assert "\n" not in capsys.readouterr().err.strip().split("\n")[0]


def test_a_wanted_position_stands_in_where_none_was_read_and_behind_one_that_was() -> None:
    vgt = next(meaning for meaning in vocabulary().meanings if meaning.column == "u_vgt_pct")
    wanted, read = (vgt.score(name, words_of(name), None) for name in ("VTG Sollwert [%]", "VTG Stellung [%]"))
    assert LEAST_SCORE < wanted < read - 0.2
    boost = next(meaning for meaning in vocabulary().meanings if meaning.column == "p_im_pa")
    assert boost.score("Ladedruck Soll", words_of("Ladedruck Soll"), None) == 0.0
