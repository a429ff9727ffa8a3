"""Augmented random search as ask/tell, in plain numpy.

Source: Mania, Guy & Recht, "Simple random search of static linear policies is competitive for reinforcement learning"
(NeurIPS 2018). Shin & Kim (IJCAI 2019), Algorithm 1, keep all N directions (`n_top=n_directions`).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

ROUNDING = 1e-12
"""Returns this close to each other, relative to their size, differ by the order of their summation only."""


class RandomSearch:
    """Maximises a return by trying symmetric perturbations of theta and following the ones that mattered.

    Ask for directions, measure the returns of `theta + noise_std * delta` and `theta - noise_std * delta`, and tell.

    Args:
        theta: where to start, shape (size,).
        n_directions: N, how many directions `ask` draws.
        n_top: b, how many of them `tell` follows.
        step_size: alpha.
        noise_std: nu, the scale of the perturbations; the update does not depend on it.

    Raises:
        ValueError: theta is not a finite vector, or n_top is not in 1..n_directions.
    """

    def __init__(self, theta: ArrayLike, *, n_directions: int, n_top: int, step_size: float, noise_std: float) -> None:
        self.theta = np.array(theta, dtype=np.float64)
        if self.theta.ndim != 1 or not np.isfinite(self.theta).all():
            raise ValueError(f"theta must be a vector of finite numbers; got shape {self.theta.shape}")
        if not 1 <= n_top <= n_directions:
            raise ValueError(f"n_top must lie in 1..n_directions = 1..{n_directions}; got {n_top}")
        self.n_directions = n_directions
        self.n_top = n_top
        self.step_size = step_size
        self.noise_std = noise_std

    def ask(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return directions to try: standard normal, shape (n_directions, theta.size)."""
        return rng.standard_normal((self.n_directions, self.theta.size))

    def tell(self, deltas: ArrayLike, returns_plus: ArrayLike, returns_minus: ArrayLike) -> float:
        """Move theta along the best directions and return how far.

        Args:
            deltas: the directions tried, shape (n_directions, theta.size).
            returns_plus, returns_minus: the returns either way, each of shape (n_directions,).

        Returns:
            The step's Euclidean length; 0.0 when the kept returns are all the same.

        Raises:
            ValueError: a shape is not as above, or a number is not finite.
        """
        deltas = _checked("deltas", deltas, (self.n_directions, self.theta.size))
        returns_plus = _checked("returns_plus", returns_plus, (self.n_directions,))
        returns_minus = _checked("returns_minus", returns_minus, (self.n_directions,))

        top = np.argsort(-np.maximum(returns_plus, returns_minus), kind="stable")[: self.n_top]
        kept = np.stack([returns_plus[top], returns_minus[top]])
        sigma = np.std(kept)  # population std of the 2b kept returns
        if sigma <= ROUNDING * np.abs(kept).max():  # nothing tells them apart: stay, not step by rounding errors
            return 0.0
        step = self.step_size / (self.n_top * sigma) * (returns_plus[top] - returns_minus[top]) @ deltas[top]
        self.theta = self.theta + step
        return float(np.linalg.norm(step))


def _checked(name: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}; got {array.shape}")
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        raise ValueError(f"{name} must be finite; got {array[tuple(bad[0])]} in row {bad[0][0]}")
    return array
