"""Frames as a recording keeps them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData

JPEG_QUALITY = 92


def encode_jpeg(image: NDArray[np.uint8]) -> bytes:
    """The JPEG of a BGR (H, W, 3) or grey (H, W) image; raises InvalidData for another."""
    done, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise InvalidData(f"an image of shape {image.shape}, {image.dtype} can't be encoded; want (H, W, 3) uint8")
    return jpeg.tobytes()
