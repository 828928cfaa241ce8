"""How blurred the edges of detected markers are: what a fast motion, a slow shutter or a wrong focus does to them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray

# Profiles across the middle of each edge, their samples, and how far they reach to either side, px.
PLACES = np.linspace(0.3, 0.7, 7)
SAMPLES = 25
REACH_PX = 8.0
# Share of the border cell's width that a profile may use.
CELL_SHARE = 0.85
# Grey levels between black and white below which an edge has no width.
LEAST_CONTRAST = 10.0


def edge_widths_px(image: NDArray[np.uint8], corners_px: FloatArray, cells: int) -> FloatArray:
    """(M, 4) width of each edge of the markers: contrast over steepest slope, px; NaN where there is hardly contrast.

    About 1.3 px for a sharp image, 2.5 sigma for a Gaussian blur, the smear itself for motion across the edge.

    Args:
        image: (H, W) grey or (H, W, 3) BGR, of which the green is looked at.
        corners_px: (M, 4, 2), clockwise.
        cells: how many cells a side of the square has, its border included.
    """
    corners = np.asarray(corners_px, dtype=np.float64)
    if not len(corners):
        return np.zeros((0, 4))
    along = np.roll(corners, -1, axis=1) - corners
    length_px = np.linalg.norm(along, axis=-1)
    normal = np.stack([along[..., 1], -along[..., 0]], axis=-1) / np.maximum(length_px, 1e-9)[..., None]
    reach_px = np.clip(CELL_SHARE * length_px.min(axis=1) / cells, 1.0, REACH_PX)
    across_px = reach_px[:, None] * np.linspace(-1.0, 1.0, SAMPLES)
    base = corners[:, :, None] + PLACES[:, None] * along[:, :, None]  # (M, 4, places, 2)
    at = base[:, :, :, None] + across_px[:, None, None, :, None] * normal[:, :, None, None]
    flat = at.reshape(-1, SAMPLES, 2).astype(np.float32)
    seen = cv2.remap(image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    green = seen[..., 1] if image.ndim == 3 else seen
    profile = np.asarray(green, dtype=np.float64).reshape(*at.shape[:3], SAMPLES).mean(axis=2)  # noise averages out
    contrast = profile.max(axis=-1) - profile.min(axis=-1)
    steepest = np.diff(profile, axis=-1).max(axis=-1) / (2 * reach_px / (SAMPLES - 1))[:, None]
    return np.where((contrast >= LEAST_CONTRAST) & (steepest > 0), contrast / np.maximum(steepest, 1e-9), np.nan)
