"""The tree builder in the browser."""

from __future__ import annotations

import json
import signal
import threading
from pathlib import Path
from typing import Annotated

import typer

from station.cli.app import app
from station.cli.options import Json
from station.cli.show import say_next, warn

HOST = "127.0.0.1"


@app.command()
def build(
    tree: Annotated[
        str | None,
        typer.Argument(
            metavar="TREE",
            help="kinematics.json, URDF, a fit's folder, or a packaged tree such as swivel_chair; else one part.",
            show_default=False,
        ),
    ] = None,
    port: Annotated[
        int | None,
        typer.Option("--port", min=1, max=65535, help="Port of the page; else a free one.", show_default=False),
    ] = None,
    host: Annotated[
        str, typer.Option("--host", help="Address to serve on; whoever reaches another than this may edit and save.")
    ] = HOST,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open a browser on the page.")] = True,
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig",
            metavar="OUT.toml",
            help="Write a rig whose simulation is TREE, with a rendered camera, and open no page.",
            show_default=False,
        ),
    ] = None,
    by_hand: Annotated[bool, typer.Option("--by-hand", help="With --rig: moved by hand, without servos.")] = False,
    as_json: Json = False,
) -> None:
    """Draw an articulated object in the browser, move it, and see whether a fit finds it.

    Needs the extra 'gui'. The first line of standard output is the page's address. Runs until it is stopped with Ctrl-C
    or SIGTERM; what isn't saved then is kept beside its file.
    """
    if rig is not None or by_hand:
        _write_rig(tree, rig, by_hand=by_hand, as_json=as_json)
        return
    from station.commands import building

    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job has it ignored
    with building.build(tree, host=host, port=port) as builder:
        try:
            if builder.was_recovered:
                warn(f"took up unsaved changes of {builder.path.name}; undo goes back to what was saved")
            if host != HOST:
                warn(f"whoever reaches {host} may edit this tree, and write files that you may write")
            about = {"address": builder.address, "file": str(builder.path)}
            print(json.dumps(about) if as_json else builder.address, flush=True)
            if not browser or not building.open_browser(builder.address):
                say_next(f"open {builder.address} in a browser; Ctrl-C ends it")
            threading.Event().wait()
        finally:
            left = builder.left()
            if left is not None:
                say_next(left)


def _write_rig(tree: str | None, out: Path | None, *, by_hand: bool, as_json: bool) -> None:
    from station.commands import building

    if tree is None or out is None:
        raise typer.BadParameter("a rig is made with --rig OUT.toml of a TREE; name both")
    remarks = building.write_rig(tree, out, by_hand=by_hand)
    if as_json:
        print(json.dumps({"rig": str(out), "remarks": remarks}))
    for remark in remarks:
        warn(remark)
    capture = f"station capture {out} --hand --out DIR" if by_hand else f"station run {out} explore --out DIR"
    say_next(f"rig           {out}", f"capture it    {capture}")
