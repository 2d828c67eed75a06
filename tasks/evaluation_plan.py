"""What the evaluation runs: ensembles and repeated trainings, as plain values from ``params.yaml``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dieseltwin.errors import InputError
from dieseltwin.settings.methods import find
from tasks.run_context import seed_for
from tasks.settings import section_of


@dataclass(frozen=True)
class Plan:
    """One ensemble.

    ``what``: all that its members' numbers depend on but for the settings: case, seeds, start, sensors, members.
    ``batches``: (first member, members) of each cached step. ``last_epoch``: the runs of the method's own ensemble on
    that case, read at their last epoch.
    """

    method: str
    case: str
    variant: str
    what: dict[str, Any]
    batches: tuple[tuple[int, int], ...]
    epochs: int | None
    last_epoch: bool = False

    @property
    def slug(self) -> str:
        """A name for files and steps."""
        parts = [self.case, self.method, self.variant]
        return "-".join(part.replace(" ", "_") for part in parts if part)

    @property
    def trained_as(self) -> str:
        """`slug` of the ensemble whose batches are this one's."""
        return f"{self.case}-{self.method}" if self.last_epoch else self.slug


def ensembles_of(settings: Mapping[str, Any], only: Sequence[str] = ()) -> list[Plan]:
    """Every ensemble of the evaluation, the paper's own first, the longest methods first.

    ``only``: names of ensembles (`Plan.slug`); none means all. A method that starts from another's networks brings that
    of its case with it, and what is read at the last epoch the ensemble that it is read from.
    Raises ``InputError`` for an unknown name.
    """
    evaluation = settings["evaluation"]
    found = [
        _plan(settings, method, case, "", {"members": evaluation["members"][method]})
        for method in sorted(evaluation["members"], key=lambda name: -find(name).rank)
        for case in evaluation["cases"]
    ]
    for variant in evaluation["variants"]:
        cases = [case for case in variant["cases"] if case in evaluation["cases"]]
        found += [_plan(settings, variant["method"], case, variant["name"], variant) for case in cases]
    known = {plan.slug: plan for plan in found}
    for name in only:
        if name not in known:
            raise InputError("--only", name, ", ".join(sorted(known)), "name an ensemble of this profile")
    wanted = {*only, *(known[name].trained_as for name in only)}
    sources = {name: find(known[name].method).sources for name in wanted}
    wanted |= {f"{known[name].case}-{source}" for name, source in sources.items() if source is not None}
    return [plan for plan in found if plan.slug in wanted] if only else found


def _plan(settings: Mapping[str, Any], method: str, case: str, variant: str, changed: Mapping[str, Any]) -> Plan:
    members, last_epoch = changed["members"], changed.get("last_epoch", False)
    if last_epoch:  # whatever the method's own ensemble has
        members = settings["evaluation"]["members"][method]
    what = {
        "case": case,
        "members": members,
        # One noise draw a member, the same for every method.
        "noise_seed": seed_for(settings["seed"], f"evaluation noise {case}"),
        # A variant keeps the seed of what it is a variant of: nothing but the change differs.
        "seed": seed_for(settings["seed"], f"evaluation {method} {case}"),
        "start": changed.get("start") or settings["identify"]["start"]["at"],
        "channels": changed.get("channels"),
        "held_out_share": changed.get("held_out_share", 0.0),
        "weight_share": changed.get("weight_share", 1.0),
        "scale_x_r": changed.get("scale_x_r"),
    }
    at_a_time = settings["evaluation"]["members_per_batch"] if find(method).with_epochs else members
    batches = tuple((first, min(at_a_time, members - first)) for first in range(0, members, at_a_time))
    return Plan(method, case, variant, what, batches, _epochs(settings, method), last_epoch)


def _epochs(settings: Mapping[str, Any], method: str) -> int | None:
    return find(method).settings.model_validate(section_of(settings, method)).trained_epochs
