import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

import rail_sumo
from rail_sumo import config, config_file, drivers, roster
from rail_sumo.config import Config
from rail_sumo.errors import InputError, ObservationError
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.policy import PolicyParameters, Shape, Whitening
from rail_sumo.records import KMH, Gaps, HostState, MetaAction
from rail_sumo.rollout import Task, drive

KEEP, ACCELERATE, DECELERATE, LEFT, RIGHT = MetaAction
NOTHING = np.empty(0)
TOP_MPS = 80 / KMH
FREE = Gaps(math.inf, 0.0, math.inf, 0.0)
ALL = [True] * 5


def leader(gap_m, speed_mps):
    return Gaps(gap_m, speed_mps, math.inf, 0.0)


def env(*, here=FREE, left=FREE, right=FREE, speed_mps=15.0, mask=ALL, changing=False):
    """What the rule driver asks of an environment."""
    host = HostState(speed_mps, 2, 0, 4, 1000.0, 3.2, 3.2, 3.2, (math.inf,) * 5, limit_mps=TOP_MPS)
    return SimpleNamespace(
        surroundings=lambda: (host, here, left, right), action_masks=lambda: mask, is_changing_lane=changing
    )


def rule(**situation):
    return drivers.Rule(config.Adas()).decide(NOTHING, env(**situation))


def test_the_rule_driver_speeds_up_when_free_until_half_a_metre_a_second_below_the_top():
    assert rule(speed_mps=TOP_MPS - 0.6) == ACCELERATE
    assert rule(speed_mps=TOP_MPS - 0.4) == KEEP


def test_the_rule_driver_does_not_speed_up_towards_a_slow_leader_it_cannot_pass():
    # 43.25 m ahead are 31.25 m beyond the time gap at 10 m/s: sqrt(10^2 + 2 * 2 * 31.25) = 15 m/s.
    blocked = [True, True, True, False, False]
    assert rule(here=leader(43.25, 10.0), speed_mps=14.4, mask=blocked) == ACCELERATE
    assert rule(here=leader(43.25, 10.0), speed_mps=14.6, mask=blocked) == KEEP


@pytest.mark.parametrize(("side", "action"), [("left", LEFT), ("right", RIGHT)])
def test_the_rule_driver_changes_for_a_gain_of_more_than_1_mps(side, action):
    other = "right" if side == "left" else "left"
    here = leader(43.25, 10.0)  # worth 15 m/s
    assert rule(here=here, speed_mps=15.0, **{side: leader(51.1, 10.0), other: here}) == action  # 16.01
    assert rule(here=here, speed_mps=15.0, **{side: leader(50.9, 10.0), other: here}) == KEEP  # 15.99


def test_the_rule_driver_takes_the_better_of_two_sides():
    here, better, worse = leader(12.0, 10.0), leader(60.0, 11.0), leader(30.0, 14.0)  # 10, 17 and 16 m/s
    assert rule(here=here, left=better, right=worse) == LEFT
    assert rule(here=here, left=worse, right=better) == RIGHT


def test_beyond_its_top_speed_a_lane_is_worth_no_more():
    # Both lanes let the host drive at its top speed: a change gains nothing.
    assert rule(here=leader(80.0, 20.0), left=FREE, speed_mps=TOP_MPS) == KEEP


def test_the_rule_driver_never_decides_what_the_mask_forbids():
    here = leader(12.0, 10.0)
    assert rule(here=here, right=leader(12.0, 10.5), mask=[True, True, True, False, True], speed_mps=12.0) == KEEP
    assert rule(here=here, mask=[True, True, True, False, True]) == RIGHT


def test_the_rule_driver_starts_no_change_during_one():
    assert rule(here=leader(12.0, 10.0), speed_mps=12.0, changing=True) == KEEP


def test_the_expert_takes_the_best_allowed_action():
    # Two tanh units of two features, then five outputs; by hand.
    first = (np.array([[1.0, 0.0], [0.0, -1.0]]), np.array([0.0, 0.5]))
    second = (np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 0.0], [0.0, 0.0]]), np.array([0, 0, 0, 0, 0.1]))
    expert = drivers.Expert([first, second])
    observation = np.array([1.0, 1.0])  # tanh(1) = 0.762, tanh(-0.5) = -0.462: 0.76, -0.46, 0.30, 1.52, 0.1
    assert expert.decide(observation, env()) == LEFT
    assert expert.decide(observation, env(mask=[True, True, True, False, True])) == KEEP
    assert expert.decide(observation, env(mask=[False, True, True, False, True])) == DECELERATE
    assert expert.decide(observation, env(mask=[False, True, False, False, False])) == ACCELERATE


def learned(**how):
    rng = np.random.default_rng(0)
    return PolicyParameters(rng.normal(size=5 * 9), Shape(8, None), Whitening(np.zeros(8), np.ones(8)), **how)


def test_a_learned_driver_decides_as_its_policy_and_sees_no_environment():
    observations = np.random.default_rng(1).normal(size=(100, 8))
    driver, policy = drivers.Learned(learned(), seed=0), learned().policy()
    decided = [driver.decide(observation, None) for observation in observations]
    assert decided == [policy(observation) for observation in observations]
    assert len(set(decided)) == 5


@pytest.mark.parametrize("samples", [False, True])
def test_a_masked_driver_chooses_among_what_is_allowed(samples):
    driver, policy = drivers.Learned(learned(samples=samples, masked=True), seed=0), learned().policy()
    closed = env(mask=[True, True, False, False, True])
    observations = np.random.default_rng(1).normal(size=(200, 8))
    decided = np.array([driver.decide(observation, closed) for observation in observations])
    assert set(decided) == {KEEP, ACCELERATE, RIGHT}
    best = np.array([policy.outputs(observation)[[KEEP, ACCELERATE, RIGHT]].argmax() for observation in observations])
    agreed = (np.array([KEEP, ACCELERATE, RIGHT])[best] == decided).mean()
    assert agreed < 1.0 if samples else agreed == 1.0


def decisions(seed, number=5000):
    driver = drivers.by_name("random", Config(), seed)
    return np.array([driver.decide(NOTHING, None) for _ in range(number)])


def test_the_random_driver_decides_everything_equally_often_and_remembers_nothing():
    counts = np.bincount(decisions(1), minlength=5)
    assert counts == pytest.approx(np.full(5, 1000), abs=4 * math.sqrt(5000 * 0.2 * 0.8))
    pairs = np.bincount(5 * decisions(1)[:-1] + decisions(1)[1:], minlength=25)
    assert pairs == pytest.approx(np.full(25, 200), abs=4.5 * math.sqrt(200))


def test_the_random_driver_is_decided_by_its_seed():
    assert np.array_equal(decisions(1, 100), decisions(1, 100))
    assert not np.array_equal(decisions(1, 100), decisions(2, 100))


def test_the_random_driver_does_not_draw_from_the_traffics_stream():
    # The environment draws its traffic from default_rng(seed); the same numbers would tie decisions to it.
    traffic = np.random.default_rng(1).integers(5, size=100)
    assert not np.array_equal(decisions(1, 100), traffic)


def test_keeping_is_all_that_keep_does_and_all_that_sumos_own_driver_is_told():
    for name in ("keep", "sumo"):
        assert drivers.by_name(name, Config(), 0).decide(NOTHING, env()) == KEEP


@pytest.mark.parametrize(
    ("name", "known", "hands_off"),
    [
        ("sumo", True, True),
        ("sumo:car", True, "car"),
        ("sumo:", False, False),
        ("rule", True, False),
        ("runs/first", False, False),
        (learned(), None, False),
    ],
)
def test_a_name_tells_whether_sumo_drives_and_as_what(name, known, hands_off):
    assert drivers.hands_off(name) == hands_off
    if isinstance(name, str):
        assert drivers.is_name(name) == known


def test_an_unknown_driver_gets_a_suggestion():
    message = "driver 'expret' not found; did you mean 'expert'? (available: expert, keep, random, rule, sumo)"
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        drivers.by_name("expret", Config(), 0)


def test_on_the_same_traffic_the_rule_driver_is_always_faster_than_keeping_and_random_is_not():
    episode = config.Episode(course_m=math.inf, duration_s=120.0)
    slow = config.Traffic(speed_low_kmh=40.0)
    speeds = {
        name: np.array(
            [drive(Task(name, Config(episode=episode, traffic=slow), seed)).speed_mps.mean() for seed in range(8)]
        )
        for name in ("rule", "keep", "random")
    }
    assert (speeds["rule"] > speeds["keep"]).all()  # by chance once in 256
    assert not (speeds["random"] > speeds["keep"]).all()


def test_a_driver_that_must_see_as_the_world_says_is_told_which_keys_to_set():
    message = (
        "the expert was trained with lidar.n_rays = 24, not 12; set lidar.n_rays=24 observation.host_speed=false "
        "observation.lateral_state=false, or train another"
    )
    odd = Config(lidar=config.Lidar(n_rays=12), observation=config.Observation(host_speed=True, lateral_state=True))
    with pytest.raises(ObservationError, match=f"^{re.escape(message)}$"):
        drivers.require_same_senses(drivers.load_expert(odd), odd, "the expert")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("lidar.max_range_m=60.0", "lidar.max_range_m = 100.0, not 60.0"),
        ("lidar.road_edges=false", "lidar.road_edges = True, not False"),
        ("observation.frames=2", "observation.frames = 1, not 2"),
        ("observation.speed_limit=true", "observation.speed_limit = False, not True"),
    ],
)
def test_senses_differ_by_what_their_numbers_mean_not_by_how_many_there_are(override, message):
    world = config_file.load(None, [override])
    with pytest.raises(ObservationError, match=re.escape(message)):
        drivers.require_same_senses(drivers.load_expert(world), world, "the expert")
    drivers.require_same_senses(drivers.Keep(), world, "keep")  # which takes whatever it is shown


def test_the_expert_may_decide_more_often_than_it_was_trained_to():
    often = config_file.load(None, ["episode.decision_period_s=0.5"])
    assert isinstance(drivers.by_name("expert", often, 0), drivers.Expert)


def test_a_drawing_driver_decides_with_softmax_probabilities_and_by_its_seed():
    outputs = np.array([1.0, 0.0, -1.0, 0.5, 2.0])
    theta, unwhitened = np.column_stack([np.zeros(5), outputs]).ravel(), Whitening(np.zeros(1), np.ones(1))
    constant = PolicyParameters(theta, Shape(1, None), unwhitened, samples=True)
    driver, same, other = (drivers.Learned(constant, seed) for seed in (1, 1, 2))
    drawn = [driver.decide(np.zeros(1), None) for _ in range(20_000)]
    expected = np.exp(outputs) / np.exp(outputs).sum()
    np.testing.assert_allclose(np.bincount(drawn, minlength=5) / len(drawn), expected, atol=0.015)  # 4 sigma
    assert [same.decide(np.zeros(1), None) for _ in range(100)] == drawn[:100]
    assert [other.decide(np.zeros(1), None) for _ in range(100)] != drawn[:100]


def test_advice_is_noted_for_each_observation_as_it_comes_and_not_taken():
    decides = SimpleNamespace(senses=None, decide=lambda observation, env: MetaAction.KEEP)
    advises = SimpleNamespace(decide=lambda observation, env: observation + env)
    driver = drivers.Advised(decides, advises)
    assert [driver.decide(observation, 10) for observation in (1, 2, 3)] == [MetaAction.KEEP] * 3
    assert driver.advice == [11, 12, 13]


@pytest.mark.parametrize("name", ["rail", "expert", "road-rail", "road-expert"])
def test_a_loaded_driver_acts_as_it_drives_one_observation_or_many(name):
    driver = rail_sumo.load_driver(name)
    config = Config().seen_with(driver.senses)
    road = HighwayEnv(config)
    observation, info = road.reset(seed=5)
    seen, masks, taken = [], [], []
    for _ in range(40):
        seen.append(observation)
        masks.append(info["action_mask"])
        taken.append(driver.decide(observation, road.agent))
        observation, _, _, _, info = road.step(taken[-1])
    road.close()
    assert len(set(taken)) > 1
    assert [driver.act(one, mask) for one, mask in zip(seen, masks, strict=True)] == taken
    many = driver.act(np.array(seen), np.array(masks))
    assert many.tolist() == taken
    assert many.dtype == np.int64
    n = driver.n_features
    with pytest.raises(ValueError, match=re.escape(f"must have shape ({n},) or (n, {n}); got ({n - 1},)")):
        driver.act(observation[:-1], masks[0])
    with pytest.raises(ValueError, match="observation holds values that are not finite"):
        driver.act(np.full(n, np.nan), masks[0])
    with pytest.raises(ValueError, match=re.escape("mask must have shape (40, 5); got (5,)")):
        driver.act(np.array(seen), masks[0])
    with pytest.raises(ValueError, match=re.escape("give act() the mask too, as info['action_mask'] tells it")):
        driver.act(observation)
    for stray in (-math.inf, math.nan, 0.5, -1):
        with pytest.raises(ValueError, match="a mask holds 0 and 1, or False and True, and nothing else"):
            driver.act(observation, [1, 1, 1, 0, stray])
    with pytest.raises(ValueError, match="a mask has nothing open"):
        driver.act(observation, np.zeros(5))


def test_a_driver_that_samples_draws_by_its_seed():
    observations = np.random.default_rng(1).normal(10.0, 30.0, (200, 48))
    one, same, other = (rail_sumo.load_driver("rail:sampled", seed=seed) for seed in (1, 1, 2))
    masks = np.ones((200, 5))
    drawn = one.act(observations, masks)
    assert drawn.tolist() == same.act(observations, masks).tolist()
    assert drawn.tolist() != other.act(observations, masks).tolist()


def test_who_has_not_learned_is_not_loaded():
    for name in ("rule", "sumo", "keep", "random"):
        with pytest.raises(InputError, match=f"'{name}' is not learned; take expert, rail"):
            rail_sumo.load_driver(name)


def test_a_driver_acts_as_its_name_says():
    world = config.Config()
    trained, by_argmax, sampled = (roster.find_driver(f"rail{mode}", world) for mode in ("", ":argmax", ":sampled"))
    assert (trained.samples, by_argmax.samples, sampled.samples) == (False, False, True)
    assert roster.find_driver("sumo:sampled", world) == "sumo:sampled"  # as a vehicle type of that name


@pytest.mark.parametrize("name", ["expert", "road-expert", "rule"])
def test_who_acts_in_one_way_is_told_no_other(name):
    with pytest.raises(InputError, match=f"^'{name}' acts in one way; leave out ':sampled'$"):
        roster.find_driver(f"{name}:sampled", config.Config())


def test_a_way_to_act_that_there_is_not():
    with pytest.raises(InputError, match=r"^policy 'rail:sample' is neither .*; did you mean 'rail:sampled'"):
        roster.find_driver("rail:sample", config.Config())
