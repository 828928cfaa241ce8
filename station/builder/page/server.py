"""The server of the page: viser on one address that is said beforehand, quiet, and for this page alone."""

from __future__ import annotations

import io
import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from functools import partial
from typing import TYPE_CHECKING

from station.errors import StationError

if TYPE_CHECKING:
    from viser import ViserServer

HOST = "127.0.0.1"
LOOPBACK = ("127.0.0.1", "localhost", "::1")
# Columns of the page that the controls take, px: three numbers side by side can be read.
PANEL_WIDTH_PX = 400


def check_gui() -> None:
    """Raise StationError unless the extra `gui` is installed."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise StationError(
            "the tree builder needs the package viser, which isn't installed\n"
            "install the station with its extra: pip install 'capture-fit-station[gui]'"
        ) from error


def chosen_port(host: str, port: int | None) -> int:
    """The port to serve on: the one asked for, or a free one.

    viser would take the next free one without a word, and wait for ever on a host that isn't this machine's.

    Raises:
        StationError: the port is taken, or the host is no address of this machine.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port or 0))
        except OSError as error:
            where = f"{host}:{port}" if port else host
            raise StationError(
                f"can't serve the builder on {where}: {error.strerror or error}\n"
                "name another port with --port or none for a free one; --host must be an address of this machine"
            ) from error
        return probe.getsockname()[1]


def address(host: str, port: int) -> str:
    """What the browser is given: an address that leads to this machine."""
    name = {"0.0.0.0": HOST, "::": "::1"}.get(host, host)
    return f"http://[{name}]:{port}" if ":" in name else f"http://{name}:{port}"


@contextmanager
def serving(host: str, port: int) -> Iterator[ViserServer]:
    """A viser server while the block runs; at its end the port is free and its threads have ended.

    It asks nothing of other machines: the page, its fonts and its scripts come from viser's own package, and the button
    that shares a page over the internet is away. Served to this machine alone it takes no orders from the pages of
    others that are open in the same browser.

    Args:
        port: a free one, as of `chosen_port`.

    Raises:
        StationError: viser isn't there, or somebody else has taken the port meanwhile.
    """
    check_gui()
    with _own_pages_only(host, port), redirect_stdout(io.StringIO()):  # it prints a banner
        from viser import ViserServer

        server = ViserServer(host=host, port=port, verbose=False)
    try:
        if server.get_port() != port:
            raise StationError(f"port {port} has been taken meanwhile; start the builder again")
        server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(PANEL_WIDTH_PX)
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


@contextmanager
def _own_pages_only(host: str, port: int) -> Iterator[None]:
    """While a server is made in the block, have its websocket refuse pages that didn't come from it.

    A browser lets any page open a websocket to this machine; the Origin header tells which page asks. viser passes no
    list of origins on to the library of websockets, which has a parameter for it. On another host than this machine's
    own the names by which people reach it aren't known: there it doesn't hold.
    """
    if host not in LOOPBACK:
        yield
        return
    import websockets.asyncio.server as library

    own = re.compile(rf"http://(127\.0\.0\.1|localhost|\[::1\]):{port}")
    serve = library.serve
    library.serve = partial(serve, origins=[own, None])  # None: it isn't a browser that asks
    try:
        yield
    finally:
        library.serve = serve
