"""What SUMO stumbles over, told to the user in one line."""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

import libsumo

from rail_sumo.errors import InputError
from rail_sumo.highway.network.demand import HOST

SUMO_ERRORS = (libsumo.TraCIException, libsumo.FatalTraCIError)


Given = ParamSpec("Given")
Returned = TypeVar("Returned")


def as_input_errors(function: Callable[Given, Returned]) -> Callable[Given, Returned]:
    """Turn SUMO's errors in a function into `InputError`.

    libsumo's own exceptions cannot be pickled, so they would not reach the parent of a worker.
    """

    @wraps(function)
    def guarded(*args: Given.args, **kwargs: Given.kwargs) -> Returned:
        try:
            return function(*args, **kwargs)
        except SUMO_ERRORS as error:
            if f"'{HOST}'" in str(error):
                raise InputError(
                    "the host was taken off the road; keep rerouters, vaporizers and the like on its course out of "
                    f"traffic.additional (SUMO: {error})"
                ) from None
            raise InputError(f"SUMO stopped: {error}") from None

    return guarded


def start(arguments: list[str]) -> None:
    """Start SUMO in this process; what it says on the way is not the user's to read.

    Raises:
        InputError: it does not start, with the first error that it told.
    """
    with tempfile.TemporaryFile() as said, _standard_error_to(said.fileno()):
        try:
            libsumo.start(["sumo", *arguments])
        except SUMO_ERRORS as error:
            said.seek(0)
            raise InputError(f"SUMO cannot load the network or its demand: {_reason(said.read(), error)}") from None


@contextmanager
def _standard_error_to(file: int) -> Iterator[None]:
    """Send what SUMO says elsewhere: it writes to the process's standard error, past sys.stderr."""
    kept = os.dup(2)
    os.dup2(file, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _reason(said: bytes, error: Exception) -> str:
    """Return the first error that SUMO told on standard error; its exception often knows only "Process Error"."""
    lines = (line.strip() for line in said.decode(errors="replace").splitlines())
    told = next((line.removeprefix("Error: ") for line in lines if line.startswith("Error")), str(error))
    return " ".join(told.split())
