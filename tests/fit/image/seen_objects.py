"""Seeded articulated objects before a camera, made from the definitions of the joints alone: where, when, how it moves.

Every marker stays in the picture, and its tilt in the range that was asked for, at all times: bodies are drawn one
after another, each until it does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.intrinsics import CameraModel
from station.logs import FloatArray
from station.perception.pose import UNIT_CORNERS
from tests.benchmarks.made_joints import (
    PITCH_M_PER_RAD,
    STATES,
    MadeJoint,
    MadeObject,
    inverse,
    poses,
    random_direction,
)
from tests.rendered_markers import facing

# A number from -1 to 1 over the time [s], (...) to (...).
Course = Callable[[FloatArray], FloatArray]

FPS = 30.0
SIZE_M = 0.05
MARGIN_PX = 12.0
# Half of the travel: least and most.
HALF_TRAVEL = {"prismatic": (0.02, 0.07), "revolute": (0.2, 0.8), "screw": (0.35, 1.0), "spherical": (0.15, 0.4)}
ROOT_SWAY_M, ROOT_SWAY_RAD = 0.015, 0.12
# Of a joint's point off the middle between its bodies, of a further tracker and of a marker on one off the first.
POINT_M, TRACKER_M, MARKER_M = 0.06, 0.06, 0.045
TURN_RAD = 0.35
# A step's ramp takes so long for its speed.
EASED_S = 0.1
FOREVER_S = 1e3
DRAWS, SHRINKING_EVERY = 20_000, 400
CHECKED_TIMES = 40


@dataclass(frozen=True)
class Scene:
    """What is before the camera.

    Attributes:
        joints: how many.
        kinds: types of the joints: each as often as another, in random order.
        root_moves: whether the root goes to and fro, or stands still.
        trackers: least and most parts on a body that are told apart; markers: least and most on each of them.
        frames: T, at FPS.
        course: "smooth", or "steps": ramps between rests.
        tilt_deg: least and most between the normals and the lines of sight.
        distance_m: least and most in the middle of the motion.
    """

    joints: int = 4
    kinds: tuple[str, ...] = ("revolute", "prismatic")
    root_moves: bool = False
    trackers: tuple[int, int] = (1, 1)
    markers: tuple[int, int] = (1, 1)
    frames: int = 300
    course: str = "smooth"
    tilt_deg: tuple[float, float] = (0.0, 75.0)
    distance_m: tuple[float, float] = (0.5, 0.7)

    @property
    def t_s(self) -> FloatArray:
        """(T,) times of the frames."""
        return np.arange(self.frames) / FPS


@dataclass(frozen=True, eq=False)
class SeenObject:
    """An object as it moves before a camera.

    Attributes:
        scene: as asked for.
        joints: parents come before their children; body 0 is the root, and frames of bodies are those of their first
            tracker.
        courses: of each joint's states, times the half travels (s,).
        T_cam_root: (4, 4) in the middle of its motion.
        sway: six courses of the root's pose [m, rad]; none for a static one.
        body_of: (K) of the trackers.
        T_body_part: (K, 4, 4).
        part_of: (M) of the markers.
        T_part_marker: (M, 4, 4).
    """

    scene: Scene
    joints: tuple[MadeJoint, ...]
    courses: tuple[tuple[tuple[Course, float], ...], ...]
    T_cam_root: FloatArray
    sway: tuple[Course, ...]
    body_of: tuple[int, ...]
    T_body_part: FloatArray
    part_of: tuple[int, ...]
    T_part_marker: FloatArray

    def at(self, t_s: FloatArray) -> MadeObject:
        """The object at times (n,)."""
        q = tuple(np.stack([half * course(t_s) for course, half in each], axis=-1) for each in self.courses)
        root = "moving" if self.sway else "static"
        return MadeObject(self.joints, q, root_at(self, t_s), root, self.body_of, self.T_body_part)

    @property
    def points_m(self) -> FloatArray:
        """(M, 4, 3) corners of the markers in their parts' frames."""
        R, p = self.T_part_marker[:, None, :3, :3], self.T_part_marker[:, None, :3, 3]
        return (R @ (SIZE_M * UNIT_CORNERS)[None, ..., None])[..., 0] + p

    def corners_m(self, T_cam_part: FloatArray) -> FloatArray:
        """(..., M, 4, 3) in the camera, of parts at (..., K, 4, 4)."""
        T = T_cam_part[..., list(self.part_of), None, :, :]
        return (T[..., :3, :3] @ self.points_m[..., None])[..., 0] + T[..., :3, 3]


def pixels(camera: CameraModel, p_cam: FloatArray) -> FloatArray:
    """(..., 2) of points (..., 3), by OpenCV."""
    flat = np.ascontiguousarray(p_cam, dtype=np.float64).reshape(-1, 1, 3)
    found, _ = cv2.projectPoints(flat, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    return np.asarray(found, dtype=np.float64).reshape(*p_cam.shape[:-1], 2)


def root_at(seen: SeenObject, t_s: FloatArray) -> FloatArray:
    """(n, 4, 4)."""
    if not seen.sway:
        return np.tile(seen.T_cam_root, (len(t_s), 1, 1))
    sway = np.stack([course(t_s) for course in seen.sway], axis=-1)
    return seen.T_cam_root @ poses(ROOT_SWAY_RAD * sway[:, 3:], ROOT_SWAY_M * sway[:, :3])


def smooth_course(rng: np.random.Generator, duration_s: float) -> Course:
    """Two sines, some turns in ten seconds."""
    rate = 2 * np.pi * np.array([rng.uniform(1.0, 2.5), rng.uniform(2.5, 5.0)]) / min(duration_s, 10.0)
    phase = rng.uniform(0, 2 * np.pi, 2)
    return lambda t_s: (2 * np.sin(rate[0] * t_s + phase[0]) + np.sin(rate[1] * t_s + phase[1])) / 3


def stepped_course(rng: np.random.Generator, duration_s: float) -> Course:
    """Ramps of a third of a second between rests of half a second to two, eased; many enough in short times."""
    pace = min(duration_s, 10.0) / 10.0
    count = int(duration_s / pace / 0.8) + 2
    rest, ramp = rng.uniform(0.5, 2.0, count) * pace, 0.33 * pace
    begin = np.cumsum(rest + ramp) - ramp
    level = rng.uniform(-1, 1, count + 1)
    times, levels = np.stack([begin, begin + ramp], axis=-1).ravel(), np.repeat(level, 2)[1:-1]
    return eased(times, levels, EASED_S * pace)


def eased(times_s: FloatArray, levels: FloatArray, within_s: float) -> Course:
    """Straight lines between levels, averaged over a moving window: what has mass takes that time for a new speed."""
    t = np.concatenate([[times_s[0] - FOREVER_S], times_s, [times_s[-1] + FOREVER_S]])
    q = np.concatenate([levels[:1], levels, levels[-1:]])
    area = np.concatenate([[0.0], np.cumsum(0.5 * (q[1:] + q[:-1]) * np.diff(t))])

    def until(at_s: FloatArray) -> FloatArray:
        k = np.clip(np.searchsorted(t, at_s) - 1, 0, len(t) - 2)
        step = at_s - t[k]
        return area[k] + step * q[k] + 0.5 * step**2 * ((q[k + 1] - q[k]) / (t[k + 1] - t[k]))

    return lambda at_s: (until(at_s + 0.5 * within_s) - until(at_s - 0.5 * within_s)) / within_s


COURSES = {"smooth": smooth_course, "steps": stepped_course}


def seen_object(rng: np.random.Generator, scene: Scene, camera: CameraModel) -> SeenObject:
    """A random object that does what the scene says."""
    duration_s = scene.frames / FPS
    new_course = COURSES[scene.course]
    kinds = rng.permutation([scene.kinds[j % len(scene.kinds)] for j in range(scene.joints)])
    sway = tuple(new_course(rng, duration_s) for _ in range(6)) if scene.root_moves else ()
    found = _with_root(rng, scene, camera, sway)
    for kind in kinds:
        courses = [new_course(rng, duration_s) for _ in range(STATES[str(kind)])]
        found = _grown(rng, found, camera, str(kind), courses)
    return found


def tilts(T_cam_marker: FloatArray) -> FloatArray:
    """(...,) [rad] between the normals and the lines of sight."""
    normal, towards = T_cam_marker[..., :3, 2], -T_cam_marker[..., :3, 3]
    across = np.linalg.norm(np.cross(normal, towards), axis=-1)
    return np.asarray(np.arctan2(across, np.sum(normal * towards, axis=-1)))


def fits(seen: SeenObject, camera: CameraModel, t_s: FloatArray, *, from_part: int = 0) -> bool:
    """Whether all markers, of the parts from one on, are in the picture and tilted as asked for at times (n,)."""
    markers = [m for m, part in enumerate(seen.part_of) if part >= from_part]
    T = seen.at(t_s).T_ref_part
    tilt = tilts(T[:, list(seen.part_of)] @ seen.T_part_marker)[:, markers]
    low, high = np.radians(seen.scene.tilt_deg)
    if tilt.min() < low or tilt.max() > high:
        return False
    px = pixels(camera, seen.corners_m(T)[:, markers])
    return bool(np.all(px > MARGIN_PX) and np.all(px < np.array(camera.size_px) - MARGIN_PX))


def _placed(rng: np.random.Generator, scene: Scene, camera: CameraModel) -> FloatArray:
    """(4, 4) of a marker in the camera, about where it may be in the middle of the motion."""
    u, v = rng.uniform([60, 60], np.array(camera.size_px) - 60)
    ray = np.array([(u - camera.matrix[0, 2]) / camera.matrix[0, 0], (v - camera.matrix[1, 2]) / camera.matrix[1, 1]])
    tilt = np.radians(rng.uniform(*scene.tilt_deg))
    azimuth, spin = rng.uniform(-np.pi, np.pi, 2)
    return facing(tilt, azimuth, spin, rng.uniform(*scene.distance_m) * np.append(ray, 1.0))


def _nearby(rng: np.random.Generator, reach_m: float) -> FloatArray:
    """(4, 4) of another tracker or marker beside the first, nearly in its plane."""
    shift = rng.uniform(-reach_m, reach_m, 3) * (1, 1, 0.4)
    return poses(rng.uniform(-TURN_RAD, TURN_RAD, 3), shift)


def _carried(rng: np.random.Generator, scene: Scene) -> tuple[FloatArray, list[int], list[FloatArray]]:
    """Poses of a new body's trackers on it, and its markers: number of the tracker, pose on it."""
    trackers = int(rng.integers(scene.trackers[0], scene.trackers[1] + 1))
    T_body_part = np.stack([np.eye(4), *(_nearby(rng, TRACKER_M) for _ in range(trackers - 1))])
    counts = rng.integers(scene.markers[0], scene.markers[1] + 1, trackers)
    mounts = [np.eye(4) if m == 0 else _nearby(rng, MARKER_M) for count in counts for m in range(count)]
    return T_body_part, [k for k, count in enumerate(counts) for _ in range(count)], mounts


def _with_root(rng: np.random.Generator, scene: Scene, camera: CameraModel, sway: tuple[Course, ...]) -> SeenObject:
    checked_s = np.linspace(0, scene.t_s[-1], CHECKED_TIMES)
    for _ in range(DRAWS):
        T_body_part, part_of, mounts = _carried(rng, scene)
        body_of = (0,) * len(T_body_part)
        T_cam_root = _placed(rng, scene, camera)
        found = SeenObject(scene, (), (), T_cam_root, sway, body_of, T_body_part, tuple(part_of), np.stack(mounts))
        if fits(found, camera, checked_s) and fits(found, camera, scene.t_s):
            return found
    raise ValueError(f"no root stays in the picture: {scene}")


def _grown(
    rng: np.random.Generator, seen: SeenObject, camera: CameraModel, kind: str, courses: list[Course]
) -> SeenObject:
    """The object with one body more, which hangs from any of the others by a joint of that kind."""
    scene, parts, bodies = seen.scene, len(seen.body_of), len(seen.joints) + 1
    checked_s = np.linspace(0, scene.t_s[-1], CHECKED_TIMES)
    middle = _middle(seen)
    for draw in range(DRAWS):
        parent = int(rng.integers(bodies))
        joint = _joint(rng, kind, parent, bodies, middle[parent], _placed(rng, scene, camera))
        half = 0.85 ** (draw // SHRINKING_EVERY) * rng.uniform(*HALF_TRAVEL[kind], len(courses))
        T_body_part, part_of, mounts = _carried(rng, scene)
        found = SeenObject(
            scene,
            (*seen.joints, joint),
            (*seen.courses, tuple(zip(courses, half.tolist(), strict=True))),
            seen.T_cam_root,
            seen.sway,
            (*seen.body_of, *(bodies for _ in T_body_part)),
            np.concatenate([seen.T_body_part, T_body_part]),
            (*seen.part_of, *(parts + k for k in part_of)),
            np.concatenate([seen.T_part_marker, np.stack(mounts)]),
        )
        if fits(found, camera, checked_s, from_part=parts) and fits(found, camera, scene.t_s, from_part=parts):
            return found
    raise ValueError(f"no {kind} joint stays in the picture: {scene}")


def _middle(seen: SeenObject) -> list[FloatArray]:
    """(4, 4) of the bodies in the camera where all states are 0."""
    found = [seen.T_cam_root]
    for joint in seen.joints:
        found.append(found[joint.parent] @ joint.T_parent_child_zero)
    return found


def _joint(
    rng: np.random.Generator, kind: str, parent: int, child: int, T_cam_parent: FloatArray, T_cam_child: FloatArray
) -> MadeJoint:
    """About an axis anyhow, or not far off the line of sight, that passes between the two bodies."""
    T_parent_child = inverse(T_cam_parent) @ T_cam_child
    axis_cam = random_direction(rng)
    if rng.uniform() < 0.4:
        axis_cam = axis_cam * rng.uniform(0, 1) + T_cam_child[:3, 3] / np.linalg.norm(T_cam_child[:3, 3])
    axis = T_cam_parent[:3, :3].T @ (axis_cam / np.linalg.norm(axis_cam))
    point = rng.uniform(0.2, 0.8) * T_parent_child[:3, 3] + rng.uniform(-POINT_M, POINT_M, 3)
    return MadeJoint(kind, parent, child, axis, point, T_parent_child, PITCH_M_PER_RAD if kind == "screw" else 0.0)
