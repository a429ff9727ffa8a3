"""The command line: parses, calls, prints."""

# Rollout workers import this package again, and `--help` is to be quick: what is slow to import (torch, pandas, SUMO)
# is imported by the command that needs it.
import signal
import sys
from importlib.metadata import version
from typing import Annotated

import typer

from rail_sumo import assets
from rail_sumo.cli import drive, learn, look, study  # noqa: F401  each hangs its commands on the tree
from rail_sumo.cli.apps import app
from rail_sumo.cli.world import choice_of
from rail_sumo.errors import InputError

__all__ = ["app", "choice_of", "main"]


def main() -> None:
    """Run the command line. A user's mistake is one line on stderr and exit code 2."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # what a cluster or `timeout` sends is as Ctrl-C
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except InputError as error:
        print(f"rail-sumo: {error}", file=sys.stderr)
    except typer.TyperException as error:
        if said := error.format_message():  # it is empty where the help was printed
            said = said.replace("Value error, ", "")  # pydantic's
            print(f"rail-sumo: {said[0].lower()}{said[1:].rstrip('.?')}; see --help", file=sys.stderr)
    sys.exit(2)


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
