"""The one kind of network here: fully connected, tanh between its layers, none after the last."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import nn


def perceptron(sizes: Sequence[int], rng: np.random.Generator) -> nn.Sequential:
    """Return a network whose layers have `sizes` units, inputs first; its weights are drawn from `rng` alone."""
    layers: list[nn.Module] = []
    with torch.random.fork_rng(devices=[]):  # torch draws weights from its global generator: put that back after
        torch.manual_seed(int(rng.integers(2**63)))
        for n_inputs, n_outputs in pairwise(sizes):
            layers += [nn.Linear(n_inputs, n_outputs), nn.Tanh()]
    return nn.Sequential(*layers[:-1])
