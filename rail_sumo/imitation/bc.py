"""Behaviour cloning: where RAIL starts, and a baseline."""

import numpy as np
import torch
from torch.nn import functional

from rail_sumo import config
from rail_sumo.imitation.demonstrations import Demonstrations
from rail_sumo.imitation.perceptron import flatten, kept_in_bounds, linear, perceptron, single_threaded
from rail_sumo.policy import N_ACTIONS, Shape, Whitening
from rail_sumo.records import Floats


@single_threaded()
def clone(
    demonstrations: Demonstrations,
    shape: Shape,
    whitening: Whitening,
    cloning: config.Cloning,
    seed: int,
    *,
    masked: bool = False,
) -> Floats:
    """Fit a policy to what was demonstrated, by softmax cross-entropy on whitened observations.

    A masked policy's softmax is over the actions that its driver was told it may choose (Huang & Ontañón, "A closer
    look at invalid action masking in policy gradient algorithms", 2022).

    Args:
        demonstrations: what was seen, allowed and decided; observations of shape (n, shape.n_features).
        shape: the layout of theta.
        whitening: the policy's own.
        cloning: epochs (0 returns the network it would start from), batch size, Adam's rate, L2 weight decay.
        seed: of the first weights and of the order of the minibatches; the same seed gives the same theta.
        masked: whether the policy is.

    Returns:
        theta, shape (shape.size,), in the layout of `policy.unflatten`.

    Raises:
        ValueError: the demonstrations' observations do not fit the shape.
        InputError: the weights do not stay finite.
    """
    if demonstrations.observations.shape[1] != shape.n_features:
        raise ValueError(
            f"demonstrations must have {shape.n_features} features for {shape}; "
            f"got {demonstrations.observations.shape[1]}"
        )
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(b"clone")))
    hidden = [] if shape.hidden is None else [shape.hidden]
    network = perceptron([shape.n_features, *hidden, N_ACTIONS], rng)
    adam = torch.optim.Adam(network.parameters(), lr=cloning.learning_rate, weight_decay=cloning.weight_decay)

    observations = torch.from_numpy(whitening(demonstrations.observations).astype(np.float32))
    actions = torch.from_numpy(demonstrations.actions)
    forbidden = torch.from_numpy(~demonstrations.allowed if masked else np.zeros_like(demonstrations.allowed))
    with kept_in_bounds(network, "cloning.learning_rate"):
        for _ in range(cloning.epochs):
            order = torch.from_numpy(rng.permutation(len(actions)))
            for batch in order.split(cloning.batch_size):
                outputs = network(observations[batch]).masked_fill(forbidden[batch], -torch.inf)
                loss = functional.cross_entropy(outputs, actions[batch])
                adam.zero_grad()
                loss.backward()
                adam.step()
    return flatten(linear(network))
