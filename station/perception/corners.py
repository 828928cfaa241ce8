"""Markers in an image: found and named by OpenCV, corners refined on their edges; what isn't a marker is dropped."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel
from station.errors import InvalidData
from station.logs import FloatArray
from station.perception.markers import load_dictionary
from station.perception.refinement import refine_corners

# One window of the adaptive threshold instead of OpenCV's three (3, 13, 23 px): half the time at the same rate.
THRESHOLD_WINDOW_PX = 13
BORDER_CELLS = 1


@dataclass(frozen=True, eq=False)
class Detections:
    """The markers of one image.

    Attributes:
        ids: (M,).
        corners_px: (M, 4, 2) clockwise from the marker's top left.
        covariance_px2: (M, 4, 2, 2) of each corner.
    """

    ids: NDArray[np.int64]
    corners_px: FloatArray
    covariance_px2: FloatArray

    def __len__(self) -> int:
        return len(self.ids)


class MarkerDetector:
    """Finds the markers of one dictionary, corners to about 0.04 px.

    A candidate whose four edges are not straight edges from black to white (low contrast, bent, partly hidden, or
    further than a few px from where OpenCV saw them) is dropped, and so is an id that appears more than once, as
    nobody can tell which is meant.
    """

    def __init__(self, dictionary: str, camera: CameraModel | None = None) -> None:
        """Raises InvalidData if OpenCV has no dictionary of that name."""
        loaded = load_dictionary(dictionary)
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
        parameters.adaptiveThreshWinSizeMin = THRESHOLD_WINDOW_PX
        parameters.adaptiveThreshWinSizeMax = THRESHOLD_WINDOW_PX
        parameters.markerBorderBits = BORDER_CELLS
        self._detector = cv2.aruco.ArucoDetector(loaded, parameters)
        self._inner = _inner_bits(loaded)
        self._camera = camera

    def detect(self, image: NDArray[np.uint8]) -> Detections:
        """The markers in an 8-bit image, grey (H, W) or BGR (H, W, 3)."""
        grey = as_grey(image)
        return self.refine(grey, *self.search(grey))

    def search(self, grey: NDArray[np.uint8]) -> tuple[NDArray[np.int64], FloatArray]:
        """Ids (M,) and rough corners (M, 4, 2) px of what decodes as a marker, right to about 2 px."""
        found, ids, _ = self._detector.detectMarkers(grey)
        if ids is None or len(ids) == 0:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2))
        return np.asarray(ids, dtype=np.int64).reshape(-1), np.asarray(found, dtype=np.float64).reshape(-1, 4, 2)

    def refine(self, grey: NDArray[np.uint8], ids: NDArray[np.int64], rough_px: FloatArray) -> Detections:
        """What a search of the image found, corners refined; without what has no marker's edges."""
        refined = refine_corners(grey, rough_px, self._inner[ids], self._camera)
        values, counts = np.unique(ids, return_counts=True)
        keep = refined.good & np.isin(ids, values[counts == 1])
        return Detections(ids[keep], refined.corners_px[keep], refined.covariance_px2[keep])


def _inner_bits(dictionary: cv2.aruco.Dictionary) -> FloatArray:
    """Bits (N, 4, n) behind the border of each marker, along its edges clockwise from the top: 1 = white."""
    size = int(dictionary.markerSize)
    bits = np.zeros((len(dictionary.bytesList), size + 2, size + 2))
    for marker, code in enumerate(dictionary.bytesList):  # OpenCV unpacks one marker at a time
        bits[marker, 1:-1, 1:-1] = cv2.aruco.Dictionary.getBitsFromByteList(code[None], size)
    return np.stack([bits[:, 1], bits[:, :, -2], bits[:, -2, ::-1], bits[:, ::-1, 1]], axis=1)


def as_grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An 8-bit image, grey (H, W) or BGR (H, W, 3), as grey; raises InvalidData for another."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise InvalidData(f"image is {image.dtype} of shape {image.shape}; want uint8, (H, W) or (H, W, 3) BGR")
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
