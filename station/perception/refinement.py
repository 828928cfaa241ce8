"""Sub-pixel corners of markers with their covariances: brightness profiles, a robust line an edge, intersections.

All edges of all markers of a frame are worked on at once. First the edges are found to a few tenths of a pixel by the
centroids of their gradients; then profiles across them are fitted by the model of an edge in the marker's own pattern.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel
from station.logs import FloatArray
from station.perception.corner_covariance import Scatter, corner_covariances
from station.perception.edge_model import edge_places, fit_shape, surroundings
from station.perception.profiles import (
    Lattice,
    Mask,
    Singles,
    coarse_corners,
    fit_lines,
    lattice_of,
    linear_light,
    moved_corners,
    profile_span,
    sample_profiles,
    unit_places,
)
from station.quadrilaterals import Edges, edges_of, following

PROFILES = 20  # along each edge
SAMPLES = 11  # across the edge, in each profile
# A profile reaches no further than this, nor than these shares of the border's width: outside only the white margin of
# one cell is certain, inside the cell behind the border is known.
REACH_PX = 3.0
LEAST_REACH_PX = 1.0
OUTER_SHARE, INNER_SHARE = 1.0, 1.5

NO_MOTION = np.zeros(3)

LINE_ROUNDS = 3
# Tukey's constant: beyond this many standard deviations a profile has no weight; 95 % efficient for Gaussian errors.
TUKEY = 4.685
MAD_TO_SIGMA = 1.4826
SMALLEST_SCALE_PX = 0.02  # floor of the robust scale, so that perfect images don't reject on rounding

# What a marker's edges must show to be believed.
LEAST_CONTRAST = 0.02  # white less black, of full linear light
LARGEST_LINE_RESIDUAL_PX = 0.5  # robust scale of the profiles about the line
LARGEST_MOVE_PX = 3.0  # of a corner's coordinate by the whole refinement
LEAST_PROFILES = 0.5  # share of the profiles that lie on the line
# RMS of the mean profile about the model, as a share of the contrast: 0.01 is usual, 0.05 a smear of 7 px, beyond which
# corners are off by tenths of a pixel.
LARGEST_MISFIT = 0.05


@dataclass(frozen=True, eq=False)
class RefinedCorners:
    """What refinement found of M markers.

    Attributes:
        corners_px: (M, 4, 2); of markers that aren't good, as they came.
        covariance_px2: (M, 4, 2, 2) of each corner, apart from a shift of all edges that all markers share.
        good: (M,) whether the edges are those of a black square on white.
        blur_px: (M,) sigma of the edges' blur, that of the pixels and of their interpolation (0.5 px) included.
    """

    corners_px: FloatArray
    covariance_px2: FloatArray
    good: NDArray[np.bool_]
    blur_px: FloatArray


class _Lines(NamedTuple):
    """Robust lines of the edges (M, 4), `place = offset + slope * along`, and how profiles lie about them."""

    offset_px: FloatArray
    slope: FloatArray
    scale_px: FloatArray
    residual_px: FloatArray
    weight: FloatArray


class _Seen(NamedTuple):
    """Profiles (M, 4, P, S) across edges, and which (M, 4, P) show an edge, at their places along and across."""

    light: Singles
    weight: FloatArray
    span_px: FloatArray
    along_px: FloatArray
    across_px: FloatArray


def refine_corners(
    grey: NDArray[np.uint8], corners_px: FloatArray, inner: FloatArray, camera: CameraModel | None = None
) -> RefinedCorners:
    """Corners of markers to a few hundredths of a pixel.

    Args:
        grey: (H, W) image.
        corners_px: (M, 4, 2) rough corners, clockwise as seen from the marker's top left, right to about 2 px.
        inner: (M, 4, n) bits (1 = white) of the n cells behind the border along each edge, see `surroundings`.
        camera: whose lens bends the edges; None = not known, long edges are then less sure.
    """
    rough = np.asarray(corners_px, dtype=np.float64)
    if len(rough) == 0:
        return RefinedCorners(rough, np.zeros((0, 4, 2, 2)), np.zeros(0, dtype=bool), np.zeros(0))
    light = linear_light(grey, rough)
    with np.errstate(invalid="ignore", divide="ignore"):  # where no edge shows there are NaN; those are not good
        coarse = coarse_corners(light, rough, inner.shape[-1], LEAST_CONTRAST)
        near = _near(coarse, rough)
        return _refined(light, rough, np.where(near[:, None, None], coarse, rough), inner, near, camera)


def _near(corners_px: FloatArray, rough_px: FloatArray) -> Mask:
    """Whether (M,) all corners are where the detector saw them; not for NaN."""
    return np.abs(corners_px - rough_px).max(axis=(1, 2)) <= LARGEST_MOVE_PX


def _refined(
    light: Singles, rough: FloatArray, coarse: FloatArray, inner: FloatArray, near: Mask, camera: CameraModel | None
) -> RefinedCorners:
    edges = edges_of(coarse)
    lattice = lattice_of(coarse, edges.normal, inner.shape[-1])
    seen = _seen(light, edges, lattice)
    slope = np.einsum("mek,mek->me", lattice.outward, edges.direction)
    beside = surroundings(inner, seen.along_px, lattice.bounds * edges.length_px[..., None], slope)
    share = seen.weight / np.maximum(seen.weight.sum(axis=-1, keepdims=True), 1.0)
    mean = (share[:, :, None].astype(np.float32) @ seen.light)[:, :, 0].astype(np.float64)
    shape = fit_shape(mean, (share[:, :, None] @ beside)[:, :, 0], seen.across_px, lattice.width_px.mean(axis=-1))
    place_px, information = edge_places(seen.light, beside, shape)
    if camera is not None:
        place_px = place_px - _bow(camera, coarse, edges, seen.along_px)
    lines = _robust_lines(seen, place_px)
    refined = moved_corners(edges, lines.offset_px, lines.slope)
    scatter = Scatter(seen.along_px, lines.residual_px, lines.weight, information)
    covariance = corner_covariances(edges, shape, scatter, bow_known=camera is not None)
    believed = (np.mean(lines.weight > 0, axis=-1) >= LEAST_PROFILES) & (lines.scale_px <= LARGEST_LINE_RESIDUAL_PX)
    believed &= (shape.contrast > LEAST_CONTRAST) & (shape.misfit <= LARGEST_MISFIT)
    good = near & _near(refined, rough) & np.all(believed, axis=-1)
    return RefinedCorners(np.where(good[:, None, None], refined, rough), covariance, good, shape.blur_px[:, 0])


def _seen(light: Singles, edges: Edges, lattice: Lattice) -> _Seen:
    """The profiles across the edges; those that leave the image or show no step from black to white have no weight."""
    out_px = np.clip(OUTER_SHARE * lattice.width_px.min(axis=-1), LEAST_REACH_PX, REACH_PX)
    in_px = np.clip(INNER_SHARE * lattice.width_px.mean(axis=-1), LEAST_REACH_PX, REACH_PX)
    across_px = (in_px + out_px)[..., None] * np.linspace(0.0, 1.0, SAMPLES) - in_px[..., None]
    span_px = profile_span(edges.length_px)
    along_px = span_px[..., None] * unit_places(PROFILES)
    profiles, inside = sample_profiles(light, edges, along_px, lattice.outward, across_px)
    step = profiles[..., -1] - profiles.min(axis=-1)
    return _Seen(profiles, (inside & (step > LEAST_CONTRAST)).astype(np.float64), span_px, along_px, across_px)


def _bow(camera: CameraModel, corners_px: FloatArray, edges: Edges, along_px: FloatArray) -> FloatArray:
    """How far outward (M, 4, P) px the lens bends straight edges between these corners: a parabola."""
    undistorted = cv2.undistortPoints(corners_px.reshape(-1, 1, 2), camera.matrix, camera.distortion)
    ideal = np.asarray(undistorted, dtype=np.float64).reshape(-1, 4, 2)
    middle = np.ones((ideal.shape[0], 4, 3))
    middle[..., :2] = 0.5 * (ideal + following(ideal))
    seen_px, _ = cv2.projectPoints(middle.reshape(-1, 3), NO_MOTION, NO_MOTION, camera.matrix, camera.distortion)
    sag_px = np.einsum("mek,mek->me", seen_px.reshape(-1, 4, 2) - edges.middle_px, edges.normal)
    return sag_px[..., None] * (1.0 - (2.0 * along_px / edges.length_px[..., None]) ** 2)


def _robust_lines(seen: _Seen, place_px: FloatArray) -> _Lines:
    """Lines through places (M, 4, P), those far off a line of the others without weight."""
    w, middle = seen.weight, place_px.shape[-1] // 2
    offset_px = slope = scale_px = np.zeros(place_px.shape[:-1])
    residual_px = place_px
    for _ in range(LINE_ROUNDS):  # reweighting: each round needs the last
        offset_px, slope = fit_lines(seen.span_px, place_px, w)
        residual_px = place_px - offset_px[..., None] - slope[..., None] * seen.along_px
        median_px = np.partition(np.abs(residual_px), middle, axis=-1)[..., middle]
        scale_px = np.maximum(MAD_TO_SIGMA * median_px, SMALLEST_SCALE_PX)
        w = seen.weight * np.maximum(1.0 - (residual_px / (TUKEY * scale_px[..., None])) ** 2, 0.0) ** 2
    return _Lines(offset_px, slope, scale_px, residual_px, w)
