"""OpenCV and FFmpeg kept off the terminal: the error that follows what they would write says it better."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Generator

import cv2

# FFmpeg writes a line for each damaged block of a video. OpenCV reads this once, when it opens its first video
# (modules/videoio/src/cap_ffmpeg_impl.hpp, InternalFFMpegRegister); -8 is AV_LOG_QUIET.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


class _Silence:
    """OpenCV's level of logging is the process's: several threads may want silence, and the last turns it off."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._wanted_by = 0
        self._level = 0

    def begin(self) -> None:
        with self._lock:
            if self._wanted_by == 0:
                self._level = cv2.utils.logging.getLogLevel()
                cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
            self._wanted_by += 1

    def end(self) -> None:
        with self._lock:
            self._wanted_by -= 1
            if self._wanted_by == 0:
                cv2.utils.logging.setLogLevel(self._level)


_SILENCE = _Silence()


@contextlib.contextmanager
def quiet_opencv() -> Generator[None, None, None]:
    """Keep OpenCV's own warnings off the terminal."""
    _SILENCE.begin()
    try:
        yield
    finally:
        _SILENCE.end()
