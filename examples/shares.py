"""What happens on a ring as more of its cars are driven: python examples/shares.py [--seeds 3] [--out runs/shares]."""

import argparse
from pathlib import Path

import pandas as pd

from rail_sumo import config_file
from rail_sumo.studies.sweep import Sweep


def main(arguments: list[str] | None = None) -> pd.DataFrame:
    """Drive three shares; print and return how the road's speed and lane changes differ from that without them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=300.0, help="the period that counts")
    parser.add_argument("--warm-up", type=float, default=60.0, help="seconds before it")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/shares"))
    given = parser.parse_args(arguments)
    tables = Sweep(
        config_file.of({"network": {"file": "ring5"}, "traffic": {"routes": ["ring5"]}}),
        drivers=("road-rail",),
        shares=(0.1, 0.5, 1.0),
        out=given.out,
        seeds=given.seeds,
        duration_s=given.seconds,
        warm_up_s=given.warm_up,
        workers=given.workers,
    ).drive()
    of_all = tables.differences.query("driver == 'road-rail' and vehicles == 'all'")
    of_all = of_all[of_all["measure"].isin(["speed_kmh", "lane_changes_per_vehkm"])]
    print(of_all[["share", "measure", "difference", "difference_low", "difference_high"]].to_string(index=False))
    return of_all


if __name__ == "__main__":
    main()
