"""What a camera sees of a seeded object, corner by corner, with the truth: for the fit from corners and its tests.

Corners are projected by OpenCV and nothing of the station's own; noise is Gaussian with the covariance that is told.
Poses are made of them as the station makes them of any corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.intrinsics import CameraModel
from station.fit.image.views import Views
from station.kinematics.tree import KinematicTree
from station.logs import BoolArray, FloatArray, JointLog, PoseLog
from station.perception.joint_covariance import joint_covariance
from station.perception.markers import Marker, MarkerTable
from station.perception.observations import ObservationLog
from station.perception.pose import estimate_poses
from station.tracking import track_parts
from tests.benchmarks.made_joints import MadeObject, inverse
from tests.benchmarks.made_trees import true_tree
from tests.fit.image.seen_objects import SIZE_M, Scene, SeenObject, pixels, seen_object
from tests.rendered_markers import DICTIONARY, webcam

# A corner's time depends on its row, and the row on the time: each round makes the error some 0.03 times as large.
SHUTTER_ROUNDS = 8
OUTLIER_PX, OUTLIER_CORNER_PX = (8.0, 30.0), 4.0


@dataclass(frozen=True)
class Seeing:
    """How the camera sees, and what the fit is told of it.

    Attributes:
        sigma_px: standard deviation of the corners' coordinates; if `correlated`, of the places of edges at their ends,
            with what neighbours then share.
        stated: deviations that are told, as multiples of the true ones.
        uneven_px: by which each edge is seen outward beside that, about, by where and how it lies: alike in all frames
            in which the marker is seen alike.
        edge_shift_px: by which edges are seen outward; told_shift_px: what the calibration says, None for nothing, with
            the deviation `told_shift_std_px`.
        readout_s: of the rolling shutter; told_readout_s: what the fit is told, None for the truth.
        focal: factor of the true focal lengths on those told, with the deviation `told_focal_std_px`.
        missing: share of sightings that are not there.
        outliers: share that are somewhere else, all four corners.
    """

    sigma_px: float = 0.1
    correlated: bool = False
    stated: float = 1.0
    edge_shift_px: float = 0.0
    uneven_px: float = 0.0
    told_shift_px: float | None = None
    told_shift_std_px: float | None = None
    readout_s: float = 0.0
    told_readout_s: float | None = None
    focal: float = 1.0
    told_focal_std_px: float | None = None
    missing: float = 0.0
    outliers: float = 0.0


@dataclass(frozen=True, eq=False)
class Watched:
    """An object, what a camera saw of it, and the truth.

    Attributes:
        seen: the object, at any time; made: at the frames' times.
        true_camera: as it is; `views.camera` is what is told.
        views: as the fit takes them, with the covariances of the noise times `stated` squared.
        error_px: (N, 8) of the corners: the noise, or what an outlier is off by.
        outlier: (N,) whether a sighting is one.
        observations: the same sightings as the station's tracking takes them.
        table: of the markers.
    """

    seen: SeenObject
    seeing: Seeing
    made: MadeObject
    true_camera: CameraModel
    views: Views
    error_px: FloatArray
    outlier: BoolArray
    observations: ObservationLog
    table: MarkerTable

    @property
    def tree(self) -> KinematicTree:
        """The true tree, each body named by its first part."""
        return true_tree(self.made)

    @property
    def states(self) -> JointLog:
        """True states at the frames' times."""
        tree = self.tree
        units = tuple(tree.units[column] for column in tree.columns)
        return JointLog(self.views.t_s, tree.columns, np.concatenate(self.made.q, axis=-1), units)

    @property
    def truth(self) -> PoseLog:
        """True poses of all parts in the camera at the frames' times, seen or not."""
        return PoseLog(self.views.t_s, "camera", self.made.parts, self.made.T_ref_part)

    @cached_property
    def poses(self) -> PoseLog:
        """Poses of the parts as the station's own perception makes them of the corners."""
        sigma_px = None if self.seeing.correlated else self.seeing.stated * self.seeing.sigma_px
        views = self.views
        return track_parts(
            self.observations, self.table, views.camera, sigma_px=sigma_px, readout_s=views.readout_s
        ).poses


SCENE, SEEING = Scene(), Seeing()


def watched(seed: int | Sequence[int], scene: Scene = SCENE, seeing: Seeing = SEEING) -> Watched:
    """A camera of 640 x 480 px, f = 600 px, with some distortion, before an object at 0.6 m.

    The same seed and scene give the same object, whatever the seeing.
    """
    told = _told_camera(seeing)
    true_camera = _true_camera(told, seeing)
    seen = seen_object(np.random.default_rng(seed), scene, true_camera)
    return watch(np.random.default_rng([*(int(n) for n in np.atleast_1d(seed)), 1]), seen, seeing)


def watch(rng: np.random.Generator, seen: SeenObject, seeing: Seeing) -> Watched:
    """Any object, seen with noise drawn by `rng`."""
    told = _told_camera(seeing)
    true_camera = _true_camera(told, seeing)
    t_s, made = seen.scene.t_s, seen.at(seen.scene.t_s)
    exact = shifted(corners_px(seen, true_camera, t_s, seeing.readout_s), seeing.edge_shift_px)
    exact = unevenly_shifted(exact, seeing.uneven_px)
    there = rng.uniform(size=exact.shape[:2]) >= seeing.missing
    frame, marker = np.nonzero(there)
    true_px = exact[frame, marker]
    corner_px2 = corner_covariance(true_px, seeing.sigma_px)
    covariance = joint_covariance(true_px, corner_px2)
    if not seeing.correlated:
        corner_px2 = np.full_like(corner_px2, np.nan)
        covariance = np.broadcast_to(seeing.sigma_px**2 * np.eye(8), covariance.shape)
    error = (np.linalg.cholesky(covariance) @ rng.normal(size=(len(frame), 8, 1)))[..., 0]
    outlier = rng.uniform(size=len(frame)) < seeing.outliers
    error[outlier] = _gross(rng, int(outlier.sum()))
    px = true_px + error.reshape(-1, 4, 2)
    table = _table(seen, made.parts)
    both = estimate_poses(px, SIZE_M, told, covariance)
    rows = np.flatnonzero(~np.isnan(both.rms_px[:, 0]))  # others are never recorded
    observations = ObservationLog(
        t_s,
        frame[rows],
        np.array([m.id for m in table.markers])[marker[rows]],
        px[rows],
        seeing.stated**2 * corner_px2[rows],
        both.T_cam_marker[rows],
        both.rms_px[rows],
    )
    views = Views(
        t_s,
        made.parts,
        np.array([m.id for m in table.markers]),
        np.array(seen.part_of),
        seen.points_m,
        frame[rows],
        marker[rows],
        px[rows],
        seeing.stated**2 * covariance[rows],
        both.T_cam_marker[rows] @ inverse(seen.T_part_marker)[marker[rows], None],
        told,
        told.readout_s or 0.0,
    )
    return Watched(seen, seeing, made, true_camera, views, error[rows], outlier[rows], observations, table)


def corners_px(seen: SeenObject, camera: CameraModel, t_s: FloatArray, readout_s: float = 0.0) -> FloatArray:
    """(T, M, 4, 2) exact corners of all markers in frames at times (T,), each corner at its own row's time."""
    px = pixels(camera, seen.corners_m(seen.at(t_s).T_ref_part))
    if not readout_s:
        return px
    for _ in range(SHUTTER_ROUNDS):
        corner_s = t_s[:, None, None] + (px[..., 1] / camera.size_px[1] - 0.5) * readout_s
        px = np.stack([_at_own_times(seen, camera, corner_s[:, m], m) for m in range(px.shape[1])], axis=1)
    return px


def _at_own_times(seen: SeenObject, camera: CameraModel, corner_s: FloatArray, marker: int) -> FloatArray:
    """(T, 4, 2) corners of one marker, each at its own time (T, 4)."""
    T = seen.at(corner_s.ravel()).T_ref_part[:, seen.part_of[marker]].reshape(*corner_s.shape, 4, 4)
    return pixels(camera, (T[..., :3, :3] @ seen.points_m[marker, ..., None])[..., 0] + T[..., :3, 3])


def shifted(px: FloatArray, outward_px: float) -> FloatArray:
    """Corners (..., 4, 2), clockwise as seen, of the quadrilaterals whose edges are seen outward.

    Those of narrow borders (a sixth of the marker) by less, as blur reaches across: by half at 3.2 px.
    """
    if not outward_px:
        return px
    by_before, by_here = by_edges(px)
    to_next = np.roll(px, -1, axis=-2) - px
    ahead, behind = (np.roll(px, n, axis=-2) - px for n in (-2, 1))
    across = sum(np.abs(to_next[..., 0] * d[..., 1] - to_next[..., 1] * d[..., 0]) for d in (ahead, behind)) / 2
    border = across / np.linalg.norm(to_next, axis=-1) / 6
    share = 1 / (1 + np.exp(-(border - 3.2) / 0.75))
    return px + outward_px * (np.roll(share, 1, axis=-1)[..., None] * by_before + share[..., None] * by_here)


def unevenly_shifted(px: FloatArray, uneven_px: float) -> FloatArray:
    """Corners (..., 4, 2) whose edges are seen outward by a smooth function of their place, direction and length."""
    if not uneven_px:
        return px
    edge = np.roll(px, -1, axis=-2) - px
    direction, length = np.arctan2(edge[..., 1], edge[..., 0]), np.linalg.norm(edge, axis=-1)
    off = np.sin(direction + px[..., 0] / 60) + np.cos(2 * direction + px[..., 1] / 80 + length / 20)
    by_before, by_here = by_edges(px)
    return px + uneven_px * (np.roll(off, 1, axis=-1)[..., None] * by_before + off[..., None] * by_here)


def by_edges(px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How corners (..., 4, 2) move when the edge that ends there, or the one that starts there, moves outward by 1."""
    along = np.roll(px, -1, axis=-2) - px
    along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    before = np.roll(along, 1, axis=-2)
    # Along the edge that stays, as far as the other one's normal needs.
    outward = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    outward_before = np.roll(outward, 1, axis=-2)
    by_before = along / np.sum(along * outward_before, axis=-1, keepdims=True)
    by_here = before / np.sum(before * outward, axis=-1, keepdims=True)
    return by_before, by_here


def corner_covariance(px: FloatArray, sigma_px: float) -> FloatArray:
    """(..., 4, 2, 2) of corners where two lines meet whose places each have this deviation, as a detector states it."""
    by_before, by_here = (x[..., :, None] * x[..., None, :] for x in by_edges(px))
    return sigma_px**2 * (by_before + by_here)


def _gross(rng: np.random.Generator, count: int) -> FloatArray:
    """(n, 8) errors of markers that were seen somewhere else."""
    angle, far = rng.uniform(0, 2 * np.pi, count), rng.uniform(*OUTLIER_PX, count)
    together = (far * np.stack([np.cos(angle), np.sin(angle)])).T
    return (together[:, None] + OUTLIER_CORNER_PX * rng.normal(size=(count, 4, 2))).reshape(count, 8)


def _told_camera(seeing: Seeing) -> CameraModel:
    std = None if seeing.told_focal_std_px is None else np.diag([seeing.told_focal_std_px] * 2 + [0.0])
    readout_s = seeing.readout_s if seeing.told_readout_s is None else seeing.told_readout_s
    return replace(
        webcam(),
        edge_shift_px=seeing.told_shift_px,
        edge_shift_std_px=seeing.told_shift_std_px,
        readout_s=readout_s or None,
        matrix_std=std,
    )


def _true_camera(told: CameraModel, seeing: Seeing) -> CameraModel:
    matrix = np.array(told.matrix)
    matrix[[0, 1], [0, 1]] *= seeing.focal
    return replace(told, matrix=matrix)


def _table(seen: SeenObject, parts: tuple[str, ...]) -> MarkerTable:
    """Markers 0, 1, ...; one that is alone on its part gives it its frame."""
    mounts = [None if seen.part_of.count(k) == 1 else T for k, T in zip(seen.part_of, seen.T_part_marker, strict=True)]
    return MarkerTable(
        DICTIONARY,
        tuple(Marker(m, parts[k], SIZE_M, T) for m, (k, T) in enumerate(zip(seen.part_of, mounts, strict=True))),
    )
