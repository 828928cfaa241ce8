"""The servo bus: an emulated one for other programs."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Annotated

import typer

from station.cli.app import app
from station.cli.options import RigArgument, Seed
from station.cli.show import say_next

FAULTS_HELP = "What goes wrong when, such as mute:3@2+1; may be repeated. docs/emulator.md lists them."


@app.command()
def emulate(
    rig: RigArgument,
    faults: Annotated[list[str] | None, typer.Option("--faults", metavar="SPEC", help=FAULTS_HELP)] = None,
    link: Annotated[
        Path | None, typer.Option("--link", help="Path of the device; must be free.", show_default=False)
    ] = None,
    seed: Seed = None,
) -> None:
    """Put a rig's servos on a pseudo-terminal, for any other program.

    The first line of standard output is the device's path. Runs until it is stopped with Ctrl-C or SIGTERM.
    """
    from station.emulation import emulate as open_emulation

    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job has it ignored
    specs = [spec for group in faults or [] for spec in group.split()]
    with open_emulation(rig, faults=specs, link=link, seed=seed) as arm:
        print(arm.path, flush=True)
        say_next(f"{rig}: {arm.summary()}; stop it with Ctrl-C")
        arm.wait()
