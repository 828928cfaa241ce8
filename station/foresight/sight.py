"""Markers in the image over time: where, how obliquely, how large, how fast."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calibration.intrinsics import CameraModel, project
from station.foresight.scene import Mount, Scene
from station.logs import FloatArray

# In the order of the detector: top left, top right, bottom right, bottom left.
CORNERS = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])


@dataclass(frozen=True, eq=False, slots=True)
class Sight:
    """M markers at T times; NaN in px where a marker isn't before the camera.

    Attributes:
        T_camera_marker: (T, M, 4, 4) in the middle of the exposure.
        corners_px: (T, M, 4, 2) where the corners are then, also outside of the image.
        tilt_rad: (T, M) between the marker's normal and the line of sight: 0 from the front, over pi / 2 from behind.
        size_px: (T, M) longest edge.
        across_px: (T, M) how far the edges are from each other: area over the longest edge.
        speed_px_s: (T, M) of the fastest corner.
        smear_px: (T, M) how far it goes while the shutter is open.
    """

    T_camera_marker: FloatArray
    corners_px: FloatArray
    tilt_rad: FloatArray
    size_px: FloatArray
    across_px: FloatArray
    speed_px_s: FloatArray
    smear_px: FloatArray


def sight(scene: Scene, exposed: Mapping[str, FloatArray]) -> Sight:
    """The scene's markers, for states (3, T) of the arm's joints: as the shutter opens, midway, and as it closes."""
    T = mounted(scene.mounts, scene.T_camera_bodies(exposed))
    size_m = np.array([mount.size_m for mount in scene.mounts])
    corners_m = CORNERS * size_m[:, None, None]
    # (M, 3, 3) @ (M, 3, 4): points as columns
    points = T[..., :3, :3] @ np.swapaxes(corners_m, -1, -2) + T[..., :3, 3:]
    before, corners_px, after = imaged(scene.camera, np.swapaxes(points, -1, -2))
    edges = np.linalg.norm(np.roll(corners_px, -1, axis=-2) - corners_px, axis=-1)
    size_px = edges.max(axis=-1)
    smear_px = np.linalg.norm(after - before, axis=-1).max(axis=-1)
    return Sight(
        T_camera_marker=T[1],
        corners_px=corners_px,
        tilt_rad=_tilt(T[1]),
        size_px=size_px,
        across_px=_area(corners_px) / np.maximum(size_px, 1e-9),
        speed_px_s=smear_px / scene.exposure_s,
        smear_px=smear_px,
    )


def mounted(mounts: tuple[Mount, ...], T_camera_body: Mapping[str, FloatArray]) -> FloatArray:
    """`T_camera_marker` (..., M, 4, 4) of mounts on bodies with poses (..., 4, 4)."""
    return np.stack([T_camera_body[mount.body] @ mount.T_body_marker for mount in mounts], axis=-3)


def imaged(camera: CameraModel, p_camera: FloatArray) -> FloatArray:
    """Pixels (..., 2) of points (..., 3) in the camera; NaN behind it and where the lens model is folded back.

    Beyond some angle the polynomial of the distortion turns around and takes points that are far outside of the view
    back into the image, where no light of theirs falls.
    """
    px = project(camera, p_camera)
    r2 = np.sum(p_camera[..., :2] ** 2, axis=-1) / np.maximum(p_camera[..., 2], 1e-9) ** 2
    return np.where((r2 < _fold_r2(camera.distortion))[..., None], px, np.nan)


def _fold_r2(distortion: FloatArray) -> float:
    """Squared radius, on the plane at distance 1, at which the radial distortion turns around."""
    k1, k2, _, _, k3 = distortion.tolist()
    # d/dr of r (1 + k1 r^2 + k2 r^4 + k3 r^6), as a polynomial of r^2
    roots = np.roots(np.trim_zeros([7 * k3, 5 * k2, 3 * k1, 1.0], "f"))
    turning = [root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0]
    return min(turning, default=np.inf)


def _tilt(T_camera_marker: FloatArray) -> FloatArray:
    normal, towards = T_camera_marker[..., :3, 2], -T_camera_marker[..., :3, 3]
    across = np.linalg.norm(np.cross(normal, towards), axis=-1)
    return np.arctan2(across, np.sum(normal * towards, axis=-1))


def _area(corners_px: FloatArray) -> FloatArray:
    x, y = corners_px[..., 0], corners_px[..., 1]
    return np.abs(np.sum(x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1), axis=-1)) / 2
