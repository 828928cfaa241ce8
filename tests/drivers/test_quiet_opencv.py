"""Silence that several want ends with the last of them, and leaves the level as it was."""

from __future__ import annotations

import cv2

from drivers.quiet_opencv import quiet_opencv


def test_opencv_speaks_again_once_nobody_wants_it_quiet() -> None:
    level = cv2.utils.logging.getLogLevel()
    first, second = quiet_opencv(), quiet_opencv()
    with first:
        second.__enter__()
    assert cv2.utils.logging.getLogLevel() == cv2.utils.logging.LOG_LEVEL_SILENT  # the second still wants it
    second.__exit__(None, None, None)
    assert cv2.utils.logging.getLogLevel() == level != cv2.utils.logging.LOG_LEVEL_SILENT
