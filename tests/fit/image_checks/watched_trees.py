"""Sessions as a fit in image space leaves them, made without one: residuals at the true poses, with what went wrong.

Tests on residuals take out all that a fit can do, so that residuals at the truth and at the fit's optimum are the same
to them: thousands of sessions take as many seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.intrinsics import CameraModel, project
from station.fit.image.camera_numbers import CameraNumbers
from station.fit.image.image_fit import ImageFit
from station.fit.image.views import IntArray, Views
from station.kinematics import se3
from station.kinematics.joint import Joint
from station.kinematics.tree import KinematicTree
from station.logs import BoolArray, FloatArray
from station.quadrilaterals import edge_shift_jacobian

CAMERA = CameraModel(
    size_px=(640, 480),
    matrix=np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]),
    distortion=np.array([-0.1, 0.05, 0.001, -0.001, 0.0]),
    matrix_std=np.array([[1.2, 0, 0.5], [0, 1.2, 0.5], [0, 0, 0]]),
    distortion_std=np.array([0.002, 0.01, 0.0002, 0.0002, 0.0]),
    edge_shift_px=0.0,
    edge_shift_std_px=0.01,
)
SIZE_M = 0.04
FPS = 20.0


@dataclass(frozen=True)
class Session:
    """What is watched, and how.

    Attributes:
        types: of the joints of a chain.
        frames: at 20 Hz.
        moving_root: whether the root sways before the camera.
        markers: on each part; those of one part are given as mounted.
        trackers: further parts on the root, with mounts that are to be found.
        sigma_px: of a corner.
        stated: what the detector says of it, as a multiple of it.
        outliers: share of gross ones.
        rests: share of the time at which nothing moves, and the same picture repeats the same errors.
        unseen: share of sightings that are missing.
    """

    types: tuple[str, ...] = ("revolute", "revolute", "revolute")
    frames: int = 300
    moving_root: bool = False
    markers: int = 1
    trackers: int = 0
    sigma_px: float = 0.1
    stated: float = 1.0
    outliers: float = 0.0
    rests: float = 0.0
    unseen: float = 0.05


@dataclass(frozen=True)
class Wrong:
    """What goes wrong, at `t_s` where it comes at a time; all zero for a clean session.

    Attributes:
        marker: which moves, by the twist `move` in its own frame.
        camera: twist of the camera in its own frame.
        focal: factor on the true camera's focal lengths.
        edges_px: shift of the edges beyond the calibration's.
        tilted_px: shift of the edges at 60 deg.
        k1: the true lens's, beyond the calibration's.
        drift: twist of the camera over the session.
    """

    t_s: float = 0.0
    marker: int = 0
    move: tuple[float, ...] = (0.0,) * 6
    camera: tuple[float, ...] = (0.0,) * 6
    drift: tuple[float, ...] = (0.0,) * 6
    focal: float = 1.0
    edges_px: float = 0.0
    tilted_px: float = 0.0
    k1: float = 0.0


def chain(types: tuple[str, ...], trackers: int, rng: np.random.Generator) -> KinematicTree:
    """A chain of joints, axes within 40 deg of the line of sight or across it in turns, links of some 8 cm."""
    names = ["base", *(f"link{i}" for i in range(1, len(types) + 1))]
    joints = []
    for i, kind in enumerate(types):
        axis = np.array([0.0, 0.3, 1.0] if i % 2 == 0 else [1.0, 0.2, 0.4]) + rng.normal(0, 0.1, 3)
        zero = se3.pose(se3.exp_so3(rng.normal(0, 0.1, 3)), [0.07, 0.03 * rng.normal(), 0.01])
        needs_axis, needs_point = kind != "spherical", kind not in ("prismatic",)
        joints.append(
            Joint(
                f"j{i}",
                kind,
                names[i],
                names[i + 1],
                axis / np.linalg.norm(axis) if needs_axis else None,
                np.array([0.03, 0.0, 0.0]) if needs_point else None,
                zero,
                0.01 if kind == "screw" else None,
            )
        )
    extra = tuple(f"base_{k}" for k in range(trackers))
    groups = (("base", *extra),) if extra else ()
    return KinematicTree("base", (*names, *extra), groups, (tuple(names),), tuple(joints))


def watched(session: Session, wrong: Wrong, rng: np.random.Generator) -> tuple[KinematicTree, ImageFit]:
    """A session's tree, and its image fit with residuals at the true poses."""
    tree = chain(session.types, session.trackers, rng)
    t = np.arange(session.frames) / FPS
    T = _poses(tree, session, t, rng)
    marker_part = np.repeat(np.arange(len(tree.parts)), session.markers)
    points = _points(session.markers, len(tree.parts))
    frame, marker = (x.ravel() for x in np.indices((len(t), len(marker_part))))
    seen = rng.random(len(frame)) >= session.unseen
    frame, marker = frame[seen], marker[seen]
    poses = T[frame, marker_part[marker]]
    true_px, by_edges_px = _true_px(wrong, t[frame] >= wrong.t_s, t[frame] / t[-1], poses, points, marker)
    views = Views(
        t_s=t,
        parts=tree.parts,
        marker_id=np.arange(len(marker_part)) + 3,
        part=marker_part,
        points_m=points,
        frame=frame,
        marker=marker,
        corners_px=true_px + by_edges_px + _noise(session, true_px, marker, rng),
        covariance_px2=np.broadcast_to((session.stated * session.sigma_px) ** 2 * np.eye(8), (len(frame), 8, 8)),
        T_ref_part=np.stack([poses, np.full(poses.shape, np.nan)], axis=1),
        camera=CAMERA,
    )
    return tree, _fit_at_the_truth(session, views, T)


def _true_px(
    wrong: Wrong, after: BoolArray, past: FloatArray, poses: FloatArray, points: FloatArray, marker: IntArray
) -> tuple[FloatArray, FloatArray]:
    """(N, 4, 2) corners without noise, and what edges add to them; `past` (N,) is the share of the session before."""
    truth = replace(
        CAMERA,
        matrix=CAMERA.matrix * np.array([[wrong.focal, 1, 1], [1, wrong.focal, 1], [1, 1, 1]]),
        distortion=CAMERA.distortion + np.array([wrong.k1, 0, 0, 0, 0]),
    )
    camera = se3.inverse(se3.exp(np.outer(after, wrong.camera) + np.outer(past, wrong.drift)))
    own, slipped = points[marker], (marker == wrong.marker) & after
    middle = points[wrong.marker].mean(axis=0)
    own = np.where(slipped[:, None, None], _at(se3.exp(np.array(wrong.move))[None], own - middle) + middle, own)
    p_cam = _at(camera @ poses, own)
    px = project(truth, p_cam)
    edges = wrong.edges_px + wrong.tilted_px * (1.0 / _cosine(p_cam) - 1.0)
    return px, edges[:, None, None] * edge_shift_jacobian(px)


def _fit_at_the_truth(session: Session, views: Views, T_ref_part: FloatArray) -> ImageFit:
    model_px = project(CAMERA, _at(T_ref_part[views.frame, views.part[views.marker]], views.points_m[views.marker]))
    residual_px = (views.corners_px - model_px).reshape(-1, 8)
    return ImageFit(
        views=views,
        T_ref_part=T_ref_part,
        numbers=CameraNumbers(edge_shift_px=0.0),
        numbers_std=CameraNumbers(np.nan, np.nan, np.nan),
        residual_px=residual_px,
        chi2=np.sum(residual_px**2, axis=1) / session.sigma_px**2,
        inlier=np.ones(len(views)),
        scale=np.full(len(views.marker_id), 1.0 / session.stated),
        doubtful=np.zeros(len(views), dtype=bool),
        alike=np.zeros(len(views.marker_id)),
        misfit=np.zeros(len(views.marker_id), dtype=bool),
        two_answers=np.zeros(T_ref_part.shape[:2], dtype=bool),
    )


def _at(T: FloatArray, points: FloatArray) -> FloatArray:
    return points @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3]


def _cosine(p_cam: FloatArray) -> FloatArray:
    normal = np.cross(p_cam[:, 2] - p_cam[:, 0], p_cam[:, 3] - p_cam[:, 1])
    middle = p_cam.mean(axis=1)
    return np.abs(np.sum(normal * middle, axis=1)) / np.linalg.norm(normal, axis=1) / np.linalg.norm(middle, axis=1)


def _points(markers: int, parts: int) -> FloatArray:
    square = 0.5 * SIZE_M * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    offsets = np.stack([np.arange(markers) * 1.2 * SIZE_M, np.zeros(markers), np.zeros(markers)], axis=-1)
    return np.tile(square + offsets[:, None], (parts, 1, 1))


def _time(session: Session, t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(T,) the object's own time, which stands still in some stretches."""
    if not session.rests:
        return t
    resting = np.repeat(rng.random(-(-len(t) // 25)) < session.rests, 25)[: len(t)]
    return np.cumsum(~resting) / FPS


def _poses(tree: KinematicTree, session: Session, t: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(T, K, 4, 4) in the camera; a marker's z points to it."""
    own = _time(session, t, rng)

    def sway(amplitude: float) -> FloatArray:
        return amplitude * np.sin(2 * np.pi * rng.uniform(0.1, 0.4) * own + rng.uniform(0, 6))

    q = {}
    for joint in tree.joints:
        if joint.type == "spherical":
            q[joint.name] = np.stack([sway(0.4) for _ in range(3)], axis=-1)
        else:
            q[joint.name] = sway(0.03 if joint.type == "prismatic" else 0.6)
    facing = se3.exp_so3(np.array([np.pi - 0.4, 0.0, 0.0])) @ se3.exp_so3(rng.normal(0, 0.15, 3))
    T_cam_root = np.tile(se3.pose(facing, [-0.1, 0.0, 0.6]), (len(t), 1, 1))
    if session.moving_root:
        T_cam_root = T_cam_root @ se3.exp(
            np.stack([*(sway(0.03) for _ in range(3)), *(sway(0.2) for _ in range(3))], -1)
        )
    relative = tree.forward(q)
    extra = {}
    for k, name in enumerate(n for n in tree.parts if n.startswith("base_")):
        extra[name] = np.tile(se3.pose(se3.exp_so3(rng.normal(0, 0.3, 3)), [0.0, 0.06 * (k + 1), 0.0]), (len(t), 1, 1))
    return np.stack([T_cam_root @ (relative | extra)[part] for part in tree.parts], axis=1)


def _noise(session: Session, px: FloatArray, marker: np.ndarray, rng: np.random.Generator) -> FloatArray:
    """White, but for the share that pictures of a marker have in common that look the same."""
    white = rng.standard_normal(px.shape)
    if session.rests:
        for m in np.unique(marker):
            rows = np.flatnonzero(marker == m)
            still = np.abs(np.diff(px[rows], axis=0)).max(axis=(1, 2)) < 1e-9
            look = np.concatenate([[0], np.cumsum(~still)])
            common = rng.standard_normal((look[-1] + 1, 4, 2))[look]
            white[rows] = np.sqrt(0.4) * white[rows] + np.sqrt(0.6) * common
    gross = rng.random(len(px)) < session.outliers
    return session.sigma_px * white + np.where(gross[:, None, None], rng.normal(0, 5.0, px.shape), 0.0)
