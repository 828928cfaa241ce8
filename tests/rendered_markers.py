"""A small marker renderer for tests and benchmarks of perception: ray by ray; truth is cv2.projectPoints alone."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calibration.intrinsics import CameraModel, FloatArray
from station.kinematics import se3

DICTIONARY = "DICT_4X4_50"
BLACK, WHITE, BACKGROUND = 0.03, 0.8, 0.3  # linear light
GAMMA = 2.2
QUIET_ZONE_CELLS = 1.0
CELLS = 6  # of a 4x4 marker with its border


def marker_bits(marker_id: int) -> np.ndarray:
    """(6, 6) cells of a marker with its border, 1 = white; row 0 is its top."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
    return (cv2.aruco.generateImageMarker(dictionary, marker_id, CELLS) > 127).astype(np.float64)


def corners_of(size_m: float) -> FloatArray:
    """(4, 3) corners in the marker's frame: top left, top right, bottom right, bottom left."""
    s = size_m / 2
    return np.array([[-s, s, 0], [s, s, 0], [s, -s, 0], [-s, -s, 0]])


def true_corners(T_cam_marker: FloatArray, size_m: float, camera: CameraModel) -> FloatArray:
    """(4, 2) pixels of the corners, by cv2.projectPoints."""
    rvec = cv2.Rodrigues(T_cam_marker[:3, :3])[0]
    px, _ = cv2.projectPoints(corners_of(size_m), rvec, T_cam_marker[:3, 3], camera.matrix, camera.distortion)
    return np.asarray(px, dtype=np.float64).reshape(4, 2)


def _paint(light: FloatArray, marker_id: int, T: FloatArray, size_m: float, camera: CameraModel, rays: int) -> None:
    """Paint one plate into the linear image: `rays` x `rays` rays a pixel, each to the plate's plane and its cell."""
    bits = np.pad(marker_bits(marker_id), int(QUIET_ZONE_CELLS), constant_values=1.0)
    plate_m = size_m * len(bits) / CELLS
    px = true_corners(T, plate_m, camera)
    height, width = light.shape
    lo = np.clip(np.floor(px.min(axis=0)).astype(int) - 3, 0, (width, height))
    hi = np.clip(np.ceil(px.max(axis=0)).astype(int) + 4, 0, (width, height))
    # Undistorted at the pixels and interpolated to the rays: distortion is straight to 1e-6 px within a pixel.
    pixels = np.stack(np.meshgrid(np.arange(lo[0], hi[0]), np.arange(lo[1], hi[1])), axis=-1).astype(np.float64)
    at_pixels = cv2.undistortPoints(pixels.reshape(-1, 1, 2), camera.matrix, camera.distortion).reshape(pixels.shape)
    down, right = np.gradient(at_pixels, axis=(0, 1))
    step = ((np.arange(rays) + 0.5) / rays - 0.5)[:, None]
    rows = at_pixels[:, None] + down[:, None] * step[:, None]
    xy = (rows[:, :, :, None] + right[:, None, :, None] * step).reshape(-1, 2)
    H = np.linalg.inv(T[:3, [0, 1, 3]])  # plane coordinates (x, y, 1) up to scale from a ray
    q = xy @ H[:, :2].T + H[:, 2]
    cell = (q[:, :2] / q[:, 2:] / plate_m * (1, -1) + 0.5) * len(bits)
    inside = np.all((cell >= 0) & (cell < len(bits)), axis=1)
    column, row = np.where(inside[:, None], cell, 0).astype(int).T
    shape = (hi[1] - lo[1], rays, hi[0] - lo[0], rays)
    paint = np.where(inside, BLACK + (WHITE - BLACK) * bits[row, column], 0.0).reshape(shape).mean(axis=(1, 3))
    cover = inside.reshape(shape).mean(axis=(1, 3))
    box = light[lo[1] : hi[1], lo[0] : hi[0]]
    box[:] = box * (1 - cover) + paint


def scene_light(
    ids: Sequence[int], T_cam_marker: FloatArray, size_m: float, camera: CameraModel, *, rays: int = 6
) -> FloatArray:
    """Linear light (H, W) of markers (M, 4, 4) on a plain background, before blur, gamma and noise."""
    light = np.full(camera.size_px[::-1], BACKGROUND)
    for marker_id, T in zip(ids, T_cam_marker, strict=True):
        _paint(light, marker_id, T, size_m, camera, rays)
    return light


def developed(
    light: FloatArray, rng: np.random.Generator, *, blur_px: float = 0.7, noise_grey: float = 2.0, gamma: float = GAMMA
) -> np.ndarray:
    """The grey image (H, W) uint8 of that light: blurred, through gamma, with noise."""
    blurred = cv2.GaussianBlur(light, (0, 0), blur_px) if blur_px > 0 else light
    grey = 255 * blurred ** (1 / gamma) + noise_grey * rng.standard_normal(light.shape)
    return np.clip(np.round(grey), 0, 255).astype(np.uint8)


def facing(tilt_rad: ArrayLike, azimuth_rad: ArrayLike, spin_rad: ArrayLike, t_m: ArrayLike) -> FloatArray:
    """(..., 4, 4) T_cam_marker at t_m (..., 3), the normal off the line of sight by `tilt_rad`, to `azimuth_rad`."""
    t = np.asarray(t_m, dtype=np.float64)
    tilt, azimuth, spin = np.broadcast_arrays(tilt_rad, azimuth_rad, spin_rad)
    zero = np.zeros(tilt.shape)
    axis = np.stack([np.cos(azimuth), np.sin(azimuth), zero], axis=-1)
    sight = se3.rotation_between(np.array([0.0, 0.0, 1.0]), t / np.linalg.norm(t, axis=-1, keepdims=True))
    turned = se3.exp_so3(axis * tilt[..., None]) @ np.diag([1.0, -1.0, -1.0])
    return se3.pose(sight @ turned @ se3.exp_so3(np.stack([zero, zero, spin], axis=-1)), t)


def webcam(size_px: tuple[int, int] = (640, 480)) -> CameraModel:
    """A webcam: f = 600 px at 640x480, mild distortion."""
    scale = size_px[0] / 640
    return CameraModel(
        size_px=size_px,
        matrix=np.array([[600.0 * scale, 0, 321.5 * scale], [0, 602.0 * scale, size_px[1] / 2 - 2.0], [0, 0, 1]]),
        distortion=np.array([0.06, -0.12, 0.0008, -0.0005, 0.0]),
    )
