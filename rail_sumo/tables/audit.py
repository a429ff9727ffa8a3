"""How well a fresh classifier tells a learner's decisions from its expert's: what no average of drives can hide.

Source: the classifier two-sample test (Lopez-Paz & Oquab, "Revisiting classifier two-sample tests", ICLR 2017), with
the area under the ROC curve in place of the accuracy. No learner has been rewarded by this classifier: it is trained
here, on some episodes, and scores others.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from rail_sumo.imitation.perceptron import perceptron, single_threaded
from rail_sumo.policy import N_ACTIONS, Whitening
from rail_sumo.records import Floats, Trajectory
from rail_sumo.tables.statistics import probability_of_improvement

FOLDS = 4
HIDDEN = (64, 64)
MINIBATCHES = 1000
"""The number of training steps, whatever the number of episodes."""
BATCH_SIZE = 256
"""Decisions in a minibatch, drawn with replacement."""
LEARNING_RATE = 1e-3


@single_threaded()
def told_apart(learner: Sequence[Trajectory], expert: Sequence[Trajectory]) -> Floats:
    """Return for each episode how well the learner's decisions in it are told from the expert's, shape (n_episodes,).

    The figure is the area under the ROC curve: how likely the classifier finds a decision of the expert's more like the
    expert than one of the learner's. 0.5 is perfect imitation, 1 none. A decision is an observation and the meta-action
    asked for. Each episode is scored by a classifier that was trained on three quarters of all, without this one.
    Chance can put a figure below 0.5. The fewer episodes there are to learn from, the less a classifier finds: compare
    figures only from equal numbers of episodes. The same episodes always give the same figures.

    Do not compare SUMO's own driver (`sumo`): it takes no decisions, its episodes hold *keep* alone, and the figure
    would only tell how rarely the expert keeps.

    Args:
        learner: its episodes.
        expert: its expert's, as many, on the same traffic.

    Returns:
        NaN for each of fewer than `FOLDS` episodes.

    Raises:
        ValueError: not as many episodes of either.
    """
    n = len(learner)
    if len(expert) != n:
        raise ValueError(f"as many episodes of the expert as of the learner are wanted, {n}; got {len(expert)}")
    if n < FOLDS:
        return np.full(n, np.nan)
    whitening = Whitening.of(np.concatenate([episode.observations for episode in (*learner, *expert)]))
    ours, theirs = ([_pairs(episode, whitening) for episode in driven] for driven in (learner, expert))
    rng = np.random.default_rng(0)
    fold = rng.permutation(n) % FOLDS
    areas = np.empty(n)
    for number in range(FOLDS):
        apart = fold != number
        classifier = _trained([ours[i] for i in np.flatnonzero(apart)], [theirs[i] for i in np.flatnonzero(apart)], rng)
        with torch.inference_mode():
            for i in np.flatnonzero(~apart):
                on_expert, on_learner = (classifier(episode)[:, 0].numpy() for episode in (theirs[i], ours[i]))
                areas[i] = probability_of_improvement(on_expert, on_learner)
    return areas


def _pairs(episode: Trajectory, whitening: Whitening) -> Tensor:
    """Return what was sensed, whitened, and what was asked for, one-hot; shape (n_decisions, n_features + 5)."""
    pairs = np.hstack([whitening(episode.observations), np.eye(N_ACTIONS)[episode.decisions]])
    return torch.from_numpy(pairs.astype(np.float32))


def _trained(learner: list[Tensor], expert: list[Tensor], rng: np.random.Generator) -> nn.Module:
    """Return a classifier whose output is larger on what looks like the expert's, by logistic regression."""
    pairs = torch.cat([*learner, *expert])
    labels = torch.zeros(len(pairs))
    labels[sum(map(len, learner)) :] = 1.0
    network = perceptron([pairs.shape[1], *HIDDEN, 1], rng)
    adam = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)
    for _ in range(MINIBATCHES):
        batch = torch.from_numpy(rng.integers(len(pairs), size=BATCH_SIZE))
        loss = functional.binary_cross_entropy_with_logits(network(pairs[batch])[:, 0], labels[batch])
        adam.zero_grad()
        loss.backward()
        adam.step()
    return network
