"""The supervisor: a flat parameter vector and an observation give an action. Workers need numpy alone."""

from dataclasses import dataclass, replace

import numpy as np

from rail_sumo.config import Senses
from rail_sumo.records import Floats, MetaAction

N_ACTIONS = len(MetaAction)
LARGEST = 1e9
"""A weight beyond this is of no use: with it float32 soon overflows."""
ARGMAX, SAMPLED = "argmax", "sampled"
"""How a policy acts: by its most probable meta-action, or by one drawn with its probabilities."""


@dataclass(frozen=True)
class Shape:
    """How theta is laid out: row-major weights with their biases, input layer first."""

    n_features: int
    hidden: int | None
    """Units of the tanh hidden layer, or None for a single (linear) layer."""

    @property
    def layers(self) -> list[tuple[int, int]]:
        """(rows, columns) of each layer's matrix; the last column is the bias."""
        if self.hidden is None:
            return [(N_ACTIONS, self.n_features + 1)]
        return [(self.hidden, self.n_features + 1), (N_ACTIONS, self.hidden + 1)]

    @property
    def size(self) -> int:
        """Length of theta."""
        return sum(rows * columns for rows, columns in self.layers)


@dataclass(frozen=True)
class Whitening:
    """Mean and standard deviation that observations are centred and scaled by, each of shape (n_features,)."""

    mean: Floats
    std: Floats

    @classmethod
    def of(cls, observations: Floats) -> "Whitening":
        """Measure observations of shape (n, n_features)."""
        return cls.by(observations.mean(axis=0), observations.std(axis=0))

    @classmethod
    def by(cls, mean: Floats, std: Floats) -> "Whitening":
        """Take measured moments; a feature that never varies keeps its scale."""
        return cls(mean, np.where(std < 1e-8, 1.0, std))

    def __call__(self, observations: Floats) -> Floats:
        """Return observations centred and scaled, shape (n, n_features)."""
        return (observations - self.mean) / self.std


class Policy:
    """Deterministic supervisor: the action with the largest of five outputs.

    Args:
        theta: flat parameters, shape (shape.size,).
        shape: the layout of theta.
        whitening: observations are centred and scaled by it before the first layer; folded into that layer's
            weights once, so that a decision costs one matrix product a layer.

    Raises:
        ValueError: theta or whitening does not fit the shape, or is not finite.
    """

    def __init__(self, theta: Floats, shape: Shape, whitening: Whitening) -> None:
        theta = np.asarray(theta, dtype=np.float64)
        if theta.shape != (shape.size,):
            raise ValueError(f"theta must have shape ({shape.size},) for {shape}; got {theta.shape}")
        if whitening.mean.shape != (shape.n_features,):
            raise ValueError(f"whitening must have shape ({shape.n_features},); got {whitening.mean.shape}")
        for name, values in (("theta", theta), ("whitening", np.array([whitening.mean, whitening.std]))):
            if not np.isfinite(values).all():
                n_wrong = values.size - np.isfinite(values).sum()
                raise ValueError(f"{name} must be finite; {n_wrong} of {values.size} values are not")
        self.shape = shape
        matrices = unflatten(theta, shape)
        weights = matrices[0][:, :-1] / whitening.std
        self._first = weights
        self._first_bias = matrices[0][:, -1] - weights @ whitening.mean
        self._second = (matrices[1][:, :-1], matrices[1][:, -1]) if shape.hidden is not None else None

    def outputs(self, observation: Floats) -> Floats:
        """Return the five outputs, shape (5,)."""
        outputs = self._first @ observation
        outputs += self._first_bias
        if self._second is None:
            return outputs
        weights, bias = self._second
        return weights @ np.tanh(outputs) + bias

    def __call__(self, observation: Floats) -> int:
        """Return the `MetaAction` for an observation of shape (n_features,)."""
        return int(self.outputs(observation).argmax())


@dataclass(frozen=True)
class PolicyParameters:
    """A learned supervisor as data: what is kept on disk and travels to a worker."""

    theta: Floats
    shape: Shape
    whitening: Whitening
    samples: bool = False
    """Whether actions are sampled with their softmax probabilities; else the most probable one is taken."""
    masked: bool = False
    """Whether it chooses among the meta-actions that the assistance layer would carry out now."""
    senses: Senses | None = None
    """What it sees with, wherever it drives; None for what the world's configuration says."""

    def acting(self, mode: str) -> "PolicyParameters":
        """Return the same policy, acting by `ARGMAX` or `SAMPLED`."""
        return replace(self, samples=mode == SAMPLED)

    def policy(self) -> Policy:
        """Return the network as a callable: its most probable meta-action, without mask or sampling."""
        return Policy(self.theta, self.shape, self.whitening)


def unflatten(theta: Floats, shape: Shape) -> list[Floats]:
    """Split theta into its layers' matrices (views)."""
    matrices, start = [], 0
    for rows, columns in shape.layers:
        matrices.append(theta[start : start + rows * columns].reshape(rows, columns))
        start += rows * columns
    return matrices
