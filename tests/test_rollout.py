import dataclasses
import itertools
import math
import multiprocessing
import multiprocessing.pool
import os
import pickle
import re
import sys
import threading
import time
import types
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from rail_sumo import config, drivers, rollout
from rail_sumo.config import Config
from rail_sumo.errors import InputError
from rail_sumo.highway.env import HighwayEnv
from rail_sumo.policy import PolicyParameters, Shape, Whitening
from rail_sumo.rollout import Task, drive, traffic_seed, workers

MINUTE = Config(episode=config.Episode(course_m=math.inf, duration_s=60.0))


def learned(seed):
    """A policy of random weights that decides differently from seed to seed."""
    shape = Shape(48, 8)
    theta = np.random.default_rng(seed).normal(size=shape.size)
    return PolicyParameters(theta, shape, Whitening(np.full(48, 10.0), np.full(48, 20.0)))


TASKS = [
    Task(driver, MINUTE, seed)
    for driver, seed in itertools.product(("random", "rule", "sumo", learned(1), learned(2)), (11, 12))
]


def same(one, other):
    return all(
        np.array_equal(getattr(one, field.name), getattr(other, field.name)) for field in dataclasses.fields(one)
    )


@pytest.fixture(scope="module")
def pool():
    with workers(2) as two:
        yield two


def in_a_worker(task):
    """Drive, and tell what the process that drove has loaded."""
    drive(task)
    return os.getpid(), "libsumo" in sys.modules, "torch" in sys.modules


def test_all_workers_are_started_before_anything_is_driven():
    before = set(multiprocessing.active_children())
    with workers(3):
        assert len(set(multiprocessing.active_children()) - before) == 3


def test_a_thread_may_have_workers():
    with ThreadPoolExecutor(1) as threads:
        assert threads.submit(count_with_two).result() == [1, 2, 3]


def count_with_two():
    with workers(2) as pool:
        return list(pool.map(abs, [-1, -2, -3]))


def late(path):
    time.sleep(3.0)
    path.touch()


def begin_and_raise(task, path, error):
    with workers(2) as two:
        two.map(task, [path])
        raise error


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError, InputError])
def test_what_goes_wrong_ends_our_own_processes_at_once_and_no_others(tmp_path, error):
    before = set(multiprocessing.active_children())  # `pool`, where a test that uses it ran earlier
    stranger = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60,))
    stranger.start()
    try:
        with pytest.raises(error):
            begin_and_raise(late, tmp_path / "done", error)
        assert stranger.is_alive()
        assert not (tmp_path / "done").exists()
        assert set(multiprocessing.active_children()) == before | {stranger}
    finally:
        stranger.terminate()
        stranger.join()


def test_workers_that_are_ended_leave_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    detector = '<e1Detector id="d" lane="highway_0" pos="500" period="5" file="e1.xml"/>'
    (tmp_path / "d.add.xml").write_text(f"<additional>{detector}</additional>")
    traffic = {"routes": ("highway3",), "additional": (str(tmp_path / "d.add.xml"),)}
    world = config.Config().changed(network={"file": "highway3"}, traffic=traffic)

    def drive_until_interrupted():
        with workers(2) as two:
            two.map(drive, [Task("keep", world, seed) for seed in range(8)])
            since = time.monotonic()
            while len(list(tmp_path.glob("rail_sumo_*"))) < 2:
                assert time.monotonic() < since + 60.0
                time.sleep(0.01)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        drive_until_interrupted()
    assert [path.name for path in tmp_path.iterdir()] == ["d.add.xml"]


def die(_):
    os.abort()


def test_a_worker_that_dies_ends_the_work_in_one_line():
    with pytest.raises(InputError, match=r"^a worker process died: memory ran out, or SUMO crashed"), workers(2) as two:
        list(two.map(die, range(4)))


def test_two_workers_drive_bit_for_bit_what_one_drives(pool):
    with workers(1) as one:
        alone = list(one.map(drive, TASKS))
    together = list(pool.map(drive, TASKS))
    assert all(same(*pair) for pair in zip(alone, together, strict=True))
    # Not because all episodes are alike.
    assert not any(same(*pair) for pair in itertools.combinations(alone, 2))


def test_the_order_of_the_tasks_does_not_matter(pool):
    backwards = list(pool.map(drive, TASKS[::-1]))
    assert all(same(drive(task), driven) for task, driven in zip(TASKS, backwards[::-1], strict=True))


def test_workers_are_processes_of_their_own_that_never_load_torch(pool):
    found = list(pool.map(in_a_worker, TASKS[:4]))
    assert os.getpid() not in {pid for pid, *_ in found}
    assert [loaded for _, *loaded in found] == [[True, False]] * 4


def test_a_users_mistake_in_a_worker_comes_back_as_it_is(pool):
    with pytest.raises(
        InputError, match=r"^driver 'nobody' not found \(available: expert, keep, random, rule, sumo\)$"
    ):
        list(pool.map(drive, [Task("nobody", MINUTE, 1)]))
    assert same(next(pool.map(drive, TASKS[:1])), drive(TASKS[0]))  # and the pool goes on


def test_a_failed_episode_leaves_the_process_free_for_the_next():
    with pytest.raises(InputError):
        drive(Task("nobody", MINUTE, 1))
    wrong = PolicyParameters(np.zeros(10), Shape(1, None), Whitening(np.zeros(1), np.ones(1)))
    with pytest.raises(ValueError, match="matmul"):
        drive(Task(wrong, MINUTE, 1))
    assert drive(TASKS[0]).end_reason == "duration"


def test_a_rollout_is_the_episode_driven_by_hand():
    driver = learned(1)
    env = HighwayEnv(MINUTE)
    observation, _ = env.reset(seed=11)
    policy, over = driver.policy(), False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy(observation))
        over = terminated or truncated
    by_hand = env.trajectory()
    env.close()
    assert same(drive(Task(driver, MINUTE, 11)), by_hand)
    # Each observation was answered by the policy.
    assert [policy(seen) for seen in by_hand.observations] == by_hand.decisions.tolist()


def test_a_task_travels_whole():
    task = pickle.loads(pickle.dumps(Task(learned(3), MINUTE, 9)))
    assert same(drive(task), drive(Task(learned(3), MINUTE, 9)))


def test_a_driver_that_no_worker_could_be_sent_is_told_before_anybody_drives():
    class Local(drivers.Rule):
        pass

    tasks = [Task(Local(MINUTE.adas), MINUTE, seed) for seed in range(2)]
    with pytest.raises(InputError, match=r"^driver Local cannot be sent to worker processes \(.*\): define it at the"):
        next(rollout.attempt_all("eval", tasks, 2))
    assert next(rollout.attempt_all("eval", tasks, 1)).end_reason == "duration"


class Tires(drivers.Rule):
    """Drives by the rule for ten decisions, and keeps its lane and speed from then on."""

    def __init__(self):
        super().__init__(MINUTE.adas)
        self.decided = 0

    def decide(self, observation, agent):
        self.decided += 1
        return super().decide(observation, agent) if self.decided <= 10 else 0


class Draws:
    """Draws its decisions from a stream of its own."""

    senses = None

    def __init__(self, seed=0):
        self._rng = np.random.default_rng(seed)

    def decide(self, observation, agent):
        return int(self._rng.integers(5))


class Begins(Draws):
    def begin(self, seed):
        return Draws(seed)


class Uncopyable(Tires):
    def __init__(self):
        super().__init__()
        self.lock = threading.Lock()


def decided(who, number):
    """What a driver decides in each of three episodes."""
    tasks = [Task(who, MINUTE, seed) for seed in (11, 12, 13)]
    return [driven.decisions.tolist() for driven in rollout.drive_all("drive", tasks, number)]


@pytest.mark.parametrize("who", [Tires(), Draws(), Begins()])
def test_what_a_driver_remembers_is_the_same_whatever_the_number_of_workers_and_in_a_film(who):
    with_one = decided(who, 1)
    assert decided(who, 2) == with_one
    film = rollout.film(Task(who, MINUTE, 12))
    assert film[1].decisions.tolist() == with_one[1]


def test_each_episode_begins_with_the_driver_as_it_was_given_or_with_what_it_begins():
    tires = Tires()
    assert all(any(episode[:10]) and not any(episode[10:]) for episode in decided(tires, 1))
    assert tires.decided == 0
    drawn = decided(Draws(), 1)
    assert drawn[0] == drawn[1] == drawn[2]
    one, other, third = decided(Begins(), 1)
    assert one != other != third != one
    assert decided(Begins(), 1) == [one, other, third]


def test_a_driver_that_cannot_be_copied_drives_itself():
    who = Uncopyable()
    assert any(any(episode[:10]) for episode in decided(who, 1))
    assert who.decided == 3 * 60


def test_of_many_vehicles_each_has_a_driver_of_its_own():
    decides = [rollout.deciders(who, MINUTE, 3)("a") for who in (Tires(), Begins())]
    again = [rollout.deciders(who, MINUTE, 3)("b") for who in (Tires(), Begins())]
    assert decides[0].__self__ is not again[0].__self__
    drawn = [[decide(None, None) for _ in range(20)] for decide in (decides[1], again[1])]
    assert drawn[0] != drawn[1]


def test_a_loaded_driver_that_samples_draws_anew_in_each_episode():
    sampling = drivers.Learned(dataclasses.replace(learned(1), samples=True), 0)
    one, other, _ = episodes = decided(sampling, 1)
    assert one != other
    assert decided(sampling, 2) == episodes


def test_a_serial_map_is_lazy_and_keeps_the_order():
    done = []
    with workers(1) as one:
        results = one.map(lambda number: done.append(number) or -number, range(5))
        assert next(results) == 0
        assert done == [0]
        assert list(results) == [-1, -2, -3, -4]


def test_ray_is_an_extra_and_its_absence_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    message = "--workers ray needs Ray; install it with: pip install 'rail-sumo[ray]'"
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"), workers("ray"):
        pass


def test_sumos_own_driver_has_its_hands_off():
    env = HighwayEnv(MINUTE, hands_off=True)
    env.reset(seed=11)
    while not env.is_over:
        env.drive(0)
    expected = env.trajectory()
    env.close()
    assert same(drive(Task("sumo", MINUTE, 11)), expected)
    assert not same(drive(Task("keep", MINUTE, 11)), expected)


def test_with_ray_the_map_is_ordered_too(monkeypatch):
    # Ray's own pool imitates the standard library's, which stands in for it here.
    pool = types.SimpleNamespace(Pool=lambda: multiprocessing.pool.ThreadPool(2))
    for name, module in {"ray": pool, "ray.util": pool, "ray.util.multiprocessing": pool}.items():
        monkeypatch.setitem(sys.modules, name, module)
    with workers("ray") as cluster:
        assert list(cluster.map(abs, range(-20, 0))) == list(range(20, 0, -1))


PURPOSES = (rollout.EVALUATION, rollout.TRAINING, rollout.DEMONSTRATION, rollout.EXPERT_TRAINING)


def test_traffic_seeds_of_different_purposes_runs_iterations_and_directions_all_differ():
    keys = [
        (run, purpose, *rest)
        for run, purpose in itertools.product(range(4), PURPOSES)
        for rest in [(), *((i,) for i in range(100)), *itertools.product(range(20), range(16))]
    ]
    seeds = [traffic_seed(*key) for key in keys]
    # Of 6,736 draws among 2**31, 0.01 pairs are expected to meet by chance.
    assert len(set(seeds)) == len(seeds)
    assert all(0 <= seed < 2**31 for seed in seeds)


def test_a_traffic_seed_depends_on_its_key_alone():
    before = traffic_seed(3, rollout.TRAINING, 5, 7)
    np.random.default_rng(3).random(10)
    traffic_seed(3, rollout.EVALUATION, 0)
    assert traffic_seed(3, rollout.TRAINING, 5, 7) == before
    # Golden: numpy promises that SeedSequence does not change. np.random.SeedSequence(3, spawn_key=(1, 5, 7)), 31 bits.
    assert before == 467158429


def test_advised_it_drives_as_it_would_and_the_advice_is_the_advisers_on_what_was_seen():
    expert = drivers.load_expert(MINUTE)
    driven, advice = rollout.practise_advised(dataclasses.replace(Task(learned(3), MINUTE, 9), adviser=expert))
    alone = drive(Task(learned(3), MINUTE, 9))
    assert same(dataclasses.replace(driven, allowed=alone.allowed), alone)
    assert alone.allowed.all()
    assert not driven.allowed.all()  # which the adviser has asked for
    assert len(advice) == len(driven.decisions)
    assert not np.array_equal(advice, driven.decisions)
    by_expert = drive(Task(expert, MINUTE, 9))
    own, advised = by_expert.decisions, rollout.practise_advised(Task(expert, MINUTE, 9, adviser=expert))[1]
    np.testing.assert_array_equal(advised, own)


def wait_in_a_worker(started):
    with workers(2) as pool:
        started.set()
        list(pool.map(time.sleep, [60.0, 60.0]))


def test_workers_end_with_a_parent_that_was_killed():
    context = multiprocessing.get_context("spawn")
    started = context.Event()
    parent = context.Process(target=wait_in_a_worker, args=(started,))
    parent.start()
    assert started.wait(60.0)

    def children():
        tasks = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()
        return [pid for pid in map(int, tasks) if "spawn_main" in Path(f"/proc/{pid}/cmdline").read_text()]

    deadline = time.monotonic() + 60.0
    while len(pids := children()) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)
    assert len(pids) == 2
    time.sleep(1.0)  # for them to begin
    parent.kill()
    parent.join()
    while any(map(alive, pids)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(map(alive, pids))


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
