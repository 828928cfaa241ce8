"""Joint covariance of a marker's four corners: neighbours share an edge, and so its errors.

A corner is where two lines meet, each fitted to an edge. Of a line fitted to evenly spread profiles the offset and the
slope err independently, the slope's part being three times the offset's at the ends: the places at the two ends of an
edge have the correlation (1 - 3) / (1 + 3). Taken as independent, corners would tell depth and place with twice the
variance that they have, and the residuals would seem noisier than they are.
"""

from __future__ import annotations

import numpy as np

from station.logs import FloatArray
from station.perception.observations import COORDINATES, CORNERS
from station.quadrilaterals import edges_of, following, preceding

# Between the places of an edge's line at its two ends: measured on rendered frames -0.46 to -0.52 (markers of 30 to 50
# px), -0.75 at 100 px, where aliasing along the edges adds to the slopes.
END_CORRELATION = -0.5


def joint_covariance(corners_px: FloatArray, covariance_px2: FloatArray) -> FloatArray:
    """Covariances (M, 8, 8) px^2 of corners (M, 4, 2), coordinates u0, v0, u1, ...; NaN where not known.

    Args:
        corners_px: (M, 4, 2) clockwise as seen.
        covariance_px2: (M, 4, 2, 2) of each corner, as the detector states it: of two lines' independent errors.
    """
    normal = edges_of(corners_px).normal
    before = preceding(normal)
    det = before[..., 0] * normal[..., 1] - before[..., 1] * normal[..., 0]
    # How corner i moves when the place of edge i - 1, or of edge i, moves outward there.
    by_before = np.stack([normal[..., 1], -normal[..., 0]], axis=-1) / det[..., None]
    by_here = np.stack([-before[..., 1], before[..., 0]], axis=-1) / det[..., None]
    at_start = _place_sigma(normal, covariance_px2)
    at_end = _place_sigma(normal, following(covariance_px2))
    # Columns: corner coordinates by the place of edge e at its start and at its end, in standard deviations.
    count, edge = len(corners_px), np.arange(CORNERS)
    G = np.zeros((count, CORNERS, 2, CORNERS, 2))
    G[:, edge, :, edge, 0] = np.moveaxis(by_here * at_start[..., None], 1, 0)
    end = (edge + 1) % CORNERS
    G[:, end, :, edge, 1] = np.moveaxis(following(by_before) * at_end[..., None], 1, 0)
    G = G.reshape(count, COORDINATES, CORNERS, 2)
    ends = np.array([[1.0, END_CORRELATION], [END_CORRELATION, 1.0]])
    spread = (G @ ends).reshape(count, COORDINATES, COORDINATES)
    return spread @ np.swapaxes(G.reshape(count, COORDINATES, COORDINATES), -1, -2)


def _place_sigma(normal: FloatArray, covariance_px2: FloatArray) -> FloatArray:
    """Standard deviations (M, 4) along the normals (M, 4, 2) of points with covariances (M, 4, 2, 2)."""
    return np.sqrt(np.einsum("mei,meij,mej->me", normal, covariance_px2, normal))
