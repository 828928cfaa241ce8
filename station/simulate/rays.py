"""Rays of sight: where each sample of a pixel looks, and where a direction falls on the image."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from station.logs import FloatArray, frozen_floats
from station.simulate.scene import CameraOptics

# Offsets (du, dv) in px of the four samples of a pixel, [row][column]: a rotated grid, so that edges along rows or
# columns meet four distinct offsets rather than two.
SAMPLES_PX = np.array([[(-1, -3), (3, -1)], [(-3, 1), (1, 3)]]) / 8.0
# Normalised image plane. Rays are solved to this; at f = 1000 px it is 1e-9 px.
RAY_TOLERANCE = 1e-12
# Normalised image plane. A ray that can't be solved to this looks beyond the fold of the distortion polynomial.
LOST_RAY = 1e-9
NEWTON_STEPS = 30
# Samples solved at a time, so that they stay in the processor's cache.
CHUNK = 1 << 15


def distorted(x: FloatArray, y: FloatArray, distortion: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Directions (x / z, y / z) with lens distortion k1 k2 p1 p2 k3 applied, as in OpenCV."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return u, v


def _jacobian(x: FloatArray, y: FloatArray, distortion: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The three distinct entries (du/dx, du/dy = dv/dx, dv/dy) of the derivative of `distorted`."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    across = x * y * slope + 2 * p1 * x + 2 * p2 * y
    return radial + x * x * slope + 2 * p1 * y + 6 * p2 * x, across, radial + y * y * slope + 6 * p1 * y + 2 * p2 * x


def undistorted(u: FloatArray, v: FloatArray, distortion: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Invert `distorted` by Newton's method for arrays of any one shape; NaN where there is no inverse.

    There is none beyond the radius where a barrel's polynomial folds back: no light from the scene falls there.
    """
    x, y = u.copy(), v.copy()
    if not np.any(distortion):
        return x, y
    residual = np.full_like(x, np.inf)
    determinant, j_xx = np.ones_like(x), np.ones_like(x)
    with np.errstate(all="ignore"):  # rays without an inverse wander off; they are marked below
        for _ in range(NEWTON_STEPS):
            u_now, v_now = distorted(x, y, distortion)
            du, dv = u_now - u, v_now - v
            residual = np.maximum(np.abs(du), np.abs(dv))
            j_xx, j_xy, j_yy = _jacobian(x, y, distortion)
            determinant = j_xx * j_yy - j_xy * j_xy
            if np.all(residual < RAY_TOLERANCE):
                break
            x -= (j_yy * du - j_xy * dv) / determinant
            y -= (j_xx * dv - j_xy * du) / determinant
        # Positive definite: on the branch through the middle of the image, not on one past the fold, mirrored or not.
        lost = ~((residual < LOST_RAY) & (determinant > 0) & (j_xx > 0))
    x[lost] = y[lost] = np.nan
    return x, y


def sample_rays(optics: CameraOptics) -> tuple[FloatArray, FloatArray]:
    """Undistorted directions x / z and y / z, each (2H, 2W), of the 2x2 samples of every pixel; NaN where none.

    Those of the last lens are kept, read-only: a program often opens the same camera again.
    """
    return _sample_rays(optics.size_px, optics.matrix.tobytes(), optics.distortion.tobytes())


@lru_cache(maxsize=1)
def _sample_rays(size_px: tuple[int, int], matrix: bytes, lens: bytes) -> tuple[FloatArray, FloatArray]:
    width, height = size_px
    distortion = np.frombuffer(lens)
    columns, rows = np.arange(2 * width), np.arange(2 * height)
    offsets = SAMPLES_PX[rows[:, None] % 2, columns[None, :] % 2]
    (fx, _, cx), (_, fy, cy), _ = np.frombuffer(matrix).reshape(3, 3)
    u = (columns[None, :] // 2 + offsets[..., 0] - cx) / fx
    v = (rows[:, None] // 2 + offsets[..., 1] - cy) / fy
    x, y = np.empty(u.size), np.empty(u.size)
    for start in range(0, u.size, CHUNK):  # chunks fit the cache; the whole image at once takes three times as long
        part = slice(start, start + CHUNK)
        x[part], y[part] = undistorted(u.reshape(-1)[part], v.reshape(-1)[part], distortion)
    return frozen_floats(x.reshape(u.shape)), frozen_floats(y.reshape(u.shape))
