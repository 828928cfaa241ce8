"""The application that the commands are added to, and the options of all of them."""

from __future__ import annotations

from typing import Annotated

import typer

app = typer.Typer(
    name="station",
    help="Watch a marked mechanism move, discover its joints, and compare the detected angles with the commands.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

# Its commands join it as those of the application do; it joins the application when it has one.
calibrate = typer.Typer(
    name="calibrate",
    help="Calibrate the camera, the servos' zeros, the camera's latency.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


def _print_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"station {version('capture-fit-station')}")
        raise typer.Exit


@app.callback()
def _options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Options of all commands; --debug is taken out by `main`, which catches the errors."""
