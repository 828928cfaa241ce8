"""What a rendered camera looks at and through: marker plates, boxes, and the camera's optics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from station.errors import InvalidData
from station.logs import ROTATION_TOLERANCE, FloatArray, frozen_floats


def check_poses(T: FloatArray, what: str) -> None:
    """Raise InvalidData unless every matrix of `T` (..., 4, 4) is a finite rigid motion."""
    R = T[..., :3, :3]
    good = np.all(np.isfinite(T)) and np.all(T[..., 3, :] == (0, 0, 0, 1))
    good = good and np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(initial=0.0) < ROTATION_TOLERANCE
    if not (good and np.all(np.linalg.det(R) > 0)):
        raise InvalidData(f"{what}: the pose is no rigid motion; want finite 4x4 matrices with a right-handed rotation")


def _frozen_pose(values: ArrayLike, what: str) -> FloatArray:
    pose = frozen_floats(values)
    if pose.shape != (4, 4):
        raise InvalidData(f"{what}: the pose has shape {pose.shape}; want (4, 4)")
    check_poses(pose, what)
    return pose


def _check_body(body: int, what: str) -> None:
    if body < 0:
        raise InvalidData(f"{what}: body {body} is no row of T_cam_body; want 0 or more")


@dataclass(frozen=True, eq=False, slots=True)
class Plate:
    """A marker printed in black on a white plate; seen from its front (+z) only.

    Attributes:
        body: row of the body's pose in `T_cam_body`.
        T_body_marker: (4, 4) marker frame in the body: origin in its middle, x right, y up, z out of the marker.
        size_m: side of the black square.
        margin_m: width of the white border around it.
        marker_id: id in the renderer's dictionary.

    Raises:
        InvalidData: for lengths that are not positive, a negative body, a pose that is no rigid motion.
    """

    body: int
    T_body_marker: FloatArray
    size_m: float
    margin_m: float
    marker_id: int

    def __post_init__(self) -> None:
        what = f"plate of marker {self.marker_id}"
        _check_body(self.body, what)
        object.__setattr__(self, "T_body_marker", _frozen_pose(self.T_body_marker, what))
        if not (0 < self.size_m < np.inf and 0 <= self.margin_m < np.inf):
            raise InvalidData(f"{what}: size {self.size_m} m, margin {self.margin_m} m; want size > 0 and margin >= 0")


@dataclass(frozen=True, eq=False, slots=True)
class Box:
    """A box in one colour, each face lit by its own angle to the light.

    Attributes:
        body: row of the body's pose in `T_cam_body`.
        T_body_box: (4, 4) the box's frame in the body, origin in its middle.
        size_m: (3,) full lengths of its edges along x, y, z.
        colour_bgr: display colour, 0 to 255 each.

    Raises:
        InvalidData: for lengths that are not positive, colours out of range, a pose that is no rigid motion.
    """

    body: int
    T_body_box: FloatArray
    size_m: FloatArray
    colour_bgr: tuple[int, int, int]

    def __post_init__(self) -> None:
        _check_body(self.body, "box")
        object.__setattr__(self, "T_body_box", _frozen_pose(self.T_body_box, "box"))
        object.__setattr__(self, "size_m", frozen_floats(self.size_m))
        if self.size_m.shape != (3,) or not np.all((self.size_m > 0) & np.isfinite(self.size_m)):
            raise InvalidData(f"box: size {self.size_m.tolist()} m; want three positive lengths")
        if len(self.colour_bgr) != 3 or not all(0 <= level <= 255 for level in self.colour_bgr):
            raise InvalidData(f"box: colour {self.colour_bgr}; want blue, green, red of 0 to 255")


@dataclass(frozen=True, eq=False, slots=True)
class CameraOptics:
    """How light becomes grey levels.

    Attributes:
        size_px: (width, height).
        matrix: (3, 3) camera matrix without skew; pixel (0, 0) is the centre of the top-left pixel.
        distortion: (5,) k1 k2 p1 p2 k3 as in OpenCV.
        blur_px: sigma of the lens's Gaussian blur; 0 for none.
        noise_grey: sigma of the sensor's noise in grey levels of 255; 0 for none.
        gamma: grey = 255 * light ** (1 / gamma); 1 for a linear camera.
        light: factor on the light of the whole scene; 1 is a well lit room, more than about 1.3 saturates white.

    Raises:
        InvalidData: for shapes or values that make no camera.
    """

    size_px: tuple[int, int]
    matrix: FloatArray
    distortion: FloatArray
    blur_px: float = 0.7
    noise_grey: float = 1.5
    gamma: float = 2.2
    light: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", frozen_floats(self.matrix))
        object.__setattr__(self, "distortion", frozen_floats(self.distortion))
        if len(self.size_px) != 2 or min(self.size_px) < 1:
            raise InvalidData(f"camera: size {self.size_px} px; want (width, height), both positive")
        if self.matrix.shape != (3, 3) or self.distortion.shape != (5,):
            shapes = f"matrix {self.matrix.shape}, distortion {self.distortion.shape}"
            raise InvalidData(f"camera: shapes are {shapes}; want (3, 3) and (5,)")
        form = np.array_equal(self.matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], (0, 0, 0, 0, 1))
        if not form or not (self.matrix[0, 0] > 0 and self.matrix[1, 1] > 0 and np.all(np.isfinite(self.matrix))):
            raise InvalidData("camera: want the matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive fx, fy")
        if not np.all(np.isfinite(self.distortion)):
            raise InvalidData("camera: the distortion has values that are not finite")
        levels = (self.blur_px, self.noise_grey, self.light, self.gamma)
        if not all(0 <= level < np.inf for level in levels) or self.gamma == 0:
            raise InvalidData(f"camera: blur, noise, light, gamma are {levels}; want 0 or more, gamma above 0")
