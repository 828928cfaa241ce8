"""One marker before a rendered camera, found by the real detector: what the benchmarks of poses look at."""

from __future__ import annotations

from functools import cache

import numpy as np

from calibration.intrinsics import CameraModel
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.markers import Marker, MarkerTable
from station.perception.observations import ObservationLog
from station.simulate.render import SceneRenderer
from station.simulate.scene import CameraOptics, Plate
from station.tracking import observe_frames

SIZE_M, MARGIN_M, FPS = 0.05, 0.012, 30.0
DICTIONARY = "DICT_4X4_50"
CAMERA = CameraModel(
    size_px=(640, 480),
    matrix=np.array([[600.0, 0, 321.5], [0, 602.0, 238.0], [0, 0, 1]]),
    distortion=np.array([0.06, -0.12, 0.0008, -0.0005, 0.0]),
)
TABLE = MarkerTable(DICTIONARY, (Marker(4, "lid", SIZE_M),))


def facing(tilt_deg: FloatArray, azimuth_rad: FloatArray, spin_rad: FloatArray, t_m: FloatArray) -> FloatArray:
    """(F, 4, 4) T_cam_marker at t_m (F, 3), the normal off the line of sight by tilts (F,), whose sign is a side."""
    tilt_rad, azimuth_rad, spin_rad = np.broadcast_arrays(np.deg2rad(tilt_deg), azimuth_rad, spin_rad)
    zero = np.zeros_like(tilt_rad)
    axis = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad), zero], axis=-1)
    sight = se3.rotation_between(np.array([0.0, 0.0, 1.0]), t_m)
    spin = se3.exp_so3(np.stack([zero, zero, spin_rad], axis=-1))
    return se3.pose(sight @ se3.exp_so3(axis * tilt_rad[..., None]) @ np.diag([1.0, -1.0, -1.0]) @ spin, t_m)


@cache
def renderer(seed: int, gamma: float = 2.2) -> SceneRenderer:
    """A white plate with marker 4; mild blur, noise of 2 grey levels."""
    optics = CameraOptics(CAMERA.size_px, CAMERA.matrix, CAMERA.distortion, blur_px=0.7, noise_grey=2.0, gamma=gamma)
    return SceneRenderer([Plate(0, np.eye(4), SIZE_M, MARGIN_M, 4)], [], DICTIONARY, optics, seed=seed)


def observed(T_cam_marker: FloatArray, *, seed: int) -> ObservationLog:
    """What the detector finds in frames of a marker at poses (F, 4, 4), a thirtieth of a second apart."""
    scene = renderer(seed)
    frames = ((f / FPS, scene.render(T[None], f)) for f, T in enumerate(T_cam_marker))
    return observe_frames(frames, TABLE, CAMERA)
