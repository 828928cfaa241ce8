"""What the image-space fit found beside the tree and its states."""

from __future__ import annotations

from dataclasses import dataclass

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
        doubtful: (N,) sightings that the tree doesn't explain, where another answer may be the right one.
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
