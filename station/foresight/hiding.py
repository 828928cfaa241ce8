"""What stands between the camera and a marker: boxes, and the plates of the other markers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.foresight.scene import Scene
from station.kinematics import se3
from station.logs import FloatArray

# Cells. The detector needs a little of the white beyond each edge; of a corner it can miss a little. By
# tests/benchmarks/detection_limits.py about half of the markers are lost when this is covered. The rim of another
# marker's plate is white, too: it may cover the white.
RIM_CELLS, CORNER_CELLS = 0.4, 0.3
# Points looked at along each edge, and across the inside.
EDGE_POINTS = 7
INNER_POINTS = 3
# Of the way to the marker. A plate that is flush with a box, or sunk into it by less, shows.
FLUSH = 2e-3
PLATE_THICKNESS_M = 1e-3
NOBODY = -1


@dataclass(frozen=True, eq=False, slots=True)
class _Obstacle:
    """A box in the way: its body, its frame there, half its lengths, and the mount that it is the plate of, or -1."""

    body: str
    T_body_box: FloatArray
    half_m: FloatArray
    mount: int


def obstacle_bodies(scene: Scene) -> tuple[str, ...]:
    """The bodies that what may hide a marker is on; rows of them are what `hidden_by` gives."""
    return tuple(obstacle.body for obstacle in _obstacles(scene))


def hidden_by(
    scene: Scene, T_camera_body: Mapping[str, FloatArray], T_camera_marker: FloatArray, asked: NDArray[np.bool_]
) -> NDArray[np.intp]:
    """(T, M) row in `obstacle_bodies` of what hides some of each marker; -1 where nothing does, or it isn't asked.

    Args:
        scene: its blocks and mounts.
        T_camera_body: (T, 4, 4) by body.
        T_camera_marker: (T, M, 4, 4).
        asked: (T, M) of which markers it is wanted.
    """
    found = np.full(asked.shape, NOBODY)
    bare, rimmed = (
        np.stack([_points(mount.size_m, mount.cells, rim) for mount in scene.mounts]) for rim in (0.0, RIM_CELLS)
    )
    reach_m = np.linalg.norm(rimmed, axis=-1).max(axis=-1)
    for row, obstacle in enumerate(_obstacles(scene)):  # some dozens; each one for all times and markers at once
        T_box_camera = se3.inverse(T_camera_body[obstacle.body] @ obstacle.T_body_box)
        near = asked & (found == NOBODY) & _near(T_box_camera, obstacle.half_m, T_camera_marker[..., :3, 3], reach_m)
        if obstacle.mount != NOBODY:
            near[:, obstacle.mount] = False
        t, m = np.nonzero(near)
        local = rimmed if obstacle.mount == NOBODY else bare
        T_box_marker = T_box_camera[t] @ T_camera_marker[t, m]
        points = local[m] @ np.swapaxes(T_box_marker[:, :3, :3], -1, -2) + T_box_marker[:, None, :3, 3]
        enters, leaves = _crossing(T_box_camera[t, None, :3, 3], points, obstacle.half_m)
        # A box that the eye is in hides nothing.
        hidden = np.any((enters > 0) & (enters < leaves) & (enters < 1 - FLUSH), axis=-1)
        found[t[hidden], m[hidden]] = row
    return found


def _obstacles(scene: Scene) -> tuple[_Obstacle, ...]:
    boxes = [_Obstacle(block.body, block.T_body_block, block.size_m / 2, NOBODY) for block in scene.blocks or ()]
    plates = [
        _Obstacle(
            mount.body,
            mount.T_body_marker,
            np.array([0.5, 0.5, 0.0]) * mount.size_m + (mount.margin_m, mount.margin_m, PLATE_THICKNESS_M / 2),
            row,
        )
        for row, mount in enumerate(scene.mounts)
    ]
    return (*boxes, *plates)


def _points(size_m: float, cells: int, rim_cells: float) -> FloatArray:
    """(P, 3) points of a marker's square and, beyond its edges, of its rim, in the marker's frame."""
    end = 0.5 - CORNER_CELLS / cells
    along = np.linspace(-end, end, EDGE_POINTS)
    rim = np.full(EDGE_POINTS, 0.5 + rim_cells / cells)
    edges = [(along, rim), (along, -rim), (rim, along), (-rim, along)]
    inner = np.meshgrid(np.linspace(-end, end, INNER_POINTS + 2), np.linspace(-end, end, INNER_POINTS + 2))
    flat = np.concatenate([np.stack(xy, axis=-1).reshape(-1, 2) for xy in (*edges, inner)])
    return size_m * np.concatenate([flat, np.zeros((len(flat), 1))], axis=-1)


def _near(T_box_camera: FloatArray, half_m: FloatArray, p_camera: FloatArray, reach_m: FloatArray) -> NDArray[np.bool_]:
    """(T, M) whether a box may hide something of what is within reach (M,) of points (T, M, 3)."""
    R, t = T_box_camera[:, :3, :3], T_box_camera[:, None, :3, 3]
    enters, leaves = _crossing(t, p_camera @ np.swapaxes(R, -1, -2) + t, half_m + reach_m[:, None])
    return (enters < leaves) & (leaves > 0) & (enters < 1)


def _crossing(eye: FloatArray, points: FloatArray, half_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where, as parts of the way from the eye (N, 1, 3) to a point (N, P, 3), it enters and leaves a box (..., 3).

    By slabs; the way misses the box where it leaves before it enters.
    """
    enters, leaves = np.full(points.shape[:-1], -np.inf), np.full(points.shape[:-1], np.inf)
    for axis in range(3):
        way = points[..., axis] - eye[..., axis]
        way[way == 0.0] = np.finfo(np.float64).tiny
        one, other = (-half_m[..., axis] - eye[..., axis]) / way, (half_m[..., axis] - eye[..., axis]) / way
        np.maximum(enters, np.minimum(one, other), out=enters)
        np.minimum(leaves, np.maximum(one, other), out=leaves)
    return enters, leaves
