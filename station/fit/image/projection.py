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


def focused(camera: CameraModel, focal: float) -> CameraModel:
    """The camera with both focal lengths times a factor."""
    matrix = camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= focal
    return replace(camera, matrix=matrix)


def corner_places(T_ref_marker: FloatArray, points_m: FloatArray) -> FloatArray:
    """(T, M, 4, 3) corners in the camera's frame, from poses (T, M, 4, 4) and their places on the parts (M, 4, 3)."""
    return points_m @ np.swapaxes(T_ref_marker[..., :3, :3], -1, -2) + T_ref_marker[..., None, :3, 3]


@dataclass(frozen=True, eq=False)
class Projected:
    """Corners of M markers in T frames in the picture.

    Attributes:
        px: (T, M, 4, 2); NaN behind the camera.
        by_shift_px: (T, M, 4, 2) motion by the edge shift.
        by_place: (T, M, 4, 2, 3) px/m.
        from_centre_px: (T, M, 4, 2) from the principal point: the change by the logarithm of the focal factor.
    """

    px: FloatArray
    by_shift_px: FloatArray
    by_place: FloatArray
    from_centre_px: FloatArray


def projected(camera: CameraModel, numbers: CameraNumbers, p_ref: FloatArray) -> FloatArray:
    """(T, M, 4, 2) px of corners (T, M, 4, 3) in the camera's frame; NaN behind it."""
    undisturbed = project(focused(camera, numbers.focal), p_ref)
    return undisturbed + numbers.edge_shift_px * _by_shift(undisturbed)


def with_derivatives(camera: CameraModel, numbers: CameraNumbers, p_ref: FloatArray) -> Projected:
    """The same with the derivatives by the corners' places, and by the numbers."""
    focus = focused(camera, numbers.focal)
    undisturbed = project(focus, p_ref)
    by_shift_px = _by_shift(undisturbed)
    return Projected(
        undisturbed + numbers.edge_shift_px * by_shift_px,
        by_shift_px,
        project_jacobian(focus, p_ref),
        undisturbed - camera.matrix[:2, 2],
    )


def _by_shift(px: FloatArray) -> FloatArray:
    """(T, M, 4, 2) motion of corners by the edge shift, by where they are without noise.

    By the corners as detected it would go with their noise, and the shift would fit that: over 1500 sightings by ten
    deviations.
    """
    return edge_shift_jacobian(px.reshape(-1, CORNERS, 2)).reshape(px.shape)


def by_twists(projected: Projected, p_ref: FloatArray, centre: FloatArray) -> FloatArray:
    """(T, M, 4, 2, 6) motion of the corners by twists of their parts along the camera's axes about `centre` (T, 3)."""
    arm = se3.hat3(p_ref - centre[:, None, None])
    return np.concatenate([projected.by_place, -projected.by_place @ arm], axis=-1)
