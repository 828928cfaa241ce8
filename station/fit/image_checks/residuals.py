"""What a fit in image space leaves of the corners, row by row, and what the tests made of it: for files and reports."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData
from station.fit.image.image_fit import ImageFit
from station.fit.image.views import COORDINATES, CORNERS
from station.fit.image_checks.checks import check_image
from station.fit.image_checks.directions import tilts_rad
from station.fit.image_checks.findings import ModelChecks
from station.fit.parallel import products_in_one_thread
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray, frozen_floats
from station.quadrilaterals import edge_shift_jacobian

IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Residuals:
    """Corners against a fitted tree, N sightings of markers in the order of frames.

    Attributes:
        t_s: (N,) times of the frames.
        marker_id: (N,) in the dictionary.
        part: (N,) names of the parts that the markers are on.
        tilt_rad: (N,) between the marker's normal and the line of sight; NaN where the tree has no pose.
        corners_px: (N, 4, 2) as detected.
        residual_px: (N, 4, 2) measured less model; NaN where the tree has no pose.
        outward_px: (N,) by which the edges lie outward of the model, the best for all four.
        sigma_px: (N,) deviation of a coordinate as stated, with the scale that the marker's turned out to have.
        chi2: (N,) squared residuals in units of their covariance.
        inlier: (N,) probability that a sighting is no outlier.
        doubtful: (N,) sightings that the tree doesn't explain.
        size_px: (width, height) of the image.
        checks: what the tests on all of it found.

    Raises:
        InvalidData: for arrays of different lengths.
    """

    t_s: FloatArray
    marker_id: IntArray
    part: tuple[str, ...]
    tilt_rad: FloatArray
    corners_px: FloatArray
    residual_px: FloatArray
    outward_px: FloatArray
    sigma_px: FloatArray
    chi2: FloatArray
    inlier: FloatArray
    doubtful: BoolArray
    size_px: tuple[int, int]
    checks: ModelChecks

    def __post_init__(self) -> None:
        for name in ("t_s", "tilt_rad", "corners_px", "residual_px", "outward_px", "sigma_px", "chi2", "inlier"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name)))
        lengths = {name: len(getattr(self, name)) for name in ROW_FIELDS}
        if len(set(lengths.values())) > 1:
            raise InvalidData(
                f"residuals: {', '.join(f'{n} {name}' for name, n in lengths.items())}; want as many each"
            )

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def good(self) -> BoolArray:
        """(N,) sightings with a residual that are no outliers."""
        return (self.inlier > 0.5) & np.isfinite(self.residual_px).all(axis=(1, 2))


ROW_FIELDS = (
    "t_s",
    "marker_id",
    "part",
    "tilt_rad",
    "corners_px",
    "residual_px",
    "outward_px",
    "sigma_px",
    "chi2",
    "inlier",
    "doubtful",
)


def checked_residuals(tree: KinematicTree, image: ImageFit) -> Residuals:
    """The residuals of an image fit, tested.

    Args:
        tree: that was fitted.
        image: what was found beside it.
    """
    views = image.views
    variance: FloatArray = np.einsum("nii->n", views.covariance_px2) / COORDINATES
    residual: FloatArray = image.residual_px.reshape(-1, CORNERS, 2)
    with products_in_one_thread():
        checks = check_image(tree, image)
    return Residuals(
        t_s=views.t_s[views.frame],
        marker_id=views.marker_id[views.marker],
        part=tuple(np.array(views.parts)[views.part[views.marker]].tolist()),
        tilt_rad=tilts_rad(image),
        corners_px=views.corners_px,
        residual_px=residual,
        outward_px=_outward(image, residual),
        sigma_px=np.sqrt(variance) * image.scale[views.marker],
        chi2=image.chi2,
        inlier=image.inlier,
        doubtful=image.in_doubt,
        size_px=views.camera.size_px,
        checks=checks,
    )


def _outward(image: ImageFit, residual_px: FloatArray) -> FloatArray:
    """(N,) the shift of the edges that explains the residuals (N, 4, 2) best."""
    views = image.views
    model = views.corners_px - residual_px  # with the edge shift in it, which changes no direction
    known = np.asarray(np.isfinite(model).all(axis=(1, 2)))
    by_shift = edge_shift_jacobian(np.where(known[:, None, None], model, views.corners_px))
    return np.sum(residual_px * by_shift, axis=(1, 2)) / np.sum(by_shift**2, axis=(1, 2))
