"""One marker before a rendered camera, found by the real detector: what the benchmarks of poses look at."""

from __future__ import annotations

from functools import cache

import numpy as np

from station.logs import FloatArray
from station.perception.markers import Marker, MarkerTable
from station.perception.observations import ObservationLog
from station.simulate.render import SceneRenderer
from station.simulate.scene import CameraOptics, Plate
from station.tracking import observe_frames
from tests.rendered_markers import DICTIONARY, webcam

SIZE_M, MARGIN_M, FPS = 0.05, 0.012, 30.0
CAMERA = webcam()
TABLE = MarkerTable(DICTIONARY, (Marker(4, "lid", SIZE_M),))


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
