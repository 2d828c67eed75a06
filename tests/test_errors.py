"""Messages are one line; errors survive a process boundary."""

from __future__ import annotations

import pickle

from hypothesis import given
from hypothesis import strategies as st

from dieseltwin.errors import DieselTwinError, InputError


@given(st.tuples(*[st.text(max_size=40)] * 4))
def test_message_is_one_line_whatever_it_is_given(parts: tuple[str, str, str, str]) -> None:
    assert len(str(InputError(*parts)).splitlines()) <= 1


def test_message_has_its_four_parts() -> None:
    error = InputError("drive.csv: column p_im_pa", 1.2, "5e4 to 1e6 Pa", "convert to Pa")
    assert str(error) == "drive.csv: column p_im_pa: got 1.2; allowed: 5e4 to 1e6 Pa; convert to Pa"
    assert isinstance(error, DieselTwinError) and error.exit_code == 2


def test_a_long_line_keeps_what_to_do_and_the_ends_of_the_place() -> None:
    do = "name it in a channel map (--channels), or go without: --sensors p_im_pa,p_em_pa,omega_t_rad_s,w_egr_kg_s"
    place = f"/{'folder/' * 12}drive.csv: column t_em_k"
    said = InputError(place, f"none ({'column, ' * 9})", "this column", do).line()
    assert len(said) <= 300 and said.endswith(do) and said.startswith("/folder/") and "column t_em_k: got none" in said


def test_error_crosses_processes() -> None:
    error = InputError("a", "b", "c", "d")
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error) and again.do == "d"
