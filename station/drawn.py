"""Where a rig's [simulation] draws things: the camera, the markers' plates and the boxes, as poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from station.formats.simulation import SimulatedBox, SimulatedCamera, SimulatedPlate, metres
from station.kinematics import se3
from station.logs import FloatArray

UP = np.array([0.0, 0.0, 1.0])


def _unit(v: ArrayLike) -> FloatArray:
    v = np.asarray(v, dtype=np.float64)
    return v / np.linalg.norm(v)


def look_at(position_m: FloatArray, target_m: FloatArray) -> FloatArray:
    """(4, 4) T_world_camera of a camera upright at `position_m` (3,) that looks at `target_m` (3,)."""
    forward = _unit(target_m - position_m)
    right = _unit(np.cross(forward, UP))
    return se3.pose(np.stack([right, np.cross(forward, right), forward], axis=-1), position_m)


def facing(position_m: FloatArray, normal: ArrayLike, up: ArrayLike) -> FloatArray:
    """(4, 4) pose of a plate at `position_m` (3,), its z along `normal` (3,), its y as near `up` (3,) as can be."""
    z = _unit(normal)
    y = np.asarray(up, dtype=np.float64)
    y = _unit(y - z * (y @ z))
    return se3.pose(np.stack([np.cross(y, z), y, z], axis=-1), position_m)


def drawn_camera(camera: SimulatedCamera) -> FloatArray:
    """(4, 4) T_root_camera."""
    return look_at(metres(camera.position_mm), metres(camera.look_at_mm))


def drawn_plate(plate: SimulatedPlate) -> FloatArray:
    """(4, 4) T_body_marker."""
    return facing(metres(plate.position_mm), plate.normal, plate.up)


def drawn_box(box: SimulatedBox) -> FloatArray:
    """(4, 4) T_body_box."""
    roll, pitch, yaw = (se3.exp_so3(np.radians(a) * axis) for a, axis in zip(box.rpy_deg, np.eye(3), strict=True))
    return se3.pose(yaw @ pitch @ roll, metres(box.position_mm))


def drawn_colour(box: SimulatedBox) -> tuple[int, int, int]:
    """Blue, green, red of a box, 0 to 255 each."""
    red, green, blue = (int(box.colour[i : i + 2], 16) for i in (1, 3, 5))
    return blue, green, red
