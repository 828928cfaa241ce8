"""A camera that delivers by itself: a thread takes its frames, stamped as they arrive, and counts what is lost."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from drivers.camera import Frame, FrameQueue, Image, Setting, Stamp
from drivers.clock import Clock
from drivers.errors import CameraError, CameraStalled, WrongSize

NS = 1_000_000_000
# A camera may take so long for its first frame, whatever its stall time.
FIRST_FRAME_S = 5.0
# `close` waits no longer than this for the thread; a dead device may hold it for as long as its driver likes.
CLOSE_S = 1.5


@dataclass(frozen=True, eq=False, slots=True)
class Taken:
    """What a source took from its camera.

    Attributes:
        t_ns, stamp, arrived_ns: as in Frame.
        image: None where it couldn't be decoded.
        stale: it is the one before once more.
        lost: frames that the camera took since the one before and that never came.
    """

    t_ns: int
    stamp: Stamp
    image: Image | None
    arrived_ns: int | None = None
    stale: bool = False
    lost: int = 0


class LiveSource(Protocol):
    """An open camera, in the hands of one thread.

    Attributes:
        size_px: (width, height) that it says it gives.
        fps: frames a second that it says it gives; None where it doesn't say.
        settings: what else it says of itself.
    """

    @property
    def size_px(self) -> tuple[int, int]: ...

    @property
    def fps(self) -> float | None: ...

    @property
    def settings(self) -> Mapping[str, Setting]: ...

    def take(self) -> Taken | None:
        """The next frame; None if there was none for a moment. Raises CameraLost where there will be no more."""
        ...

    def release(self) -> None:
        """Let go of the camera."""
        ...


class LiveCamera:
    """Frames from a source, through a thread of its own.

    Frames that nobody reads in time are dropped, oldest first, and counted. A frame that is the one before once more
    (a frozen camera) is counted and not returned.

    Args:
        name: of the camera, as in errors.
        open_source: opens it, within a few seconds; raises NoCamera or another CameraError.
        size_px: (width, height) that the frames must have; None for whatever it gives.
        clock: gives the stamps; it must run by itself.
        stall_s: without a new frame for so long, the camera has stalled.
    """

    def __init__(
        self,
        name: str,
        open_source: Callable[[], LiveSource],
        *,
        size_px: tuple[int, int] | None,
        clock: Clock,
        stall_s: float,
    ) -> None:
        self._name = name
        self._open_source = open_source
        self._want_px = size_px
        self._clock = clock
        self._stall_s = stall_s
        self._source: LiveSource | None = None
        self._queue: FrameQueue[Frame] = FrameQueue()
        self._counts = _Counts()
        self._quiet_until_ns = 0
        self._thread: threading.Thread | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height); raises CameraError where neither was it asked for nor is the camera started."""
        size_px = self._want_px if self._source is None else self._source.size_px
        if size_px is None:
            raise CameraError(f"{self._name}: its frames' size isn't known before start(); call start() first")
        return size_px

    @property
    def fps(self) -> float | None:
        """Frames a second as the camera says after `start`; None before, and where it doesn't say."""
        return None if self._source is None else self._source.fps

    @property
    def dropped(self) -> int:
        """Frames since `start` that the camera took and that were lost before they were read."""
        return self._queue.dropped

    @property
    def stale(self) -> int:
        """Frames since `start` that were the one before once more."""
        return self._counts.stale

    @property
    def settings(self) -> Mapping[str, Setting]:
        """What the camera says of itself; nothing before `start`."""
        return {} if self._source is None else self._source.settings

    def start(self) -> None:
        """Open the camera, read its settings back and start taking frames.

        Raises:
            NoCamera: there is no such camera, it can't be opened, or it refuses a setting.
            WrongSize: it gives frames of another size.
        """
        self.close()
        source = self._open_source()
        try:
            _check_size(self._name, source.size_px, self._want_px or source.size_px)
        except CameraError:
            source.release()
            raise
        self._source, self._queue, self._counts = source, FrameQueue(), _Counts()
        self._quiet_until_ns = self._clock.now_ns() + round(max(self._stall_s, FIRST_FRAME_S) * NS)
        self._thread = threading.Thread(
            target=self._run, args=(source, self._queue, self._counts), name="camera", daemon=True
        )
        self._thread.start()

    def read(self, until_ns: int) -> Frame | None:
        """The next frame as soon as it is there; None if none came by `until_ns`.

        Raises:
            CameraStalled: no new frame came for the stall time; CameraLost where the camera vanished.
            CameraError: the camera isn't started, or gives frames of another size.
        """
        if self._thread is None:
            raise CameraError(f"{self._name}: read before start(); call start() first")
        frame = self._queue.get_until(min(until_ns, self._quiet_until_ns), self._clock)
        if frame is not None:
            heard_ns = frame.t_ns if frame.arrived_ns is None else frame.arrived_ns
            self._quiet_until_ns = heard_ns + round(self._stall_s * NS)
            return frame
        if self._clock.now_ns() >= self._quiet_until_ns:
            raise self._stalled()
        return None

    def close(self) -> None:
        """Stop and release the camera. A thread that a dead device holds is left to end by itself."""
        self._queue.close()
        if self._thread is not None:
            self._thread.join(CLOSE_S)
            self._thread = None

    def _stalled(self) -> CameraStalled:
        again = self._counts.stale_in_a_row
        frozen = f"; the same picture came {again} times: it is frozen, or its lens covered" if again else ""
        waited_s = self._stall_s if self._counts.fresh else max(self._stall_s, FIRST_FRAME_S)
        return CameraStalled(
            f"{self._name}: no new frame for {waited_s:g} s, after {self._counts.fresh} frames{frozen}\n"
            "check its cable, and that no other program uses it; then start again"
        )

    def _run(self, source: LiveSource, queue: FrameQueue[Frame], counts: _Counts) -> None:
        """The thread: takes frames until the reader has gone or something breaks."""
        try:
            while not queue.closed:
                taken = source.take()
                if taken is not None:
                    self._sort(taken, queue, counts)
        except Exception as error:  # whatever it is, it is the reader's: `read` raises it
            queue.fail(error)
        finally:
            source.release()

    def _sort(self, taken: Taken, queue: FrameQueue[Frame], counts: _Counts) -> None:
        """Put a frame in the queue, or count what is wrong with it."""
        counts.index += taken.lost
        queue.count_dropped(taken.lost)
        if taken.stale:
            counts.stale += 1
            counts.stale_in_a_row += 1
            return
        counts.stale_in_a_row = 0
        if taken.image is None:
            queue.count_dropped(1)
        else:
            have = (taken.image.shape[1], taken.image.shape[0])
            _check_size(f"{self._name}: frame {counts.index}", have, self.size_px)
            queue.put(Frame(counts.index, taken.t_ns, taken.image, taken.stamp, taken.arrived_ns))
            counts.fresh += 1
        counts.index += 1


@dataclass(slots=True)
class _Counts:
    """What the thread counts: the next frame's index, frames put in the queue, stale ones, and those of late."""

    index: int = 0
    fresh: int = 0
    stale: int = 0
    stale_in_a_row: int = 0


def _check_size(where: str, have: tuple[int, int], want: tuple[int, int]) -> None:
    if have != tuple(want):
        raise WrongSize(
            f"{where}: it gives {have[0]}x{have[1]} px; want {want[0]}x{want[1]}\n"
            "set the size to one that it has, with a calibration made at that size"
        )
