"""Pictures of what the camera will see of a plan at some of its frames, drawn by the simulation's renderer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from station.foresight.forecast import Forecast, states_at
from station.simulate.render import SceneRenderer
from station.simulate.scene import Box, CameraOptics, Plate

# Wider pictures than this are drawn smaller: they are printed as wide as a hand.
WIDEST_PX = 720
# Frames that are shown.
MOMENTS = 3


def moments(forecast: Forecast) -> list[int]:
    """Frames worth a look, in time order: the first, then those whose joint states are farthest from all before."""
    q = forecast.q
    span = np.maximum(np.ptp(q, axis=0), 1e-9)
    chosen = [0]
    while len(chosen) < min(MOMENTS, len(q)):
        far = np.min(np.linalg.norm((q[:, None] - q[chosen]) / span, axis=-1), axis=1)
        chosen.append(int(np.argmax(far)))
    return sorted(set(chosen))


def foreseen_views(forecast: Forecast, dictionary: str, frames: Sequence[int]) -> list[NDArray[np.uint8]]:
    """The camera's pictures (H, W, 3) RGB at frames, without noise; markers and boxes of the scene, nothing else."""
    scene = forecast.scene
    bodies = scene.bodies
    camera = scene.camera
    if camera.size_px[0] > WIDEST_PX:
        width, height = camera.size_px
        camera = camera.scaled_to((WIDEST_PX, round(height * WIDEST_PX / width)))
    optics = CameraOptics(camera.size_px, camera.matrix, camera.distortion, noise_grey=0.0)
    plates = [
        Plate(bodies.index(mount.body), mount.T_body_marker, mount.size_m, mount.margin_m, mount.marker_id)
        for mount in scene.mounts
    ]
    boxes = [
        Box(bodies.index(block.body), block.T_body_block, block.size_m, block.colour_bgr)
        for block in scene.blocks or ()
    ]
    renderer = SceneRenderer(plates, boxes, dictionary, optics, seed=0)
    found: list[NDArray[np.uint8]] = []
    for frame in frames:  # a handful
        poses = scene.T_camera_bodies(states_at(forecast, frame))
        found.append(renderer.render(np.stack([poses[body] for body in bodies]), frame)[..., ::-1])
    return found
