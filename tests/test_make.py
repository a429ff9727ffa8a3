"""What researchers expect of an environment: registered, several at once, infos that a library can read."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from driving import registered
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.monitor import Monitor

from rail_sumo.errors import InputError
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.highway.isolated import Isolated
from rail_sumo.records import EPISODE_COLUMNS

ID = "RailSumo/Highway-v0"
BRIEF = {"episode": {"duration_s": 10.0}}


@pytest.fixture
def make():
    with registered(BRIEF) as make_one:
        yield make_one


def drive(env, seed):
    """All that an episode of one decision after the other tells."""
    observation, info = env.reset(seed=seed)
    seen, over = [(observation, info)], False
    while not over:
        observation, reward, terminated, truncated, info = env.step(len(seen) % 5)
        seen.append((observation, reward, terminated, truncated, info))
        over = terminated or truncated
    return seen


def test_importing_the_package_registers_it_and_imports_neither_sumo_nor_torch():
    program = (
        "import sys, rail_sumo, gymnasium; assert 'RailSumo/Highway-v0' in gymnasium.registry; "
        "assert not {'libsumo', 'torch', 'pandas'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_child_process_gives_the_same_bytes_and_both_live_side_by_side(make):
    here, there = make(), make(isolated=True)
    assert isinstance(here.unwrapped, HighwayEnv)
    assert isinstance(there.unwrapped, Isolated)
    for seed in (3, 4):
        for ours, theirs in zip(drive(here, seed), drive(there, seed), strict=True):
            np.testing.assert_array_equal(ours[0], theirs[0])
            np.testing.assert_array_equal(ours[-1].pop("action_mask"), theirs[-1].pop("action_mask"))
            assert ours[1:] == theirs[1:]
    mine, others = here.unwrapped.trajectory(), there.unwrapped.trajectory()
    np.testing.assert_array_equal(mine.observations, others.observations)
    assert here.unwrapped.action_masks() == there.unwrapped.action_masks()


def test_two_children_drive_at_once_and_end_with_their_environments(make):
    one, other = make(isolated=True).unwrapped, make(isolated=True).unwrapped
    first, _ = one.reset(seed=1)
    again, _ = other.reset(seed=1)
    np.testing.assert_array_equal(first, again)
    child = one._child.process
    one.close()
    assert child.poll() == 0
    with pytest.raises(RuntimeError, match="the environment is closed"):
        one.step(0)
    other.step(0)


def test_a_child_that_dies_is_told(make):
    env = make(isolated=True).unwrapped
    env.reset(seed=1)
    env._child.process.kill()
    with pytest.raises(RuntimeError, match="the environment's process has died"):
        env.step(0)


@pytest.mark.parametrize("isolated", [False, True])
@pytest.mark.parametrize(
    ("config", "said"),
    [
        ({"trafic": {}}, "configuration: unknown key 'trafic'; did you mean 'traffic'?"),
        ({"network": {"file": "highway55"}}, "network 'highway55' not found; did you mean 'highway5'?"),
        ("nowhere.toml", "cannot read configuration 'nowhere.toml'"),
        (["episode.duration_s=60"], r"nested mappings such as .*, or a TOML file; got a list"),
    ],
)
def test_bad_input_is_one_clear_line(isolated, config, said):
    with pytest.raises(InputError, match=said):
        gymnasium.make(ID, config=config, isolated=isolated)


def test_a_second_one_in_the_process_is_told_how_to_live_beside_the_first(make):
    make().reset(seed=1)
    with pytest.raises(RuntimeError, match="make one environment with isolated=True"):
        make().reset(seed=1)


def test_an_environment_that_is_lost_frees_its_simulation(make):
    """As when a notebook's cell is run twice."""
    seen = []
    for _ in range(2):
        env = gymnasium.make(ID, config=BRIEF)
        env.reset(seed=1)
        seen.append(env.step(1)[0])
    env.close()
    np.testing.assert_array_equal(*seen)


def test_every_info_has_the_mask_and_the_last_what_the_episode_came_to(make):
    env = make()
    first, *infos, last = (entry[-1] for entry in drive(env, seed=5))
    for info in (first, *infos, last):
        mask = info["action_mask"]
        assert (mask.dtype, mask.shape) == (np.int8, (5,))
        assert mask[:3].all() or not mask[1]  # during a change speed decisions are not offered
    assert set(first) == {"action_mask"}
    assert all(set(info) == {"action_mask", "carried_out"} for info in infos)
    assert set(last) == {"action_mask", "carried_out", "is_success", *EPISODE_COLUMNS} - {"policy", "episode"}
    trajectory = env.unwrapped.trajectory()
    assert (last["duration_s"], last["end_reason"], last["is_success"]) == (10.0, "duration", True)
    assert last["distance_m"] == trajectory.distance_m
    assert last["speed_kmh"] == pytest.approx(0.36 * trajectory.distance_m)


def test_a_configuration_may_be_a_toml_file(make, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[lidar]\nn_rays = 12\n")
    assert make(config=str(path)).observation_space.shape == (24,)


def test_gymnasiums_own_checks_pass_in_a_child_process_too(make):
    check_env(make(isolated=True).unwrapped, skip_render_check=True)


def test_several_at_once_are_the_vector_environment_of_the_registry():
    envs = gymnasium.make_vec(ID, num_envs=2, config=BRIEF)
    try:
        observations, infos = envs.reset(seed=[3, 4])
        assert observations.shape == (2, 48)
        assert infos["action_mask"].shape == (2, 5)
        alone = gymnasium.make(ID, config=BRIEF)
        np.testing.assert_array_equal(observations[1], alone.reset(seed=4)[0])
        alone.close()
        envs.step(np.array([1, 2]))
    finally:
        envs.close()


def test_stable_baselines_evaluates_beside_its_training_as_its_pages_teach(make, tmp_path):
    train, evaluation = Monitor(make()), Monitor(make(isolated=True))
    callback = EvalCallback(evaluation, n_eval_episodes=2, eval_freq=32, log_path=str(tmp_path), verbose=0)
    PPO("MlpPolicy", train, n_steps=32, batch_size=32, n_epochs=1, device="cpu").learn(64, callback=callback)
    told = np.load(tmp_path / "evaluations.npz")
    assert told["results"].shape == (2, 2)
    assert told["successes"].all()
