"""The sensor columns: what of the model each one reads, its noise, its faults and its words, one row a column.

A row here, of a quantity that the engine computes (`engine.quantities.Quantities`) and the nomenclature knows
(`symbols`), is a reading that the kernels give, the reader takes and checks, `simulate` and `discover` give faults, the
likelihoods compare and the reports draw (docs/tour-effect.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from dieseltwin.symbols import SYMBOLS, Symbol

if TYPE_CHECKING:
    from dieseltwin.settings.params import NoiseConfig


@dataclass(frozen=True)
class Fault:
    """A fault of a sensor that has a name in the catalogue of effects.

    Attributes:
        kind: "gain": reading (1 + magnitude); "offset": reading + magnitude.
        tolerance: smallest magnitude of interest [- or unit of the column].
        limit: largest possible one, either way.
    """

    kind: Literal["gain", "offset"]
    tolerance: float
    limit: float


@dataclass(frozen=True)
class Sensor:
    """One column that a sensor gives and the likelihood compares.

    Attributes:
        name: of its symbol, which is a state or a field of `engine.quantities.Quantities`.
        noise: usual standard deviation over the mean [-].
        floor: smallest standard deviation of the noise that is believed [unit].
        usual: a usual reading [unit]; what is believed of an offset is a share of it.
        faults: that have names; any gain or offset can be found, named or not.
        without: what a recording without it costs. Factors: smallest visible size of each effect with five sensors over
            that with six, ten minutes of simulated driving with the paper's noise (docs/formats.md).
        needed: a recording that is to be identified has it.
    """

    name: str
    noise: float
    floor: float
    usual: float
    faults: tuple[Fault, ...]
    without: str
    needed: bool = True

    @property
    def symbol(self) -> Symbol:
        """Its column, unit, plausible range, label and meaning."""
        return SYMBOLS[self.name]

    @property
    def column(self) -> str:
        """Its column in recordings."""
        return self.symbol.column


GAIN = Fault("gain", 0.01, 0.3)

# Noise: the paper's noisy few-shot case. Floors: about 0.1 % of full scale (0.5 % for the EGR venturi). Noise that is a
# percentage of a vanishing flow pretends information: without a floor a recording with a shut EGR valve would claim to
# know A_egrmax. They are far below the paper's percentages wherever a channel carries a signal.
SENSORS: tuple[Sensor, ...] = (
    Sensor(
        "p_im", 0.03, 200.0, 1.5e5, (Fault("offset", 1000.0, 3e4),),
        "identify needs it to start; for discover an offset of the sensor is out of reach, and filter and cooler must "
        "be 1.1 times as bad to show",
    ),
    Sensor(
        "p_em", 0.03, 200.0, 2.0e5, (GAIN, Fault("offset", 1500.0, 4e4)),
        "identify needs it to start; for discover offset and gain of the sensor are out of reach, other effects show "
        "as before (within 5 %)",
    ),
    Sensor(
        "omega_t", 0.01, 5.0, 5000.0, (),
        "identify needs it to start; for discover the air filter must be 4.4 times as bad to show, an exhaust leak "
        "1.8, compressor flow, blow-by and VGT offset 1.5, bearings 1.4",
    ),
    Sensor(
        "W_egr", 0.05, 5e-4, 0.05, (GAIN,),
        "a leaking, late or worn EGR valve must be twice as bad to show, volumetric efficiency 1.3 times",
    ),
    Sensor(
        "T_em", 0.03, 1.0, 700.0, (GAIN,),
        "injector drift, EGR heating and the exhaust's inertia must be 1.5 times as large to show, back-pressure 1.3; "
        "eta_sc and h_tot get intervals 1.1 times as wide",
    ),
    Sensor(
        "W_c", 0.03, 1e-3, 0.2, (GAIN,),
        "a boost leak must be 1.2 times as large to show, and then looks like a loss of compressor efficiency",
        needed=False,
    ),
)  # fmt: skip
"""The states of the gas path first, then the paper's other two, then those that a recording may lack."""

MEASURED = tuple(sensor.column for sensor in SENSORS)
"""Columns of the sensors, in the order of every array of readings."""

NEEDED = tuple(sensor.column for sensor in SENSORS if sensor.needed)
"""Those that a recording must have, the five of the paper."""

N_READ_STATES = 3
"""Sensors of states, at the head of the table: p_im, p_em, omega_t."""

READ = tuple(sensor.name for sensor in SENSORS[N_READ_STATES:])
"""Quantities that the other sensors read, by their names in `engine.quantities.Quantities`."""


def relative_noise(noise: NoiseConfig) -> tuple[float, ...]:
    """Noise of every sensor over its mean [-]: params.yaml's where it has a line for it, else the table's."""
    given = noise.model_dump()
    return tuple(given.get(f"{sensor.name.lower()}_rel", sensor.noise) for sensor in SENSORS)
