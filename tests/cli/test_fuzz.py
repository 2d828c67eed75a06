"""Some cases of the fuzzer that `python -m benchmarks.bad_inputs.fuzz` runs for as long as one likes."""

from __future__ import annotations

from benchmarks.bad_inputs.fuzz import COMMANDS, fuzz

QUICK = ("simulate", "as engine", "as map", "as params", "channels", "explain", "as geometry", "imply")


def test_no_file_made_of_known_pieces_ends_in_a_traceback() -> None:
    found = fuzz(60.0, 7, QUICK, most=60)  # cases, not seconds: on a busy machine ten held three
    assert set(QUICK) <= set(COMMANDS)
    assert sum(count for name, count in found.items() if name.endswith("exit 2")) > 20
