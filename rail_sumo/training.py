"""A run from its clone to its last iteration, every one saved as it is done."""

import itertools
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from rail_sumo import assets, drivers, registry, rollout
from rail_sumo.config import OF_LEARNERS, Config
from rail_sumo.errors import InputError
from rail_sumo.highway import metrics, varied
from rail_sumo.highway.network import demand
from rail_sumo.highway.observation import bounds, feature_names
from rail_sumo.imitation.demonstrations import Demonstrations, recorded_by, recorded_on
from rail_sumo.learners import Iteration, Practice, learner_of
from rail_sumo.policy import ARGMAX, LARGEST, SAMPLED, PolicyParameters, Shape, Whitening
from rail_sumo.records import Trajectory
from rail_sumo.rollout import SILENT, Observer, WorkerCount
from rail_sumo.run_directory import LEARNERS_COLUMNS, Checkpoint, RunDirectory, require_new

ROUNDING = 1e-3
"""How far a number may go beyond its bounds, since files hold 32 bits."""
FAR_HITS = 0.01
"""Of the rays that tell the range, how many may have hit something just short of it: 32 bits round that up."""
UNTOLD = (
    "by the demonstrations everything was open to their driver at all times (columns allowed_*, or none), and so a "
    "masked clone of them may change lanes too seldom; tell there what was open, or set policy.masked=false"
)
"""What is said of demonstrations without masks that a masked policy is to be cloned from."""


def learn(
    config: Config, out: Path, *, seed: int, workers: WorkerCount = 1, resume: bool = False, observer: Observer = SILENT
) -> RunDirectory:
    """Start a run, or take it up again, and bring it to its last iteration.

    Raises:
        InputError: as in `run.train`.
    """
    given, config = config, resolved(config)
    require_loss(config)
    run = RunDirectory(out) if resume else None
    if run is None:
        require_new(out)
    if learner_of(config).asks_the_expert:
        drivers.require_same_senses(drivers.load_expert(config), config, "the expert, who is to be asked,")
    demonstrations = demonstrations_of(given)
    inputs = inputs_of(config)
    with rollout.workers(workers) as pool:  # before the run's folder is there: Ray may be missing
        if run is None:
            for note in (*unread(config), *doubts(config, demonstrations), *other_expert(config)):
                observer.note(note)
            run = RunDirectory.create(out, config, seed, inputs, _start(config, demonstrations, seed))
        else:
            run.go_on(config, seed, inputs)

        checkpoint = run.checkpoint()
        observer.start(config.train.learner, config.train.n_iterations, done=checkpoint.iteration)
        before = checkpoint.progress[-1] if checkpoint.progress else {"environment_steps": 0, "seconds": 0.0}
        started = time.perf_counter() - before["seconds"]
        practice = Practice(run, pool)
        iterations = learner_of(config).iterate(practice, checkpoint, demonstrations)
        if not isinstance(iterations, Iterable):
            raise InputError(
                f"learner '{config.train.learner}' returns {iterations!r:.40}; it has to yield an `Iteration` of "
                "rail_sumo.learners after every iteration"
            )
        for iteration in itertools.islice(iterations, config.train.n_iterations - checkpoint.iteration):
            _require_whole(iteration, checkpoint, config.train.learner)
            row = {
                "iteration": checkpoint.iteration + 1,
                "environment_steps": before["environment_steps"] + practice.steps,
                "seconds": round(time.perf_counter() - started, 3),
                **iteration.figures,
                **metrics.means(iteration.driven),
            }
            checkpoint = Checkpoint(iteration.learned, iteration.memory, (*checkpoint.progress, row))
            run.save(checkpoint)
            observer.advance(row)
        if checkpoint.iteration < config.train.n_iterations:
            observer.note(
                f"learner '{config.train.learner}' ended by itself, after {checkpoint.iteration} of "
                f"{config.train.n_iterations} iterations"
            )
    return run


def unread(config: Config) -> Iterator[str]:
    """Tell which keys have a value of their own in sections that the learner does not read."""
    others = set(OF_LEARNERS) - set(learner_of(config).reads)
    idle = [key for key in config.of_its_own() if key.partition(".")[0] in others]
    if idle:
        yield f"{', '.join(idle)}: without effect on learner '{config.train.learner}'"


def doubts(config: Config, demonstrations: Demonstrations) -> Iterator[str]:
    """Yield what may keep a learner from its expert's level, though it can be learned."""
    if not learner_of(config).reads_demonstrations:
        return
    if config.policy.masked and demonstrations.allowed.all():
        yield UNTOLD
    theirs = set(map(assets.network_name, recorded_on(_demonstrations_file(config))))
    ours = set(map(assets.network_name, config.varied.networks or [config.network.file]))
    if theirs and theirs != ours:
        yield (
            f"the demonstrations were recorded on {', '.join(sorted(theirs))}, and this trains on "
            f"{', '.join(sorted(ours))}: a judge may tell the roads apart in place of the drivers; train there "
            f"(--network), or record the same driver here (rail-sumo expert record --driver) and name that file by "
            f"train.demonstrations"
        )


def other_expert(config: Config, compares: str = "the table at the end compares with") -> Iterator[str]:
    """Tell whose the demonstrations are and which driver figures compare with, unless it is the expert for certain.

    Args:
        config: names the demonstrations and the expert.
        compares: what refers to the expert; the sentence goes on with "the expert that train.expert names".
    """
    learner = learner_of(config)
    if not learner.reads_demonstrations:
        return
    file, folder = _demonstrations_file(config), assets.expert_folder(config.train.expert)
    if file.resolve() == (folder / assets.EXPERT_DEMONSTRATIONS).resolve():
        return
    driver, content = recorded_by(file)
    expert = expert_input(config)["train.expert"]
    if content == expert:
        return
    asked = f", and {config.train.learner} asks that one too" if learner.asks_the_expert else ""
    named = f"the expert that train.expert names, {_told(config.train.expert, expert)}{asked}"
    if content or driver not in ("", "expert", config.train.expert):
        yield (
            f"the demonstrations are of {_told(driver, content)}, and {compares} {named}: compare with the driver of "
            "the demonstrations by: rail-sumo eval RUN DRIVER --reference DRIVER"
        )
    else:
        yield (
            f"the demonstrations do not tell for certain whose they are, and {compares} {named}; if another made them, "
            "compare with that one by: rail-sumo eval RUN DRIVER --reference DRIVER"
        )


def _told(driver: str, content: str) -> str:
    return f"'{driver}'" + (f" (SHA-256 {content[:12]}...)" if content else "")


def require_loss(config: Config) -> None:
    """Raise InputError if there is no loss of the name that the judge is to minimise."""
    from rail_sumo.imitation.losses import LOSSES

    registry.find("loss", config.judge.loss, LOSSES)


def resolved(config: Config) -> Config:
    """Return the configuration as a run keeps it: iterations and mode written out, and files by their absolute paths.

    Raises:
        InputError: there is no such learner, or it has no iterations and some are wanted.
    """
    learner = learner_of(config)
    iterations, mode = config.train.iterations, config.policy.mode
    if not learner.iterations and iterations not in ("default", 0):
        raise InputError(
            f"learner '{config.train.learner}' has no iterations, got {iterations}; leave train.iterations out, or set "
            "it to default"
        )
    given = config.train
    return located(config).changed(
        train={
            "iterations": learner.iterations if iterations == "default" else iterations,
            "expert": assets.absolute(given.expert),
            "demonstrations": given.demonstrations
            if given.demonstrations == "expert"
            else assets.absolute(given.demonstrations),
        },
        policy={"mode": (SAMPLED if learner.samples else ARGMAX) if mode == "default" else mode},
    )


def located(world: Config) -> Config:
    """Return a configuration that names the files of its world by their absolute paths."""
    return world.changed(
        network={"file": assets.absolute(world.network.file)},
        traffic={name: tuple(map(assets.absolute, getattr(world.traffic, name))) for name in ("routes", "additional")},
        varied={"networks": tuple(map(assets.absolute, world.varied.networks))},
    )


def _start(config: Config, demonstrations: Demonstrations, seed: int) -> PolicyParameters:
    """Return what the first iteration starts from: a clone, or for a learner without demonstrations a fresh network."""
    from rail_sumo.imitation import bc

    whitening = Whitening.of(demonstrations.observations)
    untrained = config.cloning.model_copy(update={"epochs": 0})
    cloning = config.cloning if learner_of(config).reads_demonstrations else untrained
    n_features = len(feature_names(config.lidar, config.observation))
    shape = Shape(n_features, config.policy.hidden if config.policy.layers == 2 else None)
    masked, samples = config.policy.masked, config.policy.mode == SAMPLED
    theta = bc.clone(demonstrations, shape, whitening, cloning, seed, masked=masked)
    return PolicyParameters(theta, shape, whitening, samples, masked)


def _require_drivable(learned: PolicyParameters, before: Checkpoint, learner: str) -> None:
    """Raise InputError if what an iteration made is no policy of the run's shape, or its training has diverged."""
    try:
        replace(learned, shape=before.learned.shape).policy()
        if np.abs(learned.theta).max() > LARGEST:
            raise ValueError(f"theta has values beyond {LARGEST:g}: it diverged; lower its step size or learning rate")
    except ValueError as error:
        raise InputError(
            f"what learner '{learner}' yields in iteration {before.iteration + 1} cannot drive: {error}"
        ) from None


def _require_whole(iteration: object, before: Checkpoint, learner: str) -> None:
    """Raise InputError if what a learner yields is no iteration, cannot drive or could not be written."""
    if not isinstance(iteration, Iteration):
        raise InputError(
            f"learner '{learner}' yields a {type(iteration).__name__}; it has to yield an `Iteration` of "
            "rail_sumo.learners"
        )
    told = f"what learner '{learner}' yields in iteration {before.iteration + 1} cannot be kept"
    for name, wanted in (("learned", PolicyParameters), ("memory", Mapping), ("driven", list), ("figures", Mapping)):
        value: object = getattr(iteration, name)
        if not isinstance(value, wanted):
            raise InputError(f"{told}: {name} is {value!r:.40}; it is a {wanted.__name__}")
    for trajectory in iteration.driven:
        if not isinstance(trajectory, Trajectory):
            raise InputError(f"{told}: driven holds {trajectory!r:.40}; it is a list of what `practice.drive` returns")
    if not isinstance(iteration.learned.theta, np.ndarray):
        raise InputError(f"{told}: theta is a {type(iteration.learned.theta).__name__}; it is a numpy array")
    _require_drivable(iteration.learned, before, learner)
    for name, value in iteration.memory.items():
        if not isinstance(name, str):
            raise InputError(f"{told}: memory has the name {name!r:.40}; names are strings")
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf" or value.dtype.itemsize > 8:
            raise InputError(
                f"{told}: memory '{name}' is {value!r:.40}; memory is numpy arrays of numbers, such as np.array(3)"
            )
    unknown = sorted(iteration.figures.keys() - set(LEARNERS_COLUMNS))
    if unknown:
        raise InputError(
            f"'{unknown[0]}' is no column of progress.csv that a learner tells; figures may be: "
            f"{', '.join(LEARNERS_COLUMNS)}"
        )
    for name, figure in iteration.figures.items():
        if not isinstance(figure, int | float | np.integer | np.floating):
            raise InputError(f"{told}: figure '{name}' is {figure!r:.40}; figures are numbers")


def demonstrations_of(config: Config) -> Demonstrations:
    """Return the demonstrations that a configuration names; for a learner that is shown nothing, a blank one.

    Raises:
        InputError: there are none, or fewer than wanted, or they are damaged, of another observation or in other units.
    """
    features = feature_names(config.lidar, config.observation)
    if not learner_of(config).reads_demonstrations:
        return Demonstrations(np.zeros((1, len(features))), np.zeros(1, np.int64), np.zeros(1, np.int64))
    file = _demonstrations_file(config)
    shown = Demonstrations.load(file, features=features, demonstrating=config.demonstrating)
    _require_units(shown, file, config)
    _require_resting_rays(shown, file, config)
    return shown.take(config.train.trajectories)


def _require_units(shown: Demonstrations, file: Path, config: Config) -> None:
    """Raise InputError if what was demonstrated is not in our units, or of a LIDAR of another range."""
    features = feature_names(config.lidar, config.observation)
    low, high = bounds(config.lidar, config.observation)
    least, most = shown.observations.min(axis=0), shown.observations.max(axis=0)
    beyond = np.flatnonzero((least < low) | (most > high + ROUNDING))
    if len(beyond):
        k = int(beyond[0])
        raise InputError(
            f"demonstrations '{file}': {features[k]} goes from {least[k]:g} to {most[k]:g}, and can only from "
            f"{low[k]:g} to {high[k]:g}; give metres and m/s, and the lidar.max_range_m that they were recorded with"
        )
    farthest_m = max(most[k] for k, name in enumerate(features) if name.startswith("distance"))
    if farthest_m < config.lidar.max_range_m / 10:  # in a jam no ray may get far, but farther than that
        raise InputError(
            f"demonstrations '{file}': no distance is above {farthest_m:g} m, though a ray that hits nothing tells "
            f"the range, {config.lidar.max_range_m:g} m; give metres, and lidar.max_range_m as they were recorded with"
        )


def _require_resting_rays(shown: Demonstrations, file: Path, config: Config) -> None:
    """Raise InputError if rays that hit nothing tell a relative speed, as where speeds are absolute."""
    features = feature_names(config.lidar, config.observation)
    by_frame = shown.observations.reshape(len(shown.observations), config.observation.frames, -1)
    distances_m, speeds_mps = np.split(by_frame[:, :, : 2 * config.lidar.n_rays], 2, axis=2)
    hits_nothing = distances_m >= np.float32(config.lidar.max_range_m)
    moves = hits_nothing & (np.abs(speeds_mps) > ROUNDING)
    if moves.sum() > FAR_HITS * hits_nothing.sum():
        row, frame, ray = np.argwhere(moves)[0]
        distance = frame * by_frame.shape[2] + ray
        raise InputError(
            f"demonstrations '{file}': row {row} has {speeds_mps[row, frame, ray]:g} as "
            f"{features[distance + config.lidar.n_rays]}, where {features[distance]} is the range, "
            f"{config.lidar.max_range_m:g} m; a ray that hits nothing tells 0 there, and one that hits something how "
            "fast that is along the host's heading, minus the host's speed, in m/s"
        )


def _demonstrations_file(config: Config) -> Path:
    name = config.train.demonstrations
    return (
        assets.expert(assets.EXPERT_DEMONSTRATIONS, assets.expert_folder(config.train.expert))
        if name == "expert"
        else Path(name)
    )


def inputs_of(config: Config) -> dict[str, str]:
    """Return the SHA-256 of every file that a training with this configuration reads, by the key that names it.

    Modules from outside are among them.
    """
    inputs = world_inputs(config)
    for key, name in (("train.learner", config.train.learner), ("judge.loss", config.judge.loss)):
        source = registry.source_of(name)
        if source:
            inputs[key] = assets.sha256(source)
    if learner_of(config).reads_demonstrations:
        inputs["train.demonstrations"] = assets.sha256(_demonstrations_file(config))
    if learner_of(config).asks_the_expert:
        inputs |= expert_input(config)
    return inputs


def world_inputs(config: Config) -> dict[str, str]:
    """Return the SHA-256 of every file that driving in this configuration reads, by the key that names it."""
    traffic = demand.read(config.traffic)
    inputs = {
        "network.file": assets.sha256(assets.network(config.network.file)),
        "traffic.routes": " ".join(map(assets.sha256, traffic.routes)),
    }
    if config.varied.networks:
        files = [file for name in config.varied.networks for file in varied.files_of(name)]
        inputs["varied.networks"] = " ".join(map(assets.sha256, files))
    others = [file for file in traffic.files if file not in traffic.routes]
    if others:
        inputs["traffic.additional"] = " ".join(map(assets.sha256, others))
    return inputs


def changed_since(runs: Iterable[RunDirectory], world: Config) -> Iterator[str]:
    """Yield a line for each run whose own road or demand drives in this world, with another content than it learned by.

    Its own table is of the old content then.
    """
    now, named = world_inputs(world), located(world).flat()
    for run in runs:
        theirs = run.config.flat()
        changed = [key for key in now if named[key] == theirs[key] and now[key] != run.inputs.get(key)]
        if changed:
            yield (
                f"the content of {', '.join(changed)} has changed since '{run.path}' was trained: episodes are not "
                "those of its own table"
            )


def expert_input(config: Config) -> dict[str, str]:
    """Return the SHA-256 of the expert that a configuration names, by the key that names it."""
    return {
        "train.expert": assets.sha256(assets.expert(assets.EXPERT_POLICY, assets.expert_folder(config.train.expert)))
    }
