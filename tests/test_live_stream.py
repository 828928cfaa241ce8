"""The live view's server: on this machine only, bounded, and what it serves is the session's own recording."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from station.errors import StationError
from station.recording.live import HOST, LiveStream, check_live_port, free_port, live_address, scale_of
from station.view import Viewer, session_blueprint
from tests.listening import listening
from tests.made_sessions import JOINTS, START_NS, describe, make_frames


@contextmanager
def served(port: int | None = None) -> Iterator[tuple[LiveStream, int]]:
    port = port or free_port()
    stream = LiveStream(
        "made", "session", describe(), start_ns=START_NS, blueprint=session_blueprint(JOINTS), port=port
    )
    try:
        yield stream, port
    finally:
        stream.close()


def show(stream: LiveStream, count: int) -> None:
    for frame in make_frames(count):
        stream.show_frame(frame.index, frame.t_ns, frame.image, frame.markers)
        stream.show_readings(np.array([frame.request_ns]), frame.reading[None], frame.command[None])
        stream.show_event(frame.t_ns, "INFO", f"frame {frame.index}")


def test_the_live_view_listens_on_this_machine_only():
    before = listening()
    with served() as (stream, port):
        show(stream, 3)
        assert listening() - before == {f"0100007F:{port:04X}"}
    assert listening() == before


def test_a_port_that_is_taken_is_told_before_anything_is_served():
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(StationError, match=f"port {port} of the live view can't be used.*--port"):
            check_live_port(port)
        with pytest.raises(StationError, match=f"port {port}"), served(port):
            pass


def test_a_port_is_free_again_after_the_live_view():
    with served() as (_, port):
        pass
    check_live_port(port)


@contextmanager
def viewing(*arguments: str) -> Iterator[Viewer]:
    """A viewer without a window; skips the test where it can't draw."""
    with Viewer(arguments, headless=True) as viewer:
        if (reason := viewer.ended()) is not None:
            pytest.skip(reason.splitlines()[0])
        yield viewer


@pytest.mark.vulkan
def test_a_viewer_that_stands_still_or_dies_does_not_hold_up_the_live_view():
    with served() as (stream, port), viewing(live_address(port)) as viewer:
        os.kill(viewer.pid, signal.SIGSTOP)
        show(stream, 300)
        os.kill(viewer.pid, signal.SIGKILL)
        show(stream, 300)


@pytest.mark.vulkan
def test_a_viewer_shows_the_sessions_recording_in_its_layout_and_keeps_it_after_the_end():
    from rerun.experimental import ViewerClient

    with viewing() as viewer:
        client = ViewerClient.connect(f"rerun+http://{HOST}:{viewer.port}/proxy")
        with served() as (stream, port):
            client.open([live_address(port)])
            show(stream, 30)
        deadline = time.monotonic() + 20.0
        while time.monotonic() < deadline:  # what comes bit by bit is all there at some time
            state = client.get_state()
            if state.views and not any(view.reports for view in state.views):
                break
            time.sleep(0.1)
    assert [recording.store_id for recording in state.recordings] == ["Recording:station:made"]
    assert {view.name for view in state.views} == {"space", "camera", "joints", *JOINTS, "servos", "log"}
    assert [report.summary for view in state.views for report in view.reports] == []


@pytest.mark.parametrize(("width_px", "scale"), [(640, 1), (800, 1), (801, 2), (1920, 3)])
def test_large_images_are_shown_smaller(width_px: int, scale: int):
    assert scale_of(width_px) == scale
