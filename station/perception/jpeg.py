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


def decode_jpeg(jpeg: bytes) -> NDArray[np.uint8]:
    """The image (H, W, 3) BGR of a JPEG; raises InvalidData for what is none."""
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise InvalidData(f"{len(jpeg)} bytes can't be decoded as a JPEG")
    return np.asarray(image, np.uint8)
