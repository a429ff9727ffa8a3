"""What a user can get wrong, in one line."""

import difflib
from collections.abc import Iterable

LISTED = 20
"""At most this many names are listed in a message."""


class InputError(ValueError):
    """A user's mistake: says what was given, what is allowed and what to do. The command line exits with code 2."""


class ObservationError(InputError):
    """A driver is to drive on another observation than it was trained on."""


class CourseError(InputError):
    """A way that a host could not drive."""


class NotBegun(InputError):
    """An episode could not begin."""


def did_you_mean(given: str, available: Iterable[str], *, also: Iterable[str] = ()) -> str:
    """Return `"; did you mean 'x'? (available: ...)"` for an unknown name; without a near name, only the list.

    Of a long list only the beginning is told. What is meant may `also` be something that is not listed.
    """
    names = sorted(available)
    near = difflib.get_close_matches(given, [*names, *also], n=1)
    question = f"; did you mean '{near[0]}'?" if near else ""
    listed = names if len(names) <= LISTED else [*names[:LISTED], f"and {len(names) - LISTED} more"]
    return f"{question} (available: {', '.join(listed)})"
