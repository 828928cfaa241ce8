"""Writes what a capture records in a thread of its own, so that neither the servo loop nor detection waits for a disk.

With the recorder behind, pictures are left out first (a fit needs the corners), then frames.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from numpy.typing import ArrayLike, NDArray

from drivers.arm import ArmReading
from drivers.camera import Frame, Image
from drivers.safety import ServoState
from station.capture.counts import CaptureCounts, Tally
from station.capture.worker import Worker
from station.logs import FloatArray
from station.perception.observations import FrameMarkers
from station.seen_columns import SeenColumns

# A quarter of a second at 30 frames/s: what waits is lost to a kill.
FRAMES_WAITING = 8
# Rows are small: a minute of them may wait for a disk that is busy.
ROWS_WAITING = 10_000
# Of the places for frames: with more taken, the picture is left out.
PICTURES_UP_TO = 0.5


class SessionWriter(Protocol):
    """What writes a session's recording; `station.recording.RecordingWriter` does."""

    def log_command(self, t_ns: int, q: ArrayLike) -> None: ...

    def log_reading(
        self, t_request_ns: int, t_reply_ns: int, q: ArrayLike, t_joint_ns: ArrayLike | None = None
    ) -> None: ...

    def log_servos(self, t_ns: int, states: Mapping[int, ServoState]) -> None: ...

    def log_live_states(
        self, t_ns: int, q: ArrayLike, std: ArrayLike, columns: Sequence[str], units: Sequence[str]
    ) -> None: ...

    def log_event(self, t_ns: int, level: str, text: str) -> None: ...

    def log_frame(self, index: int, t_ns: int, image: bytes | Image | None, markers: FrameMarkers) -> None: ...

    def checkpoint(
        self, leg: int, legs: int, counts: Mapping[str, int] | None = None, motion: str | None = None
    ) -> None: ...

    def close(self, state: str, counts: Mapping[str, int] | None = None) -> None: ...


class Recorder:
    """Takes what is to be recorded, from any thread, and has it written in order.

    Args:
        waits: on a virtual clock: nothing is lost, whoever records waits.
    """

    def __init__(self, writer: SessionWriter, tally: Tally, *, waits: bool) -> None:
        self._writer, self._tally = writer, tally
        limits = {"frame": FRAMES_WAITING, "row": ROWS_WAITING}
        self._worker: Worker[Callable[[], None]] = Worker("recorder", _do, limits, waits=waits)
        self.start, self.check = self._worker.start, self._worker.check

    def event(self, t_ns: int, level: str, text: str) -> None:
        """Something that happened."""
        self._worker.give("row", lambda: self._writer.log_event(t_ns, level, text))

    def command(self, t_ns: int, q: FloatArray) -> None:
        """The joint states that are commanded."""
        self._row(lambda: self._writer.log_command(t_ns, q))

    def reading(self, reading: ArmReading) -> None:
        """The joint states that the servos reported."""
        self._row(
            lambda: self._writer.log_reading(reading.t_request_ns, reading.t_reply_ns, reading.q, reading.t_joint_ns)
        )

    def servos(self, reading: ArmReading) -> None:
        """What the servos said of themselves."""
        self._row(lambda: self._writer.log_servos(reading.t_ns, reading.servos))

    def live_states(self, t_ns: int, q: FloatArray, std: FloatArray, columns: SeenColumns) -> None:
        """The joint states that were detected in a frame, by a tree that was known."""
        self._row(lambda: self._writer.log_live_states(t_ns, q, std, columns.names, columns.units))

    def checkpoint(self, leg: int, legs: int, counts: CaptureCounts, motion: str | None = None) -> None:
        """A leg of the plan begins, by a new motion.toml if there is one; all that belongs before it has been given."""
        self._worker.give("row", lambda: self._writer.checkpoint(leg, legs, counts.as_dict(), motion))

    def frame(self, frame: Frame, markers: FrameMarkers) -> None:
        """A frame and its markers; drops what there is no time for, and counts it."""
        image: NDArray | None = frame.image
        if self._worker.fullness("frame") > PICTURES_UP_TO and not self._worker.waits:
            image = None

        def write() -> None:
            self._writer.log_frame(frame.index, frame.t_ns, image, markers)
            self._tally.add("frames")

        if not self._worker.offer("frame", write):
            self._tally.add("dropped_by_recorder")
        elif image is None:
            self._tally.add("images_left_out")

    def end(self) -> None:
        """Wait until all is written."""
        self._worker.end()

    def _row(self, write: Callable[[], None]) -> None:
        if not self._worker.offer("row", write):
            self._tally.add("readings_lost")


def _do(work: Callable[[], None]) -> None:
    work()
