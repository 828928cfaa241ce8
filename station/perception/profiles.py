"""Brightness profiles across the edges of markers, in linear light, and a first estimate of where the edges are.

The image must be linear in light: seen through gamma, blur shifts an edge into the dark side (by 0.3 px for a mild
blur). How a camera encodes light is hardly ever known; what is left of such a shift is shared by all markers and
belongs to the camera (`CameraModel.edge_shift_px`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray
from station.quadrilaterals import Edges, edges_of, following, intersect_edges, preceding

Singles = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Decoding of 8-bit images to linear light: the exponent that cameras' sRGB curve is close to.
GAMMA = 2.2
LIGHT_OF_GREY = ((np.arange(256) / 255.0) ** GAMMA).astype(np.float32)

# The first estimate: profiles along each edge, samples across, and how far they reach.
COARSE_PROFILES = 8
COARSE_SAMPLES = 13
COARSE_REACH_PX = 4.0  # must bridge the detector's error
COARSE_CELL_SHARE = 0.85  # and stay within the border cell by this share of its width
COARSE_LEAST_REACH_PX = 1.0
# Share of a profile's steepest gradient that is taken off all of it.
GRADIENT_FLOOR = 0.2
# The profiles keep this far from the corners, where the neighbouring edge's blur reaches.
CORNER_MARGIN_PX = 1.5
LARGEST_MARGIN_SHARE = 0.25  # of the edge's length
# Light is decoded this far around the markers' corners.
LIGHT_MARGIN_PX = 8


def linear_light(grey: NDArray[np.uint8], corners_px: FloatArray) -> Singles:
    """Linear light 0...1 of a grey image (H, W) around quadrilaterals (M, 4, 2); black elsewhere."""
    height, width = grey.shape
    light = np.zeros((height, width), dtype=np.float32)
    low = np.maximum(np.floor(corners_px.min(axis=1)).astype(int) - LIGHT_MARGIN_PX, 0)
    high = np.ceil(corners_px.max(axis=1)).astype(int) + LIGHT_MARGIN_PX + 1
    for (x0, y0), (x1, y1) in zip(low.tolist(), high.tolist(), strict=True):  # a few rectangles, each one call
        if x0 < width and y0 < height and x1 > 0 and y1 > 0:
            light[y0:y1, x0:x1] = cv2.LUT(grey[y0:y1, x0:x1], LIGHT_OF_GREY)
    return light


def profile_span(length_px: FloatArray) -> FloatArray:
    """How much (M, 4) px of edges of these lengths is clear of the corners."""
    return length_px - 2.0 * np.minimum(CORNER_MARGIN_PX, LARGEST_MARGIN_SHARE * length_px)


@cache
def unit_places(profiles: int) -> FloatArray:
    """Places (P,) of the profiles along an edge, from its middle, in spans."""
    return (np.arange(profiles) + 0.5) / profiles - 0.5


def sample_profiles(
    light: Singles, edges: Edges, along_px: FloatArray, outward: FloatArray, across_px: FloatArray
) -> tuple[Singles, Mask]:
    """Light (M, 4, P, S) across the edges, and whether (M, 4, P) each profile lies in the image.

    Args:
        light: (H, W).
        edges: of the M quadrilaterals.
        along_px: (M, 4, P) places of the profiles along the edges, from their middles.
        outward: (M, 4, 2) directions of the profiles, 1 px further out for each unit.
        across_px: (M, 4, S) places of the samples along the profiles.
    """
    base = (edges.middle_px[:, :, None] + along_px[..., None] * edges.direction[:, :, None]).astype(np.float32)
    step = (across_px[..., None] * outward[:, :, None]).astype(np.float32)
    x, y = (base[..., axis, None] + step[:, :, None, :, axis] for axis in (0, 1))  # (M, 4, P, S)
    rows = (-1, x.shape[-2] * x.shape[-1])  # an image of 4 M rows: remap takes no more than 32767 of them
    seen = cv2.remap(light, x.reshape(rows), y.reshape(rows), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    height, width = light.shape
    low = (np.minimum(x[..., 0], x[..., -1]) >= 0) & (np.minimum(y[..., 0], y[..., -1]) >= 0)
    high = (np.maximum(x[..., 0], x[..., -1]) <= width - 1) & (np.maximum(y[..., 0], y[..., -1]) <= height - 1)
    return np.asarray(seen, dtype=np.float32).reshape(x.shape), low & high


@dataclass(frozen=True, eq=False)
class Lattice:
    """Where the cells of markers meet their edges (M, 4), in perspective.

    Attributes:
        width_px: (M, 4, 2) of the border cell along the normal, at the start and at the end of each edge.
        bounds: (M, 4, n + 1) ends of the n cells along each edge, as shares of its length from its middle.
        outward: (M, 4, 2) direction of the cells' columns across each edge, 1 px outward along the normal a unit.
    """

    width_px: FloatArray
    bounds: FloatArray
    outward: FloatArray


def lattice_of(corners_px: FloatArray, normal: FloatArray, cells: int) -> Lattice:
    """The lattice of square markers with `cells` cells a side and corners (M, 4, 2) px.

    With depths z of the corners, a share f of the way from corner A to B is seen at f z_B / ((1 - f) z_A + f z_B).
    The corners of a parallelogram's image have depths in proportion to the areas of the triangles of the others:
    +z_0 (p_0, 1) - z_1 (p_1, 1) + z_2 (p_2, 1) - z_3 (p_3, 1) = 0.
    """
    after, opposite, before = following(corners_px), corners_px[:, [2, 3, 0, 1]], preceding(corners_px)
    a, b = opposite - after, before - after
    depth = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    depth_after, depth_opposite, depth_before = following(depth), depth[:, [2, 3, 0, 1]], preceding(depth)
    start, end = before - corners_px, opposite - after
    share = np.stack(
        [
            depth_before / ((cells - 1) * depth + depth_before),
            depth_opposite / ((cells - 1) * depth_after + depth_opposite),
        ],
        axis=-1,
    )
    width_px = -share * np.einsum("mesk,mek->mes", np.stack([start, end], axis=2), normal)
    places = np.arange(cells + 1) / cells
    far = depth_after[..., None] * places
    bounds = far / (depth[..., None] * (1.0 - places) + far) - 0.5
    sides = -(start + end)
    outward = sides / np.einsum("mek,mek->me", sides, normal)[..., None]
    return Lattice(width_px, bounds, outward)


def _edge_places(profiles: Singles, across_px: Singles) -> tuple[Singles, Singles]:
    """Gradient-weighted centroids (...) px of profiles (..., S) at outward places of that shape; contrasts (...).

    The gradient is that from black inside to white outside, less a share of its largest value: without that, noise away
    from the edge, which is stronger on the white side of linear light, pulls the centroid outward.
    """
    gradient = profiles[..., 1:] - profiles[..., :-1]
    gradient = np.maximum(gradient - GRADIENT_FLOOR * gradient.max(axis=-1, keepdims=True), 0.0)
    middle_px = 0.5 * (across_px[..., 1:] + across_px[..., :-1])
    weight = gradient.sum(axis=-1)
    centroid_px = np.sum(gradient * middle_px, axis=-1) / np.where(weight > 0, weight, 1.0)
    return centroid_px, profiles[..., -1] - profiles[..., 0]


def coarse_corners(light: Singles, corners_px: FloatArray, cells: int, least_contrast: float) -> FloatArray:
    """Corners (M, 4, 2) px to a few tenths of a pixel from rough ones; NaN where an edge shows nowhere."""
    edges = edges_of(corners_px)
    inward = np.stack([corners_px - preceding(corners_px), following(corners_px) - corners_px[:, [2, 3, 0, 1]]], axis=2)
    width_px = np.min(inward @ edges.normal[..., None], axis=(2, 3)) / cells  # perspective apart
    reach_px = np.clip(COARSE_CELL_SHARE * width_px, COARSE_LEAST_REACH_PX, COARSE_REACH_PX)
    span_px = profile_span(edges.length_px)
    across_px = reach_px[..., None] * np.linspace(-1.0, 1.0, COARSE_SAMPLES)
    along_px = span_px[..., None] * unit_places(COARSE_PROFILES)
    profiles, inside = sample_profiles(light, edges, along_px, edges.normal, across_px)
    place_px, contrast = _edge_places(profiles, across_px[:, :, None].astype(np.float32))
    weight = ((contrast > least_contrast) & inside).astype(np.float64)
    return moved_corners(edges, *fit_lines(span_px, place_px.astype(np.float64), weight))


def fit_lines(span_px: FloatArray, place_px: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Offsets and slopes (M, 4) of the lines `place = offset + slope * along` through profiles at `unit_places`.

    Args:
        span_px: (M, 4) that the profiles cover.
        place_px, weight: (M, 4, P) of the profiles; NaN where none has weight.
    """
    powers = _powers(place_px.shape[-1])
    sums, products = weight @ powers, (weight * place_px) @ powers[:, :2]
    w, wx, wxx = sums[..., 0], sums[..., 1], sums[..., 2]
    wy, wxy = products[..., 0], products[..., 1]
    det = w * wxx - wx * wx
    det = np.where(det > 0, det, np.nan)
    return (wxx * wy - wx * wxy) / det, (w * wxy - wx * wy) / (det * span_px)


@cache
def _powers(profiles: int) -> FloatArray:
    return unit_places(profiles)[:, None] ** np.arange(3)


def moved_corners(edges: Edges, offset_px: FloatArray, slope: FloatArray) -> FloatArray:
    """Corners (M, 4, 2) px of the quadrilaterals whose edges lie outward by `offset + slope * along` (M, 4)."""
    normal = edges.normal - slope[..., None] * edges.direction
    return intersect_edges(normal, np.einsum("mek,mek->me", normal, edges.middle_px) + offset_px)
