"""Detects the markers of a capture's frames and records both, in a thread of its own."""

from __future__ import annotations

import queue
import threading
from types import TracebackType

from drivers.camera import Frame
from station.perception.marker_tracker import MarkerTracker
from station.recording import RecordingWriter
from station.rig import Rig
from station.tracking import observe

QUEUED_FRAMES = 32


class FrameWorker:
    """Detects the markers of frames and records both, one frame after another, in a thread of its own.

    Raises, from `put` and on leaving, what went wrong in the thread.
    """

    def __init__(self, rig: Rig, writer: RecordingWriter) -> None:
        self._rig = rig
        self._writer = writer
        ids = [marker.id for marker in rig.markers.markers]
        self._detector = MarkerTracker(rig.markers.dictionary, rig.camera_model, ids)
        self._frames: queue.Queue[Frame | None] = queue.Queue(QUEUED_FRAMES)
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="frames", daemon=True)
        self.recorded = 0
        self.dropped = 0

    def __enter__(self) -> FrameWorker:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._frames.put(None)
        self._thread.join()
        if kind is None:
            self._check()

    def put(self, frame: Frame) -> None:
        """Hand over a frame; with no place left, waits on a virtual clock, drops and counts it on a real one."""
        self._check()
        try:
            self._frames.put(frame, block=self._rig.virtual)
        except queue.Full:
            self.dropped += 1

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        while (frame := self._frames.get()) is not None:
            if self._failure is not None:
                continue  # drain, so that nobody waits on a full queue
            try:
                self._record(frame)
            except BaseException as error:  # carried to the thread that can act on it
                self._failure = error

    def _record(self, frame: Frame) -> None:
        found = self._detector.detect(frame.image)
        markers = observe(found, self._rig.markers, self._rig.camera_model)
        self._writer.log_frame(frame.index, frame.t_ns, frame.image, markers)
        self.recorded += 1
