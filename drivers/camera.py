"""What a camera is to the station: frames with stamps, in order, with the lost ones counted."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock
from drivers.errors import CameraError

Image = NDArray[np.uint8]
# What a stamp is: the clock when the frame arrived, the camera driver's own, or the file's own.
Stamp = Literal["arrival", "driver", "file"]
Setting = str | float | bool | None
Item = TypeVar("Item")

# Frames that wait for a reader who is busy: a quarter of a second at 30 fps.
QUEUE_FRAMES = 8
# Seconds without a new frame after which a camera has stalled, where nobody says otherwise.
STALL_S = 2.0
# Seconds between two looks at the clock while waiting for a frame.
LOOK_S = 0.02


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """One image of a camera.

    Attributes:
        index: counts the frames that the camera took, from 0; a dropped frame leaves a gap.
        t_ns: its time on the clock, taken before it was decoded.
        image: (H, W, 3) uint8 BGR.
        stamp: what `t_ns` is.
        arrived_ns: the clock when it arrived, where `t_ns` is the driver's own stamp.

    Raises:
        CameraError: for an image of another shape or type.
    """

    index: int
    t_ns: int
    image: Image
    stamp: Stamp = "arrival"
    arrived_ns: int | None = None

    def __post_init__(self) -> None:
        if self.image.ndim != 3 or self.image.shape[2] != 3 or self.image.dtype != np.uint8:
            have = f"shape {self.image.shape} of {self.image.dtype}"
            raise CameraError(f"frame {self.index}: the image has {have}; want (height, width, 3) of uint8")


@dataclass(frozen=True)
class Controls:
    """What to lock, and at what; None leaves it as the camera has it.

    Attributes:
        pixel_format: four characters as V4L2 has them, such as "MJPG" or "YUYV".
        exposure_ms: time of the exposure, no longer automatic.
        focus: position of the lens in the camera's own steps, no longer automatic.
        gain: in the camera's own steps.
        white_balance_k: colour temperature, no longer automatic.
    """

    pixel_format: str | None = None
    exposure_ms: float | None = None
    focus: float | None = None
    gain: float | None = None
    white_balance_k: float | None = None


class Camera(Protocol):
    """A source of frames.

    Attributes:
        size_px: (width, height); of a camera opened "as it comes" known after `start`.
        fps: frames a second, nominal; None where nobody knows.
        dropped: frames that the camera took and `read` never returned, so far.
        stale: frames so far that were the one before once more; `read` never returns them.
        settings: what the camera says of itself after `start`: source, size, rate, locks. No password is in it.
    """

    @property
    def size_px(self) -> tuple[int, int]: ...

    @property
    def fps(self) -> float | None: ...

    @property
    def dropped(self) -> int: ...

    @property
    def stale(self) -> int: ...

    @property
    def settings(self) -> Mapping[str, Setting]: ...

    def start(self) -> None:
        """Open the device and start taking frames."""
        ...

    def read(self, until_ns: int) -> Frame | None:
        """The next frame as soon as it is there; None once the clock reads `until_ns` if none arrived by then."""
        ...

    def close(self) -> None:
        """Stop and let go of the device, within a second or two; harmless when it isn't open. May be started again."""
        ...


class FrameQueue(Generic[Item]):
    """A few frames, decoded or not, between the thread that takes them and the one that reads them.

    A full queue loses its oldest frame, as a reader wants the newest, and counts it.
    """

    def __init__(self, limit: int = QUEUE_FRAMES) -> None:
        self._frames: deque[Item] = deque()
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

    def put(self, frame: Item) -> None:
        """Append a frame; loses the oldest if there are too many."""
        with self._changed:
            if len(self._frames) >= self._limit:
                self._frames.popleft()
                self._dropped += 1
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
        """Tell the thread that takes frames that nobody reads them any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def get(self, timeout_s: float) -> Item | None:
        """The oldest frame, or None if there is none within `timeout_s`; raises what `fail` was told."""
        with self._changed:
            self._changed.wait_for(lambda: self._frames or self._error is not None, timeout_s)
            if self._frames:
                self._changed.notify_all()
                return self._frames.popleft()
            if self._error is not None:
                raise self._error
            return None

    def get_until(self, until_ns: int, clock: Clock) -> Item | None:
        """The oldest frame, or None once `clock` reads `until_ns`, looking at the clock every LOOK_S seconds."""
        while True:
            left_s = (until_ns - clock.now_ns()) * 1e-9
            frame = self.get(min(max(left_s, 0.0), LOOK_S))
            if frame is not None or left_s <= 0:
                return frame
