"""What was read of one kind of machine is refused by the others, in one line that says which it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.api.discovery import ask
from dieseltwin.api.reading import Made, diesel_recording, over_time, petrol_recording, read, settled, settled_points
from dieseltwin.challenge.petrol_plant import drive as drive_petrol
from dieseltwin.engine import we2011
from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import INPUTS
from dieseltwin.recordings.named_columns import import_columns
from dieseltwin.recordings.reader import Recording
from dieseltwin.recordings.steady_points import SteadyPoints
from dieseltwin.rigs.recording import RigRecording
from tests.api.simulated import drive


@pytest.fixture(scope="module")
def driven() -> pd.DataFrame:
    return drive(60.0, we2011.PARAMETERS)


@pytest.fixture(scope="module")
def made(driven: pd.DataFrame) -> dict[str, Made]:
    """What `read` makes of each kind."""
    time_s = np.arange(20.0)
    return {
        "diesel": read(driven), "points": read(driven.drop(columns="time_s")),
        "petrol": read(drive_petrol(90.0, 1), engine="liu_petrol"),
        "rig": RigRecording(time_s, {"q": time_s}, {"level": time_s}, "the table", ""),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("reader", "taken"),
    [
        (over_time, "diesel"),
        (lambda found: diesel_recording(found, None, we2011.PARAMETERS, sensors=()), "diesel"),
        (petrol_recording, "petrol"),
        (lambda found: settled_points(found, None, we2011.PARAMETERS, INPUTS), "points"),
    ],
)
def test_each_reader_takes_its_own(reader: Callable[[Made], Made], taken: str, made: dict[str, Made]) -> None:
    for kind, found in made.items():
        if kind == taken:
            assert reader(found) is found
        else:
            with pytest.raises(InputError) as error:
                reader(found)
            assert "\n" not in str(error.value)


def test_settled_points_are_known_before_they_are_checked(driven: pd.DataFrame, made: dict[str, Made]) -> None:
    timed = import_columns(driven)
    columns = {name: values for name, values in timed.columns.items() if name != "time_s"}
    assert settled(made["points"]) and settled(replace(timed, columns=columns))
    assert not settled(made["diesel"]) and not settled(timed)


@pytest.mark.parametrize(("kind", "says"), [("petrol", "one of a petrol engine"), ("rig", "one of a rig")])
def test_a_diesel_engine_is_asked_about_its_own_recordings(kind: str, says: str, made: dict[str, Made]) -> None:
    with pytest.raises(InputError, match=says):
        ask(made[kind])


def test_several_are_all_driving(made: dict[str, Made]) -> None:
    with pytest.raises(InputError, match="judge settled points by themselves"):
        ask([made["diesel"], made["points"]])
    with pytest.raises(InputError, match="judge them one by one"):
        ask([made["petrol"], made["petrol"]], "liu_petrol")


def test_the_time_of_a_table_may_be_its_index(driven: pd.DataFrame) -> None:
    """It was dropped, and the rows were judged as settled points."""
    seconds, values = driven["time_s"], driven.drop(columns="time_s")
    stamps = pd.Timestamp("2026-03-01") + pd.to_timedelta(seconds.to_numpy(), unit="s")
    indices = (
        pd.Index(seconds, name="time_s"), pd.to_timedelta(seconds.to_numpy(), unit="s"), stamps, stamps.rename("time_s")
    )  # fmt: skip
    for index in indices:
        found = read(values.set_axis(index))
        assert isinstance(found, Recording) and found.time_s == pytest.approx(seconds - seconds.iloc[0], abs=1e-9)
        assert (found.began is not None) is isinstance(index, pd.DatetimeIndex)
    for name in ("Zeit", "date"):
        with pytest.raises(InputError, match="column time_s"):
            read(values.assign(**{name: stamps}))
    apart = values.head(5).assign(date=pd.date_range("2026-03-01", periods=5))
    assert isinstance(read(apart), SteadyPoints)


@pytest.mark.parametrize("source", [None, 3, ["a.csv"], {"time_s": [0.0]}, np.zeros((3, 2)), b"a.csv"])
def test_what_is_no_recording_is_said(source: Any) -> None:
    """It was given back as if it had been read."""
    with pytest.raises(InputError, match=f"got a {type(source).__name__}; allowed: a file, a table"):
        read(source)


def test_columns_of_a_table_are_named_once_by_text(driven: pd.DataFrame) -> None:
    both = pd.concat([driven, driven[["p_im_pa"]]], axis=1)
    with pytest.raises(InputError, match="table: column p_im_pa: got 2 of that name"):
        read(both)
    assert isinstance(read(driven.assign(**{"x": 1.0}).rename(columns={"x": 5})), Recording)


def test_arguments_of_another_kind_are_said(driven: pd.DataFrame) -> None:
    simulation = dt.simulate(driven)
    for wrong, says in (
        (lambda: dt.simulate(simulation), "give its .table()"),
        (lambda: dt.read(driven, channels={"p": "p_im_pa"}), "got a dict; allowed: a channel map's file"),
        (lambda: dt.engine({"V_d": 0.0128}), "engine: got a dict; allowed: we2011"),
        (lambda: dt.simulate(driven, effects=["boost_leak"]), "effects: got a list; allowed: a mapping"),
        (lambda: dt.simulate(driven, effects={"boost_leak": None}), "boost_leak: got None; allowed: a number from"),
        (lambda: dt.discover(driven, withhold="bost_leak"), "unknown name 'bost_leak'"),  # not b, o, s ...
    ):
        with pytest.raises(InputError) as refused:
            wrong()
        assert says in str(refused.value)


@pytest.mark.parametrize("channels", [{"Zeit": "time_s"}, 3, ["map.yaml"], b"map.yaml", 1.5])
def test_channels_of_another_kind_are_said(channels: Any, driven: pd.DataFrame) -> None:
    points = driven.drop(columns="time_s")
    for ask_for in (
        lambda: dt.read(driven, channels=channels),
        lambda: dt.simulate(driven, channels=channels),
        lambda: dt.identify(driven, channels=channels),
        lambda: dt.discover(driven, channels=channels),
        lambda: dt.learn(driven, channels=channels),
        lambda: dt.learn(driven, "liu_petrol", channels=channels),
        lambda: dt.calibrate(points, channels=channels),
    ):
        with pytest.raises(InputError, match=f"channels: got a {type(channels).__name__}; allowed: a channel map's"):
            ask_for()


def test_what_reading_did_to_a_file_is_told_of_every_machine(driven: pd.DataFrame, tmp_path: Path) -> None:
    """Only recordings of diesel engines said it."""
    german = {"index": False, "sep": ";", "decimal": ","}
    drive_petrol(90.0, 1).to_csv(tmp_path / "petrol.csv", **german)
    driven.drop(columns="time_s")[::40].to_csv(tmp_path / "points.csv", **german)
    tank = tmp_path / "tank.csv"
    pd.DataFrame({"time_s": np.arange(60.0), "q": 1.0 + 0.1 * np.arange(60.0), "level": 2.5}).to_csv(tank, **german)
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        "kind: rig\nname: tank\nstates: {h: {scale: 1.0, nearest: level}}\ninputs: {q: m3/s}\n"
        "parameters: {k: {value: 1.0, prior_std: 0.5, scale: 0.1}}\nquantities: {dh: {formula: q - k*h}}\n"
        "rates: {h: dh}\nreadings: {level: h}\nfloors: {level: 0.1}\n"
    )
    for file, engine in (("petrol.csv", "liu_petrol"), ("points.csv", None), ("tank.csv", rig)):
        assert any("decimal comma" in note for note in read(tmp_path / file, engine=engine).notes), file
