"""Where the tree puts markers' corners in the picture, and how they move with their parts and the camera's numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.intrinsics import CameraModel, project, project_jacobian
from station.fit.image.camera_numbers import CameraNumbers
from station.fit.image.views import CORNERS
from station.kinematics import se3
from station.logs import FloatArray
from station.quadrilaterals import edge_shift_jacobian

# A corner whose edges, each moved by 1 px, move it by more: its angle is below 4 degrees, and it is none.
SHARPEST = 30.0
# Nothing is seen from farther off. On the way there residuals only fall, and so states would run away.
FARTHEST_M = 1000.0


def focused(camera: CameraModel, focal: float) -> CameraModel:
    """The camera with both focal lengths times a factor."""
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= focal
    return replace(camera, matrix=matrix)


def corner_places(T_ref_part: FloatArray, points_m: FloatArray) -> FloatArray:
    """(..., 4, 3) corners in the camera's frame, from poses (..., 4, 4) and their places on the parts (..., 4, 3)."""
    return points_m @ np.swapaxes(T_ref_part[..., :3, :3], -1, -2) + T_ref_part[..., None, :3, 3]


@dataclass(frozen=True, eq=False)
class Projected:
    """Corners of M markers in T frames in the picture.

    Attributes:
        px: (T, M, 4, 2); NaN behind the camera, and beyond `FARTHEST_M`.
        by_shift_px: (T, M, 4, 2) motion by the edge shift.
        by_place: (T, M, 4, 2, 3) px/m.
        from_centre_px: (T, M, 4, 2) from the principal point: the change by the logarithm of the focal factor.
    """

    px: FloatArray
    by_shift_px: FloatArray
    by_place: FloatArray
    from_centre_px: FloatArray


def projected(camera: CameraModel, numbers: CameraNumbers, p_ref: FloatArray) -> FloatArray:
    """(T, M, 4, 2) px of corners (T, M, 4, 3) in the camera's frame; NaN behind it, and beyond `FARTHEST_M`."""
    undisturbed = _seen(focused(camera, numbers.focal), p_ref)
    return undisturbed + numbers.edge_shift_px * _by_shift(undisturbed)


def with_derivatives(camera: CameraModel, numbers: CameraNumbers, p_ref: FloatArray) -> Projected:
    """The same with the derivatives by the corners' places, and by the numbers."""
    focus = focused(camera, numbers.focal)
    undisturbed = _seen(focus, p_ref)
    by_shift_px = _by_shift(undisturbed)
    return Projected(
        undisturbed + numbers.edge_shift_px * by_shift_px,
        by_shift_px,
        project_jacobian(focus, p_ref),
        undisturbed - camera.matrix[:2, 2],
    )


def _seen(camera: CameraModel, p_ref: FloatArray) -> FloatArray:
    return np.where(p_ref[..., 2:] < FARTHEST_M, project(camera, p_ref), np.nan)


def _by_shift(px: FloatArray) -> FloatArray:
    """(T, M, 4, 2) motion of corners by the edge shift, by where they are without noise.

    By the corners as detected it would go with their noise, and the shift would fit that: over 1500 sightings by ten
    deviations. A start can put a marker behind the camera, or turn it edge on: it then has no edges to shift.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        found = edge_shift_jacobian(px.reshape(-1, CORNERS, 2)).reshape(px.shape)
    known = np.all(np.abs(found) < SHARPEST, axis=(-2, -1), keepdims=True)  # NaN compares false
    return np.where(known, found, 0.0)


def by_twists(projected: Projected, p_ref: FloatArray, centre: FloatArray) -> FloatArray:
    """(T, M, 4, 2, 6) motion of the corners by twists of their parts along the camera's axes about `centre` (T, 3)."""
    arm = se3.hat3(p_ref - centre[:, None, None])
    return np.concatenate([projected.by_place, -projected.by_place @ arm], axis=-1)
