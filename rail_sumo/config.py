"""Every knob: TOML into frozen, typed models that refuse what they don't know."""

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from rail_sumo.records import KMH, SECONDS_PER_STEP

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Limit = Annotated[float, Field(gt=0.0)]
"""A positive number, or inf for "no limit"."""
Count = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


def _ordered(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError(f"a range is written [lowest, highest]; {ends[0]} is above {ends[1]}")
    return ends


LimitFactor = Annotated[float, Field(ge=0.1, le=10.0)]
Range = Annotated[tuple[NonNegative, NonNegative], AfterValidator(_ordered)]
"""The lowest and the highest value that may be drawn."""
Shares = Annotated[tuple[Share, Share], AfterValidator(_ordered)]
LimitFactors = Annotated[tuple[LimitFactor, LimitFactor], AfterValidator(_ordered)]


def _as_id(given: object) -> object:
    """Return a whole number as the text that it was typed as: ids often look like one."""
    return str(given) if type(given) is int else given


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True)


class Network(_Section):
    """The road."""

    file: str = "highway5"
    """A shipped network's name, or a path to a `.net.xml`."""
    course: tuple[str, ...] = ()
    """Edges that the host drives along, in driving order; between two of them it takes the shortest way. With the first
    again at the end it goes round. Empty for the longest way straight on."""
    limit_factor: LimitFactor = 1.0
    """Every speed limit of the network is multiplied by it."""


class Episode(_Section):
    """When an episode ends: after the course or the duration, whichever comes first; inf is no limit."""

    course_m: Limit = 7222.0
    """How far the host drives."""
    duration_s: Annotated[float, Field(ge=SECONDS_PER_STEP)] = math.inf
    """How long the host drives."""
    decision_period_s: Annotated[float, Field(ge=SECONDS_PER_STEP, le=2.0)] = 1.0
    """How often the supervisor decides. It also decides when a lane change ends, and the next period begins then."""

    @model_validator(mode="after")
    def _whole_steps(self) -> "Episode":
        steps = self.decision_period_s / SECONDS_PER_STEP
        if abs(steps - round(steps)) > 1e-6:
            raise ValueError(
                f"decision_period_s must be a whole number of steps of {SECONDS_PER_STEP} s, "
                f"got {self.decision_period_s}"
            )
        return self

    @model_validator(mode="after")
    def _ends(self) -> "Episode":
        if math.isinf(self.course_m) and math.isinf(self.duration_s):
            raise ValueError("course_m and duration_s are both inf: the episode would never end; set one of them")
        return self


OF_LIMIT = "limit*"


def _share_of_limit(text: str) -> str:
    if not re.fullmatch(r"limit\*(1|0?\.\d*[1-9]\d*)", text):
        raise ValueError('a share of the limit, up to 1, written "limit*0.7"')
    return text


LimitShare = Annotated[str, AfterValidator(_share_of_limit)]
FASTEST_CAR_MPS = 200.0 / KMH
"""What a car can do, as SUMO has it; networks write a higher limit where a road has none."""
SETTLE_S = 10.0
"""See `Adas.settle_s`; SUMO's own drivers hardly ever go back sooner."""
GAIN_S = 5.0
"""See `Adas.gain_s`."""


class Traffic(_Section):
    """The surrounding vehicles: a window that moves with the host, or the user's own demand."""

    routes: tuple[str, ...] = ()
    """The user's demand files (`.rou.xml`); empty for the moving window."""
    additional: tuple[str, ...] = ()
    """SUMO's additional files: stops, signal programs, vehicles too. What detectors in them report is not kept, and
    nothing in them may take the host off the road."""
    scale: Annotated[float, Field(gt=0.0, le=100.0)] = 1.0
    """How many vehicles your own demand has, as a share of those in its files; SUMO's option of that name."""
    options: tuple[str, ...] = ()
    """Further options of SUMO's, such as "random-depart-offset=5", by their names on its command line; not those that
    are rail-sumo's to set: time, contacts, outputs."""
    vehicles: Annotated[int, Field(ge=0, le=500)] = 18
    """In the moving window, beside the host."""
    driven: Annotated[int, Field(ge=0)] = 0
    """How many of these are driven too, by the same driver as the host. Each has its own senses, decisions and
    assistance; lorries are not driven."""
    ahead_m: Annotated[float, Field(ge=50.0, le=2000.0)] = 250.0
    """How far the window reaches ahead of the host."""
    behind_m: Annotated[float, Field(ge=50.0, le=2000.0)] = 150.0
    """How far the window reaches behind the host."""
    speed_low_kmh: Positive | LimitShare = "limit*0.7"
    """The lowest desired speed; they are drawn evenly. A share of the course's highest limit, or a number."""
    speed_high_kmh: Positive | LimitShare = "limit*0.875"
    """The highest desired speed, likewise."""
    lorries: Share = 0.0
    """The share of the moving window's vehicles that are lorries: 12 m long, and no faster than 90 km/h."""
    car_following: Literal["Krauss", "IDM", "EIDM", "W99"] = "Krauss"
    """SUMO's car-following model that drives the moving window's vehicles; each decides every 0.5 s."""
    lane_change_every_s: Limit = 30.0
    """Mean time between one vehicle's tries to change lanes; inf for none. Nobody tries more often than every 2 s."""
    begin_s: Annotated[float, Field(ge=0.0, le=1e9)] = 0.0
    """When to begin, in SUMO's time: 25200 for seven in the morning."""
    warm_up_s: NonNegative = 60.0
    """How long the user's own demand drives before the host enters."""
    host: Annotated[str, BeforeValidator(_as_id)] = "replaces"
    """Who the host is in it: it "replaces" a car (without cars, another motor vehicle), drawn by the seed, with its
    departure and route, or the vehicle with this id; or it is "added" to the demand, and drives along `network.course`,
    or the longest way."""
    entry_within_s: NonNegative = 600.0
    """The car that it replaces departs after a moment drawn from so many seconds after the warm-up."""
    shortest_route_m: NonNegative = 500.0
    """Cars with less to drive are not replaced, unless there are no others."""

    @model_validator(mode="after")
    def _ordered(self) -> "Traffic":
        if isinstance(self.speed_low_kmh, str) == isinstance(self.speed_high_kmh, str):
            lowest, highest = self.desired_kmh(1.0)
            if lowest > highest:
                raise ValueError(f"speed_low_kmh {self.speed_low_kmh} is above speed_high_kmh {self.speed_high_kmh}")
        return self

    @model_validator(mode="after")
    def _driven_of_vehicles(self) -> "Traffic":
        if self.driven > self.vehicles:
            raise ValueError(f"driven {self.driven} is above vehicles {self.vehicles}, of which they are; lower it")
        return self

    def desired_kmh(self, limit_kmh: float) -> tuple[float, float]:
        """Return the lowest and the highest desired speed where this is the course's highest limit."""
        lowest, highest = (
            float(speed.removeprefix(OF_LIMIT)) * limit_kmh if isinstance(speed, str) else speed
            for speed in (self.speed_low_kmh, self.speed_high_kmh)
        )
        return lowest, highest


class Varied(_Section):
    """Worlds that differ from episode to episode: each draws its own by its seed, evenly from every range. For drivers
    that are to be at home on any road. Off while no network is named."""

    networks: tuple[str, ...] = ()
    """Shipped networks' names, `.net.xml` or `.sumocfg` files: each episode drives on one of them."""
    own_demand: Share = 0.5
    """The share of episodes that drive in the network's own demand, where it has one: the shipped demand of the same
    name, or what the `.sumocfg` names. The others drive in a moving window of traffic."""
    limit_factor: LimitFactors = (0.8, 1.2)
    """`network.limit_factor`."""
    vehicles_per_lane: Range = (1.0, 7.0)
    """The moving window's vehicles, for each lane of the course."""
    slowest: Shares = (0.5, 0.8)
    """The lowest desired speed in the moving window, as a share of the course's highest limit."""
    fastest: Shares = (0.8, 1.0)
    """The highest, as a share of the same limit."""
    lorries: Shares = (0.0, 0.3)
    """`traffic.lorries`."""
    demand_scale: Range = (0.6, 1.4)
    """How many of its vehicles the network's own demand has, as a share: SUMO's option `scale`."""


class Lidar(_Section):
    """The synthetic LIDAR."""

    n_rays: Annotated[int, Field(ge=1, le=720)] = 24
    """Evenly spaced over the full circle, the first straight ahead."""
    max_range_m: Annotated[float, Field(ge=1.0, le=500.0)] = 100.0
    """Also the distance told where nothing is hit."""
    road_edges: bool = True
    """Whether rays also end at the road's edges, as at a guard rail."""


class Observation(_Section):
    """What the policy sees besides the scan; all off by default."""

    host_speed: bool = False
    """Its own speed."""
    speed_limit: bool = False
    """The speed limit where it is; 200 km/h where there is none."""
    lateral_state: bool = False
    """Its offset from the centre of the lane that a lane change set out from."""
    frames: Annotated[int, Field(ge=1, le=8)] = 1
    """Observations of so many decisions, the newest first."""


class Senses(NamedTuple):
    """All that decides what an observation's numbers mean; a part of every learned driver."""

    lidar: Lidar
    observation: Observation


def _by_traffic(given: float | Literal["by traffic"], usual: float) -> float:
    """Return the number given, or the usual one of such traffic."""
    return usual if given == "by traffic" else given


class Adas(_Section):
    """The layer that carries the decisions out."""

    max_speed_kmh: Positive | Literal["limit"] = "limit"
    """The highest set speed: the speed limit where the host is, 200 km/h where there is none, or a number. Beyond the
    limit it does not drive."""
    min_speed_kmh: Positive | Literal["limit/2"] = "limit/2"
    """The lowest set speed: half the limit, or a number. Traffic, limits and right of way may make the host slower."""
    start_speed_kmh: Positive | Literal["limit*3/4"] = "limit*3/4"
    """The speed at which the host enters, and its first set speed: three quarters of the limit, or a number. Added to
    your demand it enters as fast as the vehicles of its lane drive there, unless this is a number; in the place of a
    car it keeps that car's speed."""
    speed_step_kmh: Positive = 5.0
    """What accelerate and decelerate add to the present speed, or take from it, to get the set speed."""
    acceleration_mps2: Positive = 2.0
    """The hardest at which the host speeds up."""
    comfort_braking_mps2: Positive = 2.0
    """For everything that is in sight in time: traffic ahead, a lower set speed, limits, signals, right of way. Behind
    traffic never more than ISO 15622 allows. For the end of an acceleration lane 3, if this is less."""
    emergency_braking_mps2: Annotated[float, Field(gt=0.0, le=9.0)] = 9.0
    """The hardest, when somebody cuts in or brakes hard, or a light turns late."""
    time_gap_s: Annotated[float, Field(ge=1.0, le=5.0)] = 1.0
    """The time gap that the host keeps to the vehicle ahead."""
    standstill_gap_m: Annotated[float, Field(ge=1.0, le=10.0)] = 2.0
    """The gap that the host keeps at a standstill, and on top of the time gap while it drives."""
    lateral_speed_mps: Annotated[float, Field(ge=0.5, le=3.0)] = 1.7
    """Sideways, while changing lanes."""
    settle_s: Annotated[float, Field(ge=0.0, le=60.0)] | Literal["by traffic"] = "by traffic"
    """How long no decision takes the host back to the lane that it has crossed over from. A number, or by traffic: 10
    in your demand; 0 in made traffic, where a decision may reverse a lane change until it is complete, as in the paper.
    Out of a lane that does not lead on it goes at once."""
    gain_s: Annotated[float, Field(ge=0.0, le=60.0)] | Literal["by traffic"] = "by traffic"
    """Within what time a lane change that is decided must get the host farther than its own lane does. A number, or by
    traffic: 5 in your demand; 0 in made traffic, where it need not, as in the paper. Towards a lane that leads on
    farther it need not either."""

    def settles_s(self, *, in_demand: bool) -> float:
        """Return how long the host keeps to a lane that it has crossed over into, in your demand or in made traffic."""
        return _by_traffic(self.settle_s, SETTLE_S if in_demand else 0.0)

    def gains_within_s(self, *, in_demand: bool) -> float:
        """Return within what time a lane change must get the host farther, in your demand or in made traffic."""
        return _by_traffic(self.gain_s, GAIN_S if in_demand else 0.0)

    def highest_mps(self, limit_mps: float) -> float:
        """Return the highest set speed where this is the limit."""
        return min(limit_mps, FASTEST_CAR_MPS) if self.max_speed_kmh == "limit" else self.max_speed_kmh / KMH

    def lowest_mps(self, limit_mps: float) -> float:
        """Return the lowest set speed where this is the limit; on a slow road it may lie above the highest."""
        return min(limit_mps, FASTEST_CAR_MPS) / 2 if self.min_speed_kmh == "limit/2" else self.min_speed_kmh / KMH

    def start_mps(self, limit_mps: float) -> float:
        """Return the first set speed where this is the limit."""
        if self.start_speed_kmh == "limit*3/4":
            return min(limit_mps, FASTEST_CAR_MPS) * 3 / 4
        return self.start_speed_kmh / KMH

    @property
    def starts_by_the_limit(self) -> bool:
        """Whether no number is given for the start."""
        return self.start_speed_kmh == "limit*3/4"

    def clipped_mps(self, speed_mps: float, limit_mps: float) -> float:
        """Return a set speed, brought within its range where this is the limit; the highest counts more."""
        return min(max(speed_mps, self.lowest_mps(limit_mps)), self.highest_mps(limit_mps))

    def held_mps(self, speed_mps: float, limit_mps: float) -> float:
        """Return a set speed as it is held where this is the limit, which counts more than its range."""
        return min(self.clipped_mps(speed_mps, limit_mps), limit_mps)

    @model_validator(mode="after")
    def _ordered(self) -> "Adas":
        lowest, start, highest = self.min_speed_kmh, self.start_speed_kmh, self.max_speed_kmh
        if not isinstance(lowest, str) and not isinstance(highest, str) and lowest >= highest:
            raise ValueError(f"min_speed_kmh {lowest} must be below max_speed_kmh {highest}")
        if not isinstance(lowest, str) and not isinstance(start, str) and start < lowest:
            raise ValueError(f"start_speed_kmh {start} must not be below min_speed_kmh {lowest}")
        if not isinstance(highest, str) and not isinstance(start, str) and start > highest:
            raise ValueError(f"start_speed_kmh {start} must not be above max_speed_kmh {highest}")
        if self.comfort_braking_mps2 > self.emergency_braking_mps2:
            raise ValueError(
                f"comfort_braking_mps2 {self.comfort_braking_mps2} is above emergency_braking_mps2 "
                f"{self.emergency_braking_mps2}"
            )
        return self


class Policy(_Section):
    """The supervisor's network."""

    layers: Literal[1, 2] = 2
    """1 is linear, 2 have tanh units between."""
    hidden: Annotated[int, Field(ge=1, le=1024)] = 32
    """How many of these units."""
    masked: bool = True
    """Whether it chooses among the meta-actions that the assistance layer would carry out now, as the expert does; else
    it may ask for lane changes that are not open, and is refused. Demonstrations that do not tell what was allowed want
    false."""
    mode: Literal["default", "argmax", "sampled"] = "default"
    """How it acts: by its most probable meta-action (argmax), or by one drawn with the policy's probabilities
    (sampled). Training rollouts act the same way; GAIL's are always sampled. Default: argmax for RAIL and ARS, sampled
    for the others."""


class Cloning(_Section):
    """Behaviour cloning: softmax cross-entropy on whitened observations."""

    epochs: Annotated[int, Field(ge=0)] = 100
    """How often all demonstrations are gone through."""
    batch_size: Count = 256
    """Decisions in a minibatch."""
    learning_rate: Positive = 1e-3
    """Adam's."""
    weight_decay: NonNegative = 1e-4
    """The weight of the parameters' squares in the loss (L2)."""


class Search(_Section):
    """Augmented random search (Mania et al. 2018) over the policy's parameters."""

    n_directions: Count = 16
    """N: how many perturbations an iteration tries, each added and subtracted."""
    n_top: Count | Literal["all"] = "all"
    """b: only the best so many directions count, by the better return of either way."""
    step_size: Positive = 0.05
    """alpha: how far an iteration moves the parameters."""
    noise_std: Positive = 0.1
    """nu. Too small, and traffic's noise hides what a perturbation does; too large, and it is a different driver."""

    @property
    def kept(self) -> int:
        """How many directions count."""
        return self.n_directions if self.n_top == "all" else self.n_top

    @model_validator(mode="after")
    def _top(self) -> "Search":
        if self.kept > self.n_directions:
            raise ValueError(f"n_top {self.n_top} exceeds n_directions {self.n_directions}")
        return self


class Judge(_Section):
    """The discriminator and its training."""

    hidden: tuple[Count, ...] = (100, 100)
    """Units of each hidden layer."""
    loss: str = "least-squares"
    """What it minimises: least-squares, cross-entropy, or one from outside, written module:attribute (a
    `rail_sumo.imitation.losses.Loss`)."""
    learning_rate: Positive = 3e-4
    """Adam's."""
    minibatches: Count = 10
    """For every iteration. With many more it learns its demonstrations by heart."""
    batch_size: Count = 512
    """Decisions of the expert in a minibatch, and as many of the learner."""
    reward_clip: Positive = 5.0
    """A decision's reward, by default the judge's logit, is no larger than this, and no smaller than its negative."""


class Rail(_Section):
    """What RAIL has beside its search and its judge."""

    reward_weight: NonNegative = 0.0
    """What a unit of the environment's reward per decision adds to a rollout's return. Above 0 it is no longer
    imitation alone."""


class Gail(_Section):
    """Generative adversarial imitation learning: PPO in place of the random search, under the same judge."""

    rollouts: Count = 32
    """Driven in an iteration, as many as RAIL's, by actions drawn with the policy's probabilities."""
    critic_hidden: tuple[Count, ...] = (64, 64)
    """Units of each of the critic's hidden layers."""
    learning_rate: Positive = 3e-4
    """Adam's, of policy and critic."""
    batch_size: Annotated[int, Field(ge=2)] = 1024
    """Decisions in a minibatch."""
    epochs: Count = 10
    """How often an iteration's decisions are gone through."""
    discount: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.99
    """gamma, per decision."""
    gae_lambda: Annotated[float, Field(ge=0.0, le=1.0)] = 0.95
    """lambda of the advantage estimates."""
    entropy: NonNegative = 0.0
    """What the policy's entropy weighs in the loss."""


class Dagger(_Section):
    """Dataset aggregation: the expert tells what it would have done where the learner drove."""

    rollouts: Count = 4
    """Driven in an iteration, and added to the demonstrations."""


class Ars(_Section):
    """Augmented random search on the environment's reward, from scratch; its other knobs are those of `search`."""

    whitening: bool = True
    """Whether observations are whitened by the statistics of all met so far (V2) or taken as they are (V1)."""


class Train(_Section):
    """One training run."""

    learner: str = "rail"
    """One of rail, gail, bc, dagger and ars; or one from outside, written module:attribute (see `learners.Learner`)."""
    expert: str = "shipped"
    """Who is imitated, asked and compared with: "shipped", "road-expert", or a folder that `rail-sumo expert train`
    wrote."""
    demonstrations: str = "expert"
    """"expert" for the expert's own, or a Parquet file that `rail-sumo expert record` wrote."""
    trajectories: Count = 40
    """How many of the demonstrations are shown, from the first on."""
    iterations: Annotated[int, Field(ge=0)] | Literal["default"] = "default"
    """By default 160 of RAIL, GAIL and ARS, 20 of DAgger; behaviour cloning has none."""
    horizon_s: Positive = 200.0
    """Length of one training rollout. If much shorter than the demonstrations, the judge learns to tell early traffic
    from late traffic instead of learner from expert."""
    evaluation_episodes: Count = 16
    """On held-out traffic, when training is done."""

    @property
    def n_iterations(self) -> int:
        """How many iterations to do, in a configuration that `training.resolved` returned."""
        assert self.iterations != "default"
        return self.iterations


class Expert(_Section):
    """Masked PPO, which the expert is trained by."""

    decisions: Count = 100_000
    """How long the training is; rounded up to whole updates."""
    horizon_s: Positive = 300.0
    """Length of one training episode."""
    hidden: tuple[Count, ...] = (128, 128)
    """Units of each hidden layer."""
    learning_rate: Positive = 4e-4
    """Falls evenly over the training, towards 0."""
    discount: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.995
    """gamma, per decision."""
    decisions_per_update: Count = 2048
    """How many are driven before each update; a multiple of `batch_size`."""
    batch_size: Annotated[int, Field(ge=2)] = 64
    """Decisions in a minibatch."""
    epochs: Count = 10
    """How often an update goes through its decisions."""
    entropy: NonNegative = 0.0
    """What the policy's entropy weighs in the loss."""
    begins_as_rule: Annotated[int, Field(ge=0)] = 0
    """So many episodes of the rule driver are cloned before PPO begins; 0 for a fresh network. Then the critic alone
    learns for `critic_first` updates, before the policy moves away from what was cloned."""
    critic_first: Annotated[int, Field(ge=0)] = 0
    """For how many updates the critic alone learns, after a beginning as the rule driver."""

    @property
    def updates(self) -> int:
        """How many updates the decisions are for."""
        return math.ceil(self.decisions / self.decisions_per_update)

    @model_validator(mode="after")
    def _whole_batches(self) -> "Expert":
        if self.decisions_per_update % self.batch_size:
            raise ValueError(
                f"decisions_per_update {self.decisions_per_update} must be a multiple of batch_size {self.batch_size}"
            )
        return self


OF_LEARNERS = ("cloning", "search", "judge", "rail", "gail", "dagger", "ars")
"""Sections of the configuration that one learner reads and another does not."""
OF_LEARNING = ("policy", *OF_LEARNERS, "train", "expert")
"""Sections of the configuration that are not about the world."""


def flat(tree: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return a configuration's sections as `section.key`, each with its value."""
    return {f"{section}.{key}": value for section, values in tree.items() for key, value in values.items()}


class Config(_Section):
    """The whole tree; a function takes the part it needs."""

    network: Network = Network()
    episode: Episode = Episode()
    traffic: Traffic = Traffic()
    varied: Varied = Varied()
    lidar: Lidar = Lidar()
    observation: Observation = Observation()
    adas: Adas = Adas()
    policy: Policy = Policy()
    cloning: Cloning = Cloning()
    search: Search = Search()
    judge: Judge = Judge()
    rail: Rail = Rail()
    gail: Gail = Gail()
    dagger: Dagger = Dagger()
    ars: Ars = Ars()
    train: Train = Train()
    expert: Expert = Expert()

    def changed(self, **sections: dict[str, Any]) -> "Config":
        """Return it with other values of some keys, by section; they are not checked."""
        updated = {name: getattr(self, name).model_copy(update=keys) for name, keys in sections.items()}
        return self.model_copy(update=updated)

    def practice(self, horizon_s: float) -> "Config":
        """Return the same world with episodes that only time ends, as learners train in it."""
        return self.changed(episode={"course_m": math.inf, "duration_s": horizon_s})

    def flat(self) -> dict[str, Any]:
        """Return every key as `section.key`, with its value."""
        return flat(self.model_dump())

    def of_its_own(self) -> dict[str, Any]:
        """Return the keys that have another value than by default, as `section.key`, with it."""
        usual = Config().flat()
        return {key: value for key, value in self.flat().items() if value != usual[key]}

    @property
    def senses(self) -> Senses:
        """What drivers see in this world who bring no senses of their own."""
        return Senses(self.lidar, self.observation)

    def seen_with(self, senses: Senses | None) -> "Config":
        """Return the same world, seen with other senses; itself if these are None."""
        return self if senses is None else self.model_copy(update=senses._asdict())

    @property
    def sensing(self) -> dict[str, Any]:
        """The keys of its senses, as `section.key`."""
        return {key: value for key, value in self.flat().items() if key.startswith(("lidar.", "observation."))}

    @property
    def demonstrating(self) -> dict[str, Any]:
        """What demonstrations must share with those who learn from them: the sensing, and how often to decide."""
        return self.sensing | {"episode.decision_period_s": self.episode.decision_period_s}
