"""What happens on a road as the share of driven vehicles grows: every share and driver on the same traffic.

A run is one simulation of a user's demand, of which a share of the cars has a driver. Its seed settles the traffic and
which cars those are, so that shares and drivers are compared on the same vehicles, departures and routes. What a
finished run came to is one file under `cells/`; the same command goes on with those that are missing.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

from rail_sumo import config_file, drivers, origin, rollout, roster, training
from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.files import check_folder, whole_file
from rail_sumo.highway.network import demand, road
from rail_sumo.highway.traffic.fleet import Instead, demand_of, sumo_command
from rail_sumo.rollout import EVALUATION, SILENT, Observer, Who, traffic_seed
from rail_sumo.run_directory import CONFIG
from rail_sumo.studies import share_run, sweep_report
from rail_sumo.studies.share_run import ShareRun
from rail_sumo.studies.sweep_report import SHARE, Tables
from rail_sumo.tables import cautions, report, traffic, warm_up
from rail_sumo.tables.shares import (
    AS_THEY_ARE,
    EDGES,
    TRAFFIC_COLUMNS,
    compared,
    summarised,
)

ACC = roster.INSTEAD
"""The driver that is SUMO's own adaptive cruise control."""
FIGURES = "figures"
"""The folder of its pictures."""
SECTIONS, PERIOD = ("network", "traffic", "adas", "lidar", "observation"), "episode.decision_period_s"
"""What may be swept over beside the share: numbers of these sections, and this one."""
OTHER_GAP, OTHER_ACCELERATION = 1.1, 1.5
"""By what factor a type's `tau` or `accel` is another than that of driven cars, where it is told."""
OTHER_WISH, USUAL_DEVIATION = 0.05, 0.1
"""By how much the mean of a type's speed factors is another than 1, and SUMO's deviation of them, where it is told."""
FOUND_OVER, FOUND_WITHIN_S = 2.0, 1200.0
"""To find the warm-up the traffic is watched for so many times the period that counts, and no less long than this."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C while the runs were driven, with tables of so many seeds."""

    def __init__(self, seeds: int) -> None:
        super().__init__()
        self.seeds = seeds


@dataclass(frozen=True)
class Sweep:
    """Several drivers, each with several shares of the cars, on several seeds; or several values of a key."""

    config: Config
    drivers: tuple[str, ...]
    """Whatever `rail-sumo eval` takes, but SUMO's types; `acc`, and `sumo`: as they are."""
    shares: tuple[float, ...]
    out: Path
    """Its folder, which may hold some of it already."""
    key: str = SHARE
    """What is swept over."""
    settings: tuple[str, ...] = ("",)
    """Its values, if it is a key of the configuration."""
    seeds: int = 10
    duration_s: float = 600.0
    """The period that counts."""
    warm_up_s: float | None = None
    """How long the traffic drives before; None to find it."""
    fcd: bool = False
    """Whether SUMO's floating-car data of every run are kept, twice a second, in the folder `FCD`."""
    workers: int = 1
    observer: Observer = SILENT
    command: str = ""
    """What was typed; it is kept beside the tables."""
    road: str = ""
    """What `sweep.md` calls the road, such as the `.sumocfg` that the configuration is of; else its network's file."""
    known: tuple[str, ...] = ()
    """What to know of the configuration, told already; it is kept among the notes."""

    def drive(self) -> Tables:
        """Bring every run to its end; write the tables, `sweep.md` and a figure for each measure into `out`.

        Raises:
            Interrupted: by Ctrl-C; the tables of the seeds that all have driven are written.
            InputError: `out` holds something else, or runs of another world or period; a share outside 0 to 1, doubled,
                or none; a driver that is not found, senses something else than
                its configuration says, or is named twice; no demand, or one without cars.
        """
        self._check()
        check_folder(self.out, overwrite=True)
        other = next((name for name in (CONFIG, report.EPISODES) if (self.out / name).exists()), None)
        if other:
            raise InputError(f"'{self.out}' holds a run or an evaluation ({other}); choose another --out for the sweep")
        planned = list(self._work())  # every driver is found, or not, before the first run
        warm_up_s, notes = self._found_warm_up() if self.warm_up_s is None else (self.warm_up_s, [])
        notes += demand.warnings(demand_of(self.config), self.config.traffic)
        notes += road.misdrawn(self.config.network.file)
        notes += self._idle_keys()
        notes += self._unlike_types()
        notes += self._unlike_wishes()
        notes += self._early_ends(warm_up_s)
        notes += roster.unlike_modes(_who(one for one in planned if one.driver in self.drivers))
        for note in notes:
            self.observer.note(note)
        notes = [*self.known, *notes]
        work = [replace(one, warm_up_s=warm_up_s) for one in planned]
        for one in work:
            one.require_same_study()
        self.observer.start("runs", len(work))
        driven: list[pd.DataFrame] = []
        try:
            with rollout.workers(self.workers) as pool:
                for rows in pool.map(share_run.finish, work):
                    driven.append(rows)
                    self.observer.advance({})
        except KeyboardInterrupt:
            n_whole = len(driven) * self.seeds // len(work)
            if not n_whole:
                raise
            runs = n_whole * len(work) // self.seeds
            notes.append(f"interrupted: the tables are of {n_whole} of {self.seeds} seeds")
            self._write(work[:runs], driven[:runs], warm_up_s, notes)
            raise Interrupted(n_whole) from None
        if not (self._leaves_all or any(_drives_any(rows) for rows in driven)):
            for one in work:
                one.discard()
            raise InputError(self._nobody_drives(pd.concat(driven), warm_up_s))
        tables = self._write(work, driven, warm_up_s, notes)
        if find_spec("matplotlib") is None:
            self.observer.note("no figures without matplotlib; install it with: pip install 'rail-sumo[plots]'")
        else:
            sweep_report.draw(tables, self.out / FIGURES)
        return tables

    def _write(
        self, work: Sequence[ShareRun], driven: Sequence[pd.DataFrame], warm_up_s: float, known: Sequence[str]
    ) -> Tables:
        """Write and return the tables of some runs, and tell what they show against themselves."""
        table = report.typed(pd.concat(driven, ignore_index=True), TRAFFIC_COLUMNS)
        edges = pd.concat([pd.read_parquet(one.edges_file) for one in work], ignore_index=True)
        told = list(cautions.of_runs(table, edges))
        for note in told:
            self.observer.note(note)
        notes = (*known, *told)
        tables = Tables(table, summarised(table), compared(table), edges, self.key, self.duration_s, warm_up_s, notes)
        report.write(self.out, traffic=table, summary=tables.summary, differences=tables.differences, overwrite=True)
        with whole_file(self.out / EDGES) as partial:
            edges.to_parquet(partial, index=False)
        of_drivers = [one for one in work if one.driver in self.drivers]
        learned = {one.driver: one.learned for one in of_drivers}
        modes = roster.modes_of(_who(of_drivers))
        sumo = sumo_command(training.located(self.config), traffic_seed(0, EVALUATION, 0))
        origin.describe(self.out, self.config, self.command, notes=notes, drivers=learned, modes=modes, sumo=sumo)
        with whole_file(self.out / "sweep.md") as partial:
            page = sweep_report.markdown(tables, self.road or self.config.network.file, command=self.command)
            partial.write_text(page, encoding="utf-8")
        return tables

    @property
    def _leaves_all(self) -> bool:
        """Whether all vehicles are to be as they are."""
        return set(self.drivers) == {AS_THEY_ARE}

    def _check(self) -> None:
        if self.seeds < 1:
            raise InputError(f"--seeds must be at least 1; got {self.seeds}")
        if not self.duration_s >= 1.0 or math.isinf(self.duration_s):
            raise InputError(f"--duration takes seconds, at least 1; got {self.duration_s:g}")
        if self.warm_up_s is not None and not 0.0 <= self.warm_up_s < math.inf:
            raise InputError(f"--warm-up takes seconds from 0 up, or auto; got {self.warm_up_s:g}")
        for share in self.shares:
            if not 0.0 <= share <= 1.0:
                hint = f" (for {share:g} %, write {share / 100:g})" if 1.0 < share <= 100.0 else ""
                raise InputError(f"a share is a number from 0 to 1; got {share:g}{hint}")
        road.require_readable(self.config.network.file)
        if not demand_of(self.config).may_have_cars:
            raise InputError("only cars are driven, and the demand has none; give one with vehicles of a car's class")
        last_s, begin_s = demand_of(self.config).departs_s[1], self.config.traffic.begin_s
        if begin_s > last_s and self.key != "traffic.begin_s":
            raise InputError(
                f"the demand's last vehicle departs at {last_s:.0f} s, before traffic.begin_s = {begin_s:.0f}; set it "
                "to an earlier time"
            )
        if self.key not in (SHARE, PERIOD) and self.key.partition(".")[0] not in SECTIONS:
            raise InputError(
                f"{self.key} has no effect on a sweep; vary a number of [{'], ['.join(SECTIONS)}] or {PERIOD}"
            )
        if self.key.removeprefix("traffic.") in demand.OF_MADE_TRAFFIC:
            raise InputError(
                f"{self.key} is of made traffic, without effect on a demand; vary traffic.scale, or another"
            )
        for setting in self.settings if self.key != SHARE else ():
            try:
                float(setting)
            except ValueError:
                raise InputError(f"what is swept over are numbers; got {self.key} = '{setting}'") from None
        for what, given in (("share", self.shares), ("driver", self.drivers), (f"value of {self.key}", self.settings)):
            twice = next((one for one in given if given.count(one) > 1), None)
            if twice is not None:
                raise InputError(f"{what} {twice} is given twice; leave one out")
        if not self._leaves_all and not any(self.shares):
            raise InputError(
                f"give at least one share above 0; share 0 is always driven beside, and alone by --driver {AS_THEY_ARE}"
            )
        for name in self.drivers:
            if drivers.hands_off(name) and name != AS_THEY_ARE:
                raise InputError(f"driver '{name}' drives one vehicle; for SUMO's own drivers take '{AS_THEY_ARE}'")

    def _work(self) -> Iterator[ShareRun]:
        """Yield every run; how long it warms up is not known yet."""
        shares = [share for share in self.shares if share > 0.0]
        worlds = {setting: self._world(setting) for setting in self.settings}
        who = {setting: self._found(world) for setting, world in worlds.items()}
        learned = {
            name: "" if name == ACC else roster.content_of(name, self.config) for name in next(iter(who.values()))
        }
        for seed in range(self.seeds):  # all of one seed after another: where that is interrupted, some are whole
            for setting, world in worlds.items():
                one = ShareRun(
                    self.out,
                    world,
                    AS_THEY_ARE,
                    "nothing",
                    setting,
                    0.0,
                    (0.0, *shares),
                    seed,
                    self.duration_s,
                    keeps_fcd=self.fcd,
                )
                yield one
                for name, driver in who[setting].items():
                    for share in shares:
                        yield replace(one, driver=name, who=driver, learned=learned[name], share=share, shares=(share,))

    def _found(self, world: Config) -> dict[str, Who | Instead]:
        """Return who drives in a world, by the drivers' names."""
        who: dict[str, Who | Instead] = {
            name: ACC if name == ACC else roster.find_driver(name, world, also=[ACC])
            for name in self.drivers
            if name != AS_THEY_ARE
        }
        if self.key.startswith(("lidar.", "observation.")):
            for name, driver in who.items():
                drivers.require_same_senses(driver, world, f"driver '{name}'")
        return who

    def _world(self, setting: str) -> Config:
        if self.key == SHARE:
            return self.config
        return config_file.changed(self.config, [f"{self.key}={setting}"])

    def _found_warm_up(self) -> tuple[float, list[str]]:
        """Return how long the number of vehicles on the road takes to settle, and where it does not.

        As they are, at the slowest setting.
        """
        found_s, notes = 0.0, []
        self.observer.start("warm-up", len(self.settings))
        for setting in self.settings:
            world = self._world(setting)
            pilot = rollout.fleet_of("nothing", world, 0.0, traffic_seed(0, EVALUATION, 0))
            begin_s, last_s = world.traffic.begin_s, demand_of(world).departs_s[1]
            watched_s = max(FOUND_OVER * self.duration_s, FOUND_WITHIN_S)
            until_s = begin_s + watched_s
            if last_s >= begin_s + self.duration_s:  # else who has departed by then is all that there is
                until_s = min(until_s, last_s)
            counts = pilot.drive(until_s)
            self.observer.advance({})
            seconds, settles = warm_up.found_s(counts)
            found_s = max(found_s, float(seconds))
            if not settles:
                notes.append(
                    f"the number of vehicles on the road does not settle within {len(counts)} s{self._at(setting)}: "
                    f"more come than leave; {seconds:.0f} s are left out, and what follows depends on the period"
                )
        return found_s, notes

    def _early_ends(self, warm_up_s: float) -> Iterator[str]:
        """Tell where a demand ends before the period that counts."""
        for setting in self.settings:
            world = self._world(setting)
            last_s = demand_of(world).departs_s[1]
            begins_s = world.traffic.begin_s + warm_up_s
            ends_s = begins_s + self.duration_s
            if ends_s > last_s:
                is_over = warm_up_s > 0.0 and begins_s >= last_s
                moment, option = (
                    (f"begins at {begins_s:.0f}", "warm-up") if is_over else (f"ends at {ends_s:.0f}", "duration")
                )
                yield (
                    f"the last vehicle departs at {last_s:.0f} s, before the period {moment} s{self._at(setting)}: "
                    f"unless they drive round and round, choose a shorter --{option}, or lengthen the demand"
                )

    def _nobody_drives(self, table: pd.DataFrame, warm_up_s: float) -> str:
        """Return that no car was driven in any run, and when the demand has cars."""
        first_s, last_s = demand_of(self.config).departs_s
        begins_s = self.config.traffic.begin_s + warm_up_s
        who = "car of the share" if table["n_vehicles"].any() else "vehicle"
        until = "on" if math.isinf(last_s) else f"to {last_s:.0f} s"
        return (
            f"no {who} was on the road in the period, from {begins_s:.0f} to {begins_s + self.duration_s:.0f} s; the "
            f"demand's vehicles depart from {first_s:.0f} s {until}: change traffic.begin_s or --duration"
        )

    def _idle_keys(self) -> Iterator[str]:
        """Tell which keys do nothing to one of the drivers."""
        usual = Config().adas
        changed = {f"adas.{name}" for name, value in self.config.adas if value != getattr(usual, name)} | {self.key}
        idle = sorted(key for key in changed if key.startswith("adas."))
        if ACC in self.drivers and idle:
            yield (
                f"{', '.join(idle)}: without effect on {ACC}, which keeps the time gap (tau), accelerations and wish "
                "of the vehicle's own type"
            )

    @property
    def _has_supervisors(self) -> bool:
        """Whether any of its drivers decides for itself, in the assistance layer's way."""
        return bool(set(self.drivers) - {ACC, AS_THEY_ARE})

    def _unlike_types(self) -> Iterator[str]:
        """Tell which types of the demand keep another time gap than driven cars, or speed up otherwise.

        Unless it is swept over either.
        """
        if not self._has_supervisors or self.key in ("adas.time_gap_s", "adas.acceleration_mps2"):
            return
        adas = self.config.adas
        ours = {"tau": (adas.time_gap_s, OTHER_GAP), "accel": (adas.acceleration_mps2, OTHER_ACCELERATION)}
        told = [
            f"'{kind}' {name} {value:g}"
            for contents in demand_of(self.config).contents
            for kind, own in contents.following.items()
            for name, value in own.items()
            if not 1 / ours[name][1] < value / ours[name][0] < ours[name][1]
        ]
        if told:
            yield (
                f"driven cars keep {adas.time_gap_s:g} s and speed up by {adas.acceleration_mps2:g} m/s², and types of "
                f"the demand do otherwise ({cautions.listed(told)}): a part of what a share changes is that; to see "
                "how much, set adas.time_gap_s and adas.acceleration_mps2 to theirs"
            )

    def _unlike_wishes(self) -> Iterator[str]:
        """Tell which types of the demand want other speeds than driven cars, which all want the same."""
        if not self._has_supervisors:
            return
        told = [
            f"'{kind}' speedFactor {mean:g}, speedDev {deviation:g}"
            for contents in demand_of(self.config).contents
            for kind, (mean, deviation) in contents.wishes.items()
            if abs(mean - 1.0) > OTHER_WISH or deviation > USUAL_DEVIATION
        ]
        if told:
            yield (
                f"driven cars all want the same speed, and types of the demand do not ({cautions.listed(told)}): a "
                "part of what a share changes is that; to see how much, drive share 0 of a copy whose types have "
                'speedFactor="1" speedDev="0"'
            )

    def _at(self, setting: str) -> str:
        """Return where in the sweep something holds, to be read on after what it is."""
        return f" at {self.key} = {setting}" if setting else ""


def _who(work: Iterable[ShareRun]) -> dict[str, Who | Instead]:
    return {one.driver: one.who for one in work}


def _drives_any(rows: pd.DataFrame) -> bool:
    return bool(rows.loc[rows["vehicles"] == traffic.DRIVEN, "n_vehicles"].any())


def shares_of(texts: Sequence[str]) -> tuple[float, ...]:
    """Return shares as numbers.

    Raises:
        InputError: one is none.
    """
    try:
        return tuple(float(text) for text in texts)
    except ValueError:
        raise InputError(f"shares are numbers from 0 to 1; got '{' '.join(texts)}'") from None
