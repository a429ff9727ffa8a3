"""The one kind of network here, fully connected with tanh between its layers; and how training it goes on later."""

import random
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from rail_sumo.errors import InputError
from rail_sumo.policy import LARGEST
from rail_sumo.records import Floats


def perceptron(sizes: Sequence[int], rng: np.random.Generator) -> nn.Sequential:
    """Return a network whose layers have `sizes` units, inputs first; its weights are drawn from `rng` alone."""
    layers: list[nn.Module] = []
    with torch.random.fork_rng(devices=[]):  # torch draws weights from its global generator: put that back after
        torch.manual_seed(int(rng.integers(2**63)))
        for n_inputs, n_outputs in pairwise(sizes):
            layers += [nn.Linear(n_inputs, n_outputs), nn.Tanh()]
    return nn.Sequential(*layers[:-1])


def linear(modules: Iterable[nn.Module]) -> list[nn.Linear]:
    """Return the layers that have weights."""
    return [module for module in modules if isinstance(module, nn.Linear)]


def actor(policy: Any) -> list[nn.Linear]:
    """Return the layers of a stable-baselines3 policy from observation to action."""
    return linear([*policy.mlp_extractor.policy_net, policy.action_net])


def flatten(layers: Iterable[nn.Linear]) -> Floats:
    """Return weights as `policy.unflatten` splits them: each layer's matrix with its bias as last column."""
    matrices = [torch.column_stack([layer.weight, layer.bias]) for layer in layers]
    return torch.cat([matrix.flatten() for matrix in matrices]).detach().numpy().astype(np.float64)


def training_state(network: nn.Module, adam: torch.optim.Optimizer) -> dict[str, NDArray[Any]]:
    """Return copies of all that a later training step depends on: the network's weights and Adam's moments."""
    state = {}
    for name, parameter in network.named_parameters():
        state[f"network.{name}"] = parameter.detach().numpy().copy()
        for moment, value in adam.state[parameter].items():  # none before the first step
            state[f"adam.{name}.{moment}"] = value.numpy().copy()
    return state


def load_training_state(network: nn.Module, adam: torch.optim.Optimizer, state: Mapping[str, NDArray[Any]]) -> None:
    """Go on from what `training_state` returned; other keys are left alone.

    Raises:
        KeyError: a weight is missing.
        ValueError: a weight has another shape than the network's.
    """
    for name, parameter in network.named_parameters():
        weights = state[f"network.{name}"]
        if weights.shape != parameter.shape:
            raise ValueError(f"network.{name} must have shape {tuple(parameter.shape)}; got {weights.shape}")
        with torch.no_grad():
            parameter.copy_(torch.tensor(weights))
        prefix = f"adam.{name}."
        adam.state[parameter] = {
            key.removeprefix(prefix): torch.tensor(value) for key, value in state.items() if key.startswith(prefix)
        }


@contextmanager
def kept_in_bounds(network: nn.Module, key: str) -> Iterator[None]:
    """Refuse a training that ends, or fails, with weights that are not finite or beyond `LARGEST`.

    Args:
        network: what is trained.
        key: of its learning rate in the configuration.

    Raises:
        InputError: the weights are so.
    """
    try:
        yield
    except ValueError:  # torch's, of probabilities that are not finite
        require_in_bounds(network, key)
        raise
    require_in_bounds(network, key)


def require_in_bounds(network: nn.Module, key: str) -> None:
    """Raise InputError if weights of a network are not finite or beyond `LARGEST`; arguments as of `kept_in_bounds`."""
    if not all((parameter.abs() <= LARGEST).all() for parameter in network.parameters()):
        raise InputError(
            f"training diverged: weights of the network are not finite, or beyond {LARGEST:g}; set a smaller {key}"
        ) from None


@contextmanager
def generators_put_back() -> Iterator[None]:
    """Put the global generators back, whatever a library draws from them or seeds them with; also a decorator."""
    before = random.getstate(), np.random.get_state()  # noqa: NPY002  the library's, not ours
    try:
        with torch.random.fork_rng(devices=[]):
            yield
    finally:
        random.setstate(before[0])
        np.random.set_state(before[1])  # noqa: NPY002


@contextmanager
def seeded(rng: np.random.Generator) -> Iterator[None]:
    """Let a library that draws from the global generators draw from this one, and put those back after."""
    seed = int(rng.integers(2**32))
    with generators_put_back():
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002
        torch.manual_seed(seed)
        yield


@contextmanager
def single_threaded() -> Iterator[None]:
    """Let torch compute in this thread alone; also a decorator.

    Networks this small give a second thread too little to do. Where other processes want the cores too, threads wait
    for each other: a fit of the judge then took thirty times as long with two as with one. And with one, a sum does
    not depend on how many cores a machine has.
    """
    n_threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(n_threads)
