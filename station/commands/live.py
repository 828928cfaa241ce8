"""The live view of a capture: checked before anything moves, served once the session begins, opened in a viewer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from station.errors import StationError

if TYPE_CHECKING:
    from rerun.blueprint import Blueprint

    from station.capture.live_view import LiveView
    from station.session import SessionDescription
    from station.view import Viewer

# What a viewer that looks on for hours keeps, the newest.
VIEWER_MEMORY = "1GiB"


class LiveServer:
    """Serves a session that is about to begin, on 127.0.0.1 alone.

    Attributes:
        port: of 127.0.0.1.
        address: what a viewer connects to.
        has_served: whether the session has begun.
    """

    def __init__(self, port: int, viewer: Viewer | None) -> None:
        from station.recording.live import live_address

        self.port, self.address = port, live_address(port)
        self._viewer = viewer
        self.has_served = False

    @contextmanager
    def serving(
        self,
        about: SessionDescription,
        recording_id: str,
        name: str,
        start_ns: int,
        blueprint: Blueprint,
        say: Callable[[str], None],
    ) -> Iterator[LiveView]:
        """Serve a session, while the block runs.

        Args:
            recording_id, name: the session's, as in its file.
            start_ns: the session's start on its clock.
            say: told when the view fails; the session goes on without it.

        Raises:
            StationError: the port has been taken meanwhile.
        """
        from station.capture.live_view import QueuedView
        from station.recording.live import LiveStream

        stream = LiveStream(recording_id, name, about, start_ns=start_ns, blueprint=blueprint, port=self.port)
        self.has_served = True
        if self._viewer is not None:
            try:
                self._viewer.show(self.address)
            except StationError as error:  # closed by the person, it may be; the session is worth more than a window
                say(f"live view: {error}")
        with QueuedView(stream, lambda why: say(f"live view: {why}")) as view:
            yield view


@contextmanager
def live_server(port: int | None = None, *, opens: bool) -> Iterator[LiveServer]:
    """A server for the live view of a session that is captured in the block, and with `opens` a viewer on it.

    The viewer stays open after the block, unless the block fails before there was anything to see.

    Args:
        port: of 127.0.0.1; a free one if None.

    Raises:
        StationError: the port is taken; there is no screen to open the viewer on.
    """
    from station.recording.live import check_live_port, free_port
    from station.view import Viewer

    if port is None:
        port = free_port()
    check_live_port(port)
    if not opens:
        yield LiveServer(port, None)
        return
    viewer = Viewer(["--hide-welcome-screen", "--memory-limit", VIEWER_MEMORY])
    server = LiveServer(port, viewer)
    try:
        yield server
    finally:
        if server.has_served:
            viewer.leave()
        else:
            viewer.close()
