"""Markers in an image: found and named by OpenCV, corners refined on their edges; what isn't a marker is dropped."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel
from station.errors import InvalidData
from station.logs import FloatArray
from station.perception.marker_bits import behind_border, dictionary_bits, shows_bits
from station.perception.markers import load_dictionary
from station.perception.refinement import refine_corners

BORDER_CELLS = 1
# The quick search has one window of the adaptive threshold instead of OpenCV's three (3, 13, 23 px): 0.4 of the time.
THRESHOLD_WINDOW_PX = 13
# Candidates are rectified to this many pixels a cell (OpenCV: 4) and read without this share of each cell's rim (0.13):
# markers of 25 px at 45 deg are named at 0.98 instead of 0.77, and 50 px blurred by 2.5 px at 1.0 instead of 0.25.
READ_PX_PER_CELL = 8
READ_RIM = 0.25
# The full search looks at the sharpened image as well: grey + SHARPEN * (grey less its blur of that sigma).
SHARPEN = 1.5
SHARPEN_SIGMA_PX = 1.5
# Two finds of one id closer than this share of their size are one marker.
SAME_PLACE = 0.5

IntArray = NDArray[np.int64]
Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Detections:
    """The markers of one image.

    Attributes:
        ids: (M,).
        corners_px: (M, 4, 2) clockwise from the marker's top left.
        covariance_px2: (M, 4, 2, 2) of each corner, apart from a shift of all edges outward that all markers share:
            that is the camera's, see `CameraModel.edge_shift_px`.
    """

    ids: IntArray
    corners_px: FloatArray
    covariance_px2: FloatArray

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class RoughMarkers:
    """What a search found: ids (M,) and corners (M, 4, 2), right to about 2 px; an id may be there twice."""

    ids: IntArray
    corners_px: FloatArray

    def __len__(self) -> int:
        return len(self.ids)

    def joined(self, other: RoughMarkers) -> RoughMarkers:
        """These and those of the other that aren't the same: another id, or the same id elsewhere."""
        if not len(self) or not len(other):
            return self if len(self) else other
        middles = [markers.corners_px.mean(axis=1) for markers in (self, other)]
        size_px = np.linalg.norm(self.corners_px[:, 2] - self.corners_px[:, 0], axis=-1)
        apart_px = np.linalg.norm(middles[0][:, None] - middles[1], axis=-1)
        same = (self.ids[:, None] == other.ids) & (apart_px < SAME_PLACE * size_px[:, None])
        new = ~np.any(same, axis=0)
        return RoughMarkers(
            np.concatenate([self.ids, other.ids[new]]), np.concatenate([self.corners_px, other.corners_px[new]])
        )


class MarkerDetector:
    """Finds the markers of one dictionary in single images, corners to a few hundredths of a pixel.

    A candidate whose four edges are not straight edges from black to white (low contrast, bent, partly hidden, cut by
    the image's border, or further than a few px from where OpenCV saw them) is dropped, and so is an id that appears
    more than once, as nobody can tell which is meant.

    Args:
        dictionary: such as "DICT_4X4_50".
        camera: whose lens bends edges; None = not known: corners of long edges are then off, and stated less sure.

    Raises:
        InvalidData: if OpenCV has no dictionary of that name.
    """

    def __init__(self, dictionary: str, camera: CameraModel | None = None) -> None:
        loaded = load_dictionary(dictionary)
        self._quick = _opencv_detector(loaded, (THRESHOLD_WINDOW_PX, THRESHOLD_WINDOW_PX))
        usual = cv2.aruco.DetectorParameters()
        self._full = _opencv_detector(loaded, (usual.adaptiveThreshWinSizeMin, usual.adaptiveThreshWinSizeMax))
        self._bits = dictionary_bits(loaded)
        self._inner = behind_border(self._bits)
        self._camera = camera

    def detect(self, image: Image, expected: Collection[int] | None = None) -> Detections:
        """The markers in an 8-bit image, grey (H, W) or BGR (H, W, 3).

        Args:
            image: to search.
            expected: ids that should be there: the full search, four times as long, is made where one of them is
                missing, and always if None.
        """
        grey = as_grey(image)
        found = self.refine(grey, self.search(grey)) if expected is not None else None
        if expected is None or found is None or not set(expected) <= set(found.ids.tolist()):
            found = self.refine(grey, self.search_fully(grey))
        return found

    def search(self, grey: Image) -> RoughMarkers:
        """What decodes as a marker in a grey image at one window of the threshold."""
        return _searched(self._quick, grey)

    def search_fully(self, grey: Image) -> RoughMarkers:
        """The same at three windows, in the image and in the sharpened image: more blurred and small markers."""
        blurred = cv2.GaussianBlur(grey, (0, 0), SHARPEN_SIGMA_PX)
        sharp = np.asarray(cv2.addWeighted(grey, 1.0 + SHARPEN, blurred, -SHARPEN, 0.0), dtype=np.uint8)
        return _searched(self._full, grey).joined(_searched(self._full, sharp))

    def refine(self, grey: Image, rough: RoughMarkers) -> Detections:
        """What a search of the image found, corners refined; without what has no marker's edges, and ids seen twice."""
        refined = refine_corners(grey, rough.corners_px, self._inner[rough.ids], self._camera)
        once = np.bincount(rough.ids, minlength=len(self._bits))[rough.ids] == 1
        keep = refined.good & once
        return Detections(rough.ids[keep], refined.corners_px[keep], refined.covariance_px2[keep])

    def follow(self, grey: Image, predicted: RoughMarkers) -> Detections:
        """Those markers that are where they were predicted, to 2 px, and show the bits of their ids; no search."""
        found = self.refine(grey, predicted)
        shown = shows_bits(grey, found.corners_px, self._bits[found.ids])
        return Detections(found.ids[shown], found.corners_px[shown], found.covariance_px2[shown])


def _opencv_detector(dictionary: cv2.aruco.Dictionary, windows_px: tuple[int, int]) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = windows_px
    parameters.perspectiveRemovePixelPerCell = READ_PX_PER_CELL
    parameters.perspectiveRemoveIgnoredMarginPerCell = READ_RIM
    parameters.markerBorderBits = BORDER_CELLS
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def _searched(detector: cv2.aruco.ArucoDetector, grey: Image) -> RoughMarkers:
    found, ids, _ = detector.detectMarkers(grey)
    if ids is None or len(ids) == 0:
        return RoughMarkers(np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2)))
    corners_px = np.asarray(found, dtype=np.float64).reshape(-1, 4, 2)
    return RoughMarkers(np.asarray(ids, dtype=np.int64).reshape(-1), corners_px)


def as_grey(image: Image) -> Image:
    """An 8-bit image, grey (H, W) or BGR (H, W, 3), as grey; raises InvalidData for another."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise InvalidData(f"image is {image.dtype} of shape {image.shape}; want uint8, (H, W) or (H, W, 3) BGR")
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
