"""An expert's folder: train one, evaluate it, record its demonstrations, and say how all of it was made."""

import itertools
import json

from safetensors.numpy import save

from rail_sumo import origin, run, training
from rail_sumo.assets import EXPERT_DEMONSTRATIONS, EXPERT_POLICY, EXPERT_RECIPE, MANIFEST, sha256
from rail_sumo.config import Config
from rail_sumo.config_file import dumps
from rail_sumo.drivers import Expert
from rail_sumo.files import AnyPath, check_folder, whole_folder
from rail_sumo.highway.observation import feature_names
from rail_sumo.imitation.demonstrations import DRIVER_SHA256, Demonstrations
from rail_sumo.records import Floats
from rail_sumo.rollout import EXPERT_TRAINING, Task, practise_all, traffic_seed
from rail_sumo.tables import report


def train(
    config: Config,
    out: AnyPath,
    *,
    seed: int,
    workers: run.WorkerCount = 1,
    observer: run.Observer = run.SILENT,
) -> run.Tables:
    """Train an expert by masked PPO into the new folder `out` and return its evaluation on held-out traffic.

    The folder, which appears once it is whole, holds the weights, the recipe (`config.toml`), the demonstrations that
    training takes by default, the evaluation's tables, and the manifest: every file's SHA-256, the seed, the versions
    of SUMO and of rail-sumo, the evaluation's means. The weights depend on configuration and seed alone.

    Raises:
        InputError: `out` exists or cannot be written, or the network or the demand cannot be driven.
    """
    from rail_sumo.imitation import ppo

    check_folder(out)
    run.require_drivable(config, config.train.evaluation_episodes)
    first = _first(config, seed, workers, observer) if config.expert.begins_as_rule else None
    observer.start("practise", config.expert.updates * config.expert.decisions_per_update)
    traffic_seeds = (traffic_seed(seed, EXPERT_TRAINING, episode) for episode in itertools.count())
    layers = ppo.train(config, seed, traffic_seeds, lambda _: observer.advance({}), first)
    expert = Expert(layers)
    tables = run.evaluate(
        {report.EXPERT: expert},
        config,
        episodes=config.train.evaluation_episodes,
        seed=seed,
        workers=workers,
        observer=observer,
    )
    demonstrations = run.record(
        expert, config, episodes=config.train.trajectories, seed=seed, workers=workers, observer=observer
    )
    about = {"driver": "expert", "seed": str(seed), "config": dumps(config)}
    with whole_folder(out) as whole:
        report.save(whole, episodes=tables.episodes, summary=tables.summary)
        features = feature_names(config.lidar, config.observation)
        weights = save(_tensors(expert), metadata={"features": json.dumps(features)})
        (whole / EXPERT_POLICY).write_bytes(weights)  # not by safetensors, whose files nobody else may read
        (whole / EXPERT_RECIPE).write_text(dumps(config), encoding="utf-8")
        about[DRIVER_SHA256] = sha256(whole / EXPERT_POLICY)
        demonstrations.save(whole / EXPERT_DEMONSTRATIONS, features=features, about=about)
        means = tables.summary.set_index("metric")["mean"]
        written = origin.manifest(whole, means, seed, training.world_inputs(config))
        (whole / MANIFEST).write_text(written, encoding="utf-8")
    return tables


def _first(config: Config, seed: int, workers: run.WorkerCount, observer: run.Observer) -> Demonstrations:
    """Return what the rule driver sees and does in training traffic."""
    world = config.practice(config.expert.horizon_s)
    tasks = [
        Task("rule", world, traffic_seed(seed, EXPERT_TRAINING, 0, episode))
        for episode in range(config.expert.begins_as_rule)
    ]
    return Demonstrations.from_trajectories(list(practise_all("rule", tasks, workers, observer)))


def _tensors(expert: Expert) -> dict[str, Floats]:
    tensors: dict[str, Floats] = {}
    for index, (weights, biases) in enumerate(expert.layers):
        tensors |= {f"{index}.weight": weights, f"{index}.bias": biases}
    return tensors
