"""How far a camera shows the edges of black squares from where they are: blur seen through gamma, or overexposure.

Corners of a chessboard are free of it, so a camera calibrated on them knows where the corners of the board's markers
are; where their edges are seen tells the shift, one for all edges. What it depends on (focus, exposure, gamma) is the
camera's setting, not the place in the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError
from calibration.intrinsics import FloatArray

LEAST_MARKERS = 8
# Edges further off than so many robust standard deviations are covered or mistaken ones.
STRAY_SIGMAS = 4.0
MAD_TO_SIGMA = 1.4826
ROUNDS = 3
# Of a shift, besides what the scatter between views says: the line fits' own bias (notes: up to 0.006 px), twice.
FLOOR_PX = 0.01


@dataclass(frozen=True)
class EdgeShift:
    """A shift along the outward normals (px; negative: black looks smaller), its standard deviation, its markers."""

    shift_px: float
    std_px: float
    markers: int


def edge_offsets(seen_px: FloatArray, true_px: FloatArray) -> FloatArray:
    """(M, 4) how far each edge (from corner i to i + 1) is seen outward of the true one, at its middle, px.

    Args:
        seen_px, true_px: (M, 4, 2) corners, clockwise as seen.
    """
    along = np.roll(true_px, -1, axis=1) - true_px
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    outward = np.stack([along[..., 1], -along[..., 0]], axis=-1) / length
    middles = 0.5 * ((seen_px - true_px) + np.roll(seen_px - true_px, -1, axis=1))
    return np.sum(middles * outward, axis=-1)


def estimate_edge_shift(seen_px: FloatArray, true_px: FloatArray, view: NDArray[np.int64]) -> EdgeShift:
    """The shift that all edges share.

    Args:
        seen_px: (M, 4, 2) corners as the station's detector sees them.
        true_px: (M, 4, 2) where the calibrated camera has them.
        view: (M,) the view that each marker was seen in: what a pose is off is off for a whole view.

    Raises:
        CalibrationError: for too few markers.
    """
    if len(seen_px) < LEAST_MARKERS:
        raise CalibrationError(f"{len(seen_px)} markers tell no edge shift; want at least {LEAST_MARKERS}")
    offsets = edge_offsets(seen_px, true_px).mean(axis=1)  # a marker's own misplacement cancels
    kept, scale = np.ones(len(offsets), bool), 0.0
    for _ in range(ROUNDS):  # each round judges by the last one's middle
        middle = float(np.median(offsets[kept]))
        scale = MAD_TO_SIGMA * float(np.median(np.abs(offsets[kept] - middle)))
        kept = np.abs(offsets - middle) <= STRAY_SIGMAS * max(scale, 1e-3)
    views = np.unique(view[kept])
    means = np.array([offsets[kept & (view == v)].mean() for v in views])
    std = float(np.std(means, ddof=1) / np.sqrt(len(means))) if len(means) > 1 else scale
    return EdgeShift(float(np.mean(means)), float(np.hypot(std, FLOOR_PX)), int(kept.sum()))
