"""How much each sighting says: which stand alone against their neighbours, and which repeat what others said."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from station.fit.image.image_fit import ImageFit
from station.fit.image.views import COORDINATES, Views
from station.logs import FloatArray

IntArray = NDArray[np.intp]

# A marker that was seen less often says nothing.
LEAST_SIGHTINGS = 9
# Sightings before and after that one is compared with.
NEIGHBOURS = (-2, -1, 1, 2)
# Of this share of good sightings chance alone makes outliers.
RARE = 1e-4
# The part of a corner's variance that all pictures of a marker at rest share, and how far corners may move meanwhile:
# measured on rendered frames (station.perception.corner_noise).
COMMON_SHARE = 0.6
SAME_LOOK_PX = 0.5
# Looks that take at least this share of a session have their common error estimated; of shorter ones each sighting
# counts less.
LONG = 1 / 3


@dataclass(frozen=True, eq=False)
class Weights:
    """Of N sightings.

    Attributes:
        share: (N,) of a picture of its own that each counts; 0 for those that are left out.
        look: (N,) number of the long look that each belongs to, the same error in all of its pictures; -1 for none.
        scale: (M,) deviations of each marker's corners, as multiples of those stated.
    """

    share: FloatArray
    look: IntArray
    scale: FloatArray


def weights(image: ImageFit) -> Weights:
    """How much each sighting counts.

    The fit's own word on outliers won't do: to it, all that follows when a marker moved may be outliers. Here a
    sighting is one if it agrees with none of its marker's sightings just before and after. Nor will its word on a
    marker's noise, for the same reason, where neighbours agree better than that.
    """
    views = image.views
    share, scale = np.zeros(len(views)), np.ones(len(views.marker_id))
    usual, most = (2.0 * gammaincinv(COORDINATES / 2, p) for p in (0.5, 1.0 - RARE))
    look, alike = looks_of(views)
    long = alike >= max(LONG * len(views.t_s), LEAST_SIGHTINGS)
    for marker in range(len(views.marker_id)):  # a few
        rows = np.flatnonzero((views.marker == marker) & np.isfinite(image.residual_px).all(axis=1))
        if len(rows) < LEAST_SIGHTINGS:
            continue
        squared = _apart(image.residual_px[rows], views.covariance_px2[rows])
        local = float(np.sqrt(np.median(squared[:-1, NEIGHBOURS.index(1)]) / usual))
        repeats = np.where(long[rows], 1.0, 1.0 + COMMON_SHARE * (alike[rows] - 1.0))
        share[rows] = (squared.min(axis=1) < most * max(local, 1e-12) ** 2) / repeats
        # Neighbours at rest differ by what they don't share.
        differing = np.sqrt(1.0 - COMMON_SHARE) if np.median(alike[rows]) > 1 else 1.0
        scale[marker] = min(float(image.scale[marker]), local / differing) or 1.0
    numbers = np.unique(look[long & (share > 0)])
    return Weights(share, np.where(long & (share > 0), np.searchsorted(numbers, look), -1), scale)


def _apart(residual_px: FloatArray, covariance_px2: FloatArray) -> FloatArray:
    """(n, 4) squared differences of residuals (n, 8) to those of each neighbour, in units of their noise."""
    root = np.asarray(np.linalg.cholesky(covariance_px2), dtype=np.float64)
    found = np.full((len(root), len(NEIGHBOURS)), np.inf)
    here = np.arange(len(root))
    for i, step in enumerate(NEIGHBOURS):
        there = here + step
        inside = (there >= 0) & (there < len(root))
        apart = (residual_px[there[inside]] - residual_px[inside]) / np.sqrt(2.0)
        white = np.asarray(np.linalg.solve(root[inside], apart[..., None]), dtype=np.float64)[..., 0]
        found[inside, i] = np.sum(white**2, axis=1)
    return found


def looks_of(views: Views) -> tuple[IntArray, FloatArray]:
    """(N,) numbers of looks, sightings on end of a marker that stays within SAME_LOOK_PX of the first of them.

    And (N,) how many sightings are in the same look.
    """
    look, alike = np.zeros(len(views), dtype=np.intp), np.ones(len(views))
    number = 0
    for marker in range(len(views.marker_id)):
        rows = np.flatnonzero(views.marker == marker)
        px = views.corners_px[rows].reshape(-1, COORDINATES)
        first = 0
        while first < len(rows):  # from look to look
            count = _same(px[first:])
            here = rows[first : first + count]
            look[here], alike[here] = number, count
            first, number = first + count, number + 1
    return look, alike


def _same(px: FloatArray) -> int:
    """How many of corners (n, 8) from the first on stay near it; looks twice as far each time."""
    reach = 2
    while True:
        moved = np.abs(px[:reach] - px[0]).max(axis=1) > SAME_LOOK_PX
        if moved.any():
            return int(np.argmax(moved))
        if reach >= len(px):
            return len(px)
        reach *= 2
