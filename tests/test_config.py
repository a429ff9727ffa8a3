import math
import re
import tomllib
from pathlib import Path
from typing import Annotated, Union, get_args, get_origin

import annotated_types
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from rail_sumo import config, config_file
from rail_sumo.config import Config
from rail_sumo.errors import InputError

ORDERED = {
    "Adas": ("min_speed_kmh", "start_speed_kmh", "max_speed_kmh"),
    "Traffic": ("speed_low_kmh", "speed_high_kmh"),
    "Search": ("n_top", "n_directions"),
}
"""Keys of a section whose values must rise."""


OF_ITS_OWN = {"decision_period_s": st.integers(1, 20).map(lambda steps: steps / 10)}
"""Keys that take less than their type and limits say."""


def values(annotation, constraints=()):
    """Every value that a key of this type and these limits takes."""
    if get_origin(annotation) is Annotated:
        inner, *metadata = get_args(annotation)
        return values(inner, [limit for field in metadata for limit in getattr(field, "metadata", ())])
    if get_origin(annotation) is tuple and get_args(annotation)[-1] is not Ellipsis:  # a range
        return st.tuples(*map(values, get_args(annotation))).map(sorted).map(tuple)
    if get_origin(annotation) is tuple:
        return st.lists(values(get_args(annotation)[0]), max_size=3).map(tuple)
    if get_origin(annotation) is Union:  # a number or a word: the number
        return values(get_args(annotation)[0])
    if annotation is str:
        return st.text(st.characters(exclude_categories=["Cs"]), max_size=10)
    if annotation in (int, float):
        limits = [limit for limit in constraints if isinstance(limit, annotated_types.BaseMetadata)]
        drawn = st.from_type(Annotated[(annotation, *limits)]) if limits else st.from_type(annotation)
        # TOML has integers of 64 bits.
        return drawn.filter(lambda value: abs(value) < 2**63) if annotation is int else drawn.filter(math.isfinite)
    return st.from_type(annotation)


def sections(model):
    """Every instance of one section."""
    drawn = st.fixed_dictionaries(
        {
            name: OF_ITS_OWN[name] if name in OF_ITS_OWN else values(field.annotation, field.metadata)
            for name, field in model.model_fields.items()
        }
    )
    rising = ORDERED.get(model.__name__, ())
    if rising:
        field = model.model_fields[rising[0]]
        some = st.lists(
            values(field.annotation, field.metadata), min_size=len(rising), max_size=len(rising), unique=True
        )
        drawn = st.builds(lambda fields, risen: fields | dict(zip(rising, sorted(risen), strict=True)), drawn, some)
    if model is config.Expert:  # an update takes whole batches
        whole = st.builds(
            lambda size, n: {"batch_size": size, "decisions_per_update": n * size},
            st.integers(2, 10**6),
            st.integers(1, 10**6),
        )
        drawn = st.builds(lambda fields, batches: fields | batches, drawn, whole)
    if model is config.Traffic:  # those who are driven are among all
        drawn = drawn.map(lambda fields: fields | {"driven": min(fields["driven"], fields["vehicles"])})
    if model is config.Adas:
        drawn = drawn.map(
            lambda fields: (
                fields | {"comfort_braking_mps2": min(fields["comfort_braking_mps2"], fields["emergency_braking_mps2"])}
            )
        )
    if model is config.Train:  # cloning has no iterations
        drawn = drawn.map(lambda fields: fields | ({"iterations": "default"} if fields["learner"] == "bc" else {}))
    return drawn.map(lambda fields: model(**fields))


configs = st.fixed_dictionaries({name: sections(field.annotation) for name, field in Config.model_fields.items()}).map(
    lambda tree: Config(**tree)
)


@settings(max_examples=50)
@given(configs)
def test_written_as_toml_and_read_again_it_is_the_same(tmp_path_factory, given_config):
    path = tmp_path_factory.getbasetemp() / "config.toml"
    path.write_text(config_file.dumps(given_config), encoding="utf-8")
    assert config_file.load(path) == given_config


@settings(max_examples=50)
@given(configs)
def test_what_is_written_names_every_key(given_config):
    tree = tomllib.loads(config_file.dumps(given_config))
    assert {name: set(section) for name, section in tree.items()} == {
        name: set(field.annotation.model_fields) for name, field in Config.model_fields.items()
    }


@settings(max_examples=20)
@given(configs)
def test_explained_it_is_the_same(given_config):
    assert tomllib.loads(config_file.explained(given_config)) == tomllib.loads(config_file.dumps(given_config))


def test_a_vehicles_id_that_looks_like_a_number_is_an_id():
    assert config_file.load(None, ["traffic.host=250"]).traffic.host == "250"


def test_a_section_and_a_key_are_explained_just_before_they_stand():
    lines = config_file.explained(Config()).splitlines()
    assert max(map(len, lines)) <= 120
    assert lines[lines.index("[judge]") - 1] == "# The discriminator and its training."
    assert lines[lines.index("n_directions = 16") - 1].startswith("# N: how many perturbations an iteration tries")
    assert lines[lines.index("reward_weight = 0.0") - 2].startswith("# What a unit of the environment's reward per ")
    assert lines[lines.index("reward_weight = 0.0") - 1] == "# alone."


@pytest.mark.parametrize("changes", [{"duration_s": 300.0, "course_m": math.inf}, {"duration_s": math.inf}])
def test_no_limit_survives_the_way_through_toml(tmp_path, changes):
    given_config = Config(episode=config.Episode(**changes), traffic=config.Traffic(lane_change_every_s=math.inf))
    (tmp_path / "config.toml").write_text(config_file.dumps(given_config))
    assert config_file.load(tmp_path / "config.toml") == given_config


def test_without_a_file_the_defaults_are_the_papers_course_on_five_lanes():
    default = config_file.load()
    assert default == Config()
    assert default.network.file == "highway5"
    assert (default.episode.course_m, default.episode.duration_s) == (7222.0, math.inf)
    assert (default.lidar.n_rays, default.lidar.max_range_m, default.lidar.road_edges) == (24, 100.0, True)
    adas, limit_mps = default.adas, 80 / 3.6
    set_speeds_mps = (adas.lowest_mps(limit_mps), adas.start_mps(limit_mps), adas.highest_mps(limit_mps))
    assert set_speeds_mps == pytest.approx([40 / 3.6, 60 / 3.6, 80 / 3.6])
    assert default.adas.speed_step_kmh == 5.0


def test_a_file_changes_what_it_names_and_an_override_wins_over_it(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text("[traffic]\nvehicles = 30\nahead_m = 300\n[lidar]\nn_rays = 36")
    loaded = config_file.load(path, ["traffic.vehicles=12", "network.file=ring5", "traffic.vehicles=13"])
    changed = Config(
        traffic=config.Traffic(vehicles=13, ahead_m=300.0),
        lidar=config.Lidar(n_rays=36),
        network=config.Network(file="ring5"),
    )
    assert loaded == changed


@pytest.mark.parametrize(
    ("override", "section", "key", "value"),
    [
        ("traffic.vehicles=30", "traffic", "vehicles", 30),
        (" traffic . vehicles = 30 ", "traffic", "vehicles", 30),
        ("lidar.max_range_m=80", "lidar", "max_range_m", 80.0),
        ("lidar.road_edges=false", "lidar", "road_edges", False),
        ("episode.duration_s=3e2", "episode", "duration_s", 300.0),
        ("traffic.lane_change_every_s=inf", "traffic", "lane_change_every_s", math.inf),
        ("judge.hidden=[50, 20]", "judge", "hidden", (50, 20)),
        ("network.file=ring5", "network", "file", "ring5"),
        ("network.file='ring5'", "network", "file", "ring5"),
        ("network.file=my town.net.xml", "network", "file", "my town.net.xml"),
        ("network.file=a=b.net.xml", "network", "file", "a=b.net.xml"),
        ('traffic.routes=["a.rou.xml", "b.rou.xml"]', "traffic", "routes", ("a.rou.xml", "b.rou.xml")),
    ],
)
def test_an_override_is_read_as_toml_and_a_bare_word_as_itself(override, section, key, value):
    loaded = getattr(getattr(config_file.load(overrides=[override]), section), key)
    assert loaded == value
    assert type(loaded) is type(value)


def test_a_configuration_is_frozen():
    with pytest.raises(ValidationError, match="Instance is frozen"):
        Config().traffic.vehicles = 3


def line(message):
    return f"^{re.escape(message)}$"


SECTIONS = (
    "adas, ars, cloning, dagger, episode, expert, gail, judge, lidar, network, observation, policy, rail, search, "
    "traffic, train, varied"
)
POLICY_KEYS = "policy.hidden, policy.layers, policy.masked, policy.mode"


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ("[trafic]\nvehicles = 3", f"unknown key 'trafic'; did you mean 'traffic'? (available: {SECTIONS})"),
        ("vehicles = 3", f"unknown key 'vehicles'; did you mean 'traffic.vehicles'? (available: {SECTIONS})"),
        ("[qqq]", f"unknown key 'qqq' (available: {SECTIONS})"),
        (
            "[policy]\nhiden = 3",
            f"unknown key 'policy.hiden'; did you mean 'policy.hidden'? (available: {POLICY_KEYS})",
        ),
        (
            "[policy]\nn_directions = 3",
            f"unknown key 'policy.n_directions'; did you mean 'search.n_directions'? (available: {POLICY_KEYS})",
        ),
        ("traffic = 3", "traffic: Input should be an object, got 3"),
        ("[traffic]\nvehicles = '20'", "traffic.vehicles: Input should be a valid integer, got '20'"),
        ("[traffic]\nvehicles = 20.0", "traffic.vehicles: Input should be a valid integer, got 20.0"),
        ("[traffic]\nvehicles = true", "traffic.vehicles: Input should be a valid integer, got True"),
        ("[traffic]\nvehicles = -1", "traffic.vehicles: Input should be greater than or equal to 0, got -1"),
        (
            "[traffic]\nvehicles = -1\nahead_m = 0",
            "traffic.vehicles: Input should be greater than or equal to 0, got -1 (and 1 more)",
        ),
        (
            "[traffic]\nroutes = 'a.rou.xml'",
            'traffic.routes: Input should be a list, written ["...", "..."], got \'a.rou.xml\'',
        ),
        ("[traffic]\nroutes = [3]", "traffic.routes.0: Input should be a valid string, got 3"),
        (
            "[traffic]\nspeed_low_kmh = 80\nspeed_high_kmh = 70",
            "traffic: speed_low_kmh 80.0 is above speed_high_kmh 70.0",
        ),
        (
            "[traffic]\nspeed_low_kmh = 'limit*0.9'",
            "traffic: speed_low_kmh limit*0.9 is above speed_high_kmh limit*0.875",
        ),
        (
            "[traffic]\nspeed_low_kmh = 'limit*2'",
            "traffic.speed_low_kmh: Input should be a valid number or a share of the limit, up to 1, written "
            "\"limit*0.7\", got 'limit*2'",
        ),
        (
            "[varied]\nlorries = [0.3, 0.1]",
            "varied.lorries: a range is written [lowest, highest]; 0.3 is above 0.1, got [0.3, 0.1]",
        ),
        ("[lidar]\nroad_edges = 1", "lidar.road_edges: Input should be a valid boolean, got 1"),
        ("[lidar]\nn_rays = 0", "lidar.n_rays: Input should be greater than or equal to 1, got 0"),
        ("[lidar]\nmax_range_m = inf", "lidar.max_range_m: Input should be less than or equal to 500, got inf"),
        ("[lidar]\nmax_range_m = nan", "lidar.max_range_m: Input should be less than or equal to 500, got nan"),
        ("[episode]\ncourse_m = 0", "episode.course_m: Input should be greater than 0, got 0"),
        ("[episode]\ncourse_m = nan", "episode.course_m: Input should be greater than 0, got nan"),
        (
            "[episode]\ncourse_m = inf",
            "episode: course_m and duration_s are both inf: the episode would never end; set one of them",
        ),
        (
            "[episode]\ndecision_period_s = 2.1",
            "episode.decision_period_s: Input should be less than or equal to 2, got 2.1",
        ),
        (
            "[episode]\ndecision_period_s = 0.05",
            "episode.decision_period_s: Input should be greater than or equal to 0.1, got 0.05",
        ),
        (
            "[adas]\nstart_speed_kmh = 90\nmax_speed_kmh = 80",
            "adas: start_speed_kmh 90.0 must not be above max_speed_kmh 80.0",
        ),
        (
            "[adas]\nstart_speed_kmh = 30\nmin_speed_kmh = 40",
            "adas: start_speed_kmh 30.0 must not be below min_speed_kmh 40.0",
        ),
        (
            "[adas]\nmax_speed_kmh = 'fast'",
            "adas.max_speed_kmh: Input should be a valid number or 'limit', got 'fast'",
        ),
        ("[adas]\nmax_speed_kmh = 0", "adas.max_speed_kmh: Input should be greater than 0 or 'limit', got 0"),
        (
            "[adas]\nemergency_braking_mps2 = 1.5",
            "adas: comfort_braking_mps2 2.0 is above emergency_braking_mps2 1.5",
        ),
        ("[adas]\nmin_speed_kmh = 80\nmax_speed_kmh = 80", "adas: min_speed_kmh 80.0 must be below max_speed_kmh 80.0"),
        (
            "[adas]\nemergency_braking_mps2 = 9.5",
            "adas.emergency_braking_mps2: Input should be less than or equal to 9, got 9.5",
        ),
        ("[adas]\nsettle_s = -1", "adas.settle_s: Input should be greater than or equal to 0 or 'by traffic', got -1"),
        ("[adas]\nacceleration_mps2 = inf", "adas.acceleration_mps2: Input should be a finite number, got inf"),
        ("[search]\nn_top = 17\nn_directions = 16", "search: n_top 17 exceeds n_directions 16"),
        ("[policy]\nlayers = 3", "policy.layers: Input should be 1 or 2, got 3"),
        ("[judge]\nhidden = [100, 0]", "judge.hidden.1: Input should be greater than or equal to 1, got 0"),
        ("[expert]\ndiscount = 1.0", "expert.discount: Input should be less than 1, got 1.0"),
    ],
)
def test_a_bad_file_is_refused_in_one_line_that_says_what_was_given_and_what_is_allowed(tmp_path, toml, message):
    path = tmp_path / "own.toml"
    path.write_text(toml)
    with pytest.raises(InputError, match=line(f"configuration: {message}")):
        config_file.load(path)


@pytest.mark.parametrize("override", ["traffic.vehicles", "vehicles=30", "a.b.c=1", "=1", ".vehicles=1", "traffic.=1"])
def test_a_malformed_override_is_refused(override):
    message = f"--set takes section.key=value, for example traffic.vehicles=30; got '{override}'"
    with pytest.raises(InputError, match=line(message)):
        config_file.load(overrides=[override])


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "policy.hiden=3",
            f"unknown key 'policy.hiden'; did you mean 'policy.hidden'? (available: {POLICY_KEYS})",
        ),
        ("lidar.road_edges=False", "lidar.road_edges: Input should be a valid boolean, got 'False'"),
        ("traffic.vehicles=", "traffic.vehicles: Input should be a valid integer, got ''"),
        (
            "traffic.routes=a.rou.xml",
            'traffic.routes: Input should be a list, written ["...", "..."], got \'a.rou.xml\'',
        ),
    ],
)
def test_a_bad_override_is_refused_as_it_would_be_in_a_file(override, message):
    with pytest.raises(InputError, match=line(f"configuration: {message}")):
        config_file.load(overrides=[override])


def test_an_override_into_what_the_file_made_no_section_is_refused(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text("traffic = 3")
    message = "configuration: 'traffic' must be a section, written [traffic]; got 3"
    with pytest.raises(InputError, match=line(message)):
        config_file.load(path, ["traffic.vehicles=3"])


def test_a_file_that_cannot_be_read_or_is_no_toml_is_named(tmp_path):
    missing, broken, binary = tmp_path / "missing.toml", tmp_path / "broken.toml", tmp_path / "binary.toml"
    broken.write_text("[traffic")
    binary.write_bytes(b"\xff\xfe")
    for path, message in (
        (missing, f"cannot read configuration '{missing}': No such file or directory (current folder: {Path.cwd()})"),
        (tmp_path, f"cannot read configuration '{tmp_path}': Is a directory (current folder: {Path.cwd()})"),
    ):
        with pytest.raises(InputError, match=line(message)):
            config_file.load(path)
    for path in (broken, binary):
        with pytest.raises(InputError, match=f"^configuration '{re.escape(str(path))}' is not valid TOML: [^\n]+$"):
            config_file.load(path)


def test_a_period_that_is_no_whole_number_of_steps_is_refused():
    with pytest.raises(InputError, match=r"^configuration: episode\b.*decision_period_s.*0\.25$"):
        config_file.load(overrides=["episode.decision_period_s=0.25"])


def test_mappings_may_name_a_key_as_the_command_line_does():
    named = config_file.of({"traffic.vehicles": 30, "episode": {"duration_s": 60.0}, "episode.decision_period_s": 0.5})
    nested = {"traffic": {"vehicles": 30}, "episode": {"duration_s": 60.0, "decision_period_s": 0.5}}
    assert named == config_file.of(nested) != config_file.of(None)
    with pytest.raises(InputError, match=r"unknown key 'traffic.vehicels'; did you mean 'traffic.vehicles'"):
        config_file.of({"traffic.vehicels": 30})
    with pytest.raises(InputError, match=r"'traffic' must be a section, written \[traffic\]; got 30"):
        config_file.of({"traffic": 30, "traffic.vehicles": 30})
