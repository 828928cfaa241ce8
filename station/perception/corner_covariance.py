"""How well corners are known: covariances from what the profiles of their edges showed.

A corner is where two lines meet, so its covariance is N^-1 diag(v_1, v_2) N^-T with the unit normals of the two edges
as rows of N, and v the variance of each line's place at the corner: the shallower they meet, the worse it is known.

The variance of a line's place at its middle and at its end has these parts:

- Scatter. The places of the profiles scatter about the line, as light's noise divided by the steepness of the edge (the
  information of each profile): the noise is estimated from all four edges of a marker at once, about 90 profiles. Blur,
  contrast, obliquity and size enter through the information and through the length of the edges.
- Correlation of neighbouring profiles. They share pixels: white noise, read by bilinear interpolation at places d px
  apart, has the correlation B(d) / B(0) with B the cubic B-spline (each reading is a triangle of half width 1 px; the
  convolution of two is B). The variance of the mean of P profiles is then f / P times that of one, with
  f = 1 + 2 sum_j B(j d) / B(0): 1 for profiles 2 px apart, 1.5 / d for close ones. Compression, aliasing and texture
  correlate the noise otherwise; what the residuals' correlation over a few profiles shows beyond the B-spline's is
  applied as a factor.
- Black and contrast of the edge are estimated with its place: `level_inflation`.
- A profile that isn't the model's, smeared by motion say, is misplaced by a share of its misfit.
- What lies beyond the white margin isn't known, and pulls at narrow margins: `margin_pull_px`.
- Not included: a camera whose gamma isn't the assumed one. Its edge shift is shared as long as borders are some five
  blurs wide; at narrower ones it differs from marker to marker (gamma 1.8 for 2.2: by 0.05 px at 2.5 px).
- A floor, for what neither scatters nor is modelled: the rounding of light in time and space that bilinear reading of
  pixels leaves at edges along rows or columns, and the bow of lenses where no camera is given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.logs import FloatArray
from station.perception.edge_model import EdgeShape
from station.quadrilaterals import Edges, preceding

# Mean squared residual under the line fit's weights, as a share of the variance, for Gaussian errors.
WEIGHTED_SHARE = 0.87
# Lags, in profiles, over which the residuals' correlation is measured, and the range of the factor it gives.
LAGS = 3
EXCESS_RANGE = (0.3, 5.0)
# Lags over which the B-spline is summed: profiles are never closer than a quarter of a pixel.
SPLINE_LAGS = 8
# Standard deviation of what is beyond the margin, in contrasts from white: anything from white to black.
MARGIN_SIGMA = 0.5
# Misplacement of an edge, as a share of its misfit times its blur: 0.6 at smears of 4 to 7 px.
MISFIT_SHARE = 0.7
FLOOR_PX = 0.004
# Of the bow of an edge by a webcam's lens, per px^2 of its length: k1 = -0.1 at f = 600 px, half way to the corner.
BOW_PER_PX = 1.5e-6
SMALLEST = 1e-12


@dataclass(frozen=True, eq=False)
class Scatter:
    """Places of profiles about the line of their edge.

    Attributes:
        along_px: (M, 4, P) where along the edges the profiles are, from their middles.
        residual_px: (M, 4, P) of the places about the lines.
        weight: (M, 4, P) that each has in its line.
        information: (M, 4, P) see `edge_places`.
    """

    along_px: FloatArray
    residual_px: FloatArray
    weight: FloatArray
    information: FloatArray


def _spline(apart_px: FloatArray) -> FloatArray:
    """B(d) / B(0): correlation of bilinear readings of white noise `apart_px` apart."""
    near = 1.0 - 1.5 * apart_px**2 + 0.75 * apart_px**3
    return np.where(apart_px < 1.0, near, 0.25 * np.maximum(2.0 - apart_px, 0.0) ** 3)


def _correlation(scatter: Scatter, normalised: FloatArray) -> FloatArray:
    """Factors f (M, 4) on the variance of the mean of an edge's places that the correlation of its profiles gives."""
    spacing_px = scatter.along_px[..., 1] - scatter.along_px[..., 0]
    spline = _spline(spacing_px[..., None] * np.arange(1, SPLINE_LAGS))
    taper = 1.0 - np.arange(1, LAGS + 1) / (LAGS + 1)
    w, r = scatter.weight, scatter.weight * normalised
    profiles = w.shape[-1]
    power = np.maximum(np.einsum("mep,mep->m", r, r), SMALLEST)
    white = 1.0 + 2.0 * np.mean(spline[..., :LAGS] @ taper, axis=-1)
    # The fit of a line takes two of a profile's degrees of freedom, which correlates residuals by about -2 f / P.
    measured = 1.0 + (4.0 / profiles) * np.sum(taper) * white
    for lag in range(1, LAGS + 1):
        product = np.einsum("mep,mep->m", r[..., lag:], r[..., :-lag])
        measured = measured + (2.0 * taper[lag - 1] * profiles / (profiles - lag)) * product / power
    excess = np.clip(measured / white, *EXCESS_RANGE)
    return (1.0 + 2.0 * np.sum(spline, axis=-1)) * excess[:, None]


def corner_covariances(edges: Edges, shape: EdgeShape, scatter: Scatter, *, bow_known: bool) -> FloatArray:
    """Covariances (M, 4, 2, 2) px^2 of the corners, apart from a shift of all edges that all markers share."""
    w = scatter.weight
    total = np.maximum(w.sum(axis=-1), 1.0)
    normalised = scatter.residual_px * np.sqrt(scatter.information)
    factor = _correlation(scatter, normalised)
    freedom = np.sum(total - 2.0 * np.minimum(factor, LAGS), axis=-1)
    noise = np.einsum("mep,mep->m", w, normalised**2) / (WEIGHTED_SHARE * freedom)
    information = np.maximum(np.sum(w * scatter.information, axis=-1) / total, SMALLEST)
    of_profile = factor * noise[:, None] / information
    centre_px = np.sum(w * scatter.along_px, axis=-1) / total
    spread_px2 = np.sum(w * (scatter.along_px - centre_px[..., None]) ** 2, axis=-1)
    of_slope = of_profile / np.maximum(spread_px2, SMALLEST)
    bow_px = 0.0 if bow_known else BOW_PER_PX * edges.length_px**2
    common = of_profile * shape.level_inflation / total + (MARGIN_SIGMA * shape.margin_pull_px) ** 2
    common = common + FLOOR_PX**2 + bow_px**2 + (MISFIT_SHARE * shape.misfit * shape.blur_px) ** 2
    end_px = 0.5 * edges.length_px
    at_start, at_end = (common + of_slope * (end_px + side * centre_px) ** 2 for side in (1.0, -1.0))
    return _where_lines_meet(edges.normal, preceding(at_end), at_start)


def _where_lines_meet(normal: FloatArray, before: FloatArray, here: FloatArray) -> FloatArray:
    """Covariances (M, 4, 2, 2) of the crossings of edge i - 1 and edge i, whose places there have these variances."""
    first = preceding(normal)
    det = first[..., 0] * normal[..., 1] - first[..., 1] * normal[..., 0]
    # Columns of the inverse of the matrix whose rows are the two normals.
    a = np.stack([normal[..., 1], -normal[..., 0]], axis=-1)
    b = np.stack([-first[..., 1], first[..., 0]], axis=-1)
    spread = before[..., None, None] * (a[..., :, None] * a[..., None, :])
    spread += here[..., None, None] * (b[..., :, None] * b[..., None, :])
    return spread / (det * det)[..., None, None]
