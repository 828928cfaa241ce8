"""A session's live view, served on 127.0.0.1 over rerun's gRPC: a second stream of the recording, beside its file.

Images are scaled down; what lies over them keeps the camera's own pixels, as in the file, so that the file can be
opened beside the live view in the same viewer.
"""

from __future__ import annotations

import socket
import threading
from typing import TYPE_CHECKING

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from station.errors import StationError
from station.formats.camera import parse_camera
from station.formats.markers import parse_markers
from station.logs import FloatArray
from station.perception.jpeg import encode_jpeg
from station.perception.observations import FrameMarkers
from station.recording import scene
from station.recording.layout import (
    COMMANDED,
    ELAPSED,
    EVENTS,
    FRAME,
    IMAGE_FRAME,
    LIVE_IMAGE,
    LIVE_IMAGE_FRAME,
    LIVE_STATES,
    MEASURED,
    OVERLAY,
)
from station.recording.rrd_stream import forget_ended_streams, open_stream
from station.seen_columns import SeenColumns
from station.session import SessionDescription

if TYPE_CHECKING:
    from rerun.blueprint import Blueprint

HOST = "127.0.0.1"
# What the server keeps for viewers that connect late; the oldest goes first, what is static stays.
SERVER_MEMORY = "64MiB"
# An image is scaled down, by a whole number, until it is no wider than this.
WIDTH_PX = 800
# Between what is shown and what is sent to viewers, s.
BATCH_S = 0.1
# The server must answer within this, s; at the end, have sent all within that.
START_S = 5.0
END_S = 1.0


def live_address(port: int) -> str:
    """What a viewer connects to: `rerun ADDRESS`."""
    return f"rerun+http://{HOST}:{port}/proxy"


def check_live_port(port: int) -> None:
    """Raise StationError unless the port is free: rerun would say so only at each flush, without naming it."""
    with socket.socket() as probe:
        # As rerun's own server does; otherwise a port stays taken for a minute after the last session.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise StationError(
                f"port {port} of the live view can't be used: {error.strerror}; name another with --port, or none"
            ) from error


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


def scale_of(width_px: int) -> int:
    """By how much an image is scaled down."""
    return -(-width_px // WIDTH_PX)


class LiveStream:
    """Serves what a capture shows to viewers on this machine. All times are ns on the session's clock.

    Args:
        recording_id, name: of the session, as in its file.
        about: what the session is of.
        start_ns: its start on its clock.
        blueprint: the viewer's layout.
        port: of 127.0.0.1.
        seen: the joint states that are detected, if any are.

    Raises:
        StationError: the port is taken; RERUN=off.
    """

    def __init__(
        self,
        recording_id: str,
        name: str,
        about: SessionDescription,
        *,
        start_ns: int,
        blueprint: Blueprint,
        port: int,
        seen: SeenColumns | None = None,
    ) -> None:
        check_live_port(port)
        self._start_ns = start_ns
        self._markers = parse_markers(about.markers, "markers.toml")
        self._in_view = scene.MarkersInView(self._markers)
        self._camera = parse_camera(about.camera, "camera.toml")
        self._scale = scale_of(self._camera.size_px[0])
        self._stream = open_stream(recording_id, BATCH_S)
        try:
            sink = rr.GrpcServerSink(HOST, port, server_memory_limit=SERVER_MEMORY)
            self._stream.set_sinks(sink, default_blueprint=blueprint)
            self._stream.send_recording_name(name)
            self._show_scene(about)
            if seen is not None:
                self._stream.log(LIVE_STATES, scene.seen_series(seen.names, seen.units), static=True)
            self._stream.flush(timeout_sec=START_S)
        except BaseException as error:
            self.close()
            if isinstance(error, StationError) or not isinstance(error, Exception):
                raise
            raise StationError(f"the live view can't be served on port {port}: {error}") from error

    def _show_scene(self, about: SessionDescription) -> None:
        scene.log_camera(self._stream, self._camera)
        scene.log_marker_frames(self._stream, self._markers)
        scaled = rr.Transform3D(scale=self._scale, parent_frame=IMAGE_FRAME, child_frame=LIVE_IMAGE_FRAME)
        self._stream.log(LIVE_IMAGE, scaled, rr.CoordinateFrame(LIVE_IMAGE_FRAME), static=True)
        self._stream.set_time(ELAPSED, duration=np.timedelta64(0, "ns"))
        for entity, values in self._in_view.begin():
            self._stream.log(entity, *values)
        if about.joints:
            self._stream.log(COMMANDED, scene.commanded_series(about.joints, about.units), static=True)
            self._stream.log(MEASURED, scene.measured_series(about.joints, about.units), static=True)

    def show_frame(self, index: int, t_ns: int, image: NDArray[np.uint8], markers: FrameMarkers) -> None:
        """Show a frame (H, W, 3) BGR or (H, W) grey, and its markers."""
        if self._scale > 1:
            size = (image.shape[1] // self._scale, image.shape[0] // self._scale)
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        self._at(t_ns)
        self._stream.set_time(FRAME, sequence=index)
        self._stream.log(LIVE_IMAGE, rr.EncodedImage(contents=encode_jpeg(image), media_type="image/jpeg"))
        self._stream.log(OVERLAY, *scene.outlines(self._markers, markers))
        for entity, values in self._in_view.show(markers):
            self._stream.log(entity, *values)

    def show_readings(self, t_ns: NDArray[np.int64], q: FloatArray, goal: FloatArray) -> None:
        """Show N readings (N,), (N, J), (N, J) in rad or m; a goal is NaN where there is none."""
        elapsed = rr.TimeColumn(ELAPSED, duration=(t_ns - self._start_ns).astype("timedelta64[ns]"))
        counts = np.full(len(t_ns), q.shape[1])
        for entity, states in ((COMMANDED, goal), (MEASURED, q)):
            columns = rr.Scalars.columns(scalars=states.ravel()).partition(counts)
            self._stream.send_columns(entity, indexes=[elapsed], columns=columns)

    def show_detected(self, t_ns: NDArray[np.int64], q: FloatArray) -> None:
        """Show N states (N,), (N, C) in rad or m that were detected; NaN unseen."""
        elapsed = rr.TimeColumn(ELAPSED, duration=(t_ns - self._start_ns).astype("timedelta64[ns]"))
        columns = rr.Scalars.columns(scalars=q.ravel()).partition(np.full(len(t_ns), q.shape[1]))
        self._stream.send_columns(LIVE_STATES, indexes=[elapsed], columns=columns)

    def show_event(self, t_ns: int, level: str, text: str) -> None:
        """Show something that happened; level is INFO, WARN or ERROR."""
        self._at(t_ns)
        self._stream.log(EVENTS, rr.TextLog(text, level=level))

    def close(self) -> None:
        """End the server; viewers keep what they have."""
        ending = threading.Thread(target=self._end, args=(self._stream,), name="live view's end", daemon=True)
        del self._stream
        ending.start()
        ending.join(END_S)

    @staticmethod
    def _end(stream: rr.RecordingStream) -> None:
        stream.disconnect()
        del stream
        forget_ended_streams()

    def _at(self, t_ns: int) -> None:
        self._stream.reset_time()  # `frame` must not stick to what follows
        self._stream.set_time(ELAPSED, duration=np.timedelta64(t_ns - self._start_ns, "ns"))
