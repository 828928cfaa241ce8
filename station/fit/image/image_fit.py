"""What the image-space fit found beside the tree and its states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.image.camera_numbers import CameraNumbers
from station.fit.image.views import Views
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ImageFit:
    """Corners against the fitted tree.

    Attributes:
        views: N sightings of M markers, of the parts of the tree.
        T_ref_part: (T, K, 4, 4) of the views' parts, as the tree has them; NaN where its states are not known.
        numbers: of the camera, as estimated.
        numbers_std: their standard deviations; NaN of those that were not estimated.
        residual_px: (N, 8) measured less model, u0, v0, u1, ...
        chi2: (N,) squared, in units of the covariances with each marker's own scale.
        inlier: (N,) probability that a sighting is no outlier.
        scale: (M,) deviations that the markers' corners turned out to have, as multiples of those stated.
        doubtful: (N,) sightings that the tree doesn't explain, or that another answer explains as well.
        alike: (M,) correlation of each marker's errors in neighbouring frames.
        misfit: (M,) markers that the tree as a whole doesn't explain.
        two_answers: (T, K) parts that may be elsewhere, as corners tell the frame in two ways; the deviations of states
            have that in them.
    """

    views: Views
    T_ref_part: FloatArray
    numbers: CameraNumbers
    numbers_std: CameraNumbers
    residual_px: FloatArray
    chi2: FloatArray
    inlier: FloatArray
    scale: FloatArray
    doubtful: BoolArray
    alike: FloatArray
    misfit: BoolArray
    two_answers: BoolArray

    @property
    def in_doubt(self) -> BoolArray:
        """(N,) sightings that are doubtful, or whose marker as a whole is."""
        return self.doubtful | self.misfit[self.views.marker]


def joined(fits: Sequence[ImageFit]) -> ImageFit:
    """The corners of several trees together, sightings in the order of frames.

    Each tree tells the camera's numbers by itself; here they are the means, weighted by their variances.
    """
    if len(fits) == 1:
        return fits[0]
    views = _joined_views([fit.views for fit in fits])
    order = np.argsort(np.concatenate([fit.views.frame for fit in fits]), kind="stable")
    numbers, numbers_std = _mean_numbers(fits)
    return ImageFit(
        views=views,
        T_ref_part=np.concatenate([fit.T_ref_part for fit in fits], axis=1),
        numbers=numbers,
        numbers_std=numbers_std,
        residual_px=np.concatenate([fit.residual_px for fit in fits])[order],
        chi2=np.concatenate([fit.chi2 for fit in fits])[order],
        inlier=np.concatenate([fit.inlier for fit in fits])[order],
        scale=np.concatenate([fit.scale for fit in fits]),
        doubtful=np.concatenate([fit.doubtful for fit in fits])[order],
        alike=np.concatenate([fit.alike for fit in fits]),
        misfit=np.concatenate([fit.misfit for fit in fits]),
        two_answers=np.concatenate([fit.two_answers for fit in fits], axis=1),
    )


def _joined_views(several: Sequence[Views]) -> Views:
    first_part = np.cumsum([0, *(len(views.parts) for views in several[:-1])])
    first_marker = np.cumsum([0, *(len(views.marker_id) for views in several[:-1])])
    frame = np.concatenate([views.frame for views in several])
    order = np.argsort(frame, kind="stable")
    marker = np.concatenate([views.marker + n for views, n in zip(several, first_marker, strict=True)])
    return Views(
        t_s=several[0].t_s,
        parts=tuple(part for views in several for part in views.parts),
        marker_id=np.concatenate([views.marker_id for views in several]),
        part=np.concatenate([views.part + n for views, n in zip(several, first_part, strict=True)]),
        points_m=np.concatenate([views.points_m for views in several]),
        frame=frame[order],
        marker=marker[order],
        corners_px=np.concatenate([views.corners_px for views in several])[order],
        covariance_px2=np.concatenate([views.covariance_px2 for views in several])[order],
        T_ref_part=np.concatenate([views.T_ref_part for views in several])[order],
        camera=several[0].camera,
        readout_s=several[0].readout_s,
    )


def _mean_numbers(fits: Sequence[ImageFit]) -> tuple[CameraNumbers, CameraNumbers]:
    values = np.array([astuple(fit.numbers) for fit in fits])
    weights = np.array([astuple(fit.numbers_std) for fit in fits]) ** -2.0
    estimated = np.isfinite(weights[0])
    known = np.where(estimated, weights, 1.0)
    mean = np.sum(known * values, axis=0) / known.sum(axis=0)
    deviation = np.where(estimated, known.sum(axis=0) ** -0.5, np.nan)
    return CameraNumbers(*mean.tolist()), CameraNumbers(*deviation.tolist())
