"""Messages about unknown names and options without a meaning; quick to import, so that a mistake is said at once."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping, Sequence

from dieseltwin.errors import InputError

LISTED_NAMES = 12  # more alternatives than this make a one-line message unreadable


def refuse_options(given: Mapping[str, object], where: str) -> None:
    """Options that were given (are not None) although they mean nothing there.

    Raises:
        InputError: any was given; an option without an effect would be taken for one with.
    """
    extra = [option for option, value in given.items() if value is not None]
    if extra:
        raise InputError(", ".join(extra), "given", f"no such option {where}", "leave it out")


def did_you_mean(name: str, known: Sequence[str]) -> str:
    """'did you mean eta_sc?' for the closest known names, or where to look when none is close."""
    return _meant(name, known) or "remove it or take one of the allowed names"


def close_names(name: str, known: Collection[str]) -> str:
    """'did you mean eta_sc?' for the closest known names, or what is known when none is close."""
    return _meant(name, known) or f"known: {listed(list(known))}"


def _meant(name: str, known: Collection[str]) -> str:
    folded = {k.lower(): k for k in known}
    close = difflib.get_close_matches(name.lower(), list(folded), n=2, cutoff=0.55)
    return f"did you mean {' or '.join(folded[c] for c in close)}?" if close else ""


def listed(names: Sequence[str]) -> str:
    """The names in one line, shortened when they are many."""
    shown = list(names)[:LISTED_NAMES]
    more = len(names) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")


def unknown_name(what: str, name: str, known: Sequence[str]) -> InputError:
    """The InputError for a name that is not among the known ones, with the closest ones as a hint."""
    close = difflib.get_close_matches(name, known, n=LISTED_NAMES, cutoff=0.3)
    order = close + [k for k in known if k not in close]
    return InputError(what, f"unknown name {name!r}", listed(order), did_you_mean(name, known))
