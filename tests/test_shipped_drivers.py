"""The drivers that come with rail-sumo and go by name."""

import shutil

import pytest

from rail_sumo import assets, config_file, drivers, roster, run, training
from rail_sumo.errors import InputError
from rail_sumo.policy import PolicyParameters

SHIPPED = drivers.SHIPPED
RECIPE = assets.EXPERT_RECIPE


@pytest.mark.parametrize("name", SHIPPED)
def test_it_drives_by_name_with_the_senses_of_its_recipe_and_without_contact(name):
    world = config_file.load(
        None,
        [
            *("network.file=highway4", 'traffic.routes=["highway4"]', "traffic.entry_within_s=60"),
            *("episode.course_m=inf", "episode.duration_s=100"),
        ],
    )
    driver = roster.find_driver(name, world)
    assert driver.senses == config_file.load(assets.driver(name) / RECIPE).senses
    episodes, *_ = run.evaluate({name: driver, "keep": "keep"}, world, episodes=3, seed=7)
    assert (episodes["collisions"] + episodes["struck"] == 0).all()
    speed = episodes.groupby("policy")["speed_kmh"].mean()
    assert speed[name] > speed["keep"]


def test_drivers_of_different_senses_are_compared_on_the_same_traffic():
    world = roster.world(["rail", "road-rail"], ["episode.duration_s=20"])
    found = {name: roster.find_driver(name, world) for name in ("rail", "road-rail")}
    assert found["rail"].senses != found["road-rail"].senses
    episodes, *_ = run.evaluate(found, world, episodes=2, seed=7)
    first, second = (episodes[episodes["policy"] == name]["seed"].tolist() for name in found)
    assert first == second


def test_the_learned_act_as_they_were_trained_unless_told():
    world = config_file.load()
    rail = roster.find_driver("road-rail", world)
    assert isinstance(rail, PolicyParameters)
    assert (rail.samples, rail.masked) == (False, True)
    assert roster.find_driver("road-rail:sampled", world).samples


def test_the_road_driver_learned_from_the_road_experts_demonstrations():
    recipe = config_file.load(assets.driver("road-rail") / RECIPE)
    assert recipe.train.expert == "road-expert"
    shown = training.demonstrations_of(recipe)
    assert len(set(shown.episode.tolist())) == recipe.train.trajectories
    expert = drivers.load_expert(recipe)
    drivers.require_same_senses(expert, recipe, "the expert")


@pytest.mark.parametrize("name", SHIPPED)
def test_a_file_that_was_changed_is_refused(name, tmp_path, monkeypatch):
    shutil.copytree(assets.driver(name), tmp_path / "drivers" / name)
    monkeypatch.setattr(assets, "data_root", lambda: tmp_path)
    assets.driver(name)
    with (tmp_path / "drivers" / name / assets.EXPERT_POLICY).open("ab") as file:
        file.write(b" ")
    with pytest.raises(InputError, match="is damaged or was changed"):
        assets.driver(name)
