"""The one SUMO that libsumo holds in a process: started, ended, and its errors told in one line."""

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

import libsumo

from rail_sumo.errors import InputError
from rail_sumo.highway.names import HOST
from rail_sumo.highway.sumo_outputs import without_prefix

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
            told = without_prefix(str(error))
            if f"'{getattr(args[0], 'host_name', HOST)}'" in told:
                raise InputError(
                    "the host was taken off the road; keep rerouters, vaporizers and the like on its course out of "
                    f"traffic.additional (SUMO: {told})"
                ) from None
            raise InputError(f"SUMO stopped: {told}") from None

    return guarded


class Refused(Exception):
    """SUMO does not start; the message is the first error that it told."""


_is_open = False


def start(options: Mapping[str, object], further: Sequence[str] = ()) -> None:
    """Start SUMO in this process, until `close`; what it says on the way is not the user's to read.

    Args:
        options: SUMO's, by name.
        further: more of them, as on a command line.

    Raises:
        RuntimeError: one is running already, which libsumo would replace without a word.
        Refused: it does not start.
    """
    global _is_open
    if _is_open:
        raise RuntimeError(
            "a simulation is already running in this process and libsumo holds only one; "
            "close it, make one environment with isolated=True, or drive episodes in worker processes"
        )
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    with tempfile.TemporaryFile() as said, _output_to(said.fileno()):
        try:
            libsumo.start(["sumo", *words, *further])
        except SUMO_ERRORS as error:
            said.seek(0)
            raise Refused(_reason(said.read(), error)) from None
    _is_open = True


def close() -> None:
    """End the SUMO that was started; harmless when none is running."""
    global _is_open
    if _is_open:
        libsumo.close()
        _is_open = False


@contextmanager
def silenced() -> Iterator[None]:
    """Keep to itself what SUMO says: it calls an error what is told as one of ours, or mended."""
    with Path(os.devnull).open("w") as nowhere, _output_to(nowhere.fileno()):
        yield


@contextmanager
def _output_to(file: int) -> Iterator[None]:
    """Send what SUMO says to a file: it writes to the process's streams, past sys.stdout and sys.stderr."""
    kept = {stream: os.dup(stream) for stream in (1, 2)}
    for stream in kept:
        os.dup2(file, stream)
    try:
        yield
    finally:
        for stream, there in kept.items():
            os.dup2(there, stream)
            os.close(there)


def _reason(said: bytes, error: Exception) -> str:
    """Return the first error that SUMO told on standard error; its exception often knows only "Process Error"."""
    lines = (line.strip() for line in said.decode(errors="replace").splitlines())
    told = next((line.removeprefix("Error: ") for line in lines if line.startswith("Error")), str(error))
    return " ".join(without_prefix(told).split())
