import hashlib
import json
import re
from pathlib import Path

import pytest

from rail_sumo import assets
from rail_sumo.errors import InputError


@pytest.fixture
def expert_folder(tmp_path, monkeypatch):
    """An installation whose expert is one file of known content."""
    folder = tmp_path / "expert"
    folder.mkdir()
    (folder / "policy.safetensors").write_bytes(b"weights")
    manifest = {"files": {"policy.safetensors": hashlib.sha256(b"weights").hexdigest(), "lost.parquet": "0" * 64}}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    monkeypatch.setattr(assets, "data_root", lambda: tmp_path)
    return folder


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package folder with nothing in or beside it."""
    folder = tmp_path / "rail_sumo"
    folder.mkdir()
    monkeypatch.setattr(assets, "_PACKAGE", folder)
    assets.data_root.cache_clear()
    yield folder
    assets.data_root.cache_clear()


SHIPPED = ("arterial", "highway2", "highway3", "highway4", "highway5", "highway6", "lane_drop", "onramp", "ring5")


def test_nine_networks_are_shipped_and_each_has_a_demand_example():
    assert assets.network_names() == SHIPPED
    assert [assets.routes(name).name for name in SHIPPED] == [f"{name}.rou.xml" for name in SHIPPED]


def test_a_misspelt_network_gets_a_suggestion():
    message = f"network 'straigth3' not found (available: {', '.join(SHIPPED)})"
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        assets.network("straigth3")
    message = f"network 'higway3' not found; did you mean 'highway3'? (available: {', '.join(SHIPPED)})"
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        assets.network("higway3")


def test_a_users_own_file_passes_through(tmp_path, monkeypatch):
    own = tmp_path / "town.net.xml"
    own.write_text("<net/>")
    assert assets.network(str(own)) == own
    monkeypatch.chdir(tmp_path)
    assert assets.network("town.net.xml") == Path("town.net.xml")


def test_a_bare_name_that_is_a_file_passes_through_but_never_hides_a_shipped_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine").write_text("<net/>")
    Path("ring5").write_text("<net/>")
    assert assets.network("mine") == Path("mine")
    assert assets.network("ring5").name == "ring5.net.xml"


@pytest.mark.parametrize("given", ["town.net.xml", "town.net.xml.gz", "maps/town", "./highway5"])
def test_a_path_that_does_not_exist_is_no_misspelt_name(given, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"^network file '.*' does not exist \(current folder: "):
        assets.network(given)


def test_a_folder_is_not_a_network(tmp_path):
    with pytest.raises(InputError, match=r"cannot be read: Is a directory$"):
        assets.network(str(tmp_path))


def test_an_expert_file_that_matches_the_manifest_is_handed_out(expert_folder):
    assert assets.expert("policy.safetensors").read_bytes() == b"weights"


def test_a_changed_expert_file_is_refused(expert_folder):
    (expert_folder / "policy.safetensors").write_bytes(b"weightz")
    with pytest.raises(InputError, match=r"is damaged or was changed: its SHA-256 is .*; reinstall rail-sumo or train"):
        assets.expert("policy.safetensors")


def test_an_expert_file_outside_the_manifest_is_refused_even_if_it_exists(expert_folder):
    (expert_folder / "policy.safetensor").write_text("not listed")
    with pytest.raises(InputError, match=r"^expert file 'policy\.safetensor' not found; did you mean 'policy\.safet"):
        assets.expert("policy.safetensor")


def test_a_missing_expert_file_is_named(expert_folder):
    with pytest.raises(InputError, match=r"^expert file '.*lost\.parquet' does not exist"):
        assets.expert("lost.parquet")


@pytest.mark.parametrize("manifest", ["", "[]", "{}", '{"files": ["policy.safetensors"]}', "{"])
def test_a_broken_manifest_is_a_users_error(expert_folder, manifest):
    (expert_folder / "manifest.json").write_text(manifest)
    with pytest.raises(InputError, match=r"^the expert's manifest"):
        assets.expert("policy.safetensors")


def test_an_installation_without_an_expert_says_how_to_train_one(expert_folder):
    (expert_folder / "manifest.json").unlink()
    with pytest.raises(InputError, match=r"^no expert here: .* train one \(rail-sumo expert train\); any other"):
        assets.expert("policy.safetensors")


def test_assets_of_a_wheel_lie_in_the_package(package):
    (package / "_data").mkdir()
    (package.parent / "pyproject.toml").write_text('[project]\nname = "rail-sumo"')
    assert assets.data_root() == package / "_data"


def test_assets_of_a_checkout_lie_beside_the_package(package):
    (package.parent / "pyproject.toml").write_text('[project]\nname = "rail-sumo"')
    assert assets.data_root() == package.parent


@pytest.mark.parametrize("pyproject", [None, "", "not TOML", '[project]\nname = "somebody-else"'])
def test_another_projects_folder_is_not_mistaken_for_ours(package, pyproject):
    if pyproject is not None:
        (package.parent / "pyproject.toml").write_text(pyproject)
    with pytest.raises(InputError, match=r"reinstall rail-sumo$"):
        assets.data_root()
