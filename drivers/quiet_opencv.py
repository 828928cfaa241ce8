"""OpenCV and FFmpeg kept off the terminal: the error that follows what they would write says it better."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Generator

import cv2

# FFmpeg writes a line for each damaged block of a video. OpenCV reads this once, when it opens its first video
# (modules/videoio/src/cap_ffmpeg_impl.hpp, InternalFFMpegRegister); -8 is AV_LOG_QUIET.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


@contextlib.contextmanager
def quiet_opencv() -> Generator[None, None, None]:
    """Keep OpenCV's own warnings off the terminal."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)
