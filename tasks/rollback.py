"""Back to an earlier version: the one that is taken out says why and when, and stays out until it is asked for again.

A version is out of use as well where somebody took its alias away by hand, in MLflow's pages. One in whose place a
better one came isn't: its tag `use` says `superseded by version N`.
"""

from __future__ import annotations

from datetime import UTC, datetime

from dieseltwin.errors import InputError
from tasks.registry import (
    CHAMPION,
    IN_USE,
    NAME,
    OUT,
    OUT_DATE,
    OUT_REASON,
    PREVIOUS,
    USE,
    Registry,
    Version,
    superseded_by,
)

BY_HAND = "its alias was moved by hand"


def take_note(registry: Registry) -> list[int]:
    """Compare the alias with the tags and mend these. Returns the versions that were taken out by hand since.

    Versions of before there was a tag `use`: a promoted one with a higher number than the champion's was taken out.
    """
    champion, previous = registry.number(CHAMPION), registry.number(PREVIOUS)
    moved = []
    for known in registry.versions():
        number, use = int(known.version), known.tags.get(USE)
        untold = use is None and known.tags.get("decision") == "promoted"
        if number == champion:
            if use != IN_USE:
                registry.tag(str(number), {USE: IN_USE, OUT_REASON: None, OUT_DATE: None})
        elif use == IN_USE or (untold and (champion is None or number > champion)):
            registry.tag(str(number), _out(BY_HAND))
            moved.append(number)
        elif untold and number == previous:
            registry.tag(str(number), {USE: superseded_by(str(champion))})
    if champion is not None and champion == previous:
        _name_previous(registry, champion)
    return sorted(moved)


def taken_out(registry: Registry, sha256: str) -> str | None:
    """When and why networks of that hash were taken out of use; None where they weren't."""
    for known in registry.versions(sha256):
        if known.tags.get(USE) == OUT:
            return f"{known.tags.get(OUT_DATE, 'an unknown day')}: {known.tags.get(OUT_REASON, 'no stated reason')}"
    return None


def target(registry: Registry, number: int | None) -> Version:
    """The version to go back to: that number, or the alias ``previous``.

    Raises ``InputError`` where there is none, where it never was in use, or where its files are gone or changed.
    """
    champion, previous = registry.number(CHAMPION), registry.number(PREVIOUS)
    uses = {int(known.version): known.tags.get(USE) for known in registry.versions()}
    once = sorted(known for known, use in uses.items() if use is not None and known != champion)
    allowed = f"a version that was in use before: {', '.join(map(str, once)) or 'there is none'}"
    wanted = previous if number is None else number
    if wanted is None or (number is None and uses.get(wanted) == OUT):
        raise InputError(f"{NAME}: --back", "no version that was in use before and isn't taken out", allowed,
                         "name one with --to")  # fmt: skip
    if wanted not in once:
        said = "which is in use" if wanted == champion else "which never was in use" if wanted in uses else "not there"
        raise InputError(f"{NAME}: --to", f"{wanted}, {said}", allowed, "name one of these")
    found = registry.numbered(wanted)
    if found is None:
        raise InputError(f"{NAME}: version {wanted}", "files that are gone or changed", "those that were registered",
                         "restore mlruns/artifacts or name another version with --to")  # fmt: skip
    return found


def roll_back(registry: Registry, back: Version, reason: str) -> int | None:
    """Put an earlier version in use. Returns the version that was taken out, None where none was in use.

    The one before the earlier version becomes ``previous``: going back twice never brings up what was taken out.
    """
    champion = registry.number(CHAMPION)
    if champion is not None:
        registry.tag(str(champion), _out(reason))
    registry.put_in_use(str(back.number))
    _name_previous(registry, back.number)
    return champion


def _name_previous(registry: Registry, champion: int) -> None:
    """``previous`` is the version in whose place the champion came; nothing carries the alias where there is none."""
    before = [int(known.version) for known in registry.versions() if known.tags.get(USE) == superseded_by(champion)]
    if before:
        registry.client.set_registered_model_alias(NAME, PREVIOUS, str(max(before)))
    elif registry.number(PREVIOUS) is not None:
        registry.client.delete_registered_model_alias(NAME, PREVIOUS)


def _out(reason: str) -> dict[str, str | None]:
    return {USE: OUT, OUT_REASON: reason, OUT_DATE: datetime.now(UTC).date().isoformat()}
