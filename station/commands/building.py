"""The tree builder in the browser."""

from __future__ import annotations

import os
import sys
import webbrowser
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from station.builder.page.builder import Builder

HOST = "127.0.0.1"


def build(tree: str | None = None, *, host: str = HOST, port: int | None = None) -> AbstractContextManager[Builder]:
    """The tree builder, served while the context is entered.

    Args:
        tree: a kinematics.json or URDF, a fit's folder, a packaged example's name, or None for a draft of one part.
        host: address of this machine; on any but 127.0.0.1 whoever reaches it may edit, and write files.
        port: a free one if None.

    Raises:
        InvalidFile: the tree is missing, or no tree.
        StationError: the port is taken, or the extra `gui` isn't installed.
    """
    from station.builder.page.server import check_gui, chosen_port

    check_gui()
    chosen = chosen_port(host, port)
    from station.builder.page.builder import building

    return building(tree, host, chosen)


def write_rig(tree: str, out: Path, *, by_hand: bool = False) -> tuple[str, ...]:
    """Write a rig whose simulation is a tree, with a rendered camera; what may go wrong in a capture, in sentences.

    Args:
        tree: a kinematics.json or URDF, a fit's folder, or a packaged example's name.
        out: a .toml that isn't there yet.
        by_hand: without servos, for `capture --hand`.

    Raises:
        StationError: a tree that can't be read or can't be a rig, a file that is there or can't be written.
    """
    from station.builder.rigs import write_rig

    return write_rig(tree, out, servos=not by_hand).remarks


def open_browser(url: str) -> bool:
    """Open a browser on it, if this machine has a screen; whether one was opened."""
    if sys.platform == "linux" and not any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY"))):
        return False  # a browser for terminals would take over this one
    return webbrowser.open(url)
