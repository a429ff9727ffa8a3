import itertools
import json
import shutil

import numpy as np
import pytest

from rail_sumo import assets, config, config_file, drivers, expert, rollout, roster, run, training
from rail_sumo.assets import sha256
from rail_sumo.errors import InputError
from rail_sumo.imitation import ppo
from rail_sumo.imitation.demonstrations import Demonstrations, recorded_by
from rail_sumo.records import MetaAction

N_FEATURES = 48
SHORT = config_file.load(None, ["episode.duration_s=20", "train.evaluation_episodes=2", "train.trajectories=3"])


def always(action):
    """A network whose output is largest for one action, whatever it sees."""
    return [(np.zeros((5, N_FEATURES)), np.eye(5)[action])]


@pytest.fixture
def trained(tmp_path, monkeypatch):
    """The folder of an expert that always accelerates, as if PPO had come to that."""
    monkeypatch.setattr(
        ppo, "train", lambda config, seed, traffic_seeds, observer, first: always(MetaAction.ACCELERATE)
    )
    expert.train(SHORT, tmp_path / "mine", seed=5)
    return tmp_path / "mine"


def test_the_manifest_names_every_file_and_how_it_was_made(trained):
    manifest = json.loads((trained / "manifest.json").read_text())
    files = {path.name: sha256(path) for path in trained.iterdir() if path.name != "manifest.json"}
    assert manifest["files"] == files
    assert {"policy.safetensors", "config.toml", "demonstrations.parquet", "episodes.csv"} <= set(files)
    assert len({(trained / name).stat().st_mode for name in files}) == 1  # whoever may read one may read all
    assert manifest["seed"] == 5
    assert manifest["libsumo"].startswith("1.")
    # From 60 km/h it takes 2.8 s at 2 m/s² to 80 km/h; traffic ahead may hold it up, but never below the start.
    assert 60.0 < manifest["evaluation"]["speed_kmh"] <= 80.0
    assert config_file.load(trained / "config.toml") == SHORT


def test_the_shipped_recipe_is_the_world_that_everybody_else_drives_in_by_default():
    assert roster.world([str(assets.data_root() / "expert")]) == config.Config()


def test_the_demonstrations_are_its_own_on_other_traffic_than_the_evaluation(trained):
    world = SHORT
    features = run.feature_names(world.lidar, world.observation)
    demonstrations = Demonstrations.load(trained / "demonstrations.parquet", features=features)
    assert demonstrations.n_episodes == 3
    assert set(demonstrations.actions) == {MetaAction.ACCELERATE}
    again = run.record(drivers.load_expert(world, trained), world, episodes=3, seed=5)
    np.testing.assert_array_equal(demonstrations.observations, again.observations)


def test_the_demonstrations_tell_whose_they_are_wherever_they_lie(trained, tmp_path):
    of_it = shutil.copy(trained / "demonstrations.parquet", tmp_path / "moved.parquet")
    assert recorded_by(of_it) == ("expert", sha256(trained / "policy.safetensors"))
    own = SHORT.changed(train={"expert": str(trained), "demonstrations": str(of_it)})
    assert not list(training.other_expert(own))
    assert len(list(training.other_expert(own.changed(train={"expert": "shipped"})))) == 1


def test_training_recording_and_evaluation_meet_traffic_of_their_own(tmp_path, monkeypatch):
    met = []

    def train(config, seed, traffic_seeds, observer, first):
        met.append(list(itertools.islice(traffic_seeds, 50)))
        return always(MetaAction.KEEP)

    def noted(drives_all):
        def drive(work, tasks, *rest):
            met.append([task.seed for task in tasks])
            return drives_all(work, tasks, *rest)

        return drive

    monkeypatch.setattr(ppo, "train", train)
    for drives in ("practise_all", "attempt_all"):
        monkeypatch.setattr(run, drives, noted(getattr(run, drives)))
    expert.train(SHORT, tmp_path / "mine", seed=5)
    assert [len(seeds) for seeds in met] == [50, 2, 3]
    assert len(set(itertools.chain(*met))) == 55


def test_its_folder_drives_under_its_path_and_differs_from_the_shipped_expert(trained):
    world = roster.world([str(trained)])
    assert world == SHORT
    mine = roster.find_driver(str(trained), world)
    episodes, *_ = run.evaluate({"mine": mine, "keep": "keep"}, world, episodes=1, seed=1)
    speeds = episodes.set_index("policy")["speed_kmh"]
    assert speeds["mine"] > speeds["keep"]


def test_the_expert_that_is_named_is_imitated_asked_and_compared_with(tmp_path, monkeypatch):
    """One with other senses than the shipped one's, who does nothing but accelerate."""
    blind = [(np.zeros((5, N_FEATURES // 2)), np.eye(5)[MetaAction.ACCELERATE])]
    monkeypatch.setattr(ppo, "train", lambda config, seed, traffic_seeds, observer, first: blind)
    brief = ["lidar.n_rays=12", "episode.duration_s=20", "train.evaluation_episodes=2", "train.trajectories=10"]
    expert.train(config_file.load(None, brief), tmp_path / "mine", seed=5)
    asked = [
        "train.learner=dagger",
        "policy.mode=argmax",
        "policy.masked=false",
        "train.iterations=1",
        "train.horizon_s=10.0",
        "dagger.rollouts=1",
    ]
    world = config_file.load(None, [*brief, *asked, f"train.expert={tmp_path / 'mine'}"])
    episodes, *_ = run.train(world, tmp_path / "run", seed=1)
    speeds = episodes.pivot(index="episode", columns="policy", values="speed_kmh")
    assert set(speeds) == {"dagger", "clone, argmax", "clone, sampled", "expert"}
    # All of them accelerate from 60 km/h, and are held up by the same traffic; keeping is slower.
    assert (speeds["dagger"] == speeds["expert"]).all()
    assert (speeds["clone, argmax"] == speeds["expert"]).all()
    kept, *_ = run.evaluate({"keep": "keep"}, world, episodes=2, seed=1)
    assert (speeds["expert"].to_numpy() > kept["speed_kmh"].to_numpy()).all()
    with pytest.raises(InputError, match="no expert here"):
        run.train(config_file.load(None, [*brief, f"train.expert={tmp_path}"]), tmp_path / "other", seed=1)
    with pytest.raises(
        InputError, match=r"run' is a run, .* and not an expert's; name shipped, road-expert or a folder"
    ):
        run.train(config_file.load(None, [*brief, f"train.expert={tmp_path / 'run'}"]), tmp_path / "other", seed=1)


def test_a_changed_file_is_refused(trained):
    with (trained / "policy.safetensors").open("ab") as file:
        file.write(b"x")
    with pytest.raises(InputError, match=r"policy.safetensors' is damaged or was changed"):
        roster.find_driver(str(trained), SHORT)


def test_one_whose_weights_are_not_finite_is_no_driver(tmp_path, monkeypatch):
    wild = [(np.full((5, N_FEATURES), np.nan), np.zeros(5))]
    monkeypatch.setattr(ppo, "train", lambda config, seed, traffic_seeds, observer, first: wild)
    expert.train(SHORT, tmp_path / "wild", seed=5)
    with pytest.raises(InputError, match=r"^the expert in '.*wild' cannot drive: weights .* not finite; train an"):
        roster.find_driver(str(tmp_path / "wild"), SHORT)


def test_a_training_whose_weights_do_not_stay_finite_is_one_line():
    brief = ["decisions=256", "decisions_per_update=128", "batch_size=64", "begins_as_rule=0", "learning_rate=1e30"]
    wild = config_file.load(None, ["episode.duration_s=20", *(f"expert.{one}" for one in brief)])
    with pytest.raises(InputError, match=r"^training diverged: .* set a smaller expert\.learning_rate$"):
        ppo.train(wild, 0, itertools.count())


def test_an_existing_folder_is_refused_before_any_training(trained, monkeypatch):
    monkeypatch.setattr(ppo, "train", lambda *_: pytest.fail("trained in vain"))
    with pytest.raises(InputError, match="exists"):
        expert.train(SHORT, trained, seed=5)


def test_a_failure_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(ppo, "train", lambda config, seed, traffic_seeds, observer, first: always(MetaAction.KEEP))

    def full_disk(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(expert, "save", full_disk)
    with pytest.raises(InputError, match="No space left on device"):
        expert.train(SHORT, tmp_path / "mine", seed=5)
    assert list(tmp_path.iterdir()) == []


def test_the_recipe_is_what_ppo_is_trained_by(monkeypatch):
    class Stop(Exception):
        pass

    def look(policy, env, **given):
        seen.update(given, world=env.config, first=env.reset()[0], traffic=env._seed)
        raise Stop

    seen = {}
    monkeypatch.setattr(ppo, "MaskablePPO", look)
    recipe = ["expert.entropy=0.25", "expert.discount=0.5", "expert.horizon_s=30.0", "observation.frames=2"]
    world = config_file.load(None, [*recipe, "expert.hidden=[7]", "expert.epochs=3", "expert.batch_size=32"])
    with pytest.raises(Stop):
        ppo.train(world, 4, itertools.count(900))
    assert (seen["ent_coef"], seen["gamma"], seen["n_epochs"], seen["batch_size"]) == (0.25, 0.5, 3, 32)
    assert (seen["seed"], seen["n_steps"], seen["policy_kwargs"]["net_arch"]) == (4, 2048, [7])
    assert seen["world"] == world.practice(30.0)
    assert seen["traffic"] == 900
    two_frames = np.tile([*[100.0] * 24, *[10.0] * 24], 2)
    np.testing.assert_array_equal(ppo.scale_of(world), two_frames)
    assert np.abs(seen["first"]).max() <= 10.0  # distances of up to 1, relative speeds in tens of m/s
    assert 0.5 < seen["first"].max() <= 1.0


def test_ppo_folds_its_scale_into_the_first_layer(left_alone_by):
    """The network that is read out must decide on plain observations as the trained one did on scaled ones."""
    tiny = config_file.load(None, ["expert.decisions=50", "expert.decisions_per_update=64", "expert.hidden=[4]"])

    def train(seed, told=lambda _: None, **changes):
        return ppo.train(tiny.model_copy(update=changes), seed, itertools.count(seed), told)

    counts = []
    first, second, other = train(3, counts.append), train(3), train(4)
    assert counts[-1] == tiny.expert.updates * 64 == 64  # whole updates
    assert left_alone_by(lambda: train(3))
    unmoved = train(3, expert=tiny.expert.model_copy(update={"learning_rate": 1e-12}))
    for (weights, biases), (same_weights, same_biases) in zip(first, second, strict=True):
        np.testing.assert_array_equal(weights, same_weights)
        np.testing.assert_array_equal(biases, same_biases)
    assert not np.array_equal(first[0][0], other[0][0])
    assert np.abs(first[0][0] / unmoved[0][0] - 1.0).max() > 1e-3
    scale = ppo.scale_of(tiny)
    assert scale[0] == tiny.lidar.max_range_m
    assert scale[24] == 10.0
    # Orthogonal initialisation at gain sqrt(2) gives rows of that length; one update hardly moves them.
    rows = np.linalg.norm(first[0][0] * scale, axis=1)
    assert rows == pytest.approx(np.full(4, np.sqrt(2)), rel=0.05)


def test_an_expert_that_begins_as_the_rule_driver_decides_as_it_does(tmp_path):
    """Before PPO moves it: on drives of the rule driver that it was not shown, much more often than by chance."""
    begun = config_file.load(
        None,
        [
            *("expert.begins_as_rule=12", "expert.critic_first=1", "expert.horizon_s=100", "expert.decisions=64"),
            *("expert.decisions_per_update=64", "episode.duration_s=60", "train.evaluation_episodes=1"),
        ],
    ).changed(train={"trajectories": 1, "evaluation_episodes": 1})
    expert.train(begun, tmp_path / "mine", seed=3)
    mine = roster.find_driver(str(tmp_path / "mine"), begun)
    (driven, advice), (alone, by_expert) = (
        rollout.practise_advised(rollout.Task("rule", begun, seed=99, adviser=adviser))
        for adviser in (mine, drivers.load_expert(begun))
    )
    np.testing.assert_array_equal(driven.decisions, alone.decisions)
    assert (advice == driven.decisions).mean() > 0.75
    assert (advice == driven.decisions).mean() > (by_expert == driven.decisions).mean()


def test_while_the_critic_learns_first_the_policy_stays_as_it_was():
    def train(**changes):
        keys = {"decisions": 128, "decisions_per_update": 64, "hidden": (4,)} | changes
        return ppo.train(config.Config().changed(expert=keys), 3, itertools.count(3))

    stays, would_leap, moves = train(critic_first=2), train(critic_first=2, learning_rate=0.1), train(critic_first=1)
    for (weights, _), (same, _), (others, _) in zip(stays, would_leap, moves, strict=True):
        np.testing.assert_array_equal(weights, same)
        assert not np.array_equal(weights, others)
