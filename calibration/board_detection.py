"""A board in an image: which of its corners are seen where.

Markers are found by OpenCV. Every corner near some of them is then looked for where those say it is, in a window that
stays clear of the markers in the squares beside it (OpenCV's own windows take them in on tilted boards, with errors of
up to a pixel), and kept if its four quarters are black and white in turn. Corners of a chessboard are free of the edge
shift that blur seen through gamma gives to black squares: opposite quarters pull alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.boards import CharucoBoard, load_dictionary
from calibration.errors import CalibrationError
from calibration.intrinsics import FloatArray

Grey = NDArray[np.uint8]
IntArray = NDArray[np.int64]

# Candidates are rectified to so many pixels a cell (OpenCV: 4) and read without this share of each cell's rim (0.13):
# small and blurred ones are read, too.
READ_PX_PER_CELL = 8
READ_RIM = 0.25
# A board of which fewer markers agree with its description isn't found.
LEAST_MARKERS = 3
# Nor one that fewer than this share of what is read agrees with: a board of other columns agrees in parts.
AGREEING_SHARE = 0.6
# Markers whose corners are further than this from where the others put them are mistaken ones, in sides of a square.
STRAY_SQUARES = 0.3
# A corner is predicted by this many markers, the nearest on the board, none further than so many squares.
NEAREST_MARKERS = 6
REACH_SQUARES = 3.0
# Half widths of the refinement's window, px, and how far it stays from the nearest marker's corner, whose blur reaches
# out. A corner whose window would be smaller is left out.
SMALLEST_WINDOW_PX, LARGEST_WINDOW_PX = 2, 7
CLEARANCE_PX = 1.0
REFINEMENT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 1e-3)
# A corner that moves further than this from its prediction is another.
LARGEST_MOVE_SQUARES = 0.12
LEAST_MOVE_PX = 1.5
# Where its quarters are looked at, in squares, and how much of the image's contrast they must show.
QUARTER_SQUARES = 0.1
LEAST_CONTRAST_GREY = 12.0


@dataclass(frozen=True, eq=False)
class BoardView:
    """What one image shows of a board.

    Attributes:
        size_px: (width, height) of the image.
        ids: (N,) of the chessboard's inner corners, rising; N may be 0.
        corners_px: (N, 2) where they are.
        marker_ids: (M,) of the markers that were read and agree with the board.
        marker_corners_px: (M, 4, 2) rough corners of their black squares.
    """

    size_px: tuple[int, int]
    ids: IntArray
    corners_px: FloatArray
    marker_ids: IntArray
    marker_corners_px: FloatArray

    def __len__(self) -> int:
        return len(self.ids)


class BoardFinder:
    """Finds a board's corners in images. Not for two threads at once."""

    def __init__(self, board: CharucoBoard) -> None:
        self.board = board
        self._detector = marker_detector(board.dictionary)
        self._markers_m = board.marker_points()[..., :2]
        self._corners_m = board.corner_points()[:, :2]

    def find(self, image: Grey) -> BoardView:
        """What an 8-bit image, grey (H, W) or BGR (H, W, 3), shows of the board; raises CalibrationError for others."""
        grey = grey_of(image)
        size_px = grey.shape[1], grey.shape[0]
        ids, sides_px = read_markers(self._detector, grey)
        known = ids < self.board.marker_count
        agreed = known.copy()
        agreed[known] = self.agreeing(ids[known], sides_px[known])
        if agreed.sum() < max(LEAST_MARKERS, AGREEING_SHARE * len(ids)):
            return BoardView(size_px, np.zeros(0, np.int64), np.zeros((0, 2)), ids[:0], sides_px[:0])
        names, corners_px = self._corners(grey, ids[agreed], sides_px[agreed])
        return BoardView(size_px, names, corners_px, ids[agreed], sides_px[agreed])

    def agreeing(self, ids: IntArray, sides_px: FloatArray) -> NDArray[np.bool_]:
        """Which (M,) markers with corners (M, 4, 2) are where the board has them, seen as one plane."""
        if len(ids) < LEAST_MARKERS:
            return np.zeros(len(ids), bool)
        square_px = np.sqrt(_areas(sides_px)) * self.board.square_m / self.board.marker_m
        stray_px = STRAY_SQUARES * float(np.median(square_px))
        centres_m = self._markers_m[ids].mean(axis=1)
        H, _ = cv2.findHomography(
            self._markers_m[ids].reshape(-1, 2), sides_px.reshape(-1, 2), cv2.RANSAC, stray_px, maxIters=500
        )
        if np.size(H) != 9:  # None where there is none
            return np.zeros(len(ids), bool)
        error_px = np.linalg.norm(_mapped(np.asarray(H, np.float64), centres_m) - sides_px.mean(axis=1), axis=-1)
        return error_px < STRAY_SQUARES * square_px

    def _corners(self, grey: Grey, ids: IntArray, sides_px: FloatArray) -> tuple[IntArray, FloatArray]:
        names, predicted, steps_px = self._predicted(ids, sides_px)
        gap = 0.5 * (1 - self.board.marker_m / self.board.square_m)
        # The nearest marker corners are at (gap, gap) and (gap, -gap) of a square: how far, in the window's norm?
        diagonals = gap * np.stack([steps_px[:, 0] + steps_px[:, 1], steps_px[:, 0] - steps_px[:, 1]], axis=1)
        clear_px = np.abs(diagonals).max(axis=-1).min(axis=-1)
        window = np.minimum(np.floor(clear_px - CLEARANCE_PX), LARGEST_WINDOW_PX).astype(int)
        height, width = grey.shape
        inside = window >= SMALLEST_WINDOW_PX
        inside &= np.all((predicted >= window[:, None]) & (predicted < [width, height] - window[:, None]), axis=1)
        names, predicted, steps_px, window = names[inside], predicted[inside], steps_px[inside], window[inside]
        if not len(names):
            return names, predicted
        refined = predicted.astype(np.float32)
        for half in np.unique(window):  # few sizes
            chosen = window == half
            start = refined[chosen].reshape(-1, 1, 2).copy()
            sharper = cv2.cornerSubPix(grey, start, (int(half), int(half)), (-1, -1), REFINEMENT)
            refined[chosen] = np.reshape(sharper, (-1, 2))
        corners_px = refined.astype(np.float64)
        moved_px = np.linalg.norm(corners_px - predicted, axis=1)
        square_px = np.linalg.norm(steps_px, axis=-1).min(axis=-1)
        good = moved_px < np.maximum(LARGEST_MOVE_SQUARES * square_px, LEAST_MOVE_PX)
        good &= _is_chess(grey, corners_px, steps_px)
        return names[good], corners_px[good]

    def _predicted(self, ids: IntArray, sides_px: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Corners that markers tell of: ids (N,), where they should be (N, 2), one square's steps there (N, 2, 2) px.

        Each by the plane through its nearest markers, as a lens bends what one plane through all would say.
        """
        known_m, square_m = self._markers_m[ids], self.board.square_m
        distance_m = np.linalg.norm(self._corners_m[:, None] - known_m.mean(axis=1), axis=-1)
        names: list[int] = []
        places: list[FloatArray] = []
        for name, distances in enumerate(distance_m):  # OpenCV fits one plane at a time
            near = np.argsort(distances)[:NEAREST_MARKERS]
            near = near[distances[near] < REACH_SQUARES * square_m]
            if len(near) < 2:
                continue
            H, _ = cv2.findHomography(known_m[near].reshape(-1, 2), sides_px[near].reshape(-1, 2), 0)
            if np.size(H) != 9:
                continue
            corner = self._corners_m[name]
            beside = corner + square_m / 8 * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
            names.append(name)
            places.append(_mapped(np.asarray(H, np.float64), beside))
        around = np.array(places).reshape(-1, 5, 2)
        steps = 4 * np.stack([around[:, 1] - around[:, 2], around[:, 3] - around[:, 4]], axis=1)
        return np.array(names, np.int64), around[:, 0], steps


def marker_detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    """OpenCV's detector, as boards are looked for with it."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.perspectiveRemovePixelPerCell = READ_PX_PER_CELL
    parameters.perspectiveRemoveIgnoredMarginPerCell = READ_RIM
    return cv2.aruco.ArucoDetector(load_dictionary(dictionary), parameters)


def read_markers(detector: cv2.aruco.ArucoDetector, grey: Grey) -> tuple[IntArray, FloatArray]:
    """Ids (M,) and rough corners (M, 4, 2) px of the markers in an image; an id that is there twice is left out."""
    found, ids, _ = detector.detectMarkers(grey)
    if not len(found):  # ids are None then
        return np.zeros(0, np.int64), np.zeros((0, 4, 2))
    names = np.asarray(ids, np.int64).reshape(-1)
    sides = np.asarray(found, np.float64).reshape(-1, 4, 2)
    values, counts = np.unique(names, return_counts=True)
    once = np.isin(names, values[counts == 1])
    return names[once], sides[once]


def grey_of(image: Grey) -> Grey:
    """The grey image (H, W) of a grey or BGR one; raises CalibrationError for anything else."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise CalibrationError(f"image is {image.dtype} of shape {image.shape}; want uint8, (H, W) or (H, W, 3) BGR")
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def _areas(quads: FloatArray) -> FloatArray:
    """(M,) areas of quadrilaterals (M, 4, 2)."""
    across, down = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    return 0.5 * np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0])


def _mapped(H: FloatArray, points: FloatArray) -> FloatArray:
    """Points (N, 2) taken by a homography (3, 3)."""
    homogeneous = points @ H[:, :2].T + H[:, 2]
    return homogeneous[:, :2] / homogeneous[:, 2:]


def _is_chess(grey: Grey, corners_px: FloatArray, steps_px: FloatArray) -> NDArray[np.bool_]:
    """Whether (N,) the quarters around each corner are black and white in turn, by what the image shows there."""
    signs = np.array([(1, 1), (-1, -1), (1, -1), (-1, 1)]) * QUARTER_SQUARES
    spots = corners_px[:, None] + np.einsum("qs,nsk->nqk", signs, steps_px)
    x, y = (np.ascontiguousarray(spots[..., axis], np.float32) for axis in (0, 1))
    quarters = np.asarray(cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float64)
    one, other = quarters[:, :2], quarters[:, 2:]
    apart = np.maximum(one.min(axis=1) - other.max(axis=1), other.min(axis=1) - one.max(axis=1))
    return apart > LEAST_CONTRAST_GREY
