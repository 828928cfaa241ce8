"""What a camera sees of a draft's markers while its joints move: where to put the camera, and where markers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel, project
from station.builder.draft import Draft, limits_of
from station.builder.drawing import part_blocks
from station.drawn import look_at
from station.foresight.detector import HIDDEN, OBLIQUE_RAD, OUTSIDE, SEEN, TURNED_AWAY, reasons_but_hidden
from station.foresight.hiding import NOBODY, hidden_by
from station.foresight.scene import Block, Link, Mount, Scene
from station.foresight.sight import CORNERS, sight
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.markers import cells_along

# How far joints go while markers are looked for [rad, m]: as far as the packaged motions take them.
REACH = {"rad": float(np.radians(35.0)), "m": 0.08}
RANDOM_POSES = 8
# The camera stands where it sees most, of these directions; -90 deg is in front, as with the packaged rigs.
AZIMUTHS_DEG = tuple(range(-180, 180, 30))
ELEVATIONS_DEG = (15.0, 30.0, 50.0)
FRONT_DEG, RAISED_DEG = -90.0, 25.0
# Of the image: what stays free around all markers.
BORDER_SHARE = 0.06
NEAREST_M = 0.25
# Cells of white around a marker, as docs/rig.md asks for.
MARGIN_CELLS = 1.0
EXPOSURE_S = 0.008
# What makes a view better where the same bodies are seen: all markers, then from their front.
ALL_WEIGHT, FRONT_WEIGHT = 0.5, 0.1


@dataclass(frozen=True, eq=False, slots=True)
class Viewpoint:
    """Where a camera stands and looks, in the root's frame, and what share of the poses each marker is seen in."""

    position_m: FloatArray
    target_m: FloatArray
    seen_share: Mapping[int, float]
    score: float


def usual_camera() -> CameraModel:
    """The camera of the packaged rigs, a webcam of 640 x 480 px."""
    matrix = np.array([[610.0, 0.0, 322.0], [0.0, 609.0, 243.0], [0.0, 0.0, 1.0]])
    return CameraModel((640, 480), matrix, np.array([0.06, -0.13, 0.0006, -0.0004, 0.05]))


def direction(azimuth_deg: float = FRONT_DEG, elevation_deg: float = RAISED_DEG) -> FloatArray:
    """(3,) from an object to a camera, x forward and z up."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    across = np.cos(elevation)
    return np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])


def reached_states(draft: Draft) -> FloatArray:
    """(T, C) states of what a motion may reach: at rest, each column alone to both ends, then random ones."""
    rest = draft.usual_states()
    start = np.array([rest[column] for column in draft.tree.columns])
    low, high = start.copy(), start.copy()
    column = 0
    for joint in draft.tree.movable:
        least, most = limits_of(joint)
        for _ in joint.columns:
            reach = REACH[joint.unit]
            least_here = -most if joint.type == "spherical" else least
            low[column] = max(least_here, start[column] - reach)
            high[column] = min(most, start[column] + reach)
            column += 1
    alone = [np.where(np.arange(len(start)) == c, end, start) for c in range(len(start)) for end in (low, high)]
    random = np.random.default_rng(0).uniform(low, high, (RANDOM_POSES, len(start)))
    return np.stack([start, *alone, *random])


def best_viewpoint(draft: Draft, camera: CameraModel) -> Viewpoint:
    """Where a camera sees most of a draft's markers while the joints move; in front where others are no better."""
    q = reached_states(draft)
    views = [
        viewpoint(draft, camera, direction(azimuth, elevation), q)
        for azimuth in sorted(AZIMUTHS_DEG, key=lambda each: abs(each - FRONT_DEG))
        for elevation in ELEVATIONS_DEG
    ]
    return max(views, key=lambda view: view.score)


def viewpoint(draft: Draft, camera: CameraModel, towards: FloatArray, q: FloatArray) -> Viewpoint:
    """A camera in a direction (3,) as near as it may be to see all markers at states q (T, C), and what it sees."""
    points = swept_points(draft, q)
    position, target = framed(points, camera, towards)
    reason, tilt = outlook(draft, camera, position, target, q)
    return Viewpoint(position, target, _shares(draft, reason), _score(draft, reason, tilt))


def framed(points_m: FloatArray, camera: CameraModel, towards: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) position and (3,) target of a camera that looks along a direction and has points (N, 3) in its image."""
    target = 0.5 * (points_m.min(axis=0) + points_m.max(axis=0))
    size = np.array(camera.size_px)
    border = BORDER_SHARE * size

    def all_in(distance: float) -> bool:
        T_camera_root = se3.inverse(look_at(target + distance * towards, target))
        local = points_m @ T_camera_root[:3, :3].T + T_camera_root[:3, 3]
        if np.any(local[:, 2] < 0.1 * distance):
            return False
        px = project(camera, local)
        return bool(np.all((px > border) & (px < size - border)))

    far = NEAREST_M
    while not all_in(far):
        far *= 1.3
    near = far / 1.3
    for _ in range(12):
        middle = 0.5 * (near + far)
        near, far = (near, middle) if all_in(middle) else (middle, far)
    return target + max(far, NEAREST_M) * towards, target


def outlook(
    draft: Draft, camera: CameraModel, position_m: FloatArray, target_m: FloatArray, q: FloatArray
) -> tuple[NDArray[np.intp], FloatArray]:
    """Why each marker is not seen, of `foresight.detector.REASONS`, and its tilt; (T, M) each, at states q (T, C)."""
    scene = _scene(draft, camera, position_m, target_m)
    columns = draft.tree.columns
    states = {name: q[:, columns.index(name)] for name in scene.links}
    what = sight(scene, {name: np.stack([state] * 3) for name, state in states.items()})
    cells = np.array([mount.cells for mount in scene.mounts], dtype=np.intp)
    reason = reasons_but_hidden(what, camera.size_px, cells)
    asked = (reason != OUTSIDE) & (reason != TURNED_AWAY)
    hidden = hidden_by(scene, scene.T_camera_bodies(states), what.T_camera_marker, asked)
    return np.where((hidden != NOBODY) & (reason == SEEN), HIDDEN, reason), what.tilt_rad


def _scene(draft: Draft, camera: CameraModel, position_m: FloatArray, target_m: FloatArray) -> Scene:
    """The draft before a camera; balls rest, for a forecast's joints have one state each."""
    cells = cells_along(draft.dictionary)
    return Scene(
        tree=draft.tree,
        links={joint.name: Link() for joint in draft.tree.movable if joint.kind.states == 1},
        resting={joint.name: np.zeros(3) for joint in draft.tree.movable if joint.kind.states == 3},
        T_camera_root={draft.tree.root: se3.inverse(look_at(position_m, target_m))},
        camera=camera,
        exposure_s=EXPOSURE_S,
        mounts=tuple(
            Mount(m.id, m.part, m.part, m.mount, m.size_m, MARGIN_CELLS * m.size_m / cells, cells)
            for m in draft.markers
        ),
        blocks=tuple(
            Block(part, block.T_part_block, block.size_m, (0, 0, 0))
            for part in draft.parts
            for block in part_blocks(draft, part)
        ),
    )


def swept_points(draft: Draft, q: FloatArray) -> FloatArray:
    """(N, 3) corners of all markers at states q (T, C), and of all boxes at the first of them, in the root's frame."""
    poses = draft.tree.forward(q)
    return np.concatenate([_marker_points(draft, poses), _block_points(draft, poses)])


def _marker_points(draft: Draft, poses: Mapping[str, FloatArray]) -> FloatArray:
    """(N, 3) corners of all markers' plates at all states, in the root's frame."""
    rim = 1 + 2 * MARGIN_CELLS / cells_along(draft.dictionary)
    found = [np.zeros((0, 3))]
    for marker in draft.markers:
        T = poses[marker.part] @ marker.mount
        found.append(CORNERS * rim * marker.size_m @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3])
    return np.concatenate([points.reshape(-1, 3) for points in found])


def _block_points(draft: Draft, poses: Mapping[str, FloatArray]) -> FloatArray:
    """(N, 3) corners of all boxes at rest, in the root's frame."""
    signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    found: list[FloatArray] = []
    for part in draft.parts:
        for block in part_blocks(draft, part):
            T = poses[part][0] @ block.T_part_block
            found.append(signs * block.size_m @ T[:3, :3].T + T[:3, 3])
    return np.concatenate(found)


def _shares(draft: Draft, reason: NDArray[np.intp]) -> dict[int, float]:
    share = np.mean(reason == SEEN, axis=0)
    return {marker.id: float(share[row]) for row, marker in enumerate(draft.markers)}


def _score(draft: Draft, reason: NDArray[np.intp], tilt: FloatArray) -> float:
    """How often a part has any of its markers seen well, the mean over parts; a little for the others and for tilt."""
    seen = reason == SEEN
    well = seen & (tilt < OBLIQUE_RAD)
    part = np.array([marker.part for marker in draft.markers])
    any_seen = [well[:, part == name].any(axis=1).mean() for name in sorted(set(part.tolist()))]
    facing = float(np.mean(np.where(seen, np.cos(tilt), 0.0)))
    return float(np.mean(any_seen)) + ALL_WEIGHT * float(well.mean()) + FRONT_WEIGHT * facing
