"""What is found in the weather that health alone asks for, and in the weather that an effect asks for."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.preparation import prepare
from dieseltwin.discovery.search.singles import with_singles
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.weather import cost_of_weather, is_guessed
from dieseltwin.discovery.time_limit import OutOfTimeError
from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin
from dieseltwin.discovery.twins.interface import Lanes
from dieseltwin.engine import we2011
from dieseltwin.recordings.reader import recording
from tests.discovery.toy import SETTINGS, Toy


class _Somewhere(Toy):
    """A machine in weather that moves one of its readings."""

    moved = 0.0

    def simulate(self, lanes: Lanes) -> np.ndarray:
        readings = super().simulate(lanes)
        readings[..., 0] += self.moved
        return readings


@pytest.fixture(scope="module")
def two() -> Search:
    found = search.run(_Somewhere().record(gain=0.95, leak=0.05, x_offset=0.15), SETTINGS, laws=False)
    assert found.kind == "pair"
    return found


@pytest.mark.parametrize(("moved", "kind"), [(0.15, "single"), (-0.3, "pair")])
def test_the_likelier_weather_decides_whether_there_are_two(
    two: Search, monkeypatch: pytest.MonkeyPatch, moved: float, kind: str
) -> None:
    """-0.3: there are two effects in that weather as well, of which one is larger than it has to be."""
    there = copy(two.twin)
    there.moved = moved  # type: ignore[attr-defined]
    weathers = iter([there, None])
    monkeypatch.setattr(search, "in_weather_of", lambda found, fit: next(weathers))
    chosen = search._two_in_own_weather(two)
    assert chosen.kind == kind and (chosen.twin is there) == (kind == "single")
    if kind == "single":
        assert chosen.best is not None and chosen.best.fit.candidate.names == ("leak",)
        assert chosen.best.fit.magnitudes[0] == pytest.approx(0.05, abs=0.005)
    else:
        assert chosen is two


@pytest.mark.parametrize("kind", ["pair", "healthy", "law"])
def test_an_answer_stays_whole_where_time_is_over_in_other_weather(
    two: Search, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    def over(found: Search) -> Search:
        raise OutOfTimeError

    monkeypatch.setattr(search, "_in_own_weather", over)
    found = replace(two, kind=kind)
    if kind == "law":
        with pytest.raises(OutOfTimeError):
            search._in_own_weather_in_time(found)
    else:
        assert search._in_own_weather_in_time(found) is found


def _in_weather(twin: _Somewhere, moved: float) -> Search:
    """A search up to single effects of the same readings in other weather."""
    there = copy(twin)
    there.measured, there.moved = twin.measured.copy(), moved
    return with_singles(prepare(there, SETTINGS))


def _near_an_alarm(found: Search, gain: float) -> Search:
    """A search that has a name near an alarm, and none."""
    lead = replace(found.singles[0], objective=found.null.fit.objective - gain)
    return replace(found, singles=[lead], kind="healthy")


def test_a_name_near_an_alarm_is_one_where_the_weather_that_it_asks_for_is_likelier(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A charge cooler's loss of 7 % was 3.7 % and a charge 9 K too warm, which is no alarm."""
    twin = _Somewhere().record(gain=0.95, leak=0.02)
    found = _near_an_alarm(_in_weather(twin, -0.06), 12.0)
    monkeypatch.setattr(search, "_where_lead_asks", lambda found: [_in_weather(twin, 0.0)])
    chosen = search._one_in_own_weather(found)
    assert chosen.kind == "single" and chosen.singles[0].candidate.names == ("leak",)
    far = _near_an_alarm(found, 6.0)
    assert search._one_in_own_weather(far) is far


def test_weather_that_only_a_name_makes_up_for_is_no_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    well = _Somewhere().record(gain=0.95)
    found, there = _near_an_alarm(_in_weather(well, 0.0), 12.0), _in_weather(well, 0.06)
    assert there.gain(there.singles[0]) > 100.0
    monkeypatch.setattr(search, "_where_lead_asks", lambda found: [there])
    assert search._one_in_own_weather(found) is found


def test_weather_costs_what_is_believed_of_it_where_no_column_gives_it() -> None:
    steady = {"n_e_rpm": 1500.0, "u_delta_mg": 100.0, "u_egr_pct": 20.0, "u_vgt_pct": 50.0, "p_im_pa": 1.5e5,
              "p_em_pa": 1.8e5, "omega_t_rad_s": 6000.0, "w_egr_kg_s": 0.02, "t_em_k": 750.0, "w_c_kg_s": 0.2}
    frame = {name: np.full(600, value) for name, value in steady.items()}
    frame["time_s"] = 0.1 * np.arange(600)
    twin = LoggedTwin(recording(frame), we2011.PARAMETERS)
    assert is_guessed(twin) and cost_of_weather(twin) == 0.0
    (item,) = (item for item in twin.circumstances if item.name == "t_im_k")
    colder = LoggedTwin(recording(frame), we2011.PARAMETERS, values={"t_im_k": item.assumed - 2.0 * item.std})
    assert cost_of_weather(colder) == pytest.approx(4.0)
    told = LoggedTwin(recording({**frame, "p_amb_pa": np.full(600, 1e5), "t_amb_k": np.full(600, 290.0)}),
                      we2011.PARAMETERS, values={"p_amb_pa": 9e4})  # fmt: skip
    (read,) = (item for item in told.circumstances if item.name == "p_amb_pa")
    assert not is_guessed(told)
    assert cost_of_weather(told) == pytest.approx((1e4 / read.std) ** 2)  # a barometer is left at what it reads
    assert not is_guessed(Toy()) and cost_of_weather(Toy()) == 0.0
