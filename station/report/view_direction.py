"""From where to look at a tree so that its axes and links are told apart: an orthographic view chosen among many."""

from __future__ import annotations

import numpy as np

from station.logs import FloatArray

ELEVATIONS_DEG = (15.0, 25.0, 35.0)
AZIMUTH_STEP_DEG = 10.0
# Around the camera's own direction, which whoever sits there knows.
CAMERA_SIDE_DEG = 60.0
# Of a length: as short as this, all are as bad.
SHORTEST = 0.05


def view_axes(directions: FloatArray, up: FloatArray, towards: FloatArray | None) -> FloatArray:
    """(3, 3) rows: the picture's right and up and the direction to the viewer, for the best view of some lengths.

    Best is the greatest sum of the logarithms of how long the lengths look, as shares of what they are: one that is
    seen end-on spoils a view more than another can mend.

    Args:
        directions: (N, 3) of what shall be seen sideways, each of any length.
        up: (3,) what is up in the picture.
        towards: (3,) from the scene to the camera, near which the view stays; None for any side.
    """
    lengths = np.linalg.norm(directions, axis=1)
    unit = directions[lengths > 0] / lengths[lengths > 0, None]
    views = _candidates(up / np.linalg.norm(up), towards)
    across = np.sqrt(np.clip(1.0 - (views[:, 2] @ unit.T) ** 2, 0.0, 1.0))
    return views[int(np.argmax(np.sum(np.log(across + SHORTEST), axis=1)))]


def _candidates(up: FloatArray, towards: FloatArray | None) -> FloatArray:
    """(V, 3, 3) views from above the horizon."""
    ahead = _level(np.eye(3)[int(np.argmin(np.abs(up)))] if towards is None else towards, up)
    if np.linalg.norm(ahead) < SHORTEST:  # the camera looks straight down
        ahead = _level(np.eye(3)[int(np.argmin(np.abs(up)))], up)
    ahead = ahead / np.linalg.norm(ahead)
    side = np.cross(up, ahead)
    reach_deg = 180.0 if towards is None else CAMERA_SIDE_DEG
    azimuth = np.radians(np.arange(-reach_deg, reach_deg, AZIMUTH_STEP_DEG))[:, None, None]
    elevation = np.radians(ELEVATIONS_DEG)[None, :, None]
    flat = np.cos(azimuth) * ahead + np.sin(azimuth) * side
    viewer = (np.cos(elevation) * flat + np.sin(elevation) * up).reshape(-1, 3)
    right = np.cross(up, viewer)
    right = right / np.linalg.norm(right, axis=1, keepdims=True)
    return np.asarray(np.stack([right, np.cross(viewer, right), viewer], axis=1), dtype=np.float64)


def _level(direction: FloatArray, up: FloatArray) -> FloatArray:
    """What of a direction is level, its length a share of the direction's."""
    return (direction - (direction @ up) * up) / np.linalg.norm(direction)
