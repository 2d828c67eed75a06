"""What is looked for in a file: the quantities of a diesel engine, or of a petrol engine (`petrol.recording`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dieseltwin.recordings.channels import AMBIENT, DIESEL_COLUMNS
from dieseltwin.sensors import SENSORS


@dataclass(frozen=True)
class Machine:
    """A kind of machine as its files are read.

    Attributes:
        section: of `data/channel_names.yaml`, that holds what names of its channels say.
        order: our columns, in the order of their weight.
        costs: our column -> what can't be told without it.
        commands: that take its recordings over time, and settled points; they stand in a channel map.
    """

    section: str
    order: tuple[str, ...]
    costs: Mapping[str, str]
    commands: tuple[str, str]


DIESEL = Machine(
    "meanings",
    (*DIESEL_COLUMNS, "torque_nm"),
    {
        "n_e_rpm": "without engine speed nothing can be simulated or fitted",
        "u_delta_mg": "without fuel nothing can be simulated or fitted; fuel per hour would do, or air flow and lambda",
        "u_egr_pct": "without the EGR valve's position nothing can be simulated; if there is none, add a column of "
                     "zeros",
        "u_vgt_pct": "without the VGT's position nothing can be simulated; for a fixed turbine, add a constant column",
        **{sensor.column: sensor.without for sensor in SENSORS},
        "t_im_k": "`discover` leaves it open, else the engine file's constant stands in; charge cooler loss and EGR "
                  "heating show through flows only",
        "p_amb_pa": "`discover` finds it, else the engine file's value stands in: at 1000 m that is 11 kPa wrong in "
                    "every pressure ratio",
        "t_amb_k": "`discover` finds it, else the engine file's value stands in: 10 K change compressor flow and speed "
                   "by 1.7 %",
    },
    ("identify", "calibrate"),
)  # fmt: skip

_NOT_RECORDED = "stands in where --sensors leaves it out (`discover`, `learn`)"
PETROL = Machine(
    "petrol",
    ("omega_e_rad_s", "w_af_kg_s", "p_im_pa", "p_ic_pa", "t_ic_k", "alpha_th_pct", *AMBIENT),
    {
        "omega_e_rad_s": "without engine speed nothing can be judged",
        "w_af_kg_s": "without the flow through the air filter no balance can be closed",
        "p_im_pa": "without the pressure behind the throttle no balance can be closed",
        "p_ic_pa": "without the pressure before the throttle no flow through it is known",
        "t_ic_k": "without the temperature before the throttle no flow through it is known",
        "alpha_th_pct": "without the throttle's position no flow through it is known",
        "p_amb_pa": f"sea level {_NOT_RECORDED}",
        "t_amb_k": f"20 degC {_NOT_RECORDED}",
    },
    ("discover", "discover"),
)
