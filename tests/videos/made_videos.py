"""Rendered videos of marked things that a hand moves, with the truth: a cabinet with a door and a drawer, a lamp."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from calibration.intrinsics import CameraModel
from station.formats.camera import format_camera
from station.formats.markers import format_markers
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.markers import Marker, MarkerTable
from station.simulate.render import SceneRenderer
from station.simulate.scene import Box, CameraOptics, Plate

FPS = 30.0
DICTIONARY = "DICT_4X4_50"
SIZE_M, MARGIN_M = 0.05, 0.012
CAMERA = CameraModel(
    size_px=(640, 480),
    matrix=np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]]),
    distortion=np.array([0.05, -0.1, 0.001, 0.0, 0.0]),
)
# Marker axes (x right, y up, z out) for one that faces the camera (x right, y down, z forward).
FACING = np.diag([1.0, -1.0, -1.0])


def tilt(x_deg: float, y_deg: float) -> FloatArray:
    """(3, 3) facing the camera, then turned about the camera's x and y."""
    return se3.exp_so3(np.radians([0.0, y_deg, 0.0])) @ se3.exp_so3(np.radians([x_deg, 0.0, 0.0])) @ FACING


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies that move in front of the camera; marker k of the table is on body `bodies[k]`.

    Attributes:
        table: its mounts are `T_part_marker`; a part's frame is its body's.
        bodies: body of each marker's plate.
        T_cam_body: takes times (S,), gives poses (S, B, 4, 4).
        boxes: what else there is.
    """

    table: MarkerTable
    bodies: tuple[int, ...]
    T_cam_body: Callable[[FloatArray], FloatArray]
    boxes: tuple[Box, ...] = field(default=())

    def truth(self, t_s: FloatArray) -> FloatArray:
        """(T, K, 4, 4) poses of the table's parts."""
        body_of = {m.part: body for m, body in zip(self.table.markers, self.bodies, strict=True)}
        return self.T_cam_body(np.asarray(t_s))[:, [body_of[part] for part in self.table.parts]]


def swing(t_s: FloatArray, period_s: float) -> FloatArray:
    """0 to 1 and back, softly."""
    return 0.5 - 0.5 * np.cos(2 * np.pi * t_s / period_s)


def hinged(T_cam_hinge: FloatArray, axis: Sequence[float], q: FloatArray, T_hinge_part: FloatArray) -> FloatArray:
    """(S, 4, 4) a part that turns by q (S,) about an axis through the origin of a hinge (4, 4) or (S, 4, 4)."""
    turn = se3.pose(se3.exp_so3(q[:, None] * np.asarray(axis)), np.zeros(3))
    return T_cam_hinge @ turn @ T_hinge_part


# The cabinet's frame: the marker on its side, 0.8 m ahead.
T_CAM_CABINET = se3.pose(tilt(18, -14), np.array([-0.16, -0.08, 0.8]))
HINGE_M = np.array([0.07, 0.0, 0.0])  # in the cabinet, about its y (up)
DRAWER_AXIS = np.array([0.0, 0.0, 1.0])  # in the cabinet: towards the camera


def cabinet(door_deg: float = 60.0, drawer_m: float = 0.12, period_s: float = 3.0) -> Scene:
    """A cabinet, its door hinged about the cabinet's y through HINGE_M, its drawer sliding along the cabinet's z."""
    T_hinge_door = se3.translation([0.09, 0.0, 0.0])
    T_cabinet_drawer = se3.translation([0.11, -0.13, 0.0])

    def poses(t_s: FloatArray) -> FloatArray:
        q = -np.radians(door_deg) * swing(t_s, period_s)
        door = hinged(T_CAM_CABINET @ se3.translation(HINGE_M), (0, 1, 0), q, T_hinge_door)
        slide = se3.translation(drawer_m * swing(t_s, 0.7 * period_s)[:, None] * DRAWER_AXIS)
        drawer = T_CAM_CABINET @ slide @ T_cabinet_drawer
        return np.stack([np.broadcast_to(T_CAM_CABINET, door.shape), door, drawer], axis=1)

    markers = tuple(Marker(k, part, SIZE_M) for k, part in enumerate(("cabinet", "door", "drawer")))
    return Scene(MarkerTable(DICTIONARY, markers), (0, 1, 2), poses)


T_CAM_FOOT = se3.pose(tilt(25, 10), np.array([-0.13, 0.13, 0.75]))


def lamp(period_s: float = 3.0) -> Scene:
    """A lamp: an arm turns on the foot about the foot's z, the shade on the arm about the arm's z."""

    def poses(t_s: FloatArray) -> FloatArray:
        arm = hinged(
            T_CAM_FOOT @ se3.translation([0.06, 0.02, 0.01]),
            (0, 0, 1),
            np.radians(20 + 50 * swing(t_s, period_s)),
            se3.translation([0.09, 0.0, 0.0]),
        )
        shade = hinged(
            arm @ se3.translation([0.05, 0.0, 0.01]),
            (0, 0, 1),
            np.radians(-60 + 70 * swing(t_s, 0.6 * period_s)),
            se3.translation([0.08, 0.0, 0.0]),
        )
        return np.stack([np.broadcast_to(T_CAM_FOOT, arm.shape), arm, shade], axis=1)

    markers = tuple(Marker(k + 10, part, SIZE_M) for k, part in enumerate(("foot", "arm", "shade")))
    return Scene(MarkerTable(DICTIONARY, markers), (0, 1, 2), poses)


def moving_plate(path: Callable[[FloatArray], FloatArray], *, boxes: tuple[Box, ...] = (), more: Poses = ()) -> Scene:
    """One marked plate ("lid", marker 4) that moves as `path` says, and other bodies that do as `more` says."""

    def poses(t_s: FloatArray) -> FloatArray:
        return np.stack([path(t_s), *(other(t_s) for other in more)], axis=1)

    return Scene(MarkerTable(DICTIONARY, (Marker(4, "lid", SIZE_M),)), (0,), poses, boxes)


Poses = Sequence[Callable[[FloatArray], FloatArray]]


def times_s(frames: int, fps: float = FPS) -> FloatArray:
    """Middles of the exposures, the first at zero."""
    return np.arange(frames) / fps


def images(
    scene: Scene,
    frames: int,
    *,
    exposure_s: float = 0.0,
    instants: int = 1,
    fps: float = FPS,
    size_factor: float = 1.0,
    dictionary: str = DICTIONARY,
    blur_px: float = 0.7,
    noise_grey: float = 1.5,
) -> list[np.ndarray]:
    """The frames (H, W, 3); `size_factor` makes the markers that much larger than the table says."""
    plates = [
        Plate(body, m.mount, m.size_m * size_factor, MARGIN_M, m.id)
        for m, body in zip(scene.table.markers, scene.bodies, strict=True)
    ]
    optics = CameraOptics(CAMERA.size_px, CAMERA.matrix, CAMERA.distortion, blur_px=blur_px, noise_grey=noise_grey)
    renderer = SceneRenderer(plates, scene.boxes, dictionary, optics, seed=0)
    shares = (np.arange(instants) + 0.5) / instants - 0.5
    return [renderer.render(scene.T_cam_body(t + exposure_s * shares), k) for k, t in enumerate(times_s(frames, fps))]


def write_video(path: Path, frames: Sequence[np.ndarray], fps: float = FPS) -> Path:
    """A video file by OpenCV, .avi as MJPG, .mp4 as mp4v; without an ending a folder of PNG, which loses nothing."""
    if not path.suffix:
        path.mkdir()
        for k, frame in enumerate(frames):
            cv2.imwrite(str(path / f"{k}.png"), frame, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        return path
    fourcc = {".avi": "MJPG", ".mp4": "mp4v"}[path.suffix]
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*fourcc), fps, (width, height))
    assert writer.isOpened()
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def write_camera(folder: Path, camera: CameraModel = CAMERA) -> Path:
    """camera.toml in the folder."""
    path = folder / "camera.toml"
    path.write_text(format_camera(camera), encoding="utf-8")
    return path


def write_markers(folder: Path, table: MarkerTable) -> Path:
    """markers.toml in the folder."""
    path = folder / "markers.toml"
    path.write_text(format_markers(table), encoding="utf-8")
    return path
