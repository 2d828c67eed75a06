"""What is doubtful keeps what programs read of it."""

from __future__ import annotations

import copy

from dieseltwin.notes import Note, warnings_of


def test_a_note_keeps_its_code_in_copies() -> None:
    note = Note("p_im_pa stands still", "frozen_channel", ("p_im_pa",))
    assert note == "note: p_im_pa stands still"
    expected = [{"code": "frozen_channel", "text": "p_im_pa stands still", "affects": ["p_im_pa"]}]
    assert warnings_of([copy.deepcopy(note)]) == warnings_of([note]) == expected
