"""Who drives under a name: a driver of ours or of another module, an expert's folder, or what a run learned."""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from rail_sumo import assets, config_file, drivers, registry
from rail_sumo.config import OF_LEARNING, Config
from rail_sumo.errors import InputError, did_you_mean
from rail_sumo.policy import ARGMAX, SAMPLED, PolicyParameters
from rail_sumo.rollout import Who, driver_of
from rail_sumo.run_directory import CONFIG, POLICY, RunDirectory
from rail_sumo.tables import report

INSTEAD = "acc"
"""What drives a share of a demand, and no single host; see `studies.sweep`."""
AS_A_TYPE = f"{drivers.SUMO_AS}TYPE"
"""How SUMO's own driver as one of the demand's types is listed; see `drivers.hands_off`."""
OF_THE_WORLD = ("network.", "traffic.", "episode.", "adas.", "varied.")
"""What the keys of its other sections begin with, but for the senses, which are a driver's own."""
MODES = (ARGMAX, SAMPLED)
"""How a learned policy may act, as `runs/first:sampled`; without a colon as it was trained."""


def world(policies: Iterable[str], overrides: Iterable[str] = (), *, config: Path | None = None) -> Config:
    """Return the world to evaluate in, with `overrides` on top.

    Args:
        policies: who drives. Where no configuration is named it is that of the first run directory among them, and the
            default for drivers known by name alone.
        overrides: as of `config_file.load`.
        config: a configuration's file.

    Raises:
        InputError: a policy is neither, it senses otherwise than `overrides` ask, or what `config_file.load` raises.
    """
    named = [_name_and_mode(policy)[0] for policy in policies]
    folders = [Path(name) for name in named if _is_path(name)]
    for folder in folders:
        _require_folder(folder)
    chosen = config_file.load(config or (folders[0] / CONFIG if folders else None), overrides)
    require_heeded(policies, chosen, overrides)
    return chosen


def require_heeded(policies: Iterable[str], world: Config, overrides: Iterable[str]) -> None:
    """Raise InputError if overrides ask for what drivers do not heed.

    That is other senses than one of the policies has, for a driver keeps its own, and whatever is about learning.
    """
    for override in overrides:
        key = config_file.key_of(override)
        if key.partition(".")[0] in OF_LEARNING and key != "train.expert":
            as_trained = ": what was learned acts as it was trained, or as RUN:argmax or RUN:sampled"
            raise InputError(
                f"{key} is about learning, and changes nobody who drives{as_trained if key == 'policy.mode' else ''}; "
                "leave it out"
            )
    require_senses_heeded(policies, world, overrides)


def require_senses_heeded(policies: Iterable[str], world: Config, overrides: Iterable[str]) -> None:
    """Raise InputError if overrides ask for other senses than one of the policies has."""
    if any(override.startswith(("lidar.", "observation.")) for override in overrides):
        for policy in policies:
            drivers.require_same_senses(find_driver(policy, world), world, f"policy '{policy}'")


def unheeded_senses(who: Mapping[str, Who], world: Config) -> Iterator[str]:
    """Tell which policies sense otherwise than a world says that was named, for a driver keeps its own senses."""
    for policy, driver in who.items():
        own = world.sensing if isinstance(driver, str) else world.seen_with(driver.senses).sensing
        keys = [key for key, value in own.items() if world.sensing[key] != value]
        if keys:
            yield f"'{policy}' keeps the senses that it was trained with: without effect on it is {', '.join(keys)}"


def borrowed_senses(who: Mapping[str, Who], policies: Sequence[str], world: Config) -> Iterator[str]:
    """Tell which drivers of one's own name no senses, and so drive with those of the first run among the policies."""
    default = Config().sensing
    keys = [f"{key} = {value}" for key, value in world.sensing.items() if default[key] != value]
    borrow = [
        f"'{name}'" for name, driver in who.items() if _is_from_outside(name) and getattr(driver, "senses", 0) is None
    ]
    if keys and borrow:
        first = next(iter(judges_of(policies)), "")
        yield (
            f"{', '.join(borrow)} names no senses, and drives with those of '{first}', the first run named: "
            f"{', '.join(keys)}; what was trained with others has to say so, as senses = config_file.load().senses"
        )


def find_driver(policy: str, world: Config, *, also: Sequence[str] = (AS_A_TYPE,)) -> Who:
    """Return who drives under the name: a driver of ours or of another module, an expert's folder, or a run directory.

    What was learned acts as it was trained, or as the name says behind a colon: `rail:sampled`, `runs/first:argmax`. A
    driver of another module is written `module:attribute`: an object, or a class, which is called without arguments.

    Args:
        policy: the name.
        world: where it is to drive.
        also: further names that may have been meant, to be suggested where none is found.

    Raises:
        InputError: it is none of these, damaged, or learned on another observation than the world's; a colon behind who
            acts in one way.
    """
    name, mode = _name_and_mode(policy)
    who = _find(name, world, also)
    if not mode:
        return who
    if not isinstance(who, PolicyParameters):
        raise InputError(f"'{name}' acts in one way; leave out ':{mode}'")
    return who.acting(mode)


def content_of(policy: str, world: Config) -> str:
    """Return the SHA-256 of the file that tells what is driven under a name: weights, or a module; "" for one of ours.

    Raises:
        InputError: as of `find_driver`.
    """
    name, _ = _name_and_mode(policy)
    if _is_from_outside(name):
        source = registry.source_of(name)
        return assets.sha256(source) if source else ""
    if drivers.is_name(name) and name not in (report.EXPERT, *drivers.SHIPPED):
        return ""
    folder = assets.expert_folder(world.train.expert) if name == report.EXPERT else _folder_of(name)
    return assets.sha256(folder / (assets.EXPERT_POLICY if assets.is_expert(folder) else POLICY))


def who_drives(given: Who, world: Config) -> Who:
    """Return the driver that a name stands for, see `find_driver`, or the one given, if it can drive.

    Raises:
        InputError: no such driver, or an object that is none.
    """
    if isinstance(given, str):
        return find_driver(given, world)
    if not isinstance(given, PolicyParameters) and not (
        hasattr(given, "senses") and callable(getattr(given, "decide", None))
    ):
        raise InputError(f"a driver is a name, a run's policy, or an object with senses and decide(); got {given!r}")
    return given


def who_decides(given: Who, world: Config) -> Who:
    """Return as `who_drives` does a driver whose decisions can be recorded.

    Raises:
        InputError: as of `who_drives`; or SUMO's own driver, which takes no decisions.
    """
    if drivers.hands_off(given):
        raise InputError(
            f"driver '{given}' takes no decisions that could be recorded; take rule, expert or a run directory"
        )
    return who_drives(given, world)


def who_advises(given: Who, world: Config, driver: Who) -> Who:
    """Return as `who_decides` does a driver that is asked for its decisions where another one drives.

    Args:
        given: who is asked.
        world: where.
        driver: who drives, as `who_drives` returns it; the adviser is shown what this one senses.

    Raises:
        InputError: as of `who_decides`; or the adviser was trained with other senses than the driver's.
    """
    seen = world if isinstance(driver, str) else world.seen_with(driver.senses)
    adviser = who_decides(given, seen)
    drivers.require_same_senses(adviser, seen, f"adviser '{given}'" if isinstance(given, str) else "the adviser")
    return adviser


def _name_and_mode(policy: str) -> tuple[str, str]:
    """Return a policy's name or folder, and how it is to act; "" for as it was trained."""
    name, _, mode = policy.rpartition(":")
    return (name, mode) if mode in MODES and not drivers.is_name(policy) else (policy, "")


def _find(policy: str, world: Config, also: Sequence[str]) -> Who:
    if policy == report.EXPERT:  # read once here, not by a worker in every episode
        return drivers.load_expert(world)
    if drivers.is_name(policy) and policy not in drivers.SHIPPED:
        return policy
    if _is_from_outside(policy):
        found = registry.imported("policy", policy)
        try:
            return who_drives(found() if isinstance(found, type) else found, world)
        except TypeError as error:
            raise InputError(f"policy '{policy}' is a class that takes arguments ({error}); name an object") from None
    folder = _folder_of(policy)
    if assets.is_expert(folder):
        return drivers.load_expert(world, folder)
    _require_folder(folder, also)
    return RunDirectory(folder).policy()


def _is_from_outside(policy: str) -> bool:
    """Whether it is written `module:attribute`; a mistyped mode behind somebody's name is not."""
    who = policy.partition(":")[0]
    is_written_so = registry.is_from_outside(policy) and not drivers.is_name(policy)
    return is_written_so and not drivers.is_name(who) and not Path(who).is_dir()


def _is_path(policy: str) -> bool:
    """Whether it is no name, but a folder's path."""
    return not drivers.is_name(policy) and not _is_from_outside(policy)


def doubts(policies: Sequence[str], world: Config) -> list[str]:
    """Return what the names of the policies do not tell of who drives.

    That is a line for each run that has done fewer iterations than it is to have, and one where the expert of this
    world is not the shipped one.
    """
    told = [line for run in judges_of(policies).values() if (line := run.unfinished)]
    named = {_name_and_mode(policy)[0] for policy in policies}
    if report.EXPERT in named and world.train.expert != Config().train.expert:
        told.append(
            f"'{report.EXPERT}' is '{world.train.expert}' here, as train.expert says, and not the shipped one; name "
            "another first, or --set train.expert=shipped"
        )
    return told


def other_worlds(policies: Sequence[str], world: Config) -> Iterator[str]:
    """Tell which runs were trained in another world than that of the first run among them, which is driven in."""
    ours = (policy for policy in policies if _is_path(_name_and_mode(policy)[0]))
    runs = {str(run.path): run.config.flat() for run in judges_of(ours).values()}
    driven = world.flat()
    for name, own in itertools.islice(runs.items(), 1, None):
        first, of_first = next(iter(runs.items()))
        keys = [key for key in own if key.startswith(OF_THE_WORLD) and own[key] not in (of_first[key], driven[key])]
        if keys:
            told = ", ".join(f"{key} = {own[key]}" for key in keys)
            yield f"the world is that of '{first}', the first run named; '{name}' was trained with {told}"


def modes_of(who: Mapping[str, Who]) -> dict[str, str]:
    """Return for each learned policy how it acts, one of `MODES`."""
    return {
        name: SAMPLED if policy.samples else ARGMAX
        for name, policy in who.items()
        if isinstance(policy, PolicyParameters)
    }


def unlike_modes(who: Mapping[str, Who]) -> Iterator[str]:
    """Tell where policies whose names do not say how they act do so in different ways."""
    modes = {name: mode for name, mode in modes_of(who).items() if not _name_and_mode(name)[1]}
    if len(set(modes.values())) > 1:
        argmax, sampled = (", ".join(f"'{name}'" for name in modes if modes[name] == mode) for mode in MODES)
        yield (
            f"learned drivers act as they were trained, and not all alike: {argmax} by argmax, {sampled} sampled; to "
            "compare what they have learned and not how they act, name all of them with :argmax, or all with :sampled"
        )


def judges_of(policies: Iterable[str]) -> dict[str, RunDirectory]:
    """Return the runs of those policies that were learned, which may have a judge; see `learners.verdicts`."""
    named = {policy: _name_and_mode(policy)[0] for policy in policies}
    learned = {policy: name for policy, name in named.items() if name in drivers.SHIPPED or _is_path(name)}
    folders = {policy: _folder_of(name) for policy, name in learned.items()}
    return {policy: RunDirectory(folder) for policy, folder in folders.items() if not assets.is_expert(folder)}


def _folder_of(policy: str) -> Path:
    return assets.driver(policy) if policy in drivers.SHIPPED else Path(policy)


def load_driver(policy: str, *, seed: int = 0) -> drivers.Network:
    """Return a learned driver, to drive wherever observations come from.

    `driver.act(observation, mask)` returns a meta-action, of several observations one each; `driver.senses` tells how
    it must sense.

    Args:
        policy: a run directory, an expert's folder, or expert, rail, road-expert or road-rail; how it acts may stand
            behind a colon, as in `find_driver`.
        seed: of what it draws, if it samples.

    Raises:
        InputError: no such driver, or one that decides by more than an observation, such as `rule`.
    """
    driver = driver_of(find_driver(policy, Config()), Config(), seed)
    if not isinstance(driver, drivers.Network):
        learned = ("expert", *drivers.SHIPPED)
        raise InputError(f"'{policy}' is not learned; take {', '.join(learned)}, or a folder")
    return driver


def _require_folder(policy: Path, also: Sequence[str] = (AS_A_TYPE,)) -> None:
    if str(policy) == INSTEAD and INSTEAD not in also:
        raise InputError(f"'{policy}' drives a share of a demand; compare it in: rail-sumo sweep share")
    if policy.suffix == ".toml":
        raise InputError(f"'{policy}' is a configuration, not a driver; name it by --config")
    if not policy.exists():
        learned = set(drivers.SHIPPED) - set(assets.SHIPPED_EXPERTS)
        either_way = [f"{name}:{mode}" for name, mode in itertools.product(learned, MODES)]
        raise InputError(
            f"policy '{policy}' is neither a run directory nor a driver"
            f"{did_you_mean(str(policy), [*drivers.NAMES, *also], also=either_way)}"
        )
    if not assets.is_expert(policy):
        RunDirectory(policy)
