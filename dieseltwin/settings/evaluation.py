"""The models of `evaluation` in `params.yaml`: ensembles of every method, their variants, and what of it can be run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from dieseltwin.errors import InputError
from dieseltwin.settings.methods import find, in_order
from dieseltwin.settings.strict import StrictModel

CaseName = Literal["clean-151", "clean-301", "noisy-301"]
MethodName = Annotated[str, AfterValidator(lambda name: find(name, "evaluation: method").name)]

NOT_READ_BY_ALL = ("held_out_share", "weight_share", "scale_x_r", "start")
"""Settings of a variant that only those methods read that name them in `varied`; all read the others."""


class VariantConfig(StrictModel):
    """Further ensembles: a method with something changed."""

    name: str = Field(min_length=1)
    method: MethodName
    cases: tuple[CaseName, ...] = ("noisy-301",)
    last_epoch: bool = Field(
        default=False, description="the method's own runs, read at the last epoch; nothing is trained anew"
    )
    channels: tuple[str, ...] | None = Field(default=None, description="sensors that are read; none = all five")
    held_out_share: NonNegativeFloat = Field(default=0.0, lt=1.0, description="readings no loss sees: early stopping")
    weight_share: PositiveFloat = Field(default=1.0, description="factor on the paper's starting weights")
    scale_x_r: PositiveFloat | None = Field(default=None, description="unit of the residual of x_r; none: its own")
    start: Literal["lab", "truth"] | None = Field(default=None, description="none: identify.start.at")
    members: PositiveInt | None = Field(default=None, description="none with last_epoch: those of the method's own")

    @property
    def where(self) -> str:
        """How messages name it."""
        return f"evaluation.variants: {self.name!r} of {self.method}"

    @model_validator(mode="after")
    def _nothing_ignored(self) -> VariantConfig:
        where = self.where
        changed = [name for name, value in self if value != type(self).model_fields[name].default]
        if self.last_epoch:
            if not find(self.method).with_epochs:
                allowed = ", ".join(method.name for method in in_order() if method.with_epochs)
                raise InputError(f"{where}: last_epoch", "true", allowed, "name one of these methods")
            extra = sorted(set(changed) - {"name", "method", "cases", "last_epoch"})
            if extra:
                raise InputError(
                    f"{where}: {', '.join(extra)}", "given beside last_epoch", "name, method, cases",
                    "leave it out: the method's own runs are read, as they are",
                )  # fmt: skip
            return self
        for name in changed:
            if name in NOT_READ_BY_ALL and name not in find(self.method).varied:
                allowed = f"with {' or '.join(method.name for method in in_order() if name in method.varied)}"
                advice = f"leave it out: {self.method} ignores it"
                raise InputError(f"{where}: {name}", getattr(self, name), allowed, advice)
        if self.members is None:
            raise InputError(f"{where}: members", "nothing", "a count of runs", "add this key")
        return self


class EvaluationConfig(StrictModel):
    """The paper's tables: ensembles of every method on every case, and repeated trainings of the learned parts."""

    cases: tuple[CaseName, ...] = Field(min_length=1)
    members: dict[MethodName, PositiveInt]
    members_per_batch: PositiveInt = Field(description="runs of one tensor program and of one cached step")
    trainings: PositiveInt = Field(description="repeated trainings of the operators and bodies")
    bootstrap: PositiveInt = Field(description="resamplings of the members behind the intervals of ratios")
    variants: tuple[VariantConfig, ...] = ()

    @model_validator(mode="after")
    def _every_ensemble_can_be_made(self) -> EvaluationConfig:
        self._refuse_equal_names()
        own = {f"evaluation.members: {method}": (method, count) for method, count in self.members.items()}
        varied = {v.where: (v.method, v.members or 0) for v in self.variants}
        for where, (method, count) in {**own, **varied}.items():
            first = find(method).sources
            if first is None:
                continue
            sources = self.members.get(first, 0)
            if not sources or count > sources:
                raise InputError(
                    where, f"{count} members" if count else method,
                    f"at most the {sources} of {first}, whose networks it starts from",
                    f"give evaluation.members: {first} as many" if sources else f"add evaluation.members: {first}",
                )  # fmt: skip
        for variant in self.variants:
            if variant.last_epoch and variant.method not in self.members:
                raise InputError(
                    f"{variant.where}: last_epoch", "true",
                    ", ".join(self.members), "add the method to evaluation.members: its own runs are read",
                )  # fmt: skip
        return self

    def _refuse_equal_names(self) -> None:
        """Results lie under the names of case, method and variant, the latter with _ for a space."""
        if len(set(self.cases)) < len(self.cases):
            raise InputError("evaluation.cases", ", ".join(self.cases), "every case once", "leave out the repeated one")
        seen: set[tuple[str, str, str]] = set()
        for variant in self.variants:
            for case in variant.cases:
                key = (variant.method, case, variant.name.replace(" ", "_"))
                if key in seen:
                    raise InputError(
                        variant.where, f"twice for {case}",
                        "one name, once for a method and case", "give it another name",
                    )  # fmt: skip
                seen.add(key)
