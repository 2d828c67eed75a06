"""The calibrated petrol engine as a twin for the shared search: its readings are the misfits of its balances.

One sample is a block of a second, one channel a balance (see `petrol.model`). A reading is what a balance is off with
the calibrated maps and nothing fitted. With an effect, the other signals are taken back to what they would be without
it, each balance says which air flow should have been metered then, and that flow gives the misfit to be expected: any
size is exact, and the noise of the air flow stays out of what is expected. What may differ between two healthy
recordings are parameters with their tolerances (levels, the throttle's zero) and directions (covariance and smooth
field of each map, slow drift). Scatter and its correlation are known from held-out driving.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.nuisance import Nuisance, tolerance_modes
from dieseltwin.discovery.twins.interface import (
    Array,
    Hypothesis,
    Lanes,
    LawScope,
    Point,
    TwinDefaults,
    joined,
)
from dieseltwin.errors import InputError
from dieseltwin.notes import Note
from dieseltwin.petrol.believed import BALANCE_OF, healthy_parameters
from dieseltwin.petrol.blocks import Blocks, Once, blocks_of, make_grid
from dieseltwin.petrol.components import LINEAR_ABOVE
from dieseltwin.petrol.effects import AIR_FLOW, CLOCKS, HYPOTHESES, NEEDS, metered, undo_all
from dieseltwin.petrol.jumps import with_jumps
from dieseltwin.petrol.maps import BEND, STRAIGHT
from dieseltwin.petrol.model import (
    BALANCES,
    at_rest,
    cylinder_basis,
    drift_basis,
    log_efficiency,
    opening,
    outside,
    scale_of,
    throttle_basis,
    throttle_zero,
    unsteadiness,
)
from dieseltwin.petrol.parameters import FILLED, PetrolParameters
from dieseltwin.petrol.recording import Signals
from dieseltwin.recordings.noise import Noise, white_sigma
from dieseltwin.recordings.unread import standstills
from dieseltwin.settings.names import listed

KEPT_SPREAD = 1.206  # standard deviation of Student's t with 4 degrees of freedom within OUTLIER scales, in scales
SMALL_SHIFT = 1e-4  # of a map, for what misfits change by
LEAST_DIRECTION = 0.1  # whitened length of a direction of the maps that is still carried [-]
MAP_BALANCES = ("cylinder", "throttle")  # the others only compare sensors now and then
POINTS = (
    Point("eta_vol", "cylinder_flow", True, "-", ("omega_e", "p_im")),
    Point("A_th", "throttle_flow", True, "-", ("alpha", "Pi_th")),
    Point("intake_balance", "intake_mass_balance", False, "kg/s", ("p_im",), 1e-4),
    Point("intercooler_balance", "intercooler_mass_balance", False, "kg/s", ("p_ic",), 1e-3),
)
HOLES = {"intake_balance": "intake_leak", "intercooler_balance": "boost_leak"}


class PetrolTwin(TwinDefaults):
    """A calibrated petrol engine bound to a recording; satisfies `Twin` and `KnownErrors`.

    Args:
        engine: calibrated; its terms are part of the twin already, so `signals` come with them undone.
        signals: measured.
        columns: sensor columns that may be used; None for all.
        explained: effects with their sizes (n,) as found before. A second weighs less where a balance jumps as read and
            beside each of them: a leak that shows in short bursts of boost would weigh itself down. What the noise of
            the pressures does to a leak's flow weighs seconds down, too: near no flow it is most of it.
    """

    own_schedules = True
    courses = True
    law_scope = LawScope(holes=HOLES)

    def __init__(
        self, engine: PetrolParameters, signals: Signals, columns: Sequence[str] | None = None,
        explained: Sequence[Mapping[str, Array]] = (),
    ) -> None:  # fmt: skip
        self.engine, self.signals = engine, undo_all(engine.clocks, signals)
        self.grid = make_grid(signals.time_s)
        self.once = Once(vars(self.signals).values())
        self.blocks = blocks_of(self.signals, self.grid, engine.volumes.geometry, once=self.once)
        used = [n for n in BALANCES if columns is None or set(NEEDS[n]) <= set(columns)]
        self.channels = tuple(used)
        self.parameters = tuple(p for p in healthy_parameters(engine) if BALANCE_OF[p.name] in used)
        self.states: tuple[str, ...] = ()
        self.state_scales = np.zeros(0)
        self.points: tuple[Point, ...] = POINTS
        self.hypotheses: Mapping[str, Hypothesis] = HYPOTHESES
        self.time_s = self.grid.mid_s
        # an onset is tried at each block: neighbours are correlated, and a jump shows in its own second
        self.starts = np.arange(len(self.time_s))
        self.conditions: Mapping[str, Array] = {}
        self._known = self._maps_at(self.blocks)
        self._outside = outside(self.blocks, *engine.maps)
        raw = self.blocks
        self.plain = self._misfits(raw.W_af, raw.W_af, raw.boost - engine.boost_level, raw.cooler)
        self._sigma = self._scatter(explained)
        self._refuse_nothing_to_judge()
        self.measured = np.where(np.isfinite(self._sigma), self.plain, np.nan)
        self._directions = np.stack([self._parameter_direction(p.name) for p in self.parameters])

    def _scatter(self, explained: Sequence[Mapping[str, Array]]) -> Array:
        """(n, C) standard deviation of each reading, infinite where a block says nothing: as where it jumps least, as
        read and beside each of the explained effects."""
        scales = self._scales(self.blocks)
        for effects in explained:  # a throttle that is wide open beside an effect says nothing of its size
            scales = np.maximum(scales, self._scales(self._corrected(effects, {})))
        beside = [self._expected(effects, {}) for effects in explained]
        left = [self.plain, *(self.plain - each for each in beside)]
        out = KEPT_SPREAD * np.min([with_jumps(scales, each) for each in left], axis=0)
        for noise in self._through_effects(explained, beside):
            out = np.hypot(out, noise)
        return np.asarray(out)

    def _scales(self, blocks: Blocks) -> Array:
        """(n, C) scale of each reading by the calibration, infinite where a block says nothing, with the blocks as read
        or as they are without an effect."""
        engine, grid = self.engine, self.grid
        unsteady = unsteadiness(self.signals, grid, blocks)
        size = len(grid.mid_s)
        scales = {
            "cylinder": scale_of(engine.cylinder_spread, unsteady),
            "throttle": scale_of(engine.throttle_spread, unsteady),
            "boost": np.where(at_rest(self.blocks, grid), engine.boost_spread.base, np.inf),
            "cooler": np.full(size, engine.cooler_spread.base),
        }
        stuck = self._stuck()
        said = {name: grid.kept & ~stuck[name] & ~self.unlearned(name) for name in self.channels}
        if "throttle" in said:  # nearer to p_ic its equation is a straight line
            said["throttle"] &= blocks.p_im <= LINEAR_ABOVE * blocks.p_ic
        return np.stack([np.where(said[name], scales[name], np.inf) for name in self.channels], axis=1)

    def _through_effects(self, explained: Sequence[Mapping[str, Array]], beside: Sequence[Array]) -> Iterator[Array]:
        """(n, C) what the pressures' noise does to the misfits by way of each of some effects with their sizes (n,);
        `beside`: the misfits to be expected with each."""
        if not explained:
            return
        rows, none = np.sqrt(float(np.median(self.grid.count))), self._expected({}, {})
        pressures = {"p_ic_offset": self.signals.p_ic, "p_im_offset": self.signals.p_im}
        noises = {name: np.full(len(self.time_s), white_sigma(p) / rows) for name, p in pressures.items()}
        alone = [self._expected({name: noise}, {}) - none for name, noise in noises.items()]
        for effects, here in zip(explained, beside, strict=True):
            both = (self._expected({**effects, name: effects.get(name, 0.0) + noise}, {}) - here
                    for name, noise in noises.items())
            yield np.hypot(*(moved - own for moved, own in zip(both, alone, strict=True)))

    def _refuse_nothing_to_judge(self) -> None:
        """A balance without a second that counts can't be asked anything."""
        mute = [name for name, sigma in zip(self.channels, self._sigma.T, strict=True)
                if name in MAP_BALANCES and not np.isfinite(sigma).any()]  # fmt: skip
        if not mute:
            return
        still = [column for column, held in self._still().items() if held[self.grid.kept].all()]
        if still:
            raise InputError(f"recording: column {listed(still)}", "the same reading all the time",
                             "a reading that follows the engine", "mend this channel")  # fmt: skip
        raise InputError("recording", f"no second of the {listed(mute)} balance that can be judged",
                         "driving like that which the engine was learned from",
                         "learn it from driving that goes as far, or check the channels' units")  # fmt: skip

    def unlearned(self, balance: str) -> NDArray[np.bool_]:
        """(n,) whether a balance's map would have to be carried on too far beyond what was learned to say anything."""
        none = np.zeros(len(self.grid.mid_s), dtype=np.bool_)
        return np.any([none, *(np.abs(steps) > STRAIGHT for steps in self._outside.get(balance, ()))], axis=0)

    def notes(self) -> list[Note]:
        """How long the driving was too far beyond what was learned to be judged."""
        seconds = {name: int(np.sum(self.unlearned(name) & self.grid.kept)) for name in self.channels}
        lost = listed([f"{count} s of the {name}'s balance" for name, count in seconds.items() if count])
        return [Note(f"{lost} lie too far beyond the driving that the engine was learned from, and aren't judged; "
                     "learn it from driving that goes as far", "extrapolated")] if lost else []  # fmt: skip

    def _still(self) -> dict[str, NDArray[np.bool_]]:
        """Column -> (n,) whether its reading stands still there."""
        s = self.signals
        return {column: self.grid.mean(standstills(s.time_s, values, s.omega_e)) > 0.0
                for column, values in (("p_im_pa", s.p_im), ("p_ic_pa", s.p_ic), ("w_af_kg_s", s.W_af))}  # fmt: skip

    def _stuck(self) -> dict[str, NDArray[np.bool_]]:
        """Balance -> (n,) whether a reading that it is made of stands still there: it says nothing of the engine."""
        still = self._still()
        none = np.zeros(len(self.grid.mid_s), dtype=np.bool_)
        return {name: np.any([none, *(still[c] for c in NEEDS[name] if c in still)], axis=0) for name in self.channels}

    def _maps_at(self, b: Blocks) -> dict[str, Array]:
        """Logarithms of the volumetric efficiency and of the throttle's area by the calibrated maps, each (n,)."""
        cylinder, throttle = self.engine.maps
        return {
            "cylinder": self.once("cylinder", lambda: log_efficiency(b, cylinder), b.omega_e, b.p_im),
            "throttle": self.once(
                "throttle", lambda: throttle_basis(b, throttle) @ np.array(throttle.coefficients), b.alpha, b.psi
            ),
        }

    def _misfits(self, by_cylinders: Array, by_throttle: Array, boost: Array, cooler: Array) -> Array:
        """(n, C) misfits: of both air flows [kg/s] with the maps as the sensors read, and the other two as given."""
        raw, known = self.blocks, self._known
        every = {
            "cylinder": raw.cylinder(by_cylinders) - known["cylinder"],
            "throttle": raw.throttle(by_throttle) - known["throttle"], "boost": boost, "cooler": cooler,
        }  # fmt: skip
        return np.stack([every[name] for name in self.channels], axis=1)

    def _corrected(self, effects: Mapping[str, Array], added: Mapping[str, Array]) -> Blocks:
        """The blocks without effects (their sizes (n,)), those of the air-flow sensor left in."""
        others = {name: size[self.grid.index] for name, size in effects.items() if name not in AIR_FLOW}
        if not others and not added:
            return self.blocks
        geometry = self.engine.volumes.geometry
        return blocks_of(undo_all(others, self.signals), self.grid, geometry, added, self.once)

    def _entered(self, lanes: Lanes, b: int) -> tuple[dict[str, Array], dict[str, Array]]:
        """Effects with their sizes (n,), and signals at points, of one lane."""
        ones = np.ones(len(self.time_s))
        effects = {}
        for name, values in lanes.magnitudes.items():
            schedule = lanes.schedules.get(name, ones)
            effects[name] = values[b] * (schedule if schedule.ndim == 1 else schedule[b])
        added = dict(lanes.signals)
        if lanes.lane_points is not None and lanes.lane_signals is not None and lanes.lane_points[b] >= 0:
            point = self.points[int(lanes.lane_points[b])].name
            added = joined(added, {point: lanes.lane_signals[b]})
        return {name: size for name, size in effects.items() if np.any(size)}, added

    def expected_with(self, effects: Mapping[str, Array]) -> Array:
        """(n, C) misfits to be expected with effects, their sizes (n,)."""
        return self._expected(effects, {})

    def robust_scales(self) -> tuple[Array, Array]:
        """(n, C) scales by the calibration alone, infinite where a block says nothing, and what divides the logarithm
        of each balance's likelihood (C,)."""
        return self._scales(self.blocks), self._factors()

    def _expected(self, effects: Mapping[str, Array], added: Mapping[str, Array], shift: float = 0.0) -> Array:
        """(n, C) misfits to be expected with effects (their sizes (n,)) and signals at points.

        shift: by how much both maps are off [-]. Beside a leak the air-flow sensor reads only a part of what the
            cylinders take in, and a map's error is a larger share of that part.
        """
        b = self._corrected(effects, added)
        maps = self._maps_at(b)
        taken_in = np.exp(maps["cylinder"] + b.log_eta + shift) * b.W_d + b.before_cylinders
        let_through = np.exp(maps["throttle"] + b.log_area + shift) * b.unit_flow + b.before_throttle
        late = self.blocks.W_af - b.W_af
        return self._misfits(
            metered(effects, taken_in + late), metered(effects, let_through + late), self.blocks.boost - b.boost,
            self._cooler_beside(b),
        )  # fmt: skip

    def _cooler_beside(self, b: Blocks) -> Array:
        """(n,) misfit of the cooler's balance that is to be expected with the blocks as they are without effects.

        With the charge's middle temperature: one that was warmer than it read would vary by less of itself, so that
        every fluctuation of a healthy one would speak for an offset.
        """
        raw = self.blocks
        charge = np.log1p((b.T_ic - raw.T_ic) / float(np.median(raw.T_ic)))
        return np.asarray(np.log(b.T_amb / raw.T_amb) - charge)

    def _parameter_direction(self, name: str) -> Array:
        out = np.zeros(self.plain.shape)
        j = self.channels.index(BALANCE_OF[name])
        out[:, j] = throttle_zero(self.blocks, self.engine.maps[1]) if name == "throttle_zero_pct" else 1.0
        return out

    def noise(self) -> Noise:
        """As `KnownErrors.noise`."""
        sigma = np.array([np.median(column[np.isfinite(column)]) if np.isfinite(column).any() else np.nan
                          for column in self._sigma.T])
        return Noise(sigma, self._rho())

    def _rho(self) -> Array:
        """(C,) correlation of neighbouring blocks that makes a sum as uncertain as the calibration found it."""
        factors = self._factors()
        return np.asarray((factors - 1.0) / (factors + 1.0))

    def _factors(self) -> Array:
        """(C,) by which neighbouring blocks that are correlated count as fewer."""
        engine = self.engine
        spreads = {"cylinder": engine.cylinder_spread, "throttle": engine.throttle_spread,
                   "boost": engine.boost_spread, "cooler": engine.cooler_spread}  # fmt: skip
        return np.array([spreads[name].tempering for name in self.channels])

    def whitening(self) -> Whitening:
        """As `KnownErrors.whitening`: autoregressive noise whose size changes from block to block."""
        present = np.isfinite(self.measured)
        sigma = np.where(present, self._sigma, 1.0)
        linked = np.zeros_like(present)
        same = (np.diff(self.grid.piece) == 0)[:, None]
        linked[1:] = present[1:] & present[:-1] & same
        rho = np.where(linked, self._rho(), 0.0)
        previous = rho.copy()
        previous[1:] *= sigma[1:] / sigma[:-1]
        return Whitening(present, previous, np.where(present, 1.0 / (sigma * np.sqrt(1.0 - rho**2)), 0.0))

    def nuisances(self, lanes: Lanes) -> list[Nuisance]:
        """As `KnownErrors.nuisances`: maps within their covariance and smooth field, slow drift of every balance."""
        t, (effects, added) = self.engine.tolerances, self._entered(lanes, 0)
        blocks = self._corrected(effects, added)
        here = self._expected(effects, added)
        per_shift = (self._expected(effects, added, SMALL_SHIFT) - here) / SMALL_SHIFT
        cylinder, throttle = self.engine.maps
        bases = {
            "cylinder": (cylinder_basis(blocks, cylinder), cylinder.covariance),
            "throttle": (throttle_basis(blocks, throttle), throttle.covariance),
        }
        fields = {
            "cylinder": t.cylinder_field * tolerance_modes([blocks.omega_e, np.log(blocks.p_im)]),
            "throttle": t.throttle_field * tolerance_modes([opening(blocks.alpha), blocks.p_im / blocks.p_ic]),
        }
        drifts = {"cylinder": t.drift, "throttle": t.drift, "boost": t.boost_drift, "cooler": t.cooler_drift}
        hats = drift_basis(self.time_s)
        out = []
        for j, name in enumerate(self.channels):
            if name in bases:
                modes = [*self._modes(*bases[name], j), *fields[name], *self._bends(name)]
                per = per_shift[:, j]
                out += [self._direction(f"map of {name}, mode {k + 1}", j, per * mode) for k, mode in enumerate(modes)]
            out += [self._direction(f"drift of {name}", j, drifts[name] * hat) for hat in hats.T]
        return [*out, *self._filling(), *self._sensors(effects, added, here)]

    def _filling(self) -> list[Nuisance]:
        """What fills, as far off as it was learned: its misfits as read, were each volume larger by its spread."""
        volumes, found = self.engine.volumes, []
        for name, std in zip(FILLED, volumes.spread, strict=True):
            if std > 0.0:
                larger = volumes.model_copy(update={name: getattr(volumes, name) * (1.0 + std)})
                moved = blocks_of(self.signals, self.grid, larger.geometry, once=self.once)
                both = {"cylinder": moved.cylinder(self.blocks.W_af) - self.blocks.cylinder(self.blocks.W_af),
                        "throttle": moved.throttle(self.blocks.W_af) - self.blocks.throttle(self.blocks.W_af)}
                response = np.stack([both.get(c, np.zeros(len(self.time_s))) for c in self.channels], axis=1)
                found.append(Nuisance(f"filling of {name}", response=response))
        return found

    def _sensors(self, effects: Mapping[str, Array], added: Mapping[str, Array], here: Array) -> list[Nuisance]:
        """Clocks and the pressure sensor as far off as on healthy days, next to effects (sizes (n,)) and signals, with
        which misfits are to be expected as they are `here` (n, C)."""
        t, none = self.engine.tolerances, np.zeros(len(self.time_s))
        sizes = {name: t.clock * self.hypotheses[name].tolerance for name in CLOCKS}
        sizes |= {"p_im_gain": t.p_im_gain, "p_im_offset": t.p_im_offset_pa}
        found = []
        for name, size in sizes.items():
            moved = {**effects, name: effects.get(name, none) + size}
            found.append(Nuisance(f"healthy {name}", response=self._expected(moved, added) - here))
        return found

    def _modes(self, basis: Array, covariance: Array, channel: int) -> Array:
        """(K, n) independent directions of a map's error along the recording, those that can be seen."""
        directions = basis @ np.linalg.cholesky(covariance)
        weight = np.where(np.isfinite(self.measured[:, channel]), 1.0 / self._sigma[:, channel], 0.0)
        _, lengths, rows = np.linalg.svd(weight[:, None] * directions, full_matrices=False)
        return np.asarray((directions @ rows[lengths > LEAST_DIRECTION].T).T)

    def _bends(self, balance: str) -> list[Array]:
        """What a balance's map may bend by where it is carried on straight: (n,) below and above, an argument each."""
        found = []
        for steps in self._outside[balance]:
            beyond = np.clip(steps, -STRAIGHT, STRAIGHT)
            found += [0.5 * BEND * side**2 for side in (np.minimum(beyond, 0.0), np.maximum(beyond, 0.0)) if side.any()]
        return found

    def _direction(self, label: str, channel: int, signal: Array) -> Nuisance:
        response = np.zeros(self.plain.shape)
        response[:, channel] = signal
        return Nuisance(label, response=response)

    def first_local(self) -> Array:
        """No states start anew: (W, 0)."""
        return np.zeros((len(self.starts), 0))

    def simulate(self, lanes: Lanes) -> Array:
        """As `Twin.simulate`."""
        out = np.tensordot(lanes.parameters, self._directions, 1)
        for b in range(lanes.size):
            effects, added = self._entered(lanes, b)
            if effects or added:
                out[b] += self._expected(effects, added)
        return out

    def variables(self, lanes: Lanes) -> dict[str, Array]:
        """As `Twin.variables`: what the ports name, as measured."""
        del lanes
        b = self.blocks
        return {
            "omega_e": b.omega_e, "p_im": b.p_im, "p_ic": b.p_ic, "alpha": b.alpha, "Pi_th": b.p_im / b.p_ic,
            "W_af": b.W_af, "p_amb": b.p_amb, "T_ic": b.T_ic, "T_amb": b.T_amb, "t": self.time_s,
        }  # fmt: skip
