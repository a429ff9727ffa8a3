"""The one kind of network here, fully connected with tanh between its layers; and how training it goes on later."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn


def perceptron(sizes: Sequence[int], rng: np.random.Generator) -> nn.Sequential:
    """Return a network whose layers have `sizes` units, inputs first; its weights are drawn from `rng` alone."""
    layers: list[nn.Module] = []
    with torch.random.fork_rng(devices=[]):  # torch draws weights from its global generator: put that back after
        torch.manual_seed(int(rng.integers(2**63)))
        for n_inputs, n_outputs in pairwise(sizes):
            layers += [nn.Linear(n_inputs, n_outputs), nn.Tanh()]
    return nn.Sequential(*layers[:-1])


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
