"""The command line's tree, which the commands are hung on."""

import typer

INTERRUPTED = 130
"""The exit code after Ctrl-C, as shells have it."""

app = typer.Typer(
    help="Learn a highway driver from demonstrations, and drive it in SUMO on your own roads.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
expert = typer.Typer(help="Train the expert; record demonstrations of any driver.", no_args_is_help=True)
network = typer.Typer(help="Look at networks before driving on them.", no_args_is_help=True)
app.add_typer(expert, name="expert", rich_help_panel="Learn")
app.add_typer(network, name="network", rich_help_panel="Look")
