"""What the detector finds, as rules: measured on rendered frames by tests/benchmarks/detection_limits.py."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from station.foresight.sight import Sight
from station.logs import FloatArray

# Px of a cell across the narrow way of a marker: at this half of the frames have it, at 1.2 one in ten, at 2.0 nine in
# ten, and that is so for squares of 17 to 90 px, small ones seen from the front as well as large ones seen obliquely.
LEAST_CELL_PX = 1.57
# Over this tilt hardly any marker is found however large it is.
STEEPEST_RAD = np.radians(83.0)
# At this smear half of the markers are found: a cell and a quarter, and no more than 9 px.
MOST_SMEAR_CELLS, MOST_SMEAR_PX = 1.25, 9.0
# All are found up to this one. Beyond it corners become vague, too.
GOOD_SMEAR_PX = 4.0
# Between a marker's outermost corner and the edge of the image.
LEAST_BORDER_PX = 3.0
# Views more oblique than this are less accurate: the report shades them, too.
OBLIQUE_RAD = np.radians(60.0)

SEEN, OUTSIDE, TURNED_AWAY, OBLIQUE, SMALL, HIDDEN, SMEARED = range(7)
REASONS = ("seen", "out of the image", "turned away", "too oblique", "too small", "hidden", "smeared")


def in_image(corners_px: FloatArray, size_px: tuple[int, int]) -> NDArray[np.bool_]:
    """(...) whether all four corners (..., 4, 2) are in the image, with the room that the detector needs."""
    low, high = LEAST_BORDER_PX - 0.5, np.array(size_px) - 0.5 - LEAST_BORDER_PX
    return np.all((corners_px >= low) & (corners_px <= high), axis=(-2, -1))


def reasons_but_hidden(what: Sight, size_px: tuple[int, int], cells: NDArray[np.intp]) -> NDArray[np.intp]:
    """(T, M) why each marker is not seen, of SEEN, OUTSIDE, TURNED_AWAY, OBLIQUE, SMALL, SMEARED: the first that holds.

    Args:
        what: the markers in the image.
        size_px: (width, height) of the image.
        cells: (M,) of a side of each marker, its border included.
    """
    cell_px = what.size_px / cells
    smallest_px = LEAST_CELL_PX * cells
    rules = [
        ((what.tilt_rad >= np.pi / 2), TURNED_AWAY),
        (~in_image(what.corners_px, size_px), OUTSIDE),
        (what.size_px < smallest_px, SMALL),
        ((what.across_px < smallest_px) | (what.tilt_rad > STEEPEST_RAD), OBLIQUE),
        (what.smear_px > most_smear_px(cell_px), SMEARED),
    ]
    return np.select([rule for rule, _ in rules], [reason for _, reason in rules], SEEN)


def most_smear_px(cell_px: FloatArray) -> FloatArray:
    """The smear at which half of the markers with cells of this size are found."""
    return np.minimum(MOST_SMEAR_CELLS * cell_px, MOST_SMEAR_PX)
