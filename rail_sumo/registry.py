"""What goes by a name in the configuration: ours, or a module's from outside."""

from collections.abc import Mapping
from importlib import import_module
from typing import TypeVar

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
    module, _, attribute = name.partition(":")
    if not module or not attribute or module.startswith("."):
        raise InputError(
            f"{kind} '{name}' not found{did_you_mean(name, known)}; one from outside is written module:attribute"
        )
    try:
        imported = import_module(module)
    except ModuleNotFoundError as error:
        raise InputError(f"{kind} '{name}': {error}; install it, or add its folder to PYTHONPATH") from None
    except (ImportError, SyntaxError, AttributeError, NameError) as error:
        raise InputError(f"{kind} '{name}': '{module}' cannot be imported ({type(error).__name__}: {error})") from error
    if not hasattr(imported, attribute):
        raise InputError(f"{kind} '{name}': module '{module}' has no '{attribute}'")
    found = getattr(imported, attribute)
    wanted = type(next(iter(known.values())))
    if not isinstance(found, wanted):
        raise InputError(
            f"{kind} '{name}' must be a {wanted.__module__}.{wanted.__qualname__}; it is a {type(found).__qualname__}"
        )
    return found
