"""The one kind of network here: fully connected, tanh between its layers, none after the last."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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
