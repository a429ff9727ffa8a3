"""A configuration read from TOML, explained and written."""

import json
import textwrap
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from rail_sumo.config import OF_LEARNING, Config
from rail_sumo.errors import InputError, did_you_mean
from rail_sumo.files import AnyPath


def load(path: AnyPath | None = None, overrides: Iterable[str] = ()) -> Config:
    """Read a TOML file (all defaults without one) and apply `section.key=value` overrides.

    Values of overrides are read as TOML, bare words as strings.

    Raises:
        InputError: no such file, not TOML, an unknown key (with a suggestion), a wrong type, a value out of range.
    """
    tree: dict[str, Any] = {}
    if path is not None:
        try:
            tree = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(
                f"cannot read configuration '{path}': {error.strerror} (current folder: {Path.cwd()})"
            ) from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(f"configuration '{path}' is not valid TOML: {error}") from None
    for override in overrides:
        _apply(tree, override)
    return validate(tree)


def changed(config: Config, overrides: Iterable[str]) -> Config:
    """Return a configuration with `section.key=value` overrides; see `load` for the errors."""
    tree = tomllib.loads(dumps(config))
    for override in overrides:
        _apply(tree, override)
    return validate(tree)


def of(given: Config | Mapping[str, Any] | AnyPath | None) -> Config:
    """Return a configuration given as such, as mappings, or as a TOML file; without any, the default.

    Mappings nest, as `{"episode": {"duration_s": 60}}`, or name a key as --set does, `{"episode.duration_s": 60}`.

    Raises:
        InputError: as in `load`.
    """
    if isinstance(given, Config):
        return given
    if given is not None and not isinstance(given, Mapping | str | Path):
        raise InputError(
            'a configuration is a Config, nested mappings such as {"episode": {"duration_s": 60}}, or a TOML file; '
            f"got a {type(given).__name__}"
        )
    return load(given) if isinstance(given, str | Path) else validate(_nested(given or {}))


def validate(tree: dict[str, Any]) -> Config:
    """Return the configuration a nested dict describes; see `load` for the errors."""
    try:
        # In JSON, since strict validation of Python objects refuses lists for tuples.
        return Config.model_validate_json(json.dumps(tree, default=str))
    except ValidationError as error:
        raise InputError(_explain(error)) from None


def recorded(text: str) -> Config:
    """Return what TOML that `dumps` wrote, maybe long ago, says about sensing and deciding; the rest is default.

    Raises:
        InputError: it is not TOML, or says something else.
    """
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"configuration is not valid TOML: {error}") from None
    return validate({name: tree[name] for name in ("lidar", "observation", "episode") if name in tree})


def first_difference(given: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return the first key in which two sets of keys differ, with both values; empty if in none."""
    found = ((key, value, wanted.get(key)) for key, value in given.items() if wanted.get(key) != value)
    return next((f"{key} = {value}, not {other}" for key, value, other in found), "")


def dumps(config: Config) -> str:
    """Return the configuration as TOML, every key written out."""
    return tomli_w.dumps(config.model_dump())


def dumps_world(config: Config) -> str:
    """Return as TOML what matters to those who drive: no section about learning, but which expert is meant."""
    world = config.model_dump(exclude=set(OF_LEARNING))
    if config.train.expert != Config().train.expert:
        world["train"] = {"expert": config.train.expert}
    return tomli_w.dumps(world)


def explained(config: Config) -> str:
    """Return the configuration as TOML, every key with what it means."""
    sections = []
    for name, section in config:
        lines = [*_comment(type(section).__doc__), f"[{name}]"]
        for key, field in type(section).model_fields.items():
            lines += [*_comment(field.description), tomli_w.dumps({key: getattr(section, key)}).rstrip()]
        sections.append("\n".join([*lines, ""]))
    return "\n".join(sections)


def _comment(text: str | None) -> list[str]:
    return textwrap.wrap(text or "", 120, initial_indent="# ", subsequent_indent="# ")


def key_of(override: str) -> str:
    """Return the key that an override `section.key=value` names."""
    return override.partition("=")[0].strip()


def value_of(override: str) -> Any:
    """Return the value that an override `section.key=value` sets: read as TOML, bare words as strings."""
    text = override.partition("=")[2]
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.strip()


def _apply(tree: dict[str, Any], override: str) -> None:
    parts = [part.strip() for part in key_of(override).split(".")]
    if "=" not in override or len(parts) != 2 or not all(parts):
        raise InputError(f"--set takes section.key=value, for example traffic.vehicles=30; got '{override}'")
    _section(tree, parts[0])[parts[1]] = value_of(override)


def _section(tree: dict[str, Any], name: str) -> dict[str, Any]:
    section = tree.setdefault(name, {})
    if not isinstance(section, dict):
        raise InputError(f"configuration: '{name}' must be a section, written [{name}]; got {section!r}")
    return section


def _nested(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return mappings with every key in its section, `section.key` too."""
    tree: dict[str, Any] = {}
    for name, value in given.items():
        section, dot, key = str(name).partition(".")
        keys = {key: value} if dot else value
        if not isinstance(keys, Mapping):
            tree[section] = keys
            continue
        for one in keys:
            if one in _section(tree, section):
                raise InputError(f"configuration: '{section}.{one}' is given twice; leave one of them out")
        _section(tree, section).update(keys)
    return tree


def _explain(error: ValidationError) -> str:
    by_key: dict[tuple[int | str, ...], list[Any]] = {}  # a key of two types has an error of each, named after it
    for one in error.errors():
        key = (*one["loc"][:2], *(part for part in one["loc"][2:] if isinstance(part, int)))
        by_key.setdefault(key, []).append(one)
    (key, (first, *others)), *rest = by_key.items()
    location = ".".join(map(str, key))
    more = f" (and {len(rest)} more)" if rest else ""
    if first["type"] == "extra_forbidden":
        return f"configuration: unknown key '{location}'{_suggest(first['loc'])}{more}"
    message = " or ".join(one["msg"].removeprefix("Value error, ") for one in (first, *others))
    message = message.replace(" or Input should be", " or").replace("valid array", 'list, written ["...", "..."]')
    given = "" if isinstance(first["input"], dict) else f", got {first['input']!r}"
    return ": ".join(filter(None, ["configuration", location, f"{message}{given}{more}"]))


def _suggest(location: tuple[int | str, ...]) -> str:
    allowed = list(Config.model_fields)
    if len(location) == 2:
        allowed = [key for key in _keys() if key.startswith(f"{location[0]}.")]
    return did_you_mean(".".join(map(str, location)), allowed, also=_keys())


def _keys() -> Iterator[str]:
    for name, field in Config.model_fields.items():
        assert field.annotation is not None
        yield from (f"{name}.{key}" for key in field.annotation.model_fields)
