"""Markers that a tree as a whole does not explain: a wrong joint, or a part that bends or slips.

More noise than was stated makes residuals larger, each frame's otherwise. A wrong tree makes them larger and alike from
frame to frame, as it is wrong in the same way for states that are alike. Errors of a detector are alike, too, while
nothing moves; but then they are what was stated, or not much more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from station.fit.image.corner_data import CornerData
from station.fit.image.views import COORDINATES
from station.fit.noise import INLIER_ABOVE
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# A marker whose deviations are so many times those stated, and those of most others, is not where the tree has it.
MISFIT = 2.0
# Nor is one with so many times those stated, if its errors in neighbouring frames have this correlation, and
# one of so many deviations of chance. Rendered pictures with the right tree reach 1.3.
MISFIT_ALIKE, ALIKE, ALIKE_SIGMAS = 1.4, 0.3, 5.0
# Where there is such a marker, nor are others whose errors are alike, and so many times those stated.
FAR_OFF = 1.1
# Nor one of which more sightings than this share, and this count, fit nowhere.
LEFT_OUT, LEFT_OUT_COUNT = 0.2, 4


def misfits(data: CornerData, residual_px: FloatArray, inlier: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Markers (M,) that the tree doesn't explain, and correlations (M,) of their errors in neighbouring frames.

    Where there is one of these, so are all others that are farther off than stated, and alike from frame to frame.

    Args:
        data: with the scales of the noise.
        residual_px: (T, M, 8) measured less model.
        inlier: (T, M) probability that a sighting is no outlier.
    """
    correlation, sigmas = _alike(data.whitened(residual_px), inlier > INLIER_ABOVE)
    usual = max(float(np.median(data.scale)), 1.0) if len(data.scale) else 1.0
    is_alike = (correlation > ALIKE) & (sigmas > ALIKE_SIGMAS)
    left_out = np.sum(data.seen & (inlier <= INLIER_ABOVE), axis=0)
    many = left_out > np.maximum(LEFT_OUT * data.seen.sum(axis=0), LEFT_OUT_COUNT)
    found: BoolArray = (data.scale > MISFIT * usual) | (is_alike & (data.scale > MISFIT_ALIKE)) | many
    return found | (found.any() & is_alike & (data.scale > FAR_OFF)), correlation


def _alike(whitened: FloatArray, good: BoolArray) -> tuple[FloatArray, FloatArray]:
    """(M,) correlation of errors (T, M, 8) in neighbouring good frames (T, M), and its deviations of chance."""
    r = np.where(good[..., None], whitened, 0.0)
    pairs = np.sum(good[:-1] & good[1:], axis=0)
    square = np.sum(r**2, axis=(0, 2)) / np.maximum(good.sum(axis=0), 1)
    product = np.sum(r[:-1] * r[1:], axis=(0, 2)) / np.maximum(pairs, 1)
    correlation = product / np.where(square > 0, square, 1.0)
    return correlation, correlation * np.sqrt(COORDINATES * pairs)
