"""The reference, made from the code as Markdown: commands, configuration keys, tables' columns. Needs no Sphinx.

`make reference` writes its pages, which are committed: they are read on a code host too.
"""

import inspect
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import tomli_w
import typer
from typer.models import ArgumentInfo, OptionInfo

from rail_sumo import cli
from rail_sumo.config import Config
from rail_sumo.records import DECISION_COLUMNS, EPISODE_COLUMNS, SUMMARY_COLUMNS
from rail_sumo.run_directory import PROGRESS_COLUMNS
from rail_sumo.studies.experiment import CELL_COLUMNS
from rail_sumo.studies.reproduce import TABLE_COLUMNS
from rail_sumo.tables import shares

Columns = Mapping[str, str]

TABLES: dict[str, tuple[str, Columns]] = {
    "episodes": ("`rail-sumo eval`, `train`: a row per policy and episode", EPISODE_COLUMNS),
    "summary": ("`rail-sumo eval`, `train`: a row per policy and metric", SUMMARY_COLUMNS),
    "decisions": ("`rail-sumo eval`, `train`: a row per decision, as Parquet alone", DECISION_COLUMNS),
    "progress.csv": ("`rail-sumo train`: a row per iteration", dict.fromkeys(PROGRESS_COLUMNS, "float64")),
    "traffic": (
        "`rail-sumo sweep`: a row per driver, setting, share, seed and kind of vehicles",
        shares.TRAFFIC_COLUMNS,
    ),
    "summary of a sweep": (
        "`rail-sumo sweep`: a row per driver, setting, share, kind of vehicles and measure",
        shares.SUMMARY_COLUMNS,
    ),
    "differences": (
        "`rail-sumo sweep`: a row per driver, setting, share, kind of vehicles and measure",
        shares.DIFFERENCE_COLUMNS,
    ),
    "edges": (
        "`rail-sumo sweep`: a row per driver, setting, share, seed, kind and type of vehicles, edge, as Parquet alone",
        shares.EDGE_COLUMNS,
    ),
    "cells": ("`rail-sumo reproduce`: a row per system, mode, training and episode", CELL_COLUMNS),
    "table1.csv": ("`rail-sumo reproduce table1`: a row per system, mode and metric", TABLE_COLUMNS),
}
"""Every table: what writes it and what a row is, and its columns with their pandas types."""

DEFINED_IN = {
    "episodes": "../measures.md#one-vehicle-the-episodes-table",
    "summary": "../measures.md#means-and-intervals-the-summary-table",
    "decisions": "../measures.md#decision-by-decision-the-decisions-table",
    "progress.csv": "../start.md#progresscsv",
    "traffic": "../measures.md#the-whole-road-the-traffic-table",
    "summary of a sweep": "../measures.md#means-and-differences-of-a-sweep",
    "differences": "../measures.md#means-and-differences-of-a-sweep",
    "edges": "../measures.md#edge-by-edge-the-edges-table",
    "cells": "../reproduce.md#the-cells",
    "table1.csv": "../reproduce.md#table-1",
}
"""Where the columns are explained."""

TYPES = {
    "string": "text",
    "int64": "whole number",
    "float64": "number",
    "bool": "true or false",
    "integer": "whole number",
    "boolean": "true or false",
    "number": "number",
}


def commands() -> str:
    """Return every command with all its arguments and options."""
    parts = []
    for name, function in _commands(cli.app):
        hints = typing.get_type_hints(function, include_extras=True)
        parameters = [
            (parameter, *get_args(hints[parameter.name])[:2])
            for parameter in inspect.signature(function).parameters.values()
        ]
        arguments = [
            _metavar(*one) if one[0].default is inspect.Parameter.empty else f"[{_metavar(*one)}]"
            for one in parameters
            if isinstance(one[2], ArgumentInfo)
        ]
        rows = [_parameter(*one) for one in parameters]
        parts += [
            f"## {name}",
            f"```\n{' '.join(['rail-sumo', name, *arguments, *(['[OPTIONS]'] if rows else [])])}\n```",
            inspect.cleandoc(function.__doc__ or ""),
            *rows,
        ]
    return "\n\n".join(parts)


def _commands(app: typer.Typer, above: str = "") -> Iterator[tuple[str, Any]]:
    for command in app.registered_commands:
        assert command.callback is not None
        yield f"{above}{command.name or command.callback.__name__}", command.callback
    for group in app.registered_groups:
        assert group.typer_instance is not None
        yield from _commands(group.typer_instance, f"{group.name} ")


def _parameter(parameter: inspect.Parameter, kind: Any, info: ArgumentInfo | OptionInfo) -> str:
    name = _metavar(parameter, kind, info)
    if isinstance(info, OptionInfo):
        option = _option(parameter, info)
        name = option if kind is bool else f"{option} {name}"
    default = "" if parameter.default is None or parameter.default is False else f"{parameter.default}"
    if isinstance(info.show_default, str):
        default = info.show_default
    if parameter.default is parameter.empty:
        return _defined(name, info.help or "", "Must be given.")
    return _defined(name, info.help or "", f"Default: {default}." if default else "")


def _option(parameter: inspect.Parameter, info: OptionInfo) -> str:
    # `Annotated[..., typer.Option("--set")]`: what comes first is taken for a default
    named = [*([info.default] if isinstance(info.default, str) else []), *(info.param_decls or ())]
    return next(iter(named), f"--{parameter.name.replace('_', '-')}")


def _metavar(parameter: inspect.Parameter, kind: Any, info: ArgumentInfo | OptionInfo) -> str:
    if info.metavar:
        return info.metavar
    if get_origin(kind) is Literal:
        return "|".join(get_args(kind))
    numbers = {int: "NUMBER", float: "NUMBER"}
    kinds = [one for one in (kind, *get_args(kind)) if one in numbers]
    return numbers[kinds[0]] if kinds else "PATH" if kind is Path or Path in get_args(kind) else parameter.name.upper()


def keys() -> str:
    """Return every key of the configuration: its type, range, default and meaning."""
    parts = []
    for name, field in Config.model_fields.items():
        section = field.annotation
        assert section is not None
        schema = section.model_json_schema()
        rows = []
        for key, about in section.model_fields.items():
            default = tomli_w.dumps({"x": about.default}).removeprefix("x = ").strip()
            meaning = " ".join((about.description or "").split())
            rows.append(
                _defined(
                    f"{name}.{key}", meaning, f"{_allowed(schema['properties'][key])}. Default: {_literal(default)}."
                )
            )
        parts += [f"## `[{name}]`", section.__doc__ or "", *rows]
    return "\n\n".join(parts)


def _allowed(schema: Mapping[str, Any]) -> str:
    """Return what a value may be, of a JSON schema."""
    if "anyOf" in schema:
        return ", or ".join(_allowed(one) for one in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return " or ".join(f"`{one}`" for one in schema.get("enum", [schema.get("const")]))
    if schema.get("type") == "array":
        if "prefixItems" in schema:
            return f"a range `[lowest, highest]`; {_allowed(schema['prefixItems'][0])}"
        return f"a list of {'texts' if schema['items']['type'] == 'string' else 'whole numbers'}"
    limits = [
        text.format(_number(schema[limit]))
        for limit, text in (
            ("minimum", "from {}"),
            ("exclusiveMinimum", "above {}"),
            ("maximum", "up to {}"),
            ("exclusiveMaximum", "below {}"),
        )
        if limit in schema
    ]
    kind = "text" if schema["type"] == "string" else TYPES[schema["type"]]
    return " ".join([kind, *limits])


def _number(value: float) -> str:
    return f"{value:,.10g}"


def columns() -> str:
    """Return every table's columns with their types, and where they are explained."""
    parts = []
    for name, (about, of_table) in TABLES.items():
        rows = [[f"`{column}`", TYPES[kind]] for column, kind in of_table.items()]
        anchor = DEFINED_IN[name]
        parts += [
            f"## `{name}`" if " " not in name else f"## The {name}",
            f"{about}. [What the columns mean]({anchor}).",
            _table(("column", "type"), rows),
        ]
    return "\n\n".join(parts)


def _defined(name: str, meaning: str, more: str) -> str:
    """Return an entry of a list: what it means, and on the next line its type, or whether it must be given."""
    told = [f"{text[:1].upper()}{text[1:]}" for text in (" ".join(meaning.split()), more) if text]
    return f"- `{name}`: " + "\\\n  ".join(told)


def _literal(text: str) -> str:
    return f"`{' '.join(text.split())}`"


def _table(headings: tuple[str, ...], rows: list[list[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *([_cell(text) for text in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


MADE_BY = "Made from the code by `make reference`; change it there."
PAGES = {
    "commands.md": (f"# Commands\n\n{MADE_BY} In a terminal, `rail-sumo COMMAND --help` tells the same.", commands),
    "configuration.md": (
        f"# Configuration keys\n\n{MADE_BY} In a terminal, `rail-sumo config` prints the same as a file to start from.",
        keys,
    ),
    "tables.md": (f"# Columns of the tables\n\n{MADE_BY}", columns),
}
"""What the pages begin with, and what is made for them."""


def page(name: str) -> str:
    """Return a page of the reference."""
    beginning, made = PAGES[name]
    return f"{beginning}\n\n{made()}\n"


def main() -> None:
    """Write the pages into docs/reference."""
    for name in PAGES:
        (Path(__file__).parents[1] / "reference" / name).write_text(page(name), encoding="utf-8")


if __name__ == "__main__":
    main()
