"""How many steps and seconds RAIL and GAIL take until they drive as fast as the expert, or nearly.

    python benchmarks/efficiency.py --out runs/efficiency [--masked] [--seeds 10] [--iterations 60] [--every 4]

Either learner starts from the same clone, and acts as it trains: RAIL by argmax, GAIL sampled. They are not masked,
since a masked clone is as fast as its expert from the start; `--masked` shows that. Every so often the policy is driven
on traffic that is neither trained nor evaluated on, the same for all, and its mean speed is compared with the expert's;
it has got there when it keeps the share over two such looks, of which the first counts. Looking is not timed; seconds
are of a core's time. A training that never gets there counts as longer than all others, and so a median over trainings
stands as long as more than half of them get there.
"""

import argparse
import itertools
import tempfile
import time
from pathlib import Path

import kept
import numpy as np
import pandas as pd

from rail_sumo import config_file, learners, rollout, roster, run, training
from rail_sumo.imitation import gail  # noqa: F401  importing it takes seconds, which are nobody's training

LEARNERS = ("rail", "gail")
SHARES = (0.95, 0.97, 0.98, 0.99)
TRAFFIC = 10**6 + 1
"""The seed of the traffic they are looked at on."""
FIRST_SEED = 200
EPISODES = 24


def learning_curve(given: tuple[str, bool, int, int, int]) -> pd.DataFrame:
    """A row per look: how far training was, and the policy's speed over the expert's on the same traffic."""
    learner, is_masked, seed, n_iterations, every = given
    masked = f"policy.masked={str(is_masked).lower()}"
    world = config_file.load(None, [f"train.learner={learner}", "train.iterations=0", masked])

    def speed(driver) -> float:
        episodes, *_ = run.evaluate({"": driver}, world, episodes=EPISODES, seed=TRAFFIC)
        return episodes["speed_kmh"].mean()

    expert = speed(roster.find_driver("expert", world))
    looks = []
    with tempfile.TemporaryDirectory() as folder, rollout.workers(1) as pool:
        begun = training.learn(world, Path(folder) / "run", seed=FIRST_SEED + seed)
        iterations = learners.LEARNERS[learner].iterate(
            learners.Practice(begun, pool), begun.checkpoint(), training.demonstrations_of(world)
        )
        looks.append({"iteration": 0, "steps": 0, "seconds": 0.0, "speed": speed(begun.clone) / expert})
        steps, seconds = 0, 0.0
        for number in range(1, n_iterations + 1):
            started = time.process_time()
            iteration = next(iterations)
            seconds += time.process_time() - started
            steps += sum(len(trajectory.lane_changing) for trajectory in iteration.driven)
            if number % every == 0:
                share = speed(iteration.learned) / expert
                looks.append({"iteration": number, "steps": steps, "seconds": seconds, "speed": share})
    return pd.DataFrame(looks).assign(learner=learner, seed=seed)


def got_there(curve: pd.DataFrame, share: float) -> pd.Series:
    """Iteration, steps and seconds of the first of two looks in a row that show the share; inf without such."""
    shown = curve["speed"].to_numpy() >= share
    first = np.flatnonzero(shown[:-1] & shown[1:])
    columns = ["iteration", "steps", "seconds"]
    return curve.iloc[first[0]][columns] if len(first) else pd.Series(np.inf, columns)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--masked", action="store_true", help="tell the learners what is open")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--every", type=int, default=4, help="iterations between looks")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    parts = {
        f"{learner}{seed}{'-masked' * given.masked}-{given.iterations}-iterations-every-{given.every}": (
            learner, given.masked, seed, given.iterations, given.every,
        )
        for seed, learner in itertools.product(range(given.seeds), LEARNERS)
    }  # fmt: skip
    curves = kept.tables(
        given.out,
        parts,
        learning_curve,
        workers=given.workers,
        say=lambda curve: " ".join(f"{speed:.3f}" for speed in curve["speed"]),
    ).groupby(["learner", "seed"], sort=False)
    for share in SHARES:
        reached = curves.apply(got_there, share).unstack("learner")
        medians = reached.median().unstack("learner")
        n_reached = np.isfinite(reached["seconds"]).sum().to_dict()
        print(f"\n{share:.0%} of the expert's speed, medians; reached by {n_reached} of {given.seeds}")
        print(medians.round(1).to_string())


if __name__ == "__main__":
    main()
