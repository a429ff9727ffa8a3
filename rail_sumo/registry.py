"""What goes by a name in the configuration: ours, or a module's from outside."""

import re
from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from rail_sumo.errors import InputError, did_you_mean

Named = TypeVar("Named")


def find(kind: str, name: str, known: Mapping[str, Named]) -> Named:
    """Return what is known by the name, or the attribute of a module that `module:attribute` names.

    Workers import the module too, so it must be importable: installed, or on PYTHONPATH.

    Raises:
        InputError: neither; the module cannot be imported; or the attribute is of another type than what is known.
    """
    if name in known:
        return known[name]
    if not is_from_outside(name):
        raise InputError(
            f"{kind} '{name}' not found{did_you_mean(name, known)}; one from outside is written module:attribute"
        )
    found = imported(kind, name)
    wanted = type(next(iter(known.values())))
    if not isinstance(found, wanted):
        raise InputError(
            f"{kind} '{name}' must be a {wanted.__module__}.{wanted.__qualname__}; it is a {type(found).__qualname__}"
        )
    return found


def is_from_outside(name: str) -> bool:
    """Return whether a name is written `module:attribute`."""
    return re.fullmatch(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*", name) is not None


def imported(kind: str, name: str) -> Any:
    """Return the attribute of a module that `module:attribute` names.

    Raises:
        InputError: the module cannot be imported, or has no such attribute.
    """
    module, _, attribute = name.partition(":")
    try:
        found = import_module(module)
    except ModuleNotFoundError as error:
        raise InputError(f"{kind} '{name}': {error}; install it, or add its folder to PYTHONPATH") from None
    except (ImportError, SyntaxError, AttributeError, NameError) as error:
        raise InputError(f"{kind} '{name}': '{module}' cannot be imported ({type(error).__name__}: {error})") from error
    if not hasattr(found, attribute):
        raise InputError(f"{kind} '{name}': module '{module}' has no '{attribute}'")
    return getattr(found, attribute)


def source_of(name: str) -> Path | None:
    """Return the file of the module that `module:attribute` names; None if it has none, or the name is one of ours."""
    if not is_from_outside(name):
        return None
    found = find_spec(name.partition(":")[0])
    return Path(found.origin) if found and found.has_location and found.origin else None
