"""The camera model: pinhole with OpenCV's five distortion coefficients, its projection and the derivative."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import CalibrationError

FloatArray = NDArray[np.float64]

# k1, k2, p1, p2, k3: the order and meaning of OpenCV's calibrateCamera with its default flags.
DISTORTION_COEFFICIENTS = 5


def _frozen(values: ArrayLike, shape: tuple[int, ...], what: str) -> FloatArray:
    """A read-only float64 copy of finite `values` of the given shape, or CalibrationError."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise CalibrationError(f"camera {what} has shape {array.shape}; want {shape}")
    if not np.all(np.isfinite(array)):
        raise CalibrationError(f"camera {what} has values that are not finite")
    array.setflags(write=False)
    return array


def _check_size(size_px: tuple[int, ...]) -> None:
    if len(size_px) != 2 or min(size_px) <= 0 or any(int(n) != n for n in size_px):
        raise CalibrationError(f"camera size_px is {size_px}; want (width, height), both whole and positive")


def _check_matrix(matrix: FloatArray) -> None:
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise CalibrationError(f"camera focal lengths are {matrix[0, 0]:g}, {matrix[1, 1]:g} px; want both above zero")
    if matrix[0, 1] != 0 or matrix[1, 0] != 0 or not np.array_equal(matrix[2], (0.0, 0.0, 1.0)):
        raise CalibrationError("camera matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] (px, rows first, no skew)")


def _check_scalar(value: float | None, what: str, lowest: float) -> None:
    if value is not None and not (np.isfinite(value) and value >= lowest):
        raise CalibrationError(f"camera {what} is {value:g}; want a finite number of at least {lowest:g}")


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A calibrated camera, checked and frozen. Pixel (0, 0) is the centre of the top-left pixel.

    Attributes:
        size_px: (width, height) of the images that it was calibrated for.
        matrix: (3, 3) camera matrix in px, without skew.
        distortion: (5,) OpenCV's k1, k2, p1, p2, k3.
        rms_px: RMS reprojection error of the calibration.
        edge_shift_px: where a black square's edges are seen, along their outward normals; negative = it looks smaller
            (blur through gamma). None = not known, nothing is corrected.
        edge_shift_std_px: its standard deviation; None = not known.
        readout_s: time from the first to the last row of a rolling shutter.
        when: when it was calibrated, in words or ISO 8601.
        matrix_std: (3, 3) standard deviations of the matrix, px.
        distortion_std: (5,) standard deviations of the coefficients.

    Raises:
        CalibrationError: for wrong shapes, values that are not finite, focal lengths of zero or less, a skewed matrix.
    """

    size_px: tuple[int, int]
    matrix: FloatArray
    distortion: FloatArray
    rms_px: float | None = None
    edge_shift_px: float | None = None
    edge_shift_std_px: float | None = None
    readout_s: float | None = None
    when: str | None = None
    matrix_std: FloatArray | None = None
    distortion_std: FloatArray | None = None

    def __post_init__(self) -> None:
        _check_size(self.size_px)
        object.__setattr__(self, "size_px", tuple(int(n) for n in self.size_px))
        object.__setattr__(self, "matrix", _frozen(self.matrix, (3, 3), "matrix"))
        object.__setattr__(self, "distortion", _frozen(self.distortion, (DISTORTION_COEFFICIENTS,), "distortion"))
        _check_matrix(self.matrix)
        _check_scalar(self.rms_px, "rms_px", 0.0)
        _check_scalar(self.edge_shift_px, "edge_shift_px", -float(np.finfo(np.float64).max))
        _check_scalar(self.edge_shift_std_px, "edge_shift_std_px", 0.0)
        _check_scalar(self.readout_s, "readout_s", 0.0)
        for what, shape in (("matrix_std", (3, 3)), ("distortion_std", (DISTORTION_COEFFICIENTS,))):
            if (values := getattr(self, what)) is not None:
                object.__setattr__(self, what, std := _frozen(values, shape, what))
                if np.any(std < 0):
                    raise CalibrationError(f"camera {what} has negative standard deviations")

    def scaled_to(self, size_px: tuple[int, int]) -> CameraModel:
        """The camera of the same picture at another size: of the whole of it, scaled, and not cut.

        The shift of edges is not known at another size: blur and what a camera does to edges are of its pixels.
        """
        factor = np.array([size_px[0] / self.size_px[0], size_px[1] / self.size_px[1], 1.0])[:, None]
        centre = np.zeros((3, 3))  # of the top-left pixel, which is 0: half a pixel from the picture's corner
        centre[:2, 2] = 0.5
        return replace(
            self,
            size_px=size_px,
            matrix=factor * (self.matrix + centre) - centre,
            rms_px=None if self.rms_px is None else self.rms_px * float(np.sqrt(factor[0, 0] * factor[1, 0])),
            matrix_std=None if self.matrix_std is None else factor * self.matrix_std,
            edge_shift_px=None,
        )


def _distort(xy: FloatArray, distortion: FloatArray) -> FloatArray:
    """Distorted normalised coordinates (..., 2) of undistorted ones (..., 2); OpenCV's model of k1, k2, p1, p2, k3."""
    k1, k2, p1, p2, k3 = distortion
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=-1,
    )


def _distort_jacobian(xy: FloatArray, distortion: FloatArray) -> FloatArray:
    """Derivative (..., 2, 2) of `_distort` with respect to the undistorted coordinates; it is symmetric."""
    k1, k2, p1, p2, k3 = distortion
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))  # d radial / dx = slope * x
    xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    xy_ = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    return np.stack([np.stack([xx, xy_], axis=-1), np.stack([xy_, yy], axis=-1)], axis=-2)


def project(camera: CameraModel, p_cam: FloatArray) -> FloatArray:
    """Pixels (..., 2) of points (..., 3) in camera coordinates, m; the same as cv2.projectPoints at the identity.

    Points on or behind the camera's plane (z <= 0) have no image: NaN.
    """
    depth_m = np.where(p_cam[..., 2:] > 0, p_cam[..., 2:], np.nan)
    xy = _distort(p_cam[..., :2] / depth_m, camera.distortion)
    return xy * camera.matrix[[0, 1], [0, 1]] + camera.matrix[:2, 2]


def project_jacobian(camera: CameraModel, p_cam: FloatArray) -> FloatArray:
    """Derivative (..., 2, 3) of `project` with respect to the points (..., 3), px/m; NaN where z <= 0."""
    depth_m = np.where(p_cam[..., 2:] > 0, p_cam[..., 2:], np.nan)
    xy = p_cam[..., :2] / depth_m
    d_pixel_xy = camera.matrix[[0, 1], [0, 1]][:, None] * _distort_jacobian(xy, camera.distortion)
    scaled = d_pixel_xy / depth_m[..., None]
    d_depth = -np.einsum("...ij,...j->...i", scaled, xy)
    return np.concatenate([scaled, d_depth[..., None]], axis=-1)
