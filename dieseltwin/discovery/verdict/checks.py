"""Can this recording, with this engine file, answer the question at all? Refusals and notes, before and after the fit.

A name that comes out of a recording that can't carry it is worse than no answer, so every refusal here is an
`InputError`: one line, what was found, what would do. What is doubtful but usable becomes a note.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dieseltwin.arrays import MAD_TO_STD, Array
from dieseltwin.engine import HEALTH, MEASURED, EngineParameters, constants
from dieseltwin.engine.simulate import numpy_model
from dieseltwin.engine.terms import corrections_in
from dieseltwin.errors import InputError
from dieseltwin.notes import Note
from dieseltwin.recordings.channel_checks import channel_notes
from dieseltwin.recordings.channels import refuse_missing
from dieseltwin.recordings.guess.physics import reversed_where_read
from dieseltwin.recordings.held import rows_between_readings
from dieseltwin.recordings.reader import Recording
from dieseltwin.sensors import NEEDED
from dieseltwin.settings.strict import listed, unknown_name

MINIMUM_S = 60.0
"""Shortest running time [s]: six windows of 10 s, each of which spends three unknown states, in two halves that must
agree; noise and its correlation need some 200 rows."""

COMFORTABLE_S = 300.0
"""Below, a note: limits are higher, and all error rates were measured at 600 s. 600 s in place of the first 120 of them
lowered the limits by 1.2 to 3.6 times (the median is 1.8), that of an EGR valve that clogs with time by 30: noise
averages out with the square root of the time, tolerances of maps only as new operating points are visited."""

MOST_ROWS = 150_000
"""Rows with the engine running: responses to all tolerances and effects take 50 kB a row while they are compared."""

_MET = 100
"""Rows with a reading of every channel, from which a direction is told."""

LEAST_SENSORS = 3
"""As many readings as states; with fewer a state can't be told from a parameter."""

LEAST_SPREAD = 0.10
"""Spread (5 to 95 %) of an input over the engine's range from which it counts as varied: a map's own smooth error
changes over a third of its range, so a smaller walk sees one constant error and nothing else."""

LEAST_VARIED = 2
"""Inputs that must vary: along one input alone four health parameters and a tolerance follow any effect."""

LEAST_CELLS = 6
"""Operating points (cells of a tenth of each range) visited for a second or more: a point gives at most five equations
in steady running, four go to the health parameters; one effect, its place and a tolerance need some more."""

LEAST_PRESENT = 0.5  # share of a sensor's own raster with a reading; one that is mostly silent is not one of those used
SLOWEST_READING_S = 2.0  # raster of a sensor that still counts as one: the turbo goes from idle to full load in three
FEW_VALUES = 3  # a channel with so few different readings is stuck or a status word
LARGEST_BREATHING = 1.4
"""Factor by which the air balance may be off with a reading of the compressor flow: effects of the catalogue at ten
times their tolerance reach 1.32 (volumetric efficiency), a displacement that is wrong by half is beyond it."""

LARGEST_BREATHING_BY_MAP = 1.75
"""The same with the compressor flow from its map, whose flat speed lines magnify an error of p_im."""

NOTED_BREATHING = 1.1  # worth a note, with a reading of the compressor flow
HEALTH_FACTORS: Mapping[str, float] = {"A_egrmax": 4.0, "A_vgtmax": 2.0, "eta_sc": 2.0, "h_tot": 8.0}
"""Factor from the engine file's value beyond which a repaired health parameter is none: another engine. (Unseen physics
moves h_tot by a factor of two in the fit without it; the paper's engine differs by up to 1.33 in the field.)"""

LARGEST_CHI2 = 25.0
"""Chi-square per sample of the repaired fit, beyond tolerances, above which it is no fit: five times the noise.
Raw it says nothing beside quiet sensors: maps that are 0.3 % off leave as much behind a noise of 0.1 %."""

_SMOOTHING_S = 2.0  # of the readings in the air balance
_BALANCE_ROWS = 100
_BOOSTED = 1.3  # p_im/p_amb from which an error of a few kPa is small


def check_sensors(recording: Recording, sensors: Sequence[str] | None) -> tuple[str, ...]:
    """The sensor columns to use, in the order of `MEASURED`.

    Args:
        recording: any recording.
        sensors: columns asked for; None takes every one that the recording has, and wants the paper's five.

    Raises:
        InputError: an unknown or missing column, too few, or one that says nothing (constant, mostly missing).
    """
    where = str(recording.path or "recording")
    if sensors is not None:
        for name in sensors:
            if name not in MEASURED:
                raise unknown_name("--sensors", name, MEASURED)
    wanted = NEEDED if sensors is None else tuple(sensors)
    refuse_missing(where, recording.columns, wanted, LEAST_SENSORS)
    used = tuple(n for n in MEASURED if (n in wanted if sensors is not None else n in recording.columns))
    if len(used) < LEAST_SENSORS:
        raise InputError(
            f"{where}: sensors", listed(used) or "none", f"{LEAST_SENSORS} or more of {listed(MEASURED)}",
            "name more columns with --sensors",
        )  # fmt: skip
    for name in used:
        _check_alive(recording, name, used, where)
    return used


def _check_alive(recording: Recording, name: str, used: Sequence[str], where: str) -> None:
    running = _running(recording)
    values = recording.columns[name][running]
    finite = values[np.isfinite(values)]
    others = ",".join(other for other in used if other != name)
    leave_out = f"mend this channel or leave it out: --sensors {others}"
    slowest = SLOWEST_READING_S / float(np.median(np.diff(recording.time_s)))  # rows
    present = finite.size * min(rows_between_readings(values), max(slowest, 1.0))
    if present < LEAST_PRESENT * values.size:
        share = 100.0 * finite.size / max(values.size, 1)
        raise InputError(f"{where}: column {name}", f"a reading in {share:.0f} % of the rows",
                         f"in {100 * LEAST_PRESENT:.0f} % or more", leave_out)  # fmt: skip
    different = np.unique(finite).size
    if different <= FEW_VALUES:
        got = f"constant ({finite[0]:.6g} in every row)" if different == 1 else f"only {different} different readings"
        raise InputError(f"{where}: column {name}", got, "a reading that follows the engine", leave_out)


def _running(recording: Recording) -> np.ndarray:
    rows = [np.arange(piece.start, piece.stop) for piece in recording.pieces()]
    return np.concatenate(rows) if rows else np.empty(0, dtype=np.int64)


def check_length(recording: Recording) -> None:
    """Refuse a recording that is too short for any verdict.

    Raises:
        InputError: less than a minute of running engine.
    """
    seconds = recording.running_s
    step = float(np.median(np.diff(recording.time_s)))
    if seconds + step < MINIMUM_S:
        raise InputError(
            str(recording.path or "recording"), f"{seconds:.3g} s of running engine",
            f"{MINIMUM_S:g} s or more for a verdict, 600 s for the stated error rates", "record longer",
        )  # fmt: skip


def check_rows(*recordings: Recording) -> None:
    """Refuse recordings that are together too large for the memory that a verdict, or learning from them, takes.

    Raises:
        InputError: more than `MOST_ROWS` with the engine running.
    """
    rows = sum(piece.stop - piece.start for recording in recordings for piece in recording.pieces())
    if rows > MOST_ROWS:
        what = f"{len(recordings)} recordings" if len(recordings) > 1 else str(recordings[0].path or "recording")
        raise InputError(what, f"{rows} rows of running engine", f"at most {MOST_ROWS}",
                         "take a part, or average to 5 Hz")  # fmt: skip


def excitation(recording: Recording, engine: EngineParameters) -> tuple[dict[str, float], int]:
    """Spread of each input over the engine's range [-], and the operating points visited for a second or more."""
    running = _running(recording)
    spreads: dict[str, float] = {}
    cells = []
    for name, (low, high) in engine.input_ranges.items():
        values = recording.columns[name][running]
        values = values[np.isfinite(values)]
        near, far = np.quantile(values, [0.05, 0.95]) if values.size else (0.0, 0.0)
        spreads[name] = float((far - near) / (high - low))
        whole = recording.columns[name][running]
        cells.append(np.floor(10.0 * (np.nan_to_num(whole, nan=low) - low) / (high - low)).astype(np.int64))
    if running.size == 0:
        return spreads, 0
    _, counts = np.unique(np.stack(cells), axis=1, return_counts=True)
    step = float(np.median(np.diff(recording.time_s)))
    return spreads, int(np.count_nonzero(counts * step >= 1.0))


def check_excitation(recording: Recording, engine: EngineParameters) -> None:
    """Refuse driving along which every effect looks like a health parameter.

    Raises:
        InputError: fewer than two inputs vary, or too few operating points.
    """
    spreads, cells = excitation(recording, engine)
    varied = [name for name, spread in spreads.items() if spread >= LEAST_SPREAD]
    if len(varied) >= LEAST_VARIED and cells >= LEAST_CELLS:
        return
    got = ", ".join(f"{name} over {100 * spread:.0f} %" for name, spread in spreads.items())
    raise InputError(
        f"{recording.path or 'recording'}: not enough excitation",
        f"{got} of the engine's range; {cells} operating points",
        f"{LEAST_VARIED} or more inputs over {100 * LEAST_SPREAD:.0f} % and {LEAST_CELLS} operating points",
        "drive through other speeds and loads",
    )


def air_balance(recording: Recording, engine: EngineParameters) -> float | None:
    """What the engine breathes over what its file says that it does [-]; 1 where the displacement fits.

    Flow into the intake (compressor and EGR, less what is stored) over the flow into the cylinders that the file's
    displacement gives. With a reading of the compressor flow, a leak to the ambient is fitted beside the factor, so
    that a leak doesn't count as displacement. Without one the map at the readings of speed and pressure has to do;
    then only boosted rows count and their median is taken. None where the recording can't tell.
    """
    columns = recording.columns
    needed = ["p_im_pa", "w_egr_kg_s", "w_c_kg_s" if "w_c_kg_s" in columns else "omega_t_rad_s"]
    if any(name not in columns for name in needed):
        return None
    read = "w_c_kg_s" in columns
    inflow, breath, leak, boost = [], [], [], []
    model, c = numpy_model(), constants(engine.replace(p_amb=recording.p_amb_pa, T_amb=recording.t_amb_k))
    for piece in recording.pieces():
        time = recording.time_s[piece]
        if time[-1] - time[0] < 3.0 * _SMOOTHING_S:
            continue
        p_im, n_e = (_smooth(time, columns[name][piece]) for name in ("p_im_pa", "n_e_rpm"))
        if read:
            W_c = _smooth(time, columns["w_c_kg_s"][piece])
        else:
            omega_t = _smooth(time, columns["omega_t_rad_s"][piece])
            W_c = model.compressor_flow(model.Phi_c(c.T_amb, p_im / c.p_amb, omega_t, c), omega_t, c)
        W_egr = _smooth(time, columns["w_egr_kg_s"][piece])
        stored = c.V_im / (c.R_a * c.T_im) * np.gradient(p_im, time)
        inflow.append(W_c + W_egr - stored)
        breath.append(model.cylinder_inflow(model.eta_vol(p_im, n_e, c), p_im, n_e, c))
        boost.append(p_im / c.p_amb)
        leak.append(np.sqrt(np.maximum(p_im**2 - c.p_amb**2, 0.0)) / math.sqrt(c.R_a * c.T_im))
    if not inflow:
        return None
    flow, into, out = np.concatenate(inflow), np.concatenate(breath), np.concatenate(leak)
    kept = np.isfinite(flow) & np.isfinite(into) & (into > 0.0)
    if not read:
        kept &= np.concatenate(boost) > _BOOSTED
    if np.count_nonzero(kept) < _BALANCE_ROWS:
        return None
    if not read:
        return float(np.median(flow[kept] / into[kept]))
    return _breathing(flow[kept], into[kept], out[kept])


def _breathing(flow: Array, into: Array, out: Array) -> float:
    """Constant a of flow = a into + A out with A >= 0, relative errors weighted alike, outliers cut once."""
    weight = 1.0 / into
    kept = np.ones(flow.size, dtype=bool)
    factor = 1.0
    for _ in range(2):
        matrix = np.stack([into * weight, out * weight], axis=1)[kept]
        found, *_ = np.linalg.lstsq(matrix, (flow * weight)[kept], rcond=None)
        if found[1] < 0.0:
            found = np.array([float(np.median((flow * weight)[kept])), 0.0])
        factor = float(found[0])
        rest = (flow - found[0] * into - found[1] * out) * weight
        kept = np.abs(rest - np.median(rest)) < 3.0 * MAD_TO_STD * np.median(np.abs(rest - np.median(rest))) + 1e-12
    return factor


def _smooth(time: Array, values: Array) -> Array:
    """Moving mean over `_SMOOTHING_S`, NaN left out of it, (n,)."""
    width = max(1, round(_SMOOTHING_S / float(np.median(np.diff(time)))))
    kernel = np.ones(min(width, values.size))
    finite = np.isfinite(values)
    total = np.convolve(np.where(finite, values, 0.0), kernel, mode="same")
    count = np.convolve(finite.astype(float), kernel, mode="same")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0.5 * kernel.size, total / count, np.nan)


def check_engine(recording: Recording, engine: EngineParameters) -> float | None:
    """Refuse an engine file of another engine, before anything is fitted; returns the factor of `air_balance`.

    Raises:
        InputError: the engine breathes far more or less than its file says.
    """
    factor = air_balance(recording, engine)
    allowed = LARGEST_BREATHING if "w_c_kg_s" in recording.columns else LARGEST_BREATHING_BY_MAP
    if factor is None or 1.0 / allowed <= factor <= allowed:
        return factor
    raise InputError(
        f"{recording.path or 'recording'} with this engine file (V_d {1e3 * engine.V_d:.4g} l)",
        f"an engine that breathes {100 * factor:.0f} % of that (as with {1e3 * factor * engine.V_d:.3g} l)",
        f"{100 / allowed:.0f} to {100 * allowed:.0f} %",
        "give the file of this engine with --engine, or check the units of flows, pressure and speed",
    )


def check_recording(
    recording: Recording, engine: EngineParameters, sensors: Sequence[str] | None = None
) -> tuple[tuple[str, ...], list[Note]]:
    """All checks that need no fit.

    Returns:
        The sensor columns to use, and notes for people.

    Raises:
        InputError: the recording can't carry a verdict, or the engine file is another engine's.
    """
    if not recording.standing:
        check_length(recording)
    check_rows(recording)
    used = check_sensors(recording, sensors)
    check_excitation(recording, engine)
    factor = check_engine(recording, engine)
    notes = []
    seconds = recording.running_s
    if seconds < COMFORTABLE_S and not recording.standing:
        notes.append(Note(f"{seconds:.0f} s of driving; with 600 s most limits would be lower (five times the driving "
                          "lowered them by 1.2 to 4 times)", "short"))  # fmt: skip
    learned = corrections_in(engine.terms) is not None  # by so much its reference breathed differently as well
    noted = factor is not None and not 1.0 / NOTED_BREATHING <= factor <= NOTED_BREATHING
    if factor is not None and noted and "w_c_kg_s" in used and not learned:
        notes.append(Note(f"the engine breathes {100 * factor:.0f} % of what the engine file says; check V_d and "
                          "the flow sensors before you trust a name", "wrong_engine"))  # fmt: skip
    return used, [*notes, *channel_notes(recording, used)]


def check_sensitivity(
    recording: Recording, minimum_detectable: Mapping[str, float], limits: Mapping[str, float]
) -> None:
    """Refuse a recording that could show nothing: every effect's smallest visible size is beyond what can exist.

    Args:
        recording: for the message.
        minimum_detectable: name -> smallest visible size.
        limits: name -> largest physical size.

    Raises:
        InputError: no effect is visible within its physical range.
    """
    visible = [n for n, size in minimum_detectable.items() if math.isfinite(size) and size <= limits.get(n, math.inf)]
    if minimum_detectable and not visible:
        raise InputError(
            f"{recording.path or 'recording'}: not enough excitation",
            "no effect that could be seen within its physical range", "a recording in which at least one could",
            "drive through other speeds and loads, or record longer",
        )  # fmt: skip


def check_fit(
    recording: Recording, engine: EngineParameters, repaired: EngineParameters, chi2: float | None
) -> None:
    """Refuse a verdict where even the repaired twin is no twin of what was recorded.

    Args:
        recording: for the message.
        engine: as given.
        repaired: as found.
        chi2: per sample of the repaired fit, beyond what maps and sensors leave within their tolerances [-].

    Raises:
        InputError: residuals of five times the noise, or health parameters of no engine.
    """
    problem = misfit_of(engine, repaired, chi2)
    if problem is not None:
        first = "".join(f"turn {name} round ({why}), or " for name, why in _turned(recording).items())
        raise InputError(f"{recording.path or 'recording'} with this engine file", *problem,
                         f"{first}give the file of this engine with --engine (`dieseltwin learn` makes it from driving"
                         " when the engine was well) or --reference, or check the channels and their units")


def _turned(recording: Recording) -> dict[str, str]:
    """Positions of a recording that seem to count the other way, with the reason."""
    columns = {"p_amb_pa": np.full(recording.time_s.size, recording.p_amb_pa), **recording.columns}
    return reversed_where_read(columns, _MET)


def misfit_of(
    engine: EngineParameters, repaired: EngineParameters, chi2: float | None
) -> tuple[str, str] | None:
    """What makes a repaired twin no twin of what was recorded, and what would be allowed; None where it is one.

    Args:
        engine: as given; repaired: as found; chi2: as of `check_fit`.
    """
    for name in HEALTH:
        ratio = getattr(repaired, name) / getattr(engine, name)
        factor = HEALTH_FACTORS[name]
        if not 1.0 / factor <= ratio <= factor:
            return f"{name} at {ratio:.2g} times the file's value", f"{1 / factor:.2g} to {factor:g} times"
    if chi2 is not None and chi2 > LARGEST_CHI2:
        return (f"residuals of {math.sqrt(chi2):.2g} times the noise after every repair",
                f"{math.sqrt(LARGEST_CHI2):g} times at most")
    return None
