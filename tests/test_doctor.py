from importlib.metadata import PackageNotFoundError

import pytest

from rail_sumo import doctor
from rail_sumo.errors import InputError


@pytest.fixture
def installed(monkeypatch):
    """Say what is installed, and what rail-sumo requires."""

    def say(requirements, versions):
        def version(package):
            if package not in versions:
                raise PackageNotFoundError(package)
            return versions[package]

        monkeypatch.setattr(doctor, "requires", lambda _: requirements)
        monkeypatch.setattr(doctor, "version", version)
        return {found.what: found for found in doctor.examine()}

    return say


def test_what_is_missing_is_told_with_what_to_do_and_extras_are_not_needed(installed):
    found = installed(
        ["numpy>=2.0", "libsumo>=1.28", 'matplotlib>=3.10; extra == "plots"', "ray[default]>=2 ; extra == 'ray'"],
        {"numpy": "2.4.6", "matplotlib": "3.11"},
    )
    assert (found["numpy"].state, found["numpy"].advice) == ("2.4.6", "")
    assert (found["libsumo"].advice, found["libsumo"].is_needed) == ("pip install rail-sumo", True)
    assert (found["matplotlib (plots)"].state, found["matplotlib (plots)"].advice) == ("3.11", "")
    assert found["ray (ray)"].advice == "pip install 'rail-sumo[ray]'"
    assert not found["ray (ray)"].is_needed


def test_it_drives(installed):
    assert "drove " in installed([], {})["simulation"].state


def test_a_simulation_that_fails_is_told(installed, monkeypatch):
    def fail(task):
        raise InputError("SUMO is not itself")

    monkeypatch.setattr(doctor, "drive", fail)
    found = installed([], {})["simulation"]
    assert found.state == "failed: SUMO is not itself"
    assert found.advice
    assert found.is_needed
