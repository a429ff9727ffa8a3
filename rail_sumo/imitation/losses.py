"""What a judge minimises, and what it pays by: the ones that `judge.loss` knows by name, and the form of any other.

A judge's network gives one output for each of n pairs of observation and action. A loss says what is minimised on a
minibatch of the expert's pairs and one of the learner's, how an output becomes D, the verdict from 0 (learner) to 1
(expert), and how it becomes a reward.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

Outputs = Callable[[Tensor], Tensor]
"""The judge's network: pairs, shape (n, n_features + 5) -> outputs, shape (n,)."""


def itself(outputs: Tensor) -> Tensor:
    """Return the outputs."""
    return outputs


@dataclass(frozen=True)
class Loss:
    """A loss, D and the reward of one output; see the functions of this module for examples."""

    minimised: Callable[[Outputs, Tensor, Tensor, np.random.Generator], Tensor]
    """(network, the expert's pairs, as many of the learner's, a generator to draw from) -> the loss, a scalar."""
    verdict: Callable[[Tensor], Tensor] = torch.sigmoid
    """Outputs, shape (n,) -> D."""
    reward: Callable[[Tensor], Tensor] = itself
    """Outputs, shape (n,) -> rewards, which `judge.reward_clip` bounds. With D = sigmoid(output) the output itself is
    log D - log(1 - D)."""


def least_squares(outputs: Outputs, expert: Tensor, learner: Tensor, rng: np.random.Generator) -> Tensor:
    """Return the least-squares GAN's loss (Mao et al. 2017; Algorithm 1, lines 8 and 9), of D = sigmoid(output).

    0.25 when expert and learner look the same, 0 when D separates them perfectly.
    """
    on_expert, on_learner = torch.sigmoid(outputs(expert)), torch.sigmoid(outputs(learner))
    return 0.5 * (on_expert - 1.0).square().mean() + 0.5 * on_learner.square().mean()


def cross_entropy(outputs: Outputs, expert: Tensor, learner: Tensor, rng: np.random.Generator) -> Tensor:
    """Return the loss of the first GAN and of GAIL: the mean of -log D on the expert and -log(1 - D) on the learner.

    log 2 when expert and learner look the same.
    """
    return 0.5 * (functional.softplus(-outputs(expert)).mean() + functional.softplus(outputs(learner)).mean())


LOSSES = {"least-squares": Loss(least_squares), "cross-entropy": Loss(cross_entropy)}
"""By `judge.loss`."""
