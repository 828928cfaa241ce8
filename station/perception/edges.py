"""Sub-pixel corners of black squares: brightness profiles across the edges, a robust line an edge, then intersections.

All edges of all markers of a frame are worked on at once. The image must be linear in light: seen through gamma, blur
shifts an edge into the dark side (by 0.3 px for a mild blur). Lines are fitted in the distorted image: an edge of 40 px
in the corner of a 640x480 image with k1 = -0.1 bows by 0.03 px, which moves its corners by about 0.02 px; long edges
near the border of a strongly distorted image lose more.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray

# Decoding of 8-bit images to linear light: the exponent that cameras' sRGB curve is close to.
GAMMA = 2.2

PROFILES = 24  # along each edge
SAMPLES = 13  # across the edge, in each profile
ROUNDS = 2
# Half length of a profile: no further than this, and within the border cell by this share of its width.
HALF_PROFILE_PX = (4.0, 3.0)  # a value a round: the first must bridge the detector's error
CELL_SHARE = 0.85
SHORTEST_HALF_PROFILE_PX = 1.0
# The profiles keep this far from the corners, where the neighbouring edge's blur reaches.
CORNER_MARGIN_PX = 2.0
LARGEST_MARGIN_SHARE = 0.25  # of the edge's length
# Share of a profile's steepest gradient that is taken off all of it.
GRADIENT_FLOOR = 0.2

LINE_ROUNDS = 3
# Tukey's constant: beyond this many standard deviations a profile has no weight; 95 % efficient for Gaussian errors.
TUKEY = 4.685
MAD_TO_SIGMA = 1.4826
SMALLEST_SCALE_PX = 0.02  # floor of the robust scale, so that perfect images don't reject on rounding

# What a marker's edges must show to be believed.
LEAST_CONTRAST = 0.02  # white less black, of full linear light
LARGEST_LINE_RESIDUAL_PX = 0.5  # robust scale of the profiles about the line
LARGEST_MOVE_PX = 3.0  # of a corner by the whole refinement
LEAST_PROFILES = 0.5  # share of the profiles that show the edge


@dataclass(frozen=True, eq=False)
class RefinedCorners:
    """Corners (M, 4, 2) in px, and whether (M,) each marker's edges are those of a black square on white."""

    corners_px: FloatArray
    good: NDArray[np.bool_]


def linear_light(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Linear light 0...1 of an 8-bit grey image (H, W)."""
    table = ((np.arange(256) / 255.0) ** GAMMA).astype(np.float32)
    return np.asarray(cv2.LUT(grey, table), dtype=np.float32)


def _normals(corners_px: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions (M, 4, 2), outward normals (M, 4, 2) and lengths (M, 4) px of the edges from corner i to i + 1.

    The corners run clockwise as seen (y down); seen from behind, which no marker is, the normals would point inward.
    """
    along = np.roll(corners_px, -1, axis=1) - corners_px
    length_px = np.linalg.norm(along, axis=-1)
    direction = along / length_px[..., None]
    normal = np.stack([direction[..., 1], -direction[..., 0]], axis=-1)
    return direction, normal, length_px


def intersect_edges(normal: FloatArray, offset_px: FloatArray) -> FloatArray:
    """Corners (M, 4, 2): corner i is where edges i - 1 and i meet.

    Edge i is the line `normal . p = offset`, with normals (M, 4, 2) of any length and offsets (M, 4).
    """
    before_n, before_c = np.roll(normal, 1, axis=1), np.roll(offset_px, 1, axis=1)
    det = before_n[..., 0] * normal[..., 1] - before_n[..., 1] * normal[..., 0]
    x = before_c * normal[..., 1] - offset_px * before_n[..., 1]
    y = before_n[..., 0] * offset_px - normal[..., 0] * before_c
    return np.stack([x, y], axis=-1) / np.where(det == 0, np.nan, det)[..., None]


def shift_edges(corners_px: FloatArray, outward_px: float) -> FloatArray:
    """Corners (M, 4, 2) of the quadrilaterals whose edges are moved along their outward normals by `outward_px`."""
    _, normal, _ = _normals(corners_px)
    return intersect_edges(normal, np.sum(normal * corners_px, axis=-1) + outward_px)


def _half_profiles(corners_px: FloatArray, normal: FloatArray, cells: int, limit_px: float) -> FloatArray:
    """Half lengths (M, 4) px of the profiles: within the border cell, whose width differs from edge to edge."""
    opposite = np.stack([np.roll(corners_px, -2, axis=1), np.roll(corners_px, -3, axis=1)], axis=2)
    depth_px = -np.sum(normal[:, :, None] * (opposite - corners_px[:, :, None]), axis=-1).min(axis=-1)
    return np.clip(CELL_SHARE * depth_px / cells, SHORTEST_HALF_PROFILE_PX, limit_px)


def _profile_bases(
    corners_px: FloatArray, direction: FloatArray, length_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Middles (M, 4, PROFILES, 2) px of the profiles; places (M, 4, PROFILES) px along the edges from their middles."""
    margin_px = np.minimum(CORNER_MARGIN_PX, LARGEST_MARGIN_SHARE * length_px)
    places = (np.arange(PROFILES) + 0.5) / PROFILES - 0.5
    along_px = (length_px - 2 * margin_px)[..., None] * places
    middle = corners_px + 0.5 * (length_px[..., None] * direction)
    return middle[:, :, None] + along_px[..., None] * direction[:, :, None], along_px


def _edge_places(
    profiles: NDArray[np.float32], across_px: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Gradient-weighted centroids (...) px of profiles (..., SAMPLES) at outward places of that shape; contrasts (...).

    The gradient is that from black inside to white outside, less a share of its largest value: without that, noise away
    from the edge, which is stronger on the white side of linear light, pulls the centroid outward.
    """
    gradient = np.diff(profiles, axis=-1)
    gradient = np.maximum(gradient - GRADIENT_FLOOR * gradient.max(axis=-1, keepdims=True), 0.0)
    middle_px = 0.5 * (across_px[..., 1:] + across_px[..., :-1])
    weight = gradient.sum(axis=-1)
    centroid_px = np.sum(gradient * middle_px, axis=-1) / np.where(weight > 0, weight, 1.0)
    return centroid_px, profiles[..., -2:].mean(axis=-1) - profiles[..., :2].mean(axis=-1)


def _fit_lines(
    along_px: FloatArray, place_px: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Robust lines `place = offset + slope * along` over the last axis; offset, slope and robust scale (px) (M, 4)."""
    w = weight
    offset = slope = scale = np.zeros(place_px.shape[:-1])
    for _ in range(LINE_ROUNDS):  # reweighting: each round needs the last
        total = np.maximum(w.sum(axis=-1), 1e-12)
        mean_x = (w * along_px).sum(axis=-1) / total
        mean_y = (w * place_px).sum(axis=-1) / total
        x, y = along_px - mean_x[..., None], place_px - mean_y[..., None]
        slope = (w * x * y).sum(axis=-1) / np.maximum((w * x * x).sum(axis=-1), 1e-12)
        offset = mean_y - slope * mean_x
        residual = np.abs(y - slope[..., None] * x)
        scale = np.maximum(MAD_TO_SIGMA * np.median(residual, axis=-1), SMALLEST_SCALE_PX)
        w = weight * np.maximum(1.0 - (residual / (TUKEY * scale[..., None])) ** 2, 0.0) ** 2
    return offset, slope, scale


def _sample(
    light: NDArray[np.float32], base_px: FloatArray, normal: FloatArray, across_px: FloatArray
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Light (M, 4, PROFILES, SAMPLES) across the edges, and whether (M, 4, PROFILES) each profile lies in the image."""
    shape = (*base_px.shape[:-1], across_px.shape[-1])
    step = (across_px[..., None] * normal[:, :, None]).astype(np.float32)  # (M, 4, SAMPLES, 2)
    base = base_px.astype(np.float32)
    x = base[..., 0, None] + step[:, :, None, :, 0]
    y = base[..., 1, None] + step[:, :, None, :, 1]
    flat = (-1, shape[-1])
    seen = cv2.remap(light, x.reshape(flat), y.reshape(flat), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    ends_x, ends_y = x[..., [0, -1]], y[..., [0, -1]]
    height, width = light.shape
    inside = (ends_x >= 0) & (ends_x <= width - 1) & (ends_y >= 0) & (ends_y <= height - 1)
    return np.asarray(seen, dtype=np.float32).reshape(shape), np.all(inside, axis=-1)


def _refine_once(
    light: NDArray[np.float32], corners_px: FloatArray, cells: int, limit_px: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """One round: corners (M, 4, 2) from lines fitted about `corners_px`; whether (M,) the lines can be believed."""
    direction, normal, length_px = _normals(corners_px)
    half_px = _half_profiles(corners_px, normal, cells, limit_px)
    base_px, along_px = _profile_bases(corners_px, direction, length_px)
    across_px = half_px[..., None] * np.linspace(-1.0, 1.0, SAMPLES)
    profiles, inside = _sample(light, base_px, normal, across_px)
    place_px, contrast = _edge_places(profiles, across_px[:, :, None].astype(np.float32))
    weight = ((contrast > LEAST_CONTRAST) & inside).astype(np.float64)
    offset_px, slope, scale_px = _fit_lines(along_px, place_px.astype(np.float64), weight)
    believed = (weight.mean(axis=-1) >= LEAST_PROFILES) & (scale_px <= LARGEST_LINE_RESIDUAL_PX)
    middle_px = 0.5 * (corners_px + np.roll(corners_px, -1, axis=1))
    line_normal = normal - slope[..., None] * direction
    refined = intersect_edges(line_normal, np.sum(line_normal * middle_px, axis=-1) + offset_px)
    return refined, np.all(believed, axis=-1)


def refine_corners(light: NDArray[np.float32], corners_px: FloatArray, cells: int) -> RefinedCorners:
    """Corners of black squares to a few hundredths of a pixel.

    Args:
        light: (H, W) image in linear light, see `linear_light`.
        corners_px: (M, 4, 2) rough corners, clockwise as seen, right to about 2 px.
        cells: how many cells a side of the square has, its border included: the black border is one cell wide.

    Returns:
        The corners, and whether each marker's edges looked like edges; those of the others are as they came.
    """
    rough = np.asarray(corners_px, dtype=np.float64)
    if len(rough) == 0:
        return RefinedCorners(rough, np.zeros(0, dtype=bool))
    corners, good = rough, np.ones(len(rough), dtype=bool)
    for limit_px in HALF_PROFILE_PX[:ROUNDS]:  # the second round centres its profiles on the first's lines
        refined, believed = _refine_once(light, corners, cells, limit_px)
        moved_px = np.linalg.norm(refined - rough, axis=-1).max(axis=-1)
        good = good & believed & (moved_px <= LARGEST_MOVE_PX)  # NaN compares false
        corners = np.where(good[:, None, None], refined, rough)
    return RefinedCorners(corners, good)
