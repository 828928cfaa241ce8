"""The live view of a capture: checked before anything moves, served once the session begins, opened in a viewer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from station.errors import StationError

if TYPE_CHECKING:
    from station.capture.live_view import LiveView
    from station.recording import RecordingWriter
    from station.seen_columns import SeenColumns
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
        self, name: str, writer: RecordingWriter, now_ns: Callable[[], int], seen: SeenColumns | None = None
    ) -> Iterator[LiveView]:
        """Serve a session, while the block runs; a view that fails is told in its recording, and does no harm to it.

        Args:
            name: of the session.
            writer: of its recording.
            now_ns: the session's clock.
            seen: the joint states that are detected, if any are.

        Raises:
            StationError: the port has been taken meanwhile.
        """
        from station.capture.live_view import QueuedView
        from station.recording.live import LiveStream
        from station.view import session_blueprint

        def say(why: object) -> None:
            with suppress(StationError):  # the recording is closed, or has failed itself
                writer.log_event(now_ns(), "WARN", f"live view: {why}")

        about = writer.description
        blueprint = session_blueprint(about.joints)
        stream = LiveStream(
            writer.recording_id, name, about, start_ns=writer.start_ns, blueprint=blueprint, port=self.port, seen=seen
        )
        self.has_served = True
        if self._viewer is not None:
            try:
                self._viewer.show(self.address)
            except StationError as error:  # closed by the person, it may be; the session is worth more than a window
                say(error)
        with QueuedView(stream, say) as view:
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
