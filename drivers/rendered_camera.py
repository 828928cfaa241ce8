"""A camera whose frames are computed: it keeps the times of a real one, on a virtual clock or on the real one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext

from drivers.camera import Frame, FrameQueue, Image, Setting
from drivers.clock import Clock
from drivers.errors import CameraError

NS = 1_000_000_000


class RenderedCamera:
    """Frame k is exposed from `start + k / fps` on, and arrives `latency_s` after its exposure ends.

    Each row is exposed for `exposure_s`; the rows of a rolling shutter (`readout_s` > 0) one after another, so that the
    last row's exposure begins and ends `readout_s` after the first row's.

    On a virtual clock (`realtime=False`) nothing runs beside the caller: `read` puts the clock forward to the frame's
    arrival and renders it. Every frame is delivered, in order, however late it is asked for; one that arrived while
    the caller was busy keeps the stamp of its arrival. In real time a thread of its own renders each frame when its
    exposure is over, as what it shows isn't known before; frames that it can't keep up with are dropped and counted.

    Args:
        render: takes the middle of the middle row's exposure (ns on the clock) and the frame's index, gives an image
            (H, W, 3).
        size_px: (width, height) of the images; others are refused.
        fps: frames a second.
        exposure_s: how long the shutter is open, at most a frame's time.
        readout_s: from the first to the last row of a rolling shutter, at most a frame's time.
        latency_s: from the end of the exposure to the arrival.
        clock: gives the stamps.
        realtime: whether the clock runs by itself.
        beside: what `render` needs to be open while the camera is, such as a program that draws; opened by `start`,
            before the first exposure.

    Raises:
        CameraError: for times that make no camera, or a rendered image of another size (from `read`).
    """

    def __init__(
        self,
        render: Callable[[int, int], Image],
        *,
        size_px: tuple[int, int],
        fps: float,
        exposure_s: float,
        readout_s: float = 0.0,
        latency_s: float,
        clock: Clock,
        realtime: bool,
        beside: Callable[[], AbstractContextManager[object]] = nullcontext,
    ) -> None:
        if not fps > 0 or not 0 <= exposure_s <= 1 / fps or not 0 <= readout_s <= 1 / fps or latency_s < 0:
            have = f"fps {fps}, exposure {exposure_s} s, readout {readout_s} s, latency {latency_s} s"
            want = "fps > 0, exposure 0 to 1 / fps, readout 0 to 1 / fps, latency >= 0"
            raise CameraError(f"rendered camera: have {have}; want {want}")
        self._render = render
        self._size_px = size_px
        self._fps = fps
        self._exposure_ns = round((exposure_s + readout_s) * NS)
        self._settings: Mapping[str, Setting] = {
            "source": "rendered",
            "size_px": f"{size_px[0]}x{size_px[1]}",
            "fps": fps,
            "exposure_ms": exposure_s * 1e3,
            "exposure_locked": True,
        }
        self._latency_ns = round(latency_s * NS)
        self._clock = clock
        self._realtime = realtime
        self._beside = beside
        self._opened = ExitStack()
        self._start_ns: int | None = None
        self._next = 0
        self._queue: FrameQueue[Frame] = FrameQueue()
        self._held: Frame | None = None
        self._thread: threading.Thread | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self._size_px

    @property
    def fps(self) -> float:
        """Frames a second."""
        return self._fps

    @property
    def dropped(self) -> int:
        """Frames since `start` that were skipped because rendering or reading fell behind; 0 on a virtual clock."""
        return self._queue.dropped

    @property
    def stale(self) -> int:
        """None ever are."""
        return 0

    @property
    def settings(self) -> Mapping[str, Setting]:
        """As it was made."""
        return self._settings

    def start(self) -> None:
        """Open the shutter for frame 0 now."""
        self.close()
        self._opened.enter_context(self._beside())
        self._start_ns = self._clock.now_ns()
        self._next = 0
        self._queue = FrameQueue()
        self._held = None
        if self._realtime:
            self._thread = threading.Thread(
                target=self._run, args=(self._queue, self._start_ns), name="rendered camera", daemon=True
            )
            self._thread.start()

    def read(self, until_ns: int) -> Frame | None:
        """The next frame if it arrives by `until_ns`, else None with the clock at `until_ns`.

        Raises:
            CameraError: if the camera isn't started, or the image has another size than `size_px`.
        """
        if self._start_ns is None:
            raise CameraError("rendered camera: read before start(); call start() first")
        if self._realtime:
            return self._arrived(until_ns)
        arrival_ns = self._exposed_ns(self._start_ns, self._next) + self._latency_ns
        if arrival_ns > until_ns:
            self._clock.sleep_until_ns(until_ns)
            return None
        self._clock.sleep_until_ns(arrival_ns)
        frame = self._frame(self._start_ns, self._next)
        self._next += 1
        return frame

    def _arrived(self, until_ns: int) -> Frame | None:
        """The next frame of the thread. A frame is rendered before it arrives: it is held back until then."""
        frame = self._held or self._queue.get_until(until_ns, self._clock)
        if frame is None:
            return None
        self._clock.sleep_until_ns(min(frame.t_ns, until_ns))
        self._held = frame if frame.t_ns > until_ns else None
        return None if self._held else frame

    def close(self) -> None:
        """Stop; waits for the thread, at most a frame's time and its rendering."""
        self._queue.close()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._opened.close()
        self._start_ns = None

    def _exposed_ns(self, start_ns: int, index: int) -> int:
        """When the exposure of a frame is over."""
        return start_ns + round(index * NS / self._fps) + self._exposure_ns

    def _frame(self, start_ns: int, index: int) -> Frame:
        exposed_ns = self._exposed_ns(start_ns, index)
        image = self._render(exposed_ns - self._exposure_ns + self._exposure_ns // 2, index)
        frame = Frame(index, exposed_ns + self._latency_ns, image)
        have = (image.shape[1], image.shape[0])
        if have != tuple(self._size_px):
            raise CameraError(f"rendered camera: frame {index} has {have} px; want {self._size_px}")
        return frame

    def _run(self, queue: FrameQueue[Frame], start_ns: int) -> None:
        """The thread: renders each frame when its exposure is over, skips those that a newer one has overtaken."""
        index = 0
        while not queue.closed:
            self._clock.sleep_until_ns(self._exposed_ns(start_ns, index))
            if queue.closed:
                return
            try:
                frame = self._frame(start_ns, index)
            except Exception as error:  # whatever it is, it is the reader's: `read` raises it
                queue.fail(error)
                return
            queue.put(frame)
            index += 1
            late = 0
            while self._exposed_ns(start_ns, index + late + 1) <= self._clock.now_ns():
                late += 1
            queue.count_dropped(late)
            index += late
