"""Any camera that OpenCV can open, by its index, device or address."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from drivers.addresses import without_secrets
from drivers.camera import STALL_S, Controls, Image, Setting
from drivers.clock import Clock
from drivers.controls import Capture, lock_controls, read_settings, set_pixel_format
from drivers.errors import CameraError, CameraLost, NoCamera, SettingRefused
from drivers.live_camera import LiveCamera, Taken
from drivers.quiet_opencv import quiet_opencv
from drivers.stamps import Gaps, choose_stamp

NS = 1_000_000_000
# Seconds between two tries after a camera failed to give a frame.
RETRY_S = 0.02
# Every so many rows and columns are compared first: of two frames that differ, nearly all differ there.
THINNED = 8
V4L2 = "V4L2"

OpenCapture = Callable[[int | str, int, Sequence[int]], Capture]


def video_devices() -> list[str]:
    """Paths of the machine's video devices, in order."""
    return sorted((str(path) for path in Path("/dev").glob("video*")), key=lambda path: (len(path), path))


def open_capture(source: int | str, backend: int, parameters: Sequence[int]) -> Capture:
    """The source through OpenCV."""
    return cast(Capture, cv2.VideoCapture(source, backend, parameters))


def webcam(
    source: int | str,
    *,
    size_px: tuple[int, int] | None,
    fps: float | None,
    clock: Clock,
    stall_s: float = STALL_S,
    controls: Controls | None = None,
    opener: OpenCapture = open_capture,
) -> LiveCamera:
    """A camera by its index or device path, or by an address that OpenCV opens, such as rtsp://.

    Frames are stamped right after `grab()`, before they are decoded; with the driver's own stamp where OpenCV gives
    it (V4L2) and it agrees with the arrival.

    Args:
        source: index, device path or address.
        size_px, fps: to ask for; None for what the camera has anyway.
        clock: gives the stamps; it must be the machine's monotonic clock for the driver's stamps to be used.
        stall_s: without a new frame for so long, the camera has stalled.
        controls: what to lock, and at what.
        opener: opens the source; a test has its own.
    """
    wanted = _Wanted(source, size_px, fps, stall_s, controls or Controls())
    return LiveCamera(
        wanted.name, lambda: _opened(wanted, clock, opener), size_px=size_px, clock=clock, stall_s=stall_s
    )


@dataclass(frozen=True)
class _Wanted:
    source: int | str
    size_px: tuple[int, int] | None
    fps: float | None
    stall_s: float
    controls: Controls

    @property
    def name(self) -> str:
        return f"camera {self.source}" if isinstance(self.source, int) else f"camera '{without_secrets(self.source)}'"

    @property
    def path(self) -> str | None:
        """The device's path; None of an address."""
        if isinstance(self.source, int):
            return f"/dev/video{self.source}" if sys.platform == "linux" else None
        return None if "://" in self.source else self.source


def _opened(wanted: _Wanted, clock: Clock, opener: OpenCapture) -> CaptureSource:
    devices = ", ".join(video_devices()) or "no video device"
    # Looked for first, as OpenCV's back ends write to the terminal what they miss.
    if wanted.path is not None and not Path(wanted.path).exists():
        raise NoCamera(f"{wanted.name}: there is no {wanted.path}; this machine has {devices}; give one of these")
    backend, parameters = cv2.CAP_ANY, list[int]()
    if wanted.path is not None and sys.platform == "linux":
        backend = cv2.CAP_V4L2
    elif isinstance(wanted.source, str):
        backend, stall_ms = cv2.CAP_FFMPEG, round(wanted.stall_s * 1e3)  # else 30 s each (cap_ffmpeg_impl.hpp)
        parameters = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, stall_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, stall_ms]
    with quiet_opencv():
        capture = opener(wanted.source, backend, parameters)
        if not capture.isOpened():
            capture.release()
            raise NoCamera(
                f"{wanted.name} can't be opened; another program may hold it, or nothing answers there\n"
                f"this machine has {devices}"
            )
        try:
            return CaptureSource(capture, wanted, clock)
        except CameraError:
            capture.release()
            raise


class CaptureSource:
    """An open cv2.VideoCapture, set up and read back."""

    def __init__(self, capture: Capture, wanted: _Wanted, clock: Clock) -> None:
        self._capture = capture
        self._wanted = wanted
        self._clock = clock
        self._v4l2 = capture.getBackendName() == V4L2
        self._gaps = Gaps()
        self._last: Image | None = None
        self._last_driver_ms = -1.0
        self._set_up()
        self.size_px = (
            round(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            round(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        )
        fps = capture.get(cv2.CAP_PROP_FPS)
        self.fps = fps if fps > 0 else None
        source = wanted.source
        self.settings: Mapping[str, Setting] = {
            "source": source if isinstance(source, int) else without_secrets(source),
            "backend": capture.getBackendName(),
            "size_px": f"{self.size_px[0]}x{self.size_px[1]}",
            "fps": self.fps,
            **(read_settings(capture) if self._v4l2 else {}),
        }

    def _set_up(self) -> None:
        """Ask for what is wanted. Pixel format first, then the size: what V4L2 offers depends in that order."""
        capture, wanted = self._capture, self._wanted
        if wanted.controls != Controls() and not self._v4l2:
            raise SettingRefused(
                f"{wanted.name}: settings can be locked through V4L2 only; OpenCV opened it by "
                f"{capture.getBackendName()}\nleave pixel_format, exposure_ms, focus, gain, white_balance_k out"
            )
        if wanted.controls.pixel_format is not None:
            set_pixel_format(capture, wanted.controls.pixel_format, wanted.name)
        if wanted.size_px is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, wanted.size_px[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, wanted.size_px[1])
        if wanted.fps is not None:
            capture.set(cv2.CAP_PROP_FPS, wanted.fps)
        lock_controls(capture, wanted.controls, wanted.name)

    def take(self) -> Taken | None:
        if not self._capture.grab():
            self._check_there()
            self._clock.sleep_until_ns(self._clock.now_ns() + round(RETRY_S * NS))
            return None
        arrived_ns = self._clock.now_ns()
        driver_ms = self._capture.get(cv2.CAP_PROP_POS_MSEC) if self._v4l2 else 0.0
        t_ns, stamp = choose_stamp(driver_ms, arrived_ns)
        good, decoded = self._capture.retrieve()
        image = np.asarray(decoded, dtype=np.uint8) if good else None
        again = stamp == "driver" and driver_ms == self._last_driver_ms
        if again or _same(image, self._last):
            return Taken(t_ns, stamp, image, arrived_ns, stale=True)
        lost = self._gaps.missing_before(t_ns) if stamp == "driver" else 0
        self._last, self._last_driver_ms = image, driver_ms
        return Taken(t_ns, stamp, image, arrived_ns, lost=lost)

    def release(self) -> None:
        self._capture.release()

    def _check_there(self) -> None:
        """Raise CameraLost if the device is gone, or an address gives nothing: OpenCV then says so just once."""
        path, name = self._wanted.path, self._wanted.name
        if path is not None and not Path(path).exists():
            raise CameraLost(f"{name}: its device {path} is gone\nplug it in again, then start again")
        if isinstance(self._wanted.source, str) and path is None:
            raise CameraLost(f"{name}: the stream ended or nothing came for {self._wanted.stall_s:g} s\nstart again")


def _same(image: Image | None, last: Image | None) -> bool:
    """Whether two frames are the same in every pixel, which the noise of a sensor that works doesn't let happen."""
    if image is None or last is None or image.shape != last.shape:
        return False
    thinned = np.array_equal(image[::THINNED, ::THINNED], last[::THINNED, ::THINNED])
    return thinned and np.array_equal(image, last)
