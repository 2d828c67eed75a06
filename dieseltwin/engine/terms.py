"""Terms of one engine: effects of the catalogue with their magnitudes, and laws that were found by search."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, field_validator, model_validator

from dieseltwin.engine.effect_catalogue import ADDED_AT, EFFECTS, POINTS

Region = dict[str, tuple[float, float]]
"""Input column -> (low, high): where a term acts."""

REGION_COLUMNS = ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")

LAW_VARIABLES = (
    "p_im", "p_em", "omega_t", "n_e", "u_delta", "u_egr", "u_vgt", "p_amb", "T_amb", "T_im", "T_em", "T_e", "T_c",
    "T_1", "x_r", "p_es", "p_bc", "W_c", "W_t", "W_egr", "W_ei", "W_eo", "W_f", "Pi_c", "Pi_t", "Pi_egr", "Pi_e",
    "t",
)  # fmt: skip
"""What a law may depend on: pressures [Pa], omega_t [rad/s], n_e [rpm], u_delta [mg/cycle], actuated positions u_egr,
u_vgt [%], temperatures [K], flows [kg/s], pressure quotients [-] (Pi_egr = p_im/p_em, Pi_e = p_em/p_im), time since the
recording's start t [s]."""


def _close(name: str, known: Any) -> str:
    near = difflib.get_close_matches(name, list(known), n=3, cutoff=0.5)
    return f"did you mean {', '.join(near)}?" if near else f"known: {', '.join(known)}"


class _Limited(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    std: float | None = Field(None, ge=0, description="standard deviation of the magnitude [its unit]")
    onset_s: float | None = Field(None, description="acts from this time of the recording on [s]; None: always")
    region: Region | None = Field(None, description="acts only inside these ranges of input columns; None: everywhere")
    valid_for: str | None = Field(None, description="domain of the data behind it, in words")

    @field_validator("region")
    @classmethod
    def _known_columns(cls, region: Region | None) -> Region | None:
        for column, (low, high) in (region or {}).items():
            if column not in REGION_COLUMNS:
                raise ValueError(f"unknown region column {column!r}; {_close(column, REGION_COLUMNS)}")
            if not low <= high:
                raise ValueError(f"region {column}: low {low:g} above high {high:g}")
        return region

    def factor(self, time_s: np.ndarray, start_s: float, conditions: Mapping[str, np.ndarray]) -> np.ndarray:
        """1 where the term acts, else 0, shape (n,); 0.5 over an interval in which a condition leaves its region.

        Args:
            time_s: sample times [s], (n,); start_s: the recording's start, from which `onset_s` counts.
            conditions: the input columns of `REGION_COLUMNS`, (n,) each.
        """
        acts = np.ones(time_s.shape, dtype=bool)
        if self.onset_s is not None:
            acts &= time_s - start_s >= self.onset_s
        for column, (low, high) in (self.region or {}).items():
            acts &= (conditions[column] >= low) & (conditions[column] <= high)
        factor = acts.astype(np.float64)
        if self.region:  # factors are held over the interval behind their sample; the edge lies somewhere inside
            factor[:-1] = 0.5 * (factor[:-1] + factor[1:])
        return factor


class Term(_Limited):
    """An effect of the catalogue in one engine."""

    effect: str = Field(description="name in the catalogue (`dieseltwin effects`)")
    magnitude: float = Field(description="in the effect's unit")

    @field_validator("effect")
    @classmethod
    def _known_effect(cls, name: str) -> str:
        if name not in EFFECTS:
            raise ValueError(f"unknown effect {name!r}; {_close(name, EFFECTS)}")
        return name

    @model_validator(mode="after")
    def _possible(self) -> Term:
        effect = EFFECTS[self.effect]
        low, high = effect.limits
        if not low <= self.magnitude <= high:  # not so for NaN either
            raise ValueError(f"{self.effect}: magnitude {self.magnitude:g} outside {low:g} to {high:g} {effect.unit}")
        return self

    @property
    def law(self) -> str:
        """The law in symbols."""
        return EFFECTS[self.effect].law

    @property
    def unit(self) -> str:
        """Unit of the magnitude."""
        return EFFECTS[self.effect].unit


class LawTerm(_Limited):
    """A found law that isn't in the catalogue: coefficient times powers of variables, at one insertion point.

    Its signal is coefficient * prod((variable/reference)**exponent); relative or added as the point is (`ADDED_AT`).
    """

    point: str = Field(description="insertion point")
    coefficient: float = Field(description="signal where every variable is at its reference")
    unit: str = Field(description="of the coefficient: '-' at a relative point, else the point's unit")
    factors: tuple[tuple[str, float, float], ...] = Field((), description="(variable, reference, exponent)")
    text: str = Field("", description="the law for people")

    @field_validator("point")
    @classmethod
    def _known_point(cls, name: str) -> str:
        if name not in POINTS:
            raise ValueError(f"unknown insertion point {name!r}; {_close(name, POINTS)}")
        return name

    @model_validator(mode="after")
    def _possible(self) -> LawTerm:
        expected = ADDED_AT.get(self.point, "-")
        if self.unit != expected:
            raise ValueError(f"unit {self.unit!r} at point {self.point}; allowed {expected!r}")
        if not math.isfinite(self.coefficient):
            raise ValueError("coefficient is not finite")
        for variable, reference, exponent in self.factors:
            if variable not in LAW_VARIABLES:
                raise ValueError(f"unknown variable {variable!r}; {_close(variable, LAW_VARIABLES)}")
            if not (reference > 0 and math.isfinite(reference) and math.isfinite(exponent)):
                raise ValueError(f"{variable}: reference must be positive, exponent finite")
        return self

    def signal(self, variables: Any, power: Any = np.power) -> Any:
        """The law's value where `variables` maps names to arrays or tensors; `power` raises to a power."""
        value: Any = self.coefficient
        for variable, reference, exponent in self.factors:
            value = value * power(variables[variable] / reference, exponent)
        return value


def _kind_of_term(value: Any) -> str:
    has_point = "point" in value if isinstance(value, dict) else hasattr(value, "point")
    return "law" if has_point else "effect"


AnyTerm = Annotated[
    Annotated[Term, Tag("effect")] | Annotated[LawTerm, Tag("law")], Discriminator(_kind_of_term)
]
"""A term of either kind; in a file a law is what has a `point`."""


def effect_terms(terms: Sequence[Term | LawTerm]) -> tuple[Term, ...]:
    """Those that are effects of the catalogue."""
    return tuple(term for term in terms if isinstance(term, Term))


def law_terms(terms: Sequence[Term | LawTerm]) -> tuple[LawTerm, ...]:
    """Those that are found laws."""
    return tuple(term for term in terms if isinstance(term, LawTerm))


def amounts(
    terms: Sequence[Term | LawTerm], names: Sequence[str], time_s: np.ndarray, start_s: float,
    conditions: Mapping[str, np.ndarray],
) -> np.ndarray:  # fmt: skip
    """Magnitude of each named effect at the samples, onset and region applied, (len(names), n) [its unit].

    Args:
        terms: of an engine; laws and effects that aren't named are not looked at.
        names: of effects.
        time_s: sample times [s], (n,); start_s: the recording's start.
        conditions: the input columns of `REGION_COLUMNS`, (n,) each.
    """
    out = np.zeros((len(names), time_s.size))
    for term in effect_terms(terms):
        if term.effect in names:
            out[list(names).index(term.effect)] += term.magnitude * term.factor(time_s, start_s, conditions)
    return out
