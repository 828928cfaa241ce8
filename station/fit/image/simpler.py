"""Whether a tree with less motion explains the corners as well."""

from __future__ import annotations

import numpy as np

from station.fit.image.detector_errors import REPEATED_PX
from station.fit.image.image_fit import ImageFit
from station.fit.image.views import COORDINATES
from station.logs import FloatArray

# By so much a marker's noise, as estimated, may grow by chance; and so many more of all sightings be doubtful.
NOISE_GROWTH, MORE_DOUBTS = 1.1, 0.01


def explains_as_well(simpler: ImageFit | None, other: ImageFit | None) -> bool:
    """Whether a tree with less motion leaves no more of the corners unexplained than chance and repeated errors do."""
    if simpler is None or other is None:
        return simpler is other
    before = dict(zip(other.views.marker_id.tolist(), _noise_px2(other).tolist(), strict=True))
    after = dict(zip(simpler.views.marker_id.tolist(), _noise_px2(simpler).tolist(), strict=True))
    if not before.keys() <= after.keys():
        return False
    grown = any(after[m] > NOISE_GROWTH**2 * px2 + REPEATED_PX**2 for m, px2 in before.items())
    return not grown and bool(simpler.doubtful.sum() <= other.doubtful.sum() + MORE_DOUBTS * len(simpler.views))


def _noise_px2(image: ImageFit) -> FloatArray:
    """(M,) variance of a coordinate of each marker's corners; 0 of one that was not seen."""
    views, markers = image.views, len(image.views.marker_id)
    stated = np.trace(views.covariance_px2, axis1=-2, axis2=-1) / COORDINATES
    counts, total = (np.bincount(views.marker, weights, markers) for weights in (None, stated))
    return image.scale**2 * total / np.maximum(counts, 1)
