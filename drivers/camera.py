"""What a camera is to the station: frames with stamps, in order, with the lost ones counted."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock
from drivers.errors import CameraError

Image = NDArray[np.uint8]

# Frames that wait for a reader who is busy: a quarter of a second at 30 fps.
QUEUE_FRAMES = 8
# Seconds between two looks at the clock while waiting for a frame.
LOOK_S = 0.02


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """One image of a camera.

    Attributes:
        index: counts the frames that the camera took, from 0; a dropped frame leaves a gap.
        t_ns: the clock when the frame arrived, before it was decoded.
        image: (H, W, 3) uint8 BGR.

    Raises:
        CameraError: for an image of another shape or type.
    """

    index: int
    t_ns: int
    image: Image

    def __post_init__(self) -> None:
        if self.image.ndim != 3 or self.image.shape[2] != 3 or self.image.dtype != np.uint8:
            have = f"shape {self.image.shape} of {self.image.dtype}"
            raise CameraError(f"frame {self.index}: the image has {have}; want (height, width, 3) of uint8")


class Camera(Protocol):
    """A source of frames.

    Attributes:
        size_px: (width, height).
        fps: frames a second, nominal.
        dropped: frames that the camera took and `read` never returned, so far.
    """

    @property
    def size_px(self) -> tuple[int, int]: ...

    @property
    def fps(self) -> float: ...

    @property
    def dropped(self) -> int: ...

    def start(self) -> None:
        """Open the device and start taking frames."""
        ...

    def read(self, until_ns: int) -> Frame | None:
        """The next frame as soon as it is there; None once the clock reads `until_ns` if none arrived by then."""
        ...

    def close(self) -> None:
        """Stop and let go of the device; harmless when it isn't open. May be started again."""
        ...


class FrameQueue:
    """A few frames between the thread that takes them and the one that reads them.

    A full queue loses its oldest frame, as a reader wants the newest, and counts it.
    """

    def __init__(self, limit: int = QUEUE_FRAMES) -> None:
        self._frames: deque[Frame] = deque()
        self._limit = limit
        self._changed = threading.Condition()
        self._dropped = 0
        self._error: Exception | None = None
        self._closed = False

    @property
    def dropped(self) -> int:
        """Frames lost so far."""
        with self._changed:
            return self._dropped

    @property
    def closed(self) -> bool:
        """Whether the reader has gone."""
        with self._changed:
            return self._closed

    def put(self, frame: Frame) -> None:
        """Append a frame; loses the oldest if there are too many."""
        with self._changed:
            if len(self._frames) >= self._limit:
                self._frames.popleft()
                self._dropped += 1
            self._frames.append(frame)
            self._changed.notify_all()

    def put_waiting(self, frame: Frame) -> None:
        """Append a frame as soon as there is room; nothing is lost. Returns without it if the queue is closed."""
        with self._changed:
            self._changed.wait_for(lambda: len(self._frames) < self._limit or self._closed)
            if not self._closed:
                self._frames.append(frame)
                self._changed.notify_all()

    def count_dropped(self, frames: int) -> None:
        """Count frames that were lost before they got here."""
        with self._changed:
            self._dropped += frames

    def fail(self, error: Exception) -> None:
        """Let the reader get `error` once the frames before it are read."""
        with self._changed:
            self._error = error
            self._changed.notify_all()

    def close(self) -> None:
        """Let go of a thread that waits for room."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def get(self, timeout_s: float) -> Frame | None:
        """The oldest frame, or None if there is none within `timeout_s`; raises what `fail` was told."""
        with self._changed:
            self._changed.wait_for(lambda: self._frames or self._error is not None, timeout_s)
            if self._frames:
                self._changed.notify_all()
                return self._frames.popleft()
            if self._error is not None:
                raise self._error
            return None

    def get_until(self, until_ns: int, clock: Clock) -> Frame | None:
        """The oldest frame, or None once `clock` reads `until_ns`, looking at the clock every LOOK_S seconds."""
        while True:
            left_s = (until_ns - clock.now_ns()) * 1e-9
            frame = self.get(min(max(left_s, 0.0), LOOK_S))
            if frame is not None or left_s <= 0:
                return frame
