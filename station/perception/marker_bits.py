"""The cells of markers: those of a dictionary, and whether an image shows them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray

# A cell must lie on its side of the middle between the marker's mean white and mean black by this share of their
# difference: blur draws small cells towards the middle, but less than half of the way where corners can be refined.
CLEARANCE = 0.05
# Black and white must differ by this much, of 255.
LEAST_CONTRAST_GREY = 8.0


def dictionary_bits(dictionary: cv2.aruco.Dictionary) -> FloatArray:
    """Cells (N, n, n) of a dictionary's markers with their border of one cell, 1 = white; row 0 is the top."""
    size = int(dictionary.markerSize)
    bits = np.zeros((len(dictionary.bytesList), size + 2, size + 2))
    for marker, code in enumerate(dictionary.bytesList):  # OpenCV unpacks one marker at a time
        bits[marker, 1:-1, 1:-1] = cv2.aruco.Dictionary.getBitsFromByteList(code[None], size)
    return bits


def behind_border(bits: FloatArray) -> FloatArray:
    """Bits (M, 4, n) behind the border of markers with cells (M, n, n), along the edges clockwise from the top left."""
    return np.stack([bits[:, 1], bits[:, :, -2], bits[:, -2, ::-1], bits[:, ::-1, 1]], axis=1)


def cell_middles(corners_px: FloatArray, cells: int) -> FloatArray:
    """Middles (M, n, n, 2) px of the cells of markers with corners (M, 4, 2): rows from the top, columns from the left.

    In perspective: a point with shares (s, t) of the square is the mean of the corners weighted by (1 - s)(1 - t) z_0,
    s (1 - t) z_1, s t z_2, (1 - s) t z_3, where the depths z are as the areas of the triangles of the other corners.
    """
    after, before = corners_px[:, [1, 2, 3, 0]], corners_px[:, [3, 0, 1, 2]]
    a, b = corners_px[:, [2, 3, 0, 1]] - after, before - after
    depth = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    share = (np.arange(cells) + 0.5) / cells
    s, t = share[None, :], share[:, None]
    shares = np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=-1)  # (n, n, 4)
    weight = shares.reshape(-1, 4) * depth[:, None]  # (M, n n, 4)
    middles = (weight @ corners_px) / weight.sum(axis=-1, keepdims=True)
    return middles.reshape(-1, cells, cells, 2)


def _middle_greys(grey: NDArray[np.uint8], corners_px: FloatArray, cells: int) -> FloatArray:
    """Grey levels (M, n n) of the middles of the cells."""
    if not len(corners_px):
        return np.zeros((0, cells * cells))
    x, y = (cell_middles(corners_px, cells)[..., axis].reshape(-1, cells * cells) for axis in (0, 1))
    maps = x.astype(np.float32), y.astype(np.float32)
    return np.asarray(cv2.remap(grey, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float64)


def shows_bits(grey: NDArray[np.uint8], corners_px: FloatArray, bits: FloatArray) -> NDArray[np.bool_]:
    """Whether (M,) an image shows the cells (M, n, n) of markers with corners (M, 4, 2): every one of them."""
    if not len(corners_px):
        return np.zeros(0, dtype=bool)
    seen = _middle_greys(grey, corners_px, bits.shape[1])
    white = bits.reshape(len(bits), -1)
    black = 1.0 - white  # there is some: the border
    mean_white = np.sum(seen * white, axis=-1) / np.maximum(white.sum(axis=-1), 1.0)
    mean_black = np.sum(seen * black, axis=-1) / black.sum(axis=-1)
    contrast = mean_white - mean_black
    place = (seen - 0.5 * (mean_white + mean_black)[:, None]) * (2.0 * white - 1.0)
    return (place.min(axis=-1) > CLEARANCE * contrast) & (contrast > LEAST_CONTRAST_GREY)
