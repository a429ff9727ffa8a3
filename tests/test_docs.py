"""The pages: every command, key and column has its place, and what they name is there, on a code host too."""

import re
import shlex
from pathlib import Path

import pytest
import typer
from _site import reference

from rail_sumo import cli
from rail_sumo.config import Config
from rail_sumo.tables import traffic

ROOT = Path(__file__).parent.parent
PAGES = {
    str(page.relative_to(ROOT)): page.read_text(encoding="utf-8")
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
    if page.parent.name != "data"
}
FILES = {"csv", "html", "parquet", "py", "safetensors", "toml"}
KEY = r"^- `(\w+\.\w+)`: (.*)\\\n  (.*)$"
OF_TYPER = {"--install-completion"}
COMMAND = typer.main.get_command(cli.app)


def commands_of(group, above=()):
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands_of(command, (*above, name))
        else:
            yield " ".join((*above, name)), command


def anchors(text):
    """As code hosts make them of headings; of equal ones only the first is linked to."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


# The reference.


@pytest.mark.parametrize("name", reference.PAGES)
def test_the_reference_is_up_to_date(name):
    page = PAGES[f"docs/reference/{name}"]
    assert page == reference.page(name), f"docs/reference/{name} is not what the code says; renew it: make reference"


def test_every_command_with_every_option_is_in_the_reference():
    sections = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", reference.commands(), re.DOTALL | re.MULTILINE))
    found = dict(commands_of(COMMAND))
    assert sections.keys() == found.keys()
    assert len(found) > 10
    for name, command in found.items():
        described = re.findall(r"^- `([^` ]+)[^`]*`: ", sections[name], re.MULTILINE)
        options = [option for parameter in command.params for option in parameter.opts if option.startswith("--")]
        arguments = [parameter for parameter in command.params if not parameter.opts[0].startswith("--")]
        assert sorted(one for one in described if one.startswith("--")) == sorted(options), name
        assert len([one for one in described if not one.startswith("--")]) == len(arguments), name
        for parameter in command.params:
            assert " ".join((parameter.help or "").split()) in sections[name], (name, parameter.name)


def test_every_key_is_in_the_reference_with_its_meaning_range_and_default():
    described = {key: (meaning, rest) for key, meaning, rest in re.findall(KEY, reference.keys(), re.MULTILINE)}
    assert described.keys() == Config().flat().keys()
    for key, (meaning, _) in described.items():
        section, _, name = key.partition(".")
        about = type(getattr(Config(), section)).model_fields[name]
        assert about.description, f"{key} has no meaning"
        assert meaning.lower() == " ".join(about.description.split()).lower()
    assert described["lidar.n_rays"][1] == "Whole number from 1 up to 720. Default: `24`."
    assert described["policy.layers"][1] == "`1` or `2`. Default: `2`."
    assert (
        described["varied.lorries"][1]
        == "A range `[lowest, highest]`; number from 0 up to 1. Default: `[ 0.0, 0.3, ]`."
    )


def test_every_column_is_in_the_reference_and_explained_where_that_says():
    made = reference.columns()
    for table, (_, columns) in reference.TABLES.items():
        section = re.search(rf"^## [^\n]*{re.escape(table)}[^\n]*\n(.*?)(?=^## |\Z)", made, re.DOTALL | re.MULTILINE)
        assert section is not None, table
        assert re.findall(r"^\| `(\w+)` \|", section[1], re.MULTILINE) == list(columns)
        page, _, anchor = reference.DEFINED_IN[table].removeprefix("../").partition("#")
        text = PAGES[f"docs/{page}"]
        assert anchor in anchors(text), (table, anchor)
        explained = set(re.findall(r"`(\w+)`", text))
        as_in_episodes = set(reference.TABLES["episodes"][1]) if table == "cells" else set()
        assert set(columns) <= explained | as_in_episodes, table


def test_every_measure_of_the_road_has_a_place_of_its_own():
    of_road = PAGES["docs/measures.md"].partition("## The whole road")[2]
    for measure in traffic.MEASURES:
        assert re.search(rf"^(### .*|\| .*)`{measure}`", of_road, re.MULTILINE), measure


# What pages name.


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files_and_headings(page):
    text = re.sub(r"```.*?```", "", PAGES[page], flags=re.DOTALL)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith("http"):
            continue
        target, _, anchor = link.partition("#")
        file = ((ROOT / page).parent / target).resolve() if target else ROOT / page
        assert file.exists(), link
        if anchor:
            assert anchor in anchors(file.read_text(encoding="utf-8")), link


@pytest.mark.parametrize("page", PAGES)
def test_commands_shown_are_understood(page):
    """Every command that stands by itself: as a line of a block, or as a whole between backquotes."""
    blocks = "\n".join(re.findall(r"^ *```\n(.*?)^ *```", PAGES[page], re.DOTALL | re.MULTILINE))
    inline = re.findall(r"`(rail-sumo [^`]+)`", re.sub(r"```.*?```", "", PAGES[page], flags=re.DOTALL))
    for line in [*re.findall(r"^ *(rail-sumo .*)$", blocks, re.MULTILINE), *inline]:
        words = shlex.split(" ".join(line.split()))[1:]
        command = COMMAND
        while words and words[0] in getattr(command, "commands", {}):
            command = command.commands[words.pop(0)]
        if words[:1] == ["COMMAND"]:
            continue
        assert command is not COMMAND or words[0].startswith("--"), line
        known = {option for parameter in command.params for option in parameter.opts}
        named = {word for word in words if word.startswith("--")}
        assert named <= known | {"--help"} | OF_TYPER, line


@pytest.mark.parametrize("page", PAGES)
def test_keys_named_are_keys_of_the_configuration(page):
    sections = "|".join(Config.model_fields)
    for text in re.findall(r"`([^`\n]+)`|--set '?([^\s'=]+)", PAGES[page]):
        key = re.match(rf"(?:{sections})\.[a-z_]+(?==|$)", "".join(text).removeprefix("--set "))
        if key and key[0].rpartition(".")[2] not in FILES:
            assert key[0] in Config().flat(), key[0]


def test_no_page_is_left_out_of_the_site():
    index = PAGES["docs/index.md"]
    listed = {f"docs/{name}.md" for name in re.findall(r"^([\w/]+)$", index, re.MULTILINE)}
    assert listed == PAGES.keys() - {"README.md", "docs/index.md"}


def test_the_pictures_of_measures_are_there_to_draw():
    pictures = pytest.importorskip("_site.pictures")
    named = [name for text in PAGES.values() for name in re.findall(r"^```\{drawn\} (\w+)$", text, re.MULTILINE)]
    assert sorted(named) == sorted(pictures.PICTURES)
