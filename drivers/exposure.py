"""Whether a webcam's exposure is locked: one that changes from frame to frame moves the time of what is seen."""

from __future__ import annotations

from pathlib import Path

import cv2

# linux/v4l2-controls.h, V4L2_CID_EXPOSURE_AUTO: 0 automatic, 1 manual, 2 shutter priority (the time is set),
# 3 aperture priority (the time is automatic). OpenCV's V4L2 back end hands these through.
_TIME_IS_SET = {0: False, 1: True, 2: True, 3: False}


def read_exposure_lock(source: int | str) -> bool | None:
    """Whether the exposure time of a camera is fixed; None where it doesn't tell, as a file or an address.

    Opens the camera and closes it, so it must not be in use. Other back ends than V4L2 aren't asked: what they say
    means other things.
    """
    path = f"/dev/video{source}" if isinstance(source, int) else source
    if not path.startswith("/dev/") or not Path(path).exists():
        return None
    capture = cv2.VideoCapture(source, cv2.CAP_V4L2)
    try:
        return _TIME_IS_SET.get(round(capture.get(cv2.CAP_PROP_AUTO_EXPOSURE))) if capture.isOpened() else None
    finally:
        capture.release()
