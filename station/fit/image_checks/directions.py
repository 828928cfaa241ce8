"""Ways in which corners may be off that no fit knows of, each as derivatives of the corners."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel, project, project_jacobian
from station.fit.image.detector_errors import DETECTOR_PX
from station.fit.image.image_fit import ImageFit
from station.fit.image.projection import corner_places, focused
from station.fit.image.views import COORDINATES
from station.fit.image_checks.weighing import Weights
from station.kinematics import se3
from station.logs import FloatArray
from station.quadrilaterals import edge_shift_jacobian

IntArray = NDArray[np.intp]

TWIST = 6
CAMERA, EDGES, FOCAL, PLACE, TILT = "camera", "edges", "focal", "place", "tilt"
# k1, k2, p1, p2: a calibration that errs in k3 errs in k2 much the same way.
LENS = 4


@dataclass(frozen=True, eq=False)
class Rows:
    """Sightings that are looked at, whitened: R of them, eight numbers each.

    Attributes:
        rows: (R,) which of the image fit's sightings.
        by_pose: (R, 8, 6) derivatives by right perturbations of the pose of the part.
        by_camera: (R, 8, 7) by edge shift, focal factor, k1, k2, p1, p2, and an edge shift by tilt.
        residual: (R, 8) measured less model.
        share: (R,) of a picture of its own that each counts.
        look: (R,) number of the long look, see `Weights`.
        detector: (R,) variance of the detector's own error of a coordinate, in that of its noise.
        sigma_px: of a coordinate, typical.
    """

    rows: IntArray
    by_pose: FloatArray
    by_camera: FloatArray
    residual: FloatArray
    share: FloatArray
    look: IntArray
    detector: FloatArray
    sigma_px: float

    @property
    def pictures(self) -> float:
        """How many the sightings count as, those that repeat others for less than one."""
        return float(self.share.sum())


CAMERA_COLUMNS: Mapping[str, slice] = {
    EDGES: slice(0, 1),
    FOCAL: slice(1, 2),
    PLACE: slice(2, 2 + LENS),
    TILT: slice(2 + LENS, 3 + LENS),
}


def whitened_rows(image: ImageFit, weights: Weights) -> Rows:
    """The sightings that count, each in units of its own noise and by its share."""
    views = image.views
    T = image.T_ref_part[views.frame, views.part[views.marker]]
    known = np.isfinite(T).all(axis=(1, 2)) & np.isfinite(image.residual_px).all(axis=1)
    rows = np.flatnonzero(known & (weights.share > 0))
    poses, points = T[rows], views.points_m[views.marker[rows]]
    p_cam = corner_places(poses, points)
    camera = focused(views.camera, image.numbers.focal)
    by_point = project_jacobian(camera, p_cam) @ poses[:, None, :3, :3]
    by_pose = np.concatenate([by_point, -by_point @ se3.hat3(points)], axis=-1).reshape(-1, COORDINATES, TWIST)
    by_camera = _by_camera(camera, p_cam)
    scale = weights.scale[views.marker[rows]]
    covariance = views.covariance_px2[rows] * scale[:, None, None] ** 2
    together = np.concatenate([by_pose, by_camera, image.residual_px[rows, :, None]], axis=-1)
    share = weights.share[rows]
    root = np.linalg.cholesky(covariance)
    white = np.asarray(np.linalg.solve(root, together), dtype=np.float64) * np.sqrt(share)[:, None, None]
    variance: FloatArray = np.einsum("nii->n", covariance) / COORDINATES
    sigma_px = float(np.sqrt(np.median(variance))) if len(rows) else 0.0
    by_pose, by_camera, residual = white[..., :TWIST], white[..., TWIST:-1], white[..., -1]
    detector = share * _detector_px2(views.marker[rows], variance) / variance
    return Rows(rows, by_pose, by_camera, residual, share, weights.look[rows], detector, sigma_px)


def _detector_px2(marker: IntArray, variance_px2: FloatArray) -> FloatArray:
    """(R,) variances of the detector's own errors: larger, as noise is, where a marker is seen worse than mostly."""
    usual = np.ones(len(variance_px2))
    for m in np.unique(marker):
        usual[marker == m] = np.median(variance_px2[marker == m])
    return DETECTOR_PX**2 * np.maximum(1.0, variance_px2 / usual)


def _by_camera(camera: CameraModel, p_cam: FloatArray) -> FloatArray:
    """(R, 8, 7) of corners at points (R, 4, 3) in the camera."""
    xy = p_cam[..., :2] / p_cam[..., 2:]
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    lens = (
        np.stack(
            [
                xy * r2[..., None],
                xy * r2[..., None] ** 2,
                np.stack([2 * x * y, r2 + 2 * y * y], axis=-1),
                np.stack([r2 + 2 * x * x, 2 * x * y], axis=-1),
            ],
            axis=-1,
        )
        * (camera.matrix[[0, 1], [0, 1]])[:, None]
    )
    px = project(camera, p_cam)
    by_focal, by_shift_px = px - camera.matrix[:2, 2], edge_shift_jacobian(px)
    oblique = (1.0 / np.maximum(_facing(p_cam), 0.05) - 1.0)[:, None, None]
    columns = [by_shift_px[..., None], by_focal[..., None], lens, (oblique * by_shift_px)[..., None]]
    return np.concatenate(columns, axis=-1).reshape(-1, COORDINATES, 3 + LENS)


def _facing(p_cam: FloatArray) -> FloatArray:
    """(R,) cosine of the angle between each marker's normal and the line of sight to it; corners (R, 4, 3)."""
    normal = np.cross(p_cam[:, 2] - p_cam[:, 0], p_cam[:, 3] - p_cam[:, 1])
    middle = p_cam.mean(axis=1)
    cosine = np.einsum("ni,ni->n", normal, middle) / (np.linalg.norm(normal, axis=1) * np.linalg.norm(middle, axis=1))
    return np.abs(cosine)


def tilts_rad(image: ImageFit) -> FloatArray:
    """(N,) angle between each marker's normal and the line of sight to it, by the fitted tree; NaN where unknown."""
    views = image.views
    T = image.T_ref_part[views.frame, views.part[views.marker]]
    p_cam = corner_places(T, views.points_m[views.marker])
    return np.arctan2(np.sqrt(np.maximum(1.0 - _facing(p_cam) ** 2, 0.0)), _facing(p_cam))


def T_part_marker(points_m: FloatArray) -> FloatArray:
    """(M, 4, 4) markers' frames on their parts, of corners (M, 4, 3): x right, y up, z out of the marker."""
    x = points_m[:, 1] - points_m[:, 0] + points_m[:, 2] - points_m[:, 3]
    y = points_m[:, 0] - points_m[:, 3] + points_m[:, 1] - points_m[:, 2]
    z = np.cross(x, y)
    R = np.stack([x, np.cross(z, x), z], axis=-1)
    return se3.pose(R / np.linalg.norm(R, axis=1, keepdims=True), points_m.mean(axis=1))
