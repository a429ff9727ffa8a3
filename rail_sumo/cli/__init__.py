"""The command line: parses, calls, prints."""

# Rollout workers import this package again, and `--help` is to be quick: what is slow to import (torch, pandas, SUMO)
# is imported by the command that needs it.
import math
import os
import signal
import sys
import time
from importlib.metadata import version
from typing import Annotated

import typer

from rail_sumo import assets
from rail_sumo.cli import drive, learn, look, study  # noqa: F401  each hangs its commands on the tree
from rail_sumo.cli.apps import INTERRUPTED, app
from rail_sumo.cli.world import choice_of
from rail_sumo.errors import InputError

__all__ = ["app", "choice_of", "main"]

AT_ONCE_S = 1.0
"""A second signal within this belongs to the first."""


def main() -> None:
    """Run the command line. A user's mistake is one line on stderr and exit code 2."""
    _heed_interrupts()
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except InputError as error:
        print(f"rail-sumo: {error}", file=sys.stderr)
    except typer.TyperException as error:
        if said := error.format_message():  # it is empty where the help was printed
            said = said.replace("Value error, ", "")  # pydantic's
            print(f"rail-sumo: {said[0].lower()}{said[1:].rstrip('.?')}; see --help", file=sys.stderr)
    sys.exit(2)


def _heed_interrupts() -> None:
    """Have what a cluster or `timeout` sends be as Ctrl-C, of which a second one ends the program at once.

    Unless it comes right after the first, as `timeout` sends it: it would fall into the ending of the workers.
    """
    first_s = math.inf

    def interrupt(*_: object) -> None:
        nonlocal first_s
        if math.isinf(first_s):
            first_s = time.monotonic()
            raise KeyboardInterrupt
        if time.monotonic() > first_s + AT_ONCE_S:
            os._exit(INTERRUPTED)

    signal.signal(signal.SIGTERM, interrupt)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as in the background of a script
        signal.signal(signal.SIGINT, interrupt)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"rail-sumo {assets.own_version()} with SUMO {version('libsumo')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the versions and exit.")
    ] = False,
) -> None: ...
