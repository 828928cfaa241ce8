"""The model of brightness across a marker's edge, and its least squares fit to sampled profiles.

Across the edge, `s` px outward from where it was last thought to be, linear light is

    A + C [ Phi((s - d) / sigma) + b Phi((d - s - w) / sigma) ]

with black A, contrast C, the edge at d, blur sigma, and behind the black border of width w the inner cell's bit b (1
for white), known since the marker is. b changes along the edge, blurred as well. What is beyond the border's own width
outside and the second cell inside is not known: samples that its blur reaches have no weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from station.logs import FloatArray
from station.perception.profiles import Singles

FIRST_BLUR_PX = 0.8
BLUR_RANGE_PX = (0.45, 3.0)
FIT_STEPS = 2
# Samples nearer than this many blurs to what is unknown have no weight, outside the marker and inside; but those within
# LEAST_REACH_PX of the edge always have. The weight falls off over a length.
OUTER_CLEARANCE, INNER_CLEARANCE = 1.8, 1.2
LEAST_REACH_PX = 0.7
FALL_OFF_PX = 0.3
LARGEST_STEP_PX = 1.0
# Keeps the normal equations of edges that show nothing solvable; light of a sample is at most 1.
RIDGE = 1e-9
INV_SQRT_2PI = 1.0 / np.sqrt(2.0 * np.pi)
IDENTITY = np.eye(4)
# Moving an edge outward makes light less across it, and more across the inner step.
INWARD = np.array([[-1.0], [1.0]])

# Offset, blur and width of the border (M, 4) px.
_Place = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class EdgeShape:
    """What the edges (M, 4) look like across, on average along each.

    Attributes:
        basis: (M, 4, 5, S) what light across the edge is made of, at its place and blur, see `_basis`.
        weight: (M, 4, S) of the samples, 0...1.
        black, contrast: (M, 4) in linear light.
        offset_px: (M, 4) where the edge is, on average.
        blur_px: (M, 4) sigma; the same for the four edges of a marker.
        misfit: (M, 4) RMS of the mean profile about the model, as a share of the contrast.
        level_inflation: (M, 4) how many times larger the variance of an edge's mean place is than it would be were
            black and contrast known.
        margin_pull_px: (M, 4) by how much the edge's place moves if what is beyond the white margin is brighter than
            that by the contrast.
    """

    basis: FloatArray
    weight: FloatArray
    black: FloatArray
    contrast: FloatArray
    offset_px: FloatArray
    blur_px: FloatArray
    misfit: FloatArray
    level_inflation: FloatArray
    margin_pull_px: FloatArray


def surroundings(inner: FloatArray, along_px: FloatArray, bounds_px: FloatArray, slope: FloatArray) -> FloatArray:
    """How much of each part of `_basis`' first five light has at profiles (M, 4, P), per contrast: (M, 4, P, 5).

    Blur mixes across the edge and along it. With a lattice of cells at right angles the two are independent, and light
    is a product of steps; on a slanted lattice they have the correlation rho, of which the first term of the bivariate
    normal distribution's series is taken: Phi2(x, y) = Phi(x) Phi(y) + rho phi(x) phi(y) + ...

    Args:
        inner: (M, 4, n) bits of the n cells along each edge behind the border, in the edge's direction; the first and
            the last are border themselves: 0.
        along_px: (M, 4, P) places from the edges' middles.
        bounds_px: (M, 4, n + 1) ends of the cells, likewise.
        slope: (M, 4) px by which the profiles go along the edge for each px outward.
    """
    slant = np.sqrt(1.0 + slope * slope)
    scale = (1.0 / (FIRST_BLUR_PX * slant))[..., None, None]
    x = (along_px[..., None] - bounds_px[:, :, None]) * scale  # (M, 4, P, n + 1)
    change = np.zeros((*bounds_px.shape, 2))  # at each bound: of the black square, of the white behind its border
    change[:, :, 0, 0], change[:, :, -1, 0] = 1.0, -1.0
    change[:, :, 1:-1, 1] = inner[..., 1:] - inner[..., :-1]
    out = np.empty((*along_px.shape, 5))
    out[..., 1:3] = ndtr(x) @ change
    out[..., 0] = 1.0 - out[..., 1]
    out[..., 3:] = ((slope / slant)[..., None, None] * INV_SQRT_2PI) * (np.exp(-0.5 * x * x) @ change)
    return out


def _basis(across_px: FloatArray, at: _Place) -> FloatArray:
    """Parts of light across an edge (M, 4, 7, S).

    1, the outer and the inner step, their derivatives by the edge's place, and those by blur. The derivatives by place,
    times the blur, are also what a slanted lattice adds where the black square ends and where the cells behind change.
    """
    offset_px, blur_px, width_px = (part[..., None] for part in at)
    out = np.empty((*across_px.shape[:2], 7, across_px.shape[-1]))
    x = np.empty((*across_px.shape[:2], 2, across_px.shape[-1]))
    np.divide(across_px - offset_px, blur_px, out=x[:, :, 0])
    np.subtract(-width_px / blur_px, x[:, :, 0], out=x[:, :, 1])
    bell = np.exp(-0.5 * x * x) * (INV_SQRT_2PI / blur_px)[..., None]
    out[:, :, 0] = 1.0
    ndtr(x, out=out[:, :, 1:3])
    np.multiply(bell, INWARD, out=out[:, :, 3:5])
    np.multiply(bell, -x, out=out[:, :, 5:])
    return out


def _sample_weight(across_px: FloatArray, at: _Place) -> FloatArray:
    offset_px, blur_px, width_px = at
    out_px = np.maximum(width_px - OUTER_CLEARANCE * blur_px, LEAST_REACH_PX) + offset_px
    in_px = np.maximum(2 * width_px - INNER_CLEARANCE * blur_px, LEAST_REACH_PX) - offset_px
    room_px = np.minimum(out_px[..., None] - across_px, across_px + in_px[..., None])
    return np.minimum(np.maximum(room_px / FALL_OFF_PX + 0.5, 0.0), 1.0)


def fit_shape(mean: FloatArray, beside: FloatArray, across_px: FloatArray, width_px: FloatArray) -> EdgeShape:
    """Fit the model to mean profiles (M, 4, S) in mean surroundings (M, 4, 5), by Gauss-Newton.

    The blur is shared by a marker's edges, each counting by what it tells: where the border is narrow against the blur,
    an edge alone would not tell blur, place and black apart.

    Args:
        mean: (M, 4, S) light.
        beside: (M, 4, 5) of `surroundings`.
        across_px: (M, 4, S) places of the samples, outward.
        width_px: (M, 4) of the black border.
    """
    offset_px, blur_px = np.zeros(width_px.shape), _first_blur(mean, across_px)
    for _ in range(FIT_STEPS):  # each step starts from the last
        at = offset_px, blur_px, width_px
        rows = _derivatives(_basis(across_px, at), beside, blur_px)
        weighted = rows * _sample_weight(across_px, at)[:, :, None]
        inverse = np.linalg.inv(weighted @ np.swapaxes(rows, -1, -2) + RIDGE * IDENTITY)
        found = (inverse @ (weighted @ mean[..., None]))[..., 0]
        contrast = np.where(np.abs(found[..., 1]) > RIDGE, found[..., 1], RIDGE)
        step_px = found[..., 2:] / contrast[..., None]
        offset_px = offset_px + np.minimum(np.maximum(step_px[..., 0], -LARGEST_STEP_PX), LARGEST_STEP_PX)
        told = contrast**2 / inverse[..., 3, 3]
        new_px = np.sum(told * (blur_px + step_px[..., 1]), axis=-1) / np.sum(told, axis=-1)
        blur_px = np.repeat(np.minimum(np.maximum(new_px, BLUR_RANGE_PX[0]), BLUR_RANGE_PX[1])[:, None], 4, axis=1)
    return _shape_at((offset_px, blur_px, width_px), mean, beside, across_px)


def _first_blur(mean: FloatArray, across_px: FloatArray) -> FloatArray:
    """Blur (M, 4) px from the steepest slope of the mean profiles, the same for a marker's edges."""
    spacing_px = across_px[..., 1] - across_px[..., 0]
    steepest = np.max(mean[..., 1:] - mean[..., :-1], axis=-1) / spacing_px
    blur_px = INV_SQRT_2PI * np.sum(np.ptp(mean, axis=-1), axis=-1) / np.sum(steepest, axis=-1)
    return np.repeat(np.clip(np.nan_to_num(blur_px), *BLUR_RANGE_PX)[:, None], 4, axis=1)


def _derivatives(basis: FloatArray, beside: FloatArray, blur_px: FloatArray) -> FloatArray:
    """Derivatives (M, 4, 4, S) of light by black and contrast, and by place and blur per contrast."""
    parts = np.zeros((*blur_px.shape, 4, 7))
    parts[..., 0, 0] = parts[..., 2, 3] = parts[..., 3, 5] = 1.0
    parts[..., 1, :5] = beside
    parts[..., 1, 3:5] *= blur_px[..., None]
    parts[..., 2, 4] = parts[..., 3, 6] = beside[..., 2]
    return parts @ basis


def _shape_at(at: _Place, mean: FloatArray, beside: FloatArray, across_px: FloatArray) -> EdgeShape:
    """The shape at a place and blur: black and contrast of each edge, and how well they can be told from its place."""
    offset_px, blur_px, width_px = at
    basis, weight = _basis(across_px, at), _sample_weight(across_px, at)
    rows = _derivatives(basis, beside, blur_px)[:, :, :3]
    weighted = rows * weight[:, :, None]
    normal = weighted @ np.swapaxes(rows, -1, -2)
    inverse = np.linalg.inv(normal + RIDGE * IDENTITY[:3, :3])
    beyond = ndtr((across_px - (offset_px + width_px)[..., None]) / blur_px[..., None])
    found = inverse @ (weighted @ np.stack([mean, beyond], axis=-1))  # (M, 4, 3, 2)
    residual = mean - (found[..., None, :, 0] @ rows)[..., 0, :]
    square = np.einsum("mes,mes->me", weight, residual * residual) / np.sum(weight, axis=-1)
    return EdgeShape(
        basis=basis[:, :, :5],
        weight=weight,
        black=found[..., 0, 0],
        contrast=found[..., 1, 0],
        offset_px=offset_px,
        blur_px=blur_px,
        misfit=np.sqrt(square) / np.abs(found[..., 1, 0]),
        level_inflation=np.maximum(inverse[..., 2, 2] * normal[..., 2, 2], 1.0),
        margin_pull_px=found[..., 2, 1],
    )


def edge_places(profiles: Singles, beside: FloatArray, shape: EdgeShape) -> tuple[FloatArray, FloatArray]:
    """Places (M, 4, P) px of the edge in each profile, and the information (M, 4, P) that each has of it.

    Black, contrast and blur are those of the whole edge. The least squares step is linear in the samples, so what the
    model predicts is taken off once an edge instead of once a sample. The information is the sum of the squared
    derivatives of light by place: light's variance over it is the place's.
    """
    derivatives = shape.basis[:, :, 3:5]
    weighted = np.swapaxes(derivatives * shape.weight[:, :, None], -1, -2)
    moments = shape.basis @ weighted  # (M, 4, 5, 2)
    square = moments[:, :, 3:]
    contrast = shape.contrast[..., None]
    scale = np.repeat(contrast, 5, axis=-1)
    scale[..., 3:] *= shape.blur_px[..., None]
    off = profiles @ weighted.astype(np.float32) - beside @ (scale[..., None] * moments)
    off -= (shape.black[..., None] * moments[:, :, 0])[:, :, None]
    white = beside[..., 2]
    gain = square[..., 0, 0, None] + white * (2 * square[..., 0, 1, None] + white * square[..., 1, 1, None])
    gain = np.maximum(gain, RIDGE)
    place_px = shape.offset_px[..., None] + (off[..., 0] + white * off[..., 1]) / (contrast * gain)
    return place_px, contrast**2 * gain
