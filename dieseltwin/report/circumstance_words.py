"""Words for what a recording was made under and doesn't say: weather, clocks, the fuel's scale."""

from __future__ import annotations

from collections.abc import Mapping

from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.discovery.verdict.found_circumstance import FoundCircumstance
from dieseltwin.notes import listing
from dieseltwin.recordings.circumstances import CORRECTED, kind_of
from dieseltwin.report import quantities

ALIKE: Mapping[str, tuple[str, str]] = {
    "egr_dead_time": ("time_shift:u_egr_pct", "a column u_egr_pct that alone is recorded early by as much"),
    "vgt_dead_time": ("time_shift:u_vgt_pct", "a column u_vgt_pct that alone is recorded early by as much"),
    "injector_drift": ("", "a fuel signal whose scale, or a fuel whose heating value, is off by as much"),
}
"""Effect -> circumstance that looks the same, and in words."""

NEARLY_HEALTH: Mapping[str, tuple[str, str]] = {
    "injector_drift": ("eta_sc", "only the contrast between low and high loads decides, and weighing the fuel would "
                       "settle it"),
}  # fmt: skip
"""Effect -> health parameter that it is hardly separable from, and what decides, in words."""


def circumstance_words(item: FoundCircumstance) -> str:
    """What a recording was made under, "the ambient pressure is 93.1 ± 0.3 kPa, not 101.3"."""
    kind, _, column = item.name.rpartition(":")
    if kind == "time_shift":
        late = "late" if item.value > 0.0 else "early"
        return f"{column} is recorded {_with_deviation(abs(item.value), item.std, 2)} s {late}"
    if kind == "drift":
        way = "rises" if item.value > 0.0 else "falls"
        return f"the ambient pressure {way} by {_with_deviation(1e-3 * abs(item.value), 1e-3 * item.std, 1)} kPa"
    if kind == "scale":
        burns = _with_deviation(100.0 * item.value, 100.0 * item.std, 1)
        return f"the fuel that burns is {burns} % of what is recorded"
    if kind == "corrected":
        maps = {"k_cflow": "efficiency follows corrected flow", "k_cspeed": "flow follows corrected speed"}[column]
        return f"the compressor's {maps} by {_with_deviation(100.0 * item.value, 100.0 * item.std, 0)} %"
    words = {"p_amb_pa": "the ambient pressure", "t_amb_k": "the ambient temperature",
             "t_im_k": "the temperature behind the charge cooler"}[column]  # fmt: skip
    factor, shift, unit = (1e-3, 0.0, "kPa") if item.unit == "Pa" else (1.0, -273.15, "°C")
    value, assumed = factor * item.value + shift, factor * item.assumed + shift
    return f"{words} is {_with_deviation(value, factor * item.std, 1)} {unit}, not {assumed:.1f}"


def compressor_words(document: Discrepancy) -> list[str]:
    """What a learned engine's compressor does in weather that isn't that of its learning, in words."""
    told = [_on_its_day(document, item) for item in document.circumstances if kind_of(item.name) == CORRECTED]
    return [f"the weather isn't that in which the engine was learned: {listing(told)} (0 % is the published model); "
            "limits and intervals hold what that leaves open"] if told else []  # fmt: skip


def shown_day(date: str) -> str:
    """Day of a recording's date, or the name that stands for it where there is none."""
    return date if date.startswith("recording") else date[:10]


def _with_deviation(value: float, std: float, decimals: int) -> str:
    """Value ± standard deviation; more decimals where a deviation that isn't zero would read as zero."""
    if std > 0.0 and round(std, decimals) == 0.0:
        decimals = quantities.decimals_for(std)
    return f"{value:.{decimals}f} ± {std:.{decimals}f}"


def circumstances_words(document: Discrepancy) -> str:
    """All circumstances that are plainly others than assumed, empty where there is none."""
    off = [_on_its_day(document, item) for item in document.circumstances if item.off]
    return listing(off) if off else ""


def _on_its_day(document: Discrepancy, item: FoundCircumstance) -> str:
    words = circumstance_words(item)
    return words if item.recording is None else f"on {shown_day(document.recordings[item.recording - 1].date)} {words}"


def blameless_words(document: Discrepancy) -> str:
    """What circumstances that are others than assumed mean for the engine.

    Weather and clocks are none of its faults. A charge at another temperature may be one: the air that the cylinders
    take in and the exhaust's temperature tell it, and these a loss of eta_vol beside one of eta_sc changes as well.
    """
    if any(item.off and item.name == "t_im_k" for item in document.circumstances):
        return ("which may be the weather, the charge cooler or how well the cylinders fill: a column of the charge's "
                "temperature (t_im_k) would tell")  # fmt: skip
    return "which is no fault of the engine"


def recorded_words(document: Discrepancy) -> list[str]:
    """What was put right before anything was judged."""
    words = circumstances_words(document)
    return [f"as the recording shows, though its columns don't say so, {words}, {blameless_words(document)}"
            ] if words else []  # fmt: skip


def nearly_health_words(document: Discrepancy) -> list[str]:
    """That a change of health gives nearly the same as what was found, and what decides."""
    names = [effect.name for effect in document.effects if effect.name in NEARLY_HEALTH]
    return [f"{name} is hardly separable from {NEARLY_HEALTH[name][0]}, which could give nearly the same: "
            f"{NEARLY_HEALTH[name][1]}" for name in names]  # fmt: skip


def alike_words(document: Discrepancy) -> list[str]:
    """Effects that the recording's own errors would look like, as sentences."""
    opened = {item.name for item in document.circumstances}
    said = []
    for name in (name for effect in document.effects for name in effect.names):
        alike = ALIKE.get(name)
        if alike is not None and alike[0] not in opened:
            said.append(f"in this recording {name} looks the same as {alike[1]}")
    return said
