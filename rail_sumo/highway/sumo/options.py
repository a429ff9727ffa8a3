"""What SUMO is started with: a user's options, ours, and our vehicle types."""

from pathlib import Path

from rail_sumo.highway.names import HOST
from rail_sumo.highway.network.demand import Demand
from rail_sumo.records import SECONDS_PER_STEP

HOST_TYPES = Path(__file__).with_name("host.add.xml")
TRAFFIC_TYPES = Path(__file__).with_name("traffic.add.xml")
"""The types as SUMO has them by default, whatever a user's demand says of its default. The made traffic decides every
0.5 s, which halves what it costs, and brakes by 3 m/s², which calms it. Its types are kept away from a user's demand:
one type with an `actionStepLength` of its own, though nobody is of it, makes SUMO drive everybody differently."""

ALWAYS = {
    "step-length": SECONDS_PER_STEP,
    "collision.action": "warn",
    "collision.mingap-factor": 0,
    "collision.check-junctions": "true",
    "no-step-log": "true",
    "no-warnings": "true",
    "xml-validation": "never",
}
"""What SUMO is always told: contacts are counted and not removed, and nothing is said."""
FOR_MADE_TRAFFIC = {"time-to-teleport": -1, "max-depart-delay": 0}
"""What it is told beside these of a window's traffic: a vehicle enters at once or not at all, and never teleports."""

SEEDS = 2**31
"""SUMO takes seeds below this."""


def options_of(net_file: Path, demand: Demand, *, begin_s: float, seed: int) -> dict[str, object]:
    """Return what SUMO is started with, by the options' names."""
    types = (HOST_TYPES,) if demand.has_traffic else (HOST_TYPES, TRAFFIC_TYPES)
    return {
        "net-file": net_file,
        "additional-files": ",".join(map(str, (*types, *demand.additional))),
        "begin": begin_s,
        **({} if demand.has_traffic else FOR_MADE_TRAFFIC),
        **demand.options,
        **ALWAYS,
        "seed": seed % SEEDS,
        **({"route-files": ",".join(map(str, demand.routes))} if demand.routes else {}),
    }


def floating_car_data(file: Path, *, reach_m: float) -> tuple[str, ...]:
    """Return the options that have SUMO write, on every step, where the host is and who is within reach of it.

    Parquet, CSV or XML, by the file's suffix. `HOST` in them stands for whatever the host's id is.
    """
    columns = "x,y,angle,type,speed,acceleration,lane,pos,odometer"
    return (
        *("--fcd-output", str(file), "--fcd-output.attributes", columns),
        *("--device.fcd.explicit", HOST, "--device.fcd.radius", str(reach_m)),
    )
