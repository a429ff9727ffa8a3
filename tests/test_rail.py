import itertools

import numpy as np
import pytest
from toy import N_DECISIONS, SHAPE, WHITENING, agreement, episode, expert, sights, wrong_everywhere

from rail_sumo.config import Judge as JudgeSettings
from rail_sumo.config import Search
from rail_sumo.imitation import rail
from rail_sumo.imitation.discriminator import Discriminator, Fit
from rail_sumo.imitation.random_search import RandomSearch
from rail_sumo.policy import Policy

SEARCH = Search(n_directions=8, n_top=4, step_size=0.05, noise_std=0.3)
JUDGE = JudgeSettings(hidden=(16,), minibatches=20, batch_size=128, learning_rate=0.01)


def drive(theta, seed):
    policy, seen = Policy(theta, SHAPE, WHITENING), sights(seed)
    return episode(seen, [policy(sight) for sight in seen], seed=seed)


def evaluate(theta, perturbations, iteration):
    seeds = [1000 * iteration + direction for direction in range(len(perturbations))]
    plus, minus = (
        [drive(theta + sign * delta, seed) for delta, seed in zip(perturbations, seeds, strict=True)]
        for sign in (1.0, -1.0)
    )
    return plus, minus


def judge(settings=JUDGE, seed=0):
    return Discriminator(WHITENING, settings, seed, horizon_decisions=N_DECISIONS)


def train(judge, iterations, theta=None, seed=0, first_iteration=1, evaluate=evaluate):
    theta = wrong_everywhere() if theta is None else theta
    states = rail.train(
        theta,
        expert(),
        search=SEARCH,
        judge=judge,
        evaluate=evaluate,
        seed=seed,
        first_iteration=first_iteration,
    )
    return list(itertools.islice(states, iterations))


class ByChance:
    """A judge that never learns and scores by the dice."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)

    def fit(self, expert, learner, rng):
        return Fit(0.25, 0.5, 0.5)

    def returns(self, trajectories):
        return self.rng.normal(size=len(trajectories))


class Indifferent(ByChance):
    """A judge to whom all is alike."""

    def returns(self, trajectories):
        return np.full(len(trajectories), 0.1)


def test_it_learns_to_do_what_the_expert_does():
    assert agreement(wrong_everywhere()) == 0.0
    learned = [agreement(train(judge(seed=seed), 30, seed=seed)[-1].theta) for seed in range(5)]
    guessed = [agreement(train(ByChance(seed), 30, seed=seed)[-1].theta) for seed in range(5)]
    assert np.mean(learned) > 0.9
    assert np.mean(guessed) < 0.5


def test_an_indifferent_judge_moves_nothing():
    for state in train(Indifferent(0), 3):
        assert state.step_norm == 0.0
        assert np.array_equal(state.theta, wrong_everywhere())


def test_the_judge_first_sees_through_the_learner_and_in_the_end_cannot():
    losses = [state.judge_fit.loss for state in train(judge(), 30)]
    assert min(losses[:15]) < 0.22
    assert losses[-1] == pytest.approx(0.25, abs=0.01)  # D = 1/2 everywhere


def test_resumed_is_uninterrupted_bit_for_bit():
    uninterrupted = train(judge(), 6)

    first = judge()
    *_, last = train(first, 4)
    second = judge()
    second.load_state(first.state())
    resumed = train(second, 2, theta=last.theta, first_iteration=last.iteration + 1)

    for state, expected in zip(resumed, uninterrupted[4:], strict=True):
        assert state.iteration == expected.iteration
        assert np.array_equal(state.theta, expected.theta)
        assert (state.step_norm, state.judge_fit) == (expected.step_norm, expected.judge_fit)


def test_the_seed_decides_and_every_iteration_draws_anew():
    asked = []

    def listen(theta, perturbations, iteration):
        asked.append(perturbations)
        return evaluate(theta, perturbations, iteration)

    for seed in (0, 0, 1):
        train(Indifferent(0), 2, seed=seed, evaluate=listen)
    one, two, same_one, same_two, other, _ = asked
    assert np.array_equal(one, same_one)
    assert np.array_equal(two, same_two)
    assert not np.array_equal(one, two)
    assert not np.array_equal(one, other)
    assert np.std(asked) == pytest.approx(SEARCH.noise_std, rel=0.1)  # 960 draws


def test_an_iteration_is_ask_drive_fit_judge_tell():
    """The scores are those of the judge just fitted, for all rollouts alike, and the step is the search's own."""
    events = []

    class Recorder(ByChance):
        def fit(self, expert, learner, rng):
            events.append(("fit", len(expert.actions), list(learner)))
            return super().fit(expert, learner, rng)

        def returns(self, trajectories):
            scores = super().returns(trajectories)
            events.append(("returns", scores, list(trajectories)))
            return scores

    deltas = []

    def listen(theta, perturbations, iteration):
        deltas.append(perturbations / SEARCH.noise_std)
        return evaluate(theta, perturbations, iteration)

    (state,) = train(Recorder(3), 1, evaluate=listen)
    assert [event[0] for event in events] == ["fit", "returns", "returns"]
    assert events[0][1:] == (5 * N_DECISIONS, state.plus + state.minus)
    assert (events[1][2], events[2][2]) == (state.plus, state.minus)

    search = RandomSearch(wrong_everywhere(), n_directions=8, n_top=4, step_size=0.05, noise_std=0.3)
    assert state.step_norm == pytest.approx(search.tell(deltas[0], events[1][1], events[2][1]))
    assert state.theta == pytest.approx(search.theta)
    assert [trajectory.seed for trajectory in state.plus] == [trajectory.seed for trajectory in state.minus]


def test_a_state_is_not_overtaken_by_the_next():
    states = rail.train(wrong_everywhere(), expert(), search=SEARCH, judge=ByChance(0), evaluate=evaluate, seed=0)
    first = next(states)
    kept = first.theta.copy()
    assert next(states).step_norm > 0.0
    assert np.array_equal(first.theta, kept)
