"""The way of a capture's frames: camera, detection, recorder, each in its own thread."""

from __future__ import annotations

from drivers.camera import Frame
from station.capture.camera_thread import CameraThread
from station.capture.counts import Tally
from station.capture.detection import Detection, Found
from station.capture.journal import Journal
from station.capture.live_view import LiveView
from station.rig import Rig


class FrameLine:
    """Frames on their way from the camera to the recording.

    They are recorded only between `open` and `close`, by their own stamps: what came before the motion, or while it
    was held, shows an arm that does something else than was planned. A frame whose stamp isn't after that of the one
    before counts as dropped: of two that a network camera gave at once, nobody knows when the second was taken.

    Args:
        found: gets each frame that is to be recorded, with its markers, in detection's thread.
    """

    def __init__(self, rig: Rig, found: Found, journal: Journal, tally: Tally, live: LiveView | None) -> None:
        self._clock, self._tally = rig.clock, tally
        self.detection = Detection(rig, found, tally, live, waits=rig.virtual)
        self.camera = CameraThread(rig.camera, rig.clock, self._take, journal, tally, rig.table.camera.reconnect_s)
        self._since_ns: int | None = None
        self._lost_before = (0, 0)
        self._last_ns = -1

    def start(self) -> None:
        """Begin to read the camera; from a thread that has its turn."""
        self.detection.start()
        self.camera.start()

    def check(self) -> None:
        """Raise what went wrong with the camera or in detection, if anything did."""
        self.camera.check()
        self.detection.check()

    def open(self) -> None:
        """Record frames from now on."""
        self._lost_before = self.camera.lost
        self._since_ns = self._clock.now_ns()

    def close(self) -> None:
        """Record no more frames, for now."""
        dropped, stale = self.lost_since_open
        self._since_ns = None
        self._tally.add("dropped_by_camera", dropped)
        self._tally.add("stale_frames", stale)

    @property
    def is_open(self) -> bool:
        """Whether frames are recorded now."""
        return self._since_ns is not None

    @property
    def lost_since_open(self) -> tuple[int, int]:
        """Frames that the camera dropped, and stale ones, since the line was opened; none where it is closed."""
        if self._since_ns is None:
            return 0, 0
        dropped, stale = self.camera.lost
        return dropped - self._lost_before[0], stale - self._lost_before[1]

    def ask_to_end(self) -> None:
        """Record and read no further frames; from a thread that has its turn, before it gives that up."""
        self.close()
        self.camera.ask_to_end()

    def end(self) -> None:
        """Wait until the camera's thread has ended and all frames are detected; not from a thread in its turn."""
        self.camera.end()
        self.detection.end()

    def _take(self, frame: Frame) -> None:
        since_ns = self._since_ns
        if frame.t_ns <= self._last_ns:
            self._tally.add("dropped_by_camera" if since_ns is not None else "frames_outside")
            return
        self._last_ns = frame.t_ns
        if since_ns is not None and frame.t_ns >= since_ns:
            self.detection.offer(frame)
        else:
            self._tally.add("frames_outside")
            self.detection.show(frame)
