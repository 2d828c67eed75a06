"""`params.yaml` as frozen models: one model a stage; no defaults here, the numbers and their reasons stand in the file.

Units are part of the field names (`_s`, `_rpm`, `_pa`, `_k`, `_pct`, `_mg`, `_kg_s`); `_rel` is a fraction of a mean;
fields without a unit are counts or dimensionless. An owner of a stage adds a field to its model and to `params.yaml`.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from pydantic import (
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    SerializeAsAny,
    field_validator,
)

from dieseltwin.errors import InputError
from dieseltwin.paths import refuse_unreadable
from dieseltwin.settings.discovery import DiscoverConfig, LearnConfig, PromotionConfig, ProofConfig
from dieseltwin.settings.evaluation import EvaluationConfig
from dieseltwin.settings.maps import MapsConfig, Widths
from dieseltwin.settings.method_settings import MethodSettings
from dieseltwin.settings.methods import find
from dieseltwin.settings.strict import StrictModel, overridden, read_profile, validate
from dieseltwin.settings.watch import WatchConfig

PARAMS_FILE = "params.yaml"
OWN_SECTIONS = ("profiles", "driving", "identify", "promotion", "discover", "proof", "watch")
"""Top-level names by which a settings file is known; others, as `seed`, stand in any program's."""
DEFAULT_PROFILE = "quick"

# Sections of the settings as JSON, in the environment of a process that has to look no file up, nor have those that it
# starts: the result of a flow's step is known by its sections, and the file may have been edited meanwhile.
SECTIONS_VARIABLE = "DIESELTWIN_SECTIONS"

Range = tuple[float, float]

# RK4 is stable up to 2.785 time constants, and the engine's fastest is 11 ms. Set-II at three ambients against steps of
# 1.25 ms: states are off by at most 0.5 % of their mean at 29 ms, 4 % at 33 ms, 16 % at 40 ms, hundreds at 0.2 s.
LONGEST_STEP_S = 0.03


class EngineConfig(StrictModel):
    """The engine that data are made with, and the step of the simulator."""

    step_s: float = Field(gt=0.0, le=LONGEST_STEP_S)
    overrides: dict[str, float | tuple[float, ...]]
    field_ratios: dict[str, PositiveFloat] = Field(description="laboratory value / field value")


class RandomDrivingConfig(StrictModel):
    """Seeded random transient driving: speed and load hold, ramp and idle, with jitter and slow dither."""

    speed_rpm: Range
    load_rel: Range = Field(description="of the full-load torque at that speed")
    hold_s: Range
    ramp_s: Range
    idle_share: Range
    idle_speed_rpm: Range
    smoothing_s: NonNegativeFloat
    speed_jitter_rpm: NonNegativeFloat
    fuel_jitter_mg: NonNegativeFloat
    position_dither_pct: Range = Field(description="standard deviation of the slow random dither of the actuators")
    dither_time_s: PositiveFloat


class SpeedMapConfig(StrictModel):
    """GTR 4 de-normalisation speeds."""

    n_idle_rpm: PositiveFloat
    n_lo_rpm: PositiveFloat
    n_pref_rpm: PositiveFloat
    n_hi_rpm: PositiveFloat


class EcuConfig(StrictModel):
    """Limits of the ECU map from speed and load to fuel and actuator positions."""

    smoke_lambda_min: PositiveFloat
    egr_fraction_max: PositiveFloat
    turbo_speed_max_rad_s: PositiveFloat
    smoke_reserve_rel: NonNegativeFloat = Field(description="kept above the smoke limit when inputs are made")
    turbo_reserve_rel: NonNegativeFloat = Field(lt=0.5, description="kept below the turbo's limit when inputs are made")
    idle_u_egr_pct: NonNegativeFloat
    idle_shut_u_egr_pct: NonNegativeFloat
    idle_shut_after_s: PositiveFloat
    fuel_min_mg: PositiveFloat


class CaseConfig(StrictModel):
    """One case of the paper's table: a set of inputs, an ambient relative to the baseline, a sampling time."""

    set: Literal["set_i", "set_ii", "set_iii", "set_iv"]
    delta_t_amb_k: float
    delta_p_amb_pa: float
    parameters: Literal["lab", "field"]


class SetConfig(StrictModel):
    """One set of inputs."""

    duration_s: PositiveFloat
    seed: NonNegativeInt
    input_step_s: PositiveFloat
    modified: Literal["none", "u_egr", "u_vgt"]


class DrivingConfig(StrictModel):
    """Sets of inputs and the cases recorded with them."""

    sample_s: PositiveFloat
    sample_eta_tm_s: PositiveFloat
    sets: dict[str, SetConfig]
    cases: dict[str, CaseConfig]
    random: RandomDrivingConfig
    speed_map: SpeedMapConfig
    ecu: EcuConfig


class NoiseConfig(StrictModel):
    """Additive Gaussian noise, sigma as a fraction of the mean of the clean signal over the whole recording."""

    p_im_rel: NonNegativeFloat
    p_em_rel: NonNegativeFloat
    omega_t_rel: NonNegativeFloat
    w_egr_rel: NonNegativeFloat
    t_em_rel: NonNegativeFloat
    w_c_rel: NonNegativeFloat
    label_rel: NonNegativeFloat = Field(description="of the mean absolute label, for the surrogates' labels")
    seed: NonNegativeInt


class OperatorConfig(StrictModel):
    """One causality DeepONet."""

    input_hidden: Widths
    initial_hidden: Widths
    trunk_hidden: Widths
    basis: PositiveInt
    updates: PositiveInt = Field(description="of Adam; an epoch of the paper is one update on the full batch")
    batch: PositiveInt = Field(description="rows of random windows in an update")
    rate: PositiveFloat
    loss_weights: tuple[PositiveFloat, ...]


class OperatorsConfig(StrictModel):
    """Actuator operators: EGR (two outputs) and VGT (one)."""

    window_s: PositiveFloat
    sample_s: PositiveFloat
    slide_s: PositiveFloat = Field(description="shift of the sliding window that augments the training data")
    memory_s: PositiveFloat = Field(description="older samples decay fastest")
    memory_decay: NonNegativeFloat = Field(description="weight decay of the oldest samples, per learning rate")
    forget_s: PositiveFloat = Field(description="shortest time constant that the trunk starts with")
    start_share: NonNegativeFloat = Field(le=1.0, description="rows from the first samples of a window")
    finish_rows: NonNegativeInt = Field(description="rows a pass to solve the last layer at the end; 0 for none")
    finish_ridge: PositiveFloat = Field(description="of the mean diagonal of that system")
    egr: OperatorConfig
    vgt: OperatorConfig


class BodyConfig(StrictModel):
    """One multi-head body."""

    hidden: Widths


class BodiesPaperConfig(StrictModel):
    """Training of the four bodies as printed: Adam on all heads."""

    epochs: PositiveInt
    rate: PositiveFloat
    finish_heads: bool = Field(description="solve the heads in closed form after the last epoch")
    first_layer_scale: Range | None = Field(default=None, description="as of conditioned; none: the printed start")


class BodiesConditionedConfig(StrictModel):
    """Training of the four bodies by variable projection: Adam, then L-BFGS."""

    epochs: PositiveInt
    rate: PositiveFloat
    lbfgs_steps: NonNegativeInt
    first_layer_scale: Range = Field(description="slopes of the first layer on time scaled to [-1, 1]")


class BodiesConfig(StrictModel):
    """The four multi-head bodies."""

    heads: PositiveInt
    sizes: dict[str, BodyConfig]
    paper: BodiesPaperConfig
    conditioned: BodiesConditionedConfig


class PretrainConfig(StrictModel):
    """Everything learned from laboratory data."""

    maps: MapsConfig
    operators: OperatorsConfig
    bodies: BodiesConfig


class StartConfig(StrictModel):
    """Where the unknowns start: at the laboratory values, never around the truth but to show how much that flatters."""

    at: Literal["lab", "truth"]
    sd_masked: NonNegativeFloat


def _sections(sections: Mapping[str, Any]) -> dict[str, MethodSettings]:
    """Every section as its method's model. Raises `InputError` for an unknown method and what a model refuses."""
    where = "identify.methods"
    if not isinstance(sections, Mapping):
        raise InputError(where, f"a {type(sections).__name__}", "a mapping of methods to their settings", "mend it")
    found: dict[str, MethodSettings] = {}
    for name, section in sections.items():
        model = find(str(name), where).settings
        if isinstance(section, MethodSettings):
            section = section.model_dump()
        if not isinstance(section, Mapping):
            raise InputError(f"{where}.{name}", section, "a mapping of names to values", "mend it")
        found[str(name)] = validate(model, section, f"{where}.{name}")
    return found


class IdentifyConfig(StrictModel):
    """What the estimators share, and the settings of each."""

    segment_s: PositiveFloat
    runs: PositiveInt
    identifiable_bound_rel: PositiveFloat
    minutes: PositiveFloat = Field(description="how much of Case-V is identified, from its start [min]")
    start: StartConfig
    methods: dict[str, SerializeAsAny[MethodSettings]] = Field(description="their own settings, by the method's name")

    _models_of_the_methods = field_validator("methods", mode="before")(_sections)

    def of(self, method: str) -> MethodSettings:
        """The settings of one method; its own defaults where the file names none.

        Raises:
            InputError: unknown method, or a value is missing that has no default.
        """
        if method in self.methods:
            return self.methods[method]
        return validate(find(method).settings, {}, f"identify.methods.{method}")

    def changed(self, method: str, **settings: object) -> IdentifyConfig:
        """The same with some settings of one method changed; refused like what stands in the file."""
        own = self.of(method)
        section = validate(type(own), {**own.model_dump(), **settings}, f"identify.methods.{method}")
        return self.model_copy(update={"methods": {**self.methods, method: section}})

    def runs_of(self, method: str) -> int:
        """Runs a segment: the method's own number where it has one."""
        return self.of(method).members or self.runs


class ReportConfig(StrictModel):
    """Figures of the report."""

    dpi: PositiveInt


class Params(StrictModel):
    """All of `params.yaml` with one profile applied."""

    profile: str
    seed: NonNegativeInt
    engine: EngineConfig
    driving: DrivingConfig
    noise: NoiseConfig
    pretrain: PretrainConfig
    identify: IdentifyConfig
    evaluation: EvaluationConfig
    promotion: PromotionConfig
    learn: LearnConfig
    discover: DiscoverConfig
    proof: ProofConfig
    watch: WatchConfig
    report: ReportConfig

    @property
    def sha256(self) -> str:
        """Hash of every number of this profile: the same for the same numbers, whatever the comments and order."""
        return params_sha256(self)


def default_params_path() -> Path:
    """`params.yaml` of the working folder, else the package's own (in a checkout a link to the one at the top).

    Other programs have a file of that name as well (DVC's is): one without any section of ours is theirs.
    """
    here = Path(PARAMS_FILE)
    return here if here.is_file() and _is_ours(here) else Path(__file__).resolve().parents[1] / PARAMS_FILE


def _is_ours(path: Path) -> bool:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return True  # reading it once more says what is wrong
    return any(name in OWN_SECTIONS for name in re.findall(r"^[\"']?(\w+)[\"']?[ \t]*:", text, re.MULTILINE))


def load_params(path: str | Path | None = None, profile: str = DEFAULT_PROFILE) -> Params:
    """Read and validate the settings of one profile.

    Args:
        path: the file; None takes `default_params_path()`.
        profile: a name under `profiles:`; its values replace the common ones above it.

    Raises:
        InputError: unreadable file, unknown profile, unknown or missing key, value out of range.
        RuntimeError: no file is named in a process that was given its sections (`SECTIONS_VARIABLE`), and not this one.
    """
    if path is None and SECTIONS_VARIABLE in os.environ:
        given = ", ".join(json.loads(os.environ[SECTIONS_VARIABLE])) or "none"
        raise RuntimeError(f"settings: got a question beyond the sections that this process was given ({given}); "
                           "allowed: the sections of its step; add another one there")  # fmt: skip
    path = default_params_path() if path is None else Path(path)
    refuse_unreadable(path, "a YAML file")
    try:
        content = path.read_bytes()
    except OSError:
        content = b""  # reading it once more says what is wrong
    return _validated(path, content, profile)


@lru_cache(maxsize=8)
def _validated(path: Path, content: bytes, profile: str) -> Params:
    """The settings of a file that holds these bytes: a command asks for them several times."""
    common, overrides = read_profile(path, profile)
    validate(Params, {**common, "profile": profile}, str(path))
    settings = overridden(common, overrides, f"{path}: profiles.{profile}")
    return validate(Params, {**settings, "profile": profile}, f"{path}: profile {profile}")


def params_sha256(params: Params | Mapping[str, object]) -> str:
    """SHA-256 (hex) of the settings, or of plain sections of them, as canonical JSON."""
    plain = params.model_dump(mode="json") if isinstance(params, Params) else dict(params)
    canonical = json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()
