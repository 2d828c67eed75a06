"""The machine of a rig's file with what a round of the search found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.twin import Placed
from dieseltwin.discovery.likelihood.fit import Fit
from dieseltwin.discovery.search.state import Search
from dieseltwin.rigs.parameters import LawFactor, RigLaw, RigParameters, RigTerm
from dieseltwin.rigs.twin import RigTwin, When


def machine_with(
    rig: RigParameters, found: Search, names: tuple[str, ...], law: Law | None, then: When | None = None
) -> RigParameters:
    """The machine with what a round found, parameters as the search left them."""
    recording = cast(RigTwin, found.twin).recording
    if law is not None:
        more = tuple(_written(placed, law.text, recording.sha256) for placed in law.placed)
        return rig.model_copy(update={"laws": (*rig.laws, *more)})
    at = explanation(found, names)
    sizes: Mapping[str, float] = dict(zip(at.candidate.names, map(float, at.magnitudes), strict=True))
    parameters = {name: p.model_copy(update={"value": float(value)})
                  for (name, p), value in zip(rig.parameters.items(), at.parameters, strict=False)}
    when: dict[str, Any] = {} if then is None else {**vars(then), "found_in": recording.sha256}
    terms = (*rig.terms, *(RigTerm(effect=name, magnitude=sizes[name], **when) for name in names))
    return rig.model_copy(update={"parameters": parameters, "terms": terms})


def explanation(found: Search, names: tuple[str, ...]) -> Fit:
    """The fit of what a round takes."""
    return found.best.fit if found.best is not None and found.best.fit.candidate.names == names else found.singles[0]


def _written(placed: Placed, text: str, sha256: str) -> RigLaw:
    form = placed.form
    factors = tuple(LawFactor(kind=f.kind, variables=f.variables, references=f.references, shape=float(f.shape),
                              units=f.units) for f in form.factors)  # fmt: skip
    begun = {} if form.since_s is None else {"onset_s": form.since_s, "found_in": sha256}
    return RigLaw(at=form.point, coefficient=float(placed.coefficient), factors=factors, text=text, **begun)
