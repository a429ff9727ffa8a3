"""Whatever decides for the host: fixed rules, the expert, learned policies."""

import copy
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from safetensors import safe_open

from rail_sumo import assets
from rail_sumo.config import Adas, Config, Senses
from rail_sumo.config_file import first_difference, recorded
from rail_sumo.errors import InputError, ObservationError, did_you_mean
from rail_sumo.highway.agent import Agent
from rail_sumo.highway.vehicle import acc
from rail_sumo.highway.vehicle.acc import Leader
from rail_sumo.policy import N_ACTIONS, PolicyParameters
from rail_sumo.records import Floats, Gaps, MetaAction


class Driver(Protocol):
    """Decides from what the supervisor sees; its vehicle is at hand for drivers that see more."""

    @property
    def senses(self) -> Senses | None:
        """What it must see with; None if it takes what the world's configuration says."""

    def decide(self, observation: Floats, agent: Agent) -> int:
        """Return the next `MetaAction`."""


@runtime_checkable
class Begins(Protocol):
    """A driver that remembers or draws: others drive in its stead, each one vehicle for one episode."""

    def begin(self, seed: int) -> Driver:
        """Return a driver that remembers nothing yet, and draws by the seed; itself if it does neither."""


class Keep:
    """Keeps lane and set speed."""

    senses = None

    def decide(self, observation: Floats, agent: Agent) -> int:
        """Return KEEP."""
        return MetaAction.KEEP


class Random:
    """Draws every meta-action with the same probability."""

    senses = None

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def decide(self, observation: Floats, agent: Agent) -> int:
        """Return any meta-action."""
        return int(self._rng.integers(len(MetaAction)))


class Rule:
    """Gap acceptance on the true neighbours: speeds up when free, overtakes where another lane is faster.

    A lane's worth is the speed that adaptive cruise control would allow the host behind its leader; a change must gain
    `GAIN_MPS` (the incentive and switching threshold of MOBIL, Kesting, Treiber & Helbing 2007; its safety criterion is
    the ADAS layer's gate).
    """

    GAIN_MPS = 1.0
    senses = None

    def __init__(self, adas: Adas) -> None:
        self._adas = adas

    def decide(self, observation: Floats, agent: Agent) -> int:
        """Return the meta-action with the best prospect."""
        host, here, left, right = agent.surroundings()
        mask = agent.action_masks()
        top = self._adas.highest_mps(host.limit_mps)
        now = self._prospect(here, top)
        sides = [(self._prospect(left, top), MetaAction.LEFT), (self._prospect(right, top), MetaAction.RIGHT)]
        best, side = max((side for side in sides if mask[side[1]]), default=(-math.inf, MetaAction.KEEP))
        if not agent.is_changing_lane and best > now + self.GAIN_MPS:
            return side
        if host.speed_mps < min(now, top) - 0.5:
            return MetaAction.ACCELERATE
        return MetaAction.KEEP

    def _prospect(self, gaps: Gaps, top_mps: float) -> float:
        return min(top_mps, acc.allowed_mps(Leader(gaps.ahead_m, gaps.ahead_speed_mps), self._adas))


class Network(ABC):
    """A learned driver: a network that gives each meta-action an output, from the observation alone."""

    senses: Senses | None

    def begin(self, seed: int) -> "Network":
        """Return the same network, which draws by the seed if it draws."""
        return self

    @abstractmethod
    def decide(self, observation: Floats, agent: Agent) -> int:
        """Return the next `MetaAction`."""

    @abstractmethod
    def outputs(self, observation: Floats, allowed: Sequence[bool]) -> Floats:
        """Return the network's outputs, shape (5,); -inf for what is not allowed, if it heeds that."""

    @abstractmethod
    def choose(self, outputs: Floats) -> int:
        """Return the meta-action that it takes by its outputs."""

    def act(self, observation: Floats, mask: ArrayLike | None = None) -> int | NDArray[np.int64]:
        """Return the meta-action for an observation, or for each of several.

        Args:
            observation: shape (n_features,), or (n, n_features); see `highway.observation.feature_names`.
            mask: which meta-actions would be carried out, shape (5,) or (n, 5), as `info["action_mask"]` tells it. A
                driver that was trained without a mask does not heed it, and needs none.

        Returns:
            A `MetaAction` as an int, or their array of shape (n,).

        Raises:
            ValueError: observation or mask has another shape, an observation has a value that is not finite, a mask one
                that is neither 0 nor 1, or a driver that heeds a mask is given none, or one in which nothing is open.
        """
        if mask is None and self.heeds_mask:
            raise ValueError("this driver heeds what is open: give act() the mask too, as info['action_mask'] tells it")
        observations = np.asarray(observation, dtype=np.float64)
        masks = np.ones((*observations.shape[:-1], N_ACTIONS)) if mask is None else np.asarray(mask)
        if observations.ndim not in (1, 2) or observations.shape[-1] != self.n_features:
            raise ValueError(
                f"observation must have shape ({self.n_features},) or (n, {self.n_features}); got {observations.shape}"
            )
        if not np.isfinite(observations).all():
            raise ValueError("observation holds values that are not finite")
        if masks.shape != (*observations.shape[:-1], N_ACTIONS):
            raise ValueError(f"mask must have shape {(*observations.shape[:-1], N_ACTIONS)}; got {masks.shape}")
        if not ((masks == 0) | (masks == 1)).all():
            raise ValueError("a mask holds 0 and 1, or False and True, and nothing else")
        if self.heeds_mask and not masks.any(axis=-1).all():
            raise ValueError("a mask has nothing open; keep always is")
        if observations.ndim == 1:
            return self.choose(self.outputs(observations, masks.astype(np.bool_).tolist()))
        rows = zip(observations, masks.astype(np.bool_).tolist(), strict=True)
        return np.array([self.choose(self.outputs(*row)) for row in rows], dtype=np.int64)

    def probabilities(self, observation: Floats, allowed: Sequence[bool]) -> tuple[float, ...]:
        """Return how probable each meta-action is for one observation, shape (n_features,), if it were sampled."""
        outputs = self.outputs(observation, allowed)
        likelihoods = np.exp(outputs - outputs.max())
        return tuple((likelihoods / likelihoods.sum()).tolist())

    @property
    @abstractmethod
    def heeds_mask(self) -> bool:
        """Whether it chooses among what is open."""

    @property
    @abstractmethod
    def n_features(self) -> int:
        """How many numbers an observation has."""


class Expert(Network):
    """An expert: a tanh network trained by masked PPO, driven by its most probable allowed action.

    Args:
        layers: (weights, biases) from input to output; weights of shape (n_out, n_in).
        senses: what it was trained with.
    """

    def __init__(self, layers: Sequence[tuple[Floats, Floats]], senses: Senses | None = None) -> None:
        self.layers = layers
        self.senses = senses

    def decide(self, observation: Floats, agent: Agent) -> int:
        """Return the allowed action with the largest output."""
        return int(self.outputs(observation, agent.action_masks()).argmax())

    def outputs(self, observation: Floats, allowed: Sequence[bool]) -> Floats:
        """Return the network's outputs, shape (5,), -inf for what is not allowed."""
        hidden = observation
        for weights, biases in self.layers[:-1]:
            hidden = np.tanh(weights @ hidden + biases)
        weights, biases = self.layers[-1]
        return np.where(allowed, weights @ hidden + biases, -np.inf)

    def choose(self, outputs: Floats) -> int:
        """Return the action with the largest output."""
        return int(outputs.argmax())

    @property
    def heeds_mask(self) -> bool:
        """Always: it was trained with one."""
        return True

    @property
    def n_features(self) -> int:
        """How many numbers an observation has."""
        return self.layers[0][0].shape[1]


class Learned(Network):
    """A learned policy. It sees the observation; if it is masked, also which meta-actions would be carried out now.

    Args:
        parameters: the policy, whether it samples, and whether it is masked.
        seed: of sampling.
    """

    def __init__(self, parameters: PolicyParameters, seed: int) -> None:
        self._policy = parameters.policy()
        self._is_masked = parameters.masked
        self.senses = parameters.senses
        self._rng = _drawn_by(seed) if parameters.samples else None

    def begin(self, seed: int) -> "Learned":
        """Return the same policy, which samples by the seed if it samples."""
        again = copy.copy(self)
        again._rng = None if self._rng is None else _drawn_by(seed)
        return again

    def decide(self, observation: Floats, agent: Agent) -> int:
        """Return the most probable action, or a sampled one."""
        return self.choose(self.outputs(observation, agent.action_masks() if self._is_masked else ()))

    def outputs(self, observation: Floats, allowed: Sequence[bool]) -> Floats:
        """Return the network's outputs, shape (5,); -inf for what is not allowed, if it is masked."""
        outputs = self._policy.outputs(observation)
        return np.where(allowed, outputs, -np.inf) if self._is_masked else outputs

    def choose(self, outputs: Floats) -> int:
        """Return the action with the largest output, or one that is drawn by them."""
        if self._rng is not None:
            outputs = outputs + self._rng.gumbel(size=len(outputs))  # the Gumbel-max trick
        return int(outputs.argmax())

    @property
    def heeds_mask(self) -> bool:
        """Whether it was trained with one."""
        return self._is_masked

    @property
    def n_features(self) -> int:
        """How many numbers an observation has."""
        return self._policy.shape.n_features


def _drawn_by(seed: int) -> np.random.Generator:
    """Return a stream of its own, beside the traffic's."""
    return np.random.default_rng([seed, 2])


class Advised:
    """Lets one driver drive and records what another would have decided."""

    def __init__(self, driver: Driver, adviser: Driver) -> None:
        self._driver = driver
        self._adviser = adviser
        self.senses = driver.senses
        self.advice: list[int] = []

    def decide(self, observation: Floats, agent: Agent) -> int:
        """Return the driver's own decision."""
        self.advice.append(self._adviser.decide(observation, agent))
        return self._driver.decide(observation, agent)


def probabilities(driver: Driver, observation: Floats, allowed: Sequence[bool]) -> tuple[float, ...]:
    """Return how probable each meta-action is to a learned driver; of any other driver nothing.

    Args:
        driver: who drives.
        observation: what it observes.
        allowed: which meta-actions would be carried out.
    """
    return driver.probabilities(observation, allowed) if isinstance(driver, Network) else ()


SHIPPED = ("rail", "road-expert", "road-rail")
"""Learned drivers by name, beside the expert: the paper's, and those of varied roads."""
NAMES = ("expert", *SHIPPED, "rule", "sumo", "keep", "random")
"""Drivers by name. `sumo` keeps too: SUMO drives in its stead (`HighwayEnv(hands_off=True)`).

So does `sumo:TYPE`, with the host as a vehicle of one of the demand's types.
"""
SUMO_AS = "sumo:"


def is_name(policy: str) -> bool:
    """Return whether a driver goes by the name."""
    return policy in NAMES or (policy.startswith(SUMO_AS) and policy != SUMO_AS)


def hands_off(name: object) -> bool | str:
    """Return whether SUMO's own driver drives under the name, as `HighwayEnv` takes it: or as which vehicle type."""
    if not isinstance(name, str) or not is_name(name):
        return False
    return name.removeprefix(SUMO_AS) if name.startswith(SUMO_AS) else name == "sumo"


def by_name(name: str, config: Config, seed: int) -> Driver:
    """Return a driver for one episode; `seed` matters to the random one alone.

    Raises:
        InputError: no such driver; the expert senses something else than the configuration says.
    """
    match name:
        case "keep":
            return Keep()
        case _ if hands_off(name):
            return Keep()
        case "random":
            return Random(np.random.default_rng([seed, 1]))  # not the stream that the traffic draws from
        case "rule":
            return Rule(config.adas)
        case "expert":
            return load_expert(config)
        case _:
            raise InputError(f"driver '{name}' not found{did_you_mean(name, set(NAMES) - set(SHIPPED))}")


def load_expert(config: Config, folder: Path | None = None) -> Expert:
    """Return the expert in `folder`, which `rail-sumo expert train` wrote; without one, the configuration's.

    Raises:
        InputError: it is missing or damaged, or has weights that are not finite.
    """
    folder = folder or assets.expert_folder(config.train.expert)
    assets.require_expert(folder)
    with safe_open(assets.expert(assets.EXPERT_POLICY, folder), framework="numpy") as file:
        n_layers = len(file.keys()) // 2
        layers = [(file.get_tensor(f"{i}.weight"), file.get_tensor(f"{i}.bias")) for i in range(n_layers)]
    if not all(np.isfinite(values).all() for layer in layers for values in layer):
        raise InputError(f"the expert in '{folder}' cannot drive: weights of its network are not finite; train another")
    recipe = recorded(assets.expert(assets.EXPERT_RECIPE, folder).read_text(encoding="utf-8"))
    return Expert(layers, recipe.senses)


def require_same_senses(driver: Driver | PolicyParameters | str, config: Config, name: str) -> None:
    """Raise ObservationError if a driver was trained with other senses than the configuration's; a name was not."""
    if isinstance(driver, str):
        return
    own, given = config.seen_with(driver.senses).sensing, config.sensing
    mismatch = first_difference(own, given)
    if mismatch:
        raise ObservationError(f"{name} was trained with {mismatch}; set {settings(own, given)}, or train another")


def settings(own: Mapping[str, Any], given: Mapping[str, Any]) -> str:
    """Return the keys of a driver's senses that are not as given, each as `--set` takes it."""
    return " ".join(f"{key}={json.dumps(value)}" for key, value in own.items() if given[key] != value)
