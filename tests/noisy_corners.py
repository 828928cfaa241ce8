"""Noise of corners for tests: of each coordinate by itself, or of lines fitted to the edges, which neighbours share."""

from __future__ import annotations

import numpy as np

from calibration.intrinsics import FloatArray
from station.quadrilaterals import edges_of, intersect_edges


def independent(px: FloatArray, sigma_px: float, rng: np.random.Generator) -> FloatArray:
    """Corners (M, 4, 2) with white noise on each coordinate."""
    return px + sigma_px * rng.standard_normal(px.shape)


def of_edges(px: FloatArray, sigma_px: float, rng: np.random.Generator) -> FloatArray:
    """Corners (M, 4, 2) where the edges meet that lie off by `sigma_px` at their ends: offset and slope err apart.

    Of evenly spread profiles the slope has three times the offset's variance at the ends.
    """
    edges = edges_of(px)
    offset, slope = (
        sigma_px * rng.standard_normal((2, *edges.length_px.shape)) * np.array([0.5, 0.75**0.5])[:, None, None]
    )
    normal = edges.normal - (slope / (0.5 * edges.length_px))[..., None] * edges.direction
    return intersect_edges(normal, np.sum(normal * edges.middle_px, axis=-1) + offset)


def joint(covariance_px2: FloatArray) -> FloatArray:
    """Covariances (M, 8, 8) of corners that err independently, of theirs (M, 4, 2, 2)."""
    whole = np.zeros((len(covariance_px2), 4, 2, 4, 2))
    corner = np.arange(4)
    whole[:, corner, :, corner] = np.moveaxis(covariance_px2, 1, 0)
    return whole.reshape(-1, 8, 8)
