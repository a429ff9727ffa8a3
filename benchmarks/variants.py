"""Other ways to search and to judge than rail_sumo's own, to be compared with them."""

import itertools
from collections import deque
from typing import Any

import numpy as np
import torch
from scipy import stats

from rail_sumo.imitation.discriminator import Discriminator
from rail_sumo.imitation.losses import Loss, least_squares
from rail_sumo.imitation.random_search import RandomSearch
from rail_sumo.records import Floats, Trajectory


class Ranked(RandomSearch):
    """Follows the returns' ranks among all 2N, from -1/2 to 1/2, in place of the returns."""

    def tell(self, deltas, returns_plus, returns_minus):
        ranks = stats.rankdata([*returns_plus, *returns_minus])
        shaped = (ranks - 1) / (len(ranks) - 1) - 0.5
        return super().tell(deltas, shaped[: len(deltas)], shaped[len(deltas) :])


def shrinking(search: Any) -> Any:
    """A class of searches whose steps become smaller by 1 % an iteration."""

    class Shrinking(search):
        def tell(self, deltas, returns_plus, returns_minus):
            length = super().tell(deltas, returns_plus, returns_minus)
            self.step_size *= 0.99
            return length

    return Shrinking


def clipped_up(search: Any) -> Any:
    """A class of searches with momentum, whose steps have one length and whose velocity has a limit.

    Source: Toklu, Liskowski & Srivastava, "ClipUp" (PPSN 2020). Lengths are chosen so that velocity is about as fast
    as the steps of the plain search.
    """

    class ClippedUp(search):
        theta: Floats
        velocity: Floats | float = 0.0

        def tell(self, deltas, returns_plus, returns_minus):
            before = self.theta
            length = super().tell(deltas, returns_plus, returns_minus)
            if not length:
                return length
            velocity = 0.9 * self.velocity + 5 * self.step_size * (self.theta - before) / length
            self.velocity = velocity * min(1.0, 10 * self.step_size / np.linalg.norm(velocity))
            self.theta = before + self.velocity
            return float(np.linalg.norm(self.velocity))

    return ClippedUp


class Remembering:
    """A judge that learns from the learner's last three iterations, not from the newest alone."""

    def __init__(self, judge: Discriminator) -> None:
        self._judge = judge
        self._last: deque[list[Trajectory]] = deque(maxlen=3)
        self.returns = judge.returns

    def fit(self, expert, learner, rng):
        self._last.append(list(learner))
        return self._judge.fit(expert, list(itertools.chain.from_iterable(self._last)), rng)


def penalised(outputs, expert, learner, rng):
    """Least squares, and 0.2 of the mean square of D's slope between the two sides: D is not to become a cliff.

    Source: zero-centred gradient penalty (Thanh-Tung, Tran & Venkatesh 2019).
    """
    share = torch.from_numpy(rng.random((len(expert), 1), dtype=np.float32))
    between = (share * expert + (1.0 - share) * learner).requires_grad_()
    (slope,) = torch.autograd.grad(torch.sigmoid(outputs(between)).sum(), between, create_graph=True)
    return least_squares(outputs, expert, learner, rng) + 0.2 * slope.square().sum(dim=1).mean()


PENALISED = Loss(penalised)
"""For `judge.loss=variants:PENALISED`."""
