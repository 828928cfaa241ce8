"""Any camera or video file that OpenCV can open: a thread takes the frames and stamps them as they arrive."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Generator
from pathlib import Path

import cv2
import numpy as np

from drivers.camera import Frame, FrameQueue
from drivers.clock import Clock
from drivers.errors import CameraError, CameraStalled, NoCamera

NS = 1_000_000_000
# Seconds between two tries after a camera failed to give a frame.
RETRY_S = 0.02


def video_devices() -> list[str]:
    """Paths of the machine's video devices, in order."""
    return sorted((str(path) for path in Path("/dev").glob("video*")), key=lambda path: (len(path), path))


@contextlib.contextmanager
def _quiet_opencv() -> Generator[None, None, None]:
    """Keep OpenCV's own warnings off the terminal: the error that follows says it better."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


class Webcam:
    """A camera by its index or device path, or a video file or address, through `cv2.VideoCapture`.

    Frames are stamped right after `grab()`, before they are decoded. A camera's frames that nobody reads in time are
    dropped, oldest first, and counted. A file is played at its own speed, waits for its reader and loses nothing.

    Args:
        source: index of a camera, path of a device or a video file, or an address that OpenCV opens.
        size_px: (width, height) that the frames must have.
        fps: frames a second to ask a camera for. What the camera or file says it gives is in `fps` after `start`.
        clock: gives the stamps. It must run by itself, but for video files.
        stall_s: a camera that gives no frame for so long has stalled.

    Not handled: exposure and focus, pixel formats, time stamps of the camera's driver.
    """

    def __init__(
        self, source: int | str, size_px: tuple[int, int], fps: float, clock: Clock, stall_s: float = 2.0
    ) -> None:
        self._source = source
        self._size_px = size_px
        self._fps = fps
        self._clock = clock
        self._stall_ns = round(stall_s * NS)
        self._is_file = isinstance(source, str) and Path(source).is_file()
        self._queue = FrameQueue()
        self._heard_ns = 0
        self._thread: threading.Thread | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self._size_px

    @property
    def fps(self) -> float:
        """Frames a second: as asked for, and after `start` as the camera or file says, if it says anything."""
        return self._fps

    @property
    def dropped(self) -> int:
        """Frames since `start` that came and were lost before they were read."""
        return self._queue.dropped

    def start(self) -> None:
        """Open the camera, read its settings back and start taking frames.

        Raises:
            NoCamera: if there is no such camera or file, or it can't be opened.
            CameraError: if it gives frames of another size.
        """
        self.close()
        with _quiet_opencv():
            capture = self._opened()
        try:
            self._check_settings(capture)
        except CameraError:
            capture.release()
            raise
        self._queue = FrameQueue()
        self._heard_ns = self._clock.now_ns()
        self._thread = threading.Thread(target=self._run, args=(capture, self._queue), name="webcam", daemon=True)
        self._thread.start()

    def read(self, until_ns: int) -> Frame | None:
        """The next frame as soon as it is there; None if none came by `until_ns`.

        Raises:
            CameraStalled: if no frame came for `stall_s`, or the file is at its end.
            CameraError: if the camera isn't started.
        """
        if self._thread is None:
            raise CameraError(f"{self._name}: read before start(); call start() first")
        stalled_ns = self._heard_ns + self._stall_ns
        frame = self._queue.get_until(min(until_ns, stalled_ns), self._clock)
        if frame is not None:
            self._heard_ns = max(self._heard_ns, frame.t_ns)
            return frame
        if self._clock.now_ns() >= stalled_ns and not self._is_file:
            raise CameraStalled(
                f"{self._name}: no frame for {self._stall_ns / NS:g} s; "
                "check its cable, and that no other program uses it; then start again"
            )
        return None

    def close(self) -> None:
        """Stop and release the camera; waits for the thread, which a dead device may hold for as long as its driver."""
        self._queue.close()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    @property
    def _name(self) -> str:
        return f"camera {self._source}" if isinstance(self._source, int) else f"camera '{self._source}'"

    def _opened(self) -> cv2.VideoCapture:
        path = f"/dev/video{self._source}" if isinstance(self._source, int) else self._source
        devices = ", ".join(video_devices()) or "no video device"
        # Looked for first, as OpenCV's back ends write to the terminal what they miss.
        if "://" not in path and not Path(path).exists():
            raise NoCamera(f"{self._name}: there is no {path}; this machine has {devices}; give one of these or a file")
        capture = cv2.VideoCapture(self._source)
        if not capture.isOpened():
            capture.release()
            what = "is no video that OpenCV reads" if self._is_file else "can't be opened; another program may hold it"
            raise NoCamera(f"{self._name}: {path} {what}; this machine has {devices}")
        return capture

    def _check_settings(self, capture: cv2.VideoCapture) -> None:
        """Set what a camera can be told, and read back what it and a file give."""
        if not self._is_file:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._size_px[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._size_px[1])
            capture.set(cv2.CAP_PROP_FPS, self._fps)
        have = (round(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), round(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        if have != tuple(self._size_px):
            raise CameraError(
                f"{self._name}: it gives {have[0]}x{have[1]} px; want {self._size_px[0]}x{self._size_px[1]};\n"
                "set the size to one that it has, with a calibration made at that size"
            )
        fps = capture.get(cv2.CAP_PROP_FPS)
        self._fps = fps if fps > 0 else self._fps

    def _run(self, capture: cv2.VideoCapture, queue: FrameQueue) -> None:
        """The thread: takes frames until the reader has gone, the file ends, or something breaks."""
        try:
            if self._is_file:
                self._play(capture, queue)
            else:
                self._watch(capture, queue)
        except Exception as error:  # whatever it is, it is the reader's: `read` raises it
            queue.fail(error)
        finally:
            capture.release()

    def _watch(self, capture: cv2.VideoCapture, queue: FrameQueue) -> None:
        index = 0
        while not queue.closed:
            if not capture.grab():
                # Gone or slow: `read` decides when that is a stall.
                self._clock.sleep_until_ns(self._clock.now_ns() + round(RETRY_S * NS))
                continue
            frame = self._frame(capture, index)
            if frame is None:
                queue.count_dropped(1)
            else:
                queue.put(frame)
            index += 1

    def _play(self, capture: cv2.VideoCapture, queue: FrameQueue) -> None:
        start_ns = self._clock.now_ns()
        index = 0
        while not queue.closed:
            self._clock.sleep_until_ns(start_ns + round(index * NS / self._fps))
            if not capture.grab():
                queue.fail(CameraStalled(f"{self._name}: the video ended after {index} frames"))
                return
            frame = self._frame(capture, index)
            if frame is None:
                raise CameraError(f"{self._name}: frame {index} can't be decoded; the file is damaged from there on")
            queue.put_waiting(frame)
            index += 1

    def _frame(self, capture: cv2.VideoCapture, index: int) -> Frame | None:
        """The frame that was just grabbed: stamped, then decoded; None if it can't be decoded."""
        t_ns = self._clock.now_ns()
        good, image = capture.retrieve()
        if not good:
            return None
        have = (image.shape[1], image.shape[0])
        if have != tuple(self._size_px):
            raise CameraError(f"{self._name}: frame {index} has {have} px; it said {self._size_px} when it was opened")
        return Frame(index, t_ns, np.asarray(image, dtype=np.uint8))
