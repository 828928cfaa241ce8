"""Bodies: what joints connect. At first each tracked part is one; later several parts that are rigid to each other.

A body's pose in a frame is the information-weighted mean of what its parts say that were seen in it; a body that
stands still in the reference frame has one pose for all frames, told by all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from station.errors import InvalidData
from station.fit.noise import INLIER_ABOVE, LEAST_ESTIMATED_SCALE, LEAST_GIVEN_SCALE, given_noise, unknown_noise
from station.fit.pairwise import OUTLIER_SHARE_START, ROTATION_VOLUME, PairTracks
from station.kinematics import se3
from station.logs import FloatArray, PoseLog

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# Smallest side of the scene [m]: the volume in which a gross outlier may lie.
LEAST_SCENE_M = 0.1
FUSE_ITERATIONS = 6
# Relative to the largest entry: rounding in whatever made the covariance.
SYMMETRIC_WITHIN = 1e-6
MOUNT_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Bodies:
    """Poses of K bodies at T times.

    Attributes:
        names: K.
        T_ref_body: (T, K, 4, 4), identity where not seen.
        seen: (T, K).
        oriented: (T, K) seen with orientation.
        covariance: (T, K, 6, 6) finite; None where it is unknown and has to be estimated for each pair.
        noisy: (K,) False for a reference frame, which is known exactly.
        least_scale: least factor of the given covariances.
        scene_m3: volume of the scene.
    """

    names: tuple[str, ...]
    T_ref_body: FloatArray
    seen: BoolArray
    oriented: BoolArray
    covariance: FloatArray | None
    noisy: BoolArray
    least_scale: float
    scene_m3: float

    def take(self, bodies: Sequence[int]) -> Bodies:
        """Some of the bodies."""
        k = list(bodies)
        covariance = None if self.covariance is None else self.covariance[:, k]
        return replace(
            self,
            names=tuple(self.names[i] for i in k),
            T_ref_body=self.T_ref_body[:, k],
            seen=self.seen[:, k],
            oriented=self.oriented[:, k],
            covariance=covariance,
            noisy=self.noisy[k],
        )


def bodies_of_log(log: PoseLog) -> Bodies:
    """Each part a body of its own. Covariances are used if every seen part has a finite one for its position.

    Raises:
        InvalidData: for a covariance that is none.
    """
    seen = np.array(log.seen)
    poses = np.where(seen[..., None, None], log.T_ref_part, np.eye(4))
    oriented, covariance = seen.copy(), None
    if log.covariance is not None:
        oriented &= np.all(np.isfinite(np.diagonal(log.covariance, axis1=-2, axis2=-1)[..., 3:]), axis=-1)
        if np.all(np.isfinite(log.covariance[seen][:, :3, :3])):
            covariance = _finite_covariance(log.covariance, seen, oriented)
            _check_covariance(log, covariance)
        else:  # rotation flags can be told apart even where no size is: infinite is not observed, NaN is unknown
            oriented = seen & ~np.any(np.isinf(np.diagonal(log.covariance, axis1=-2, axis2=-1)[..., 3:]), axis=-1)
    noisy = np.ones(len(log.parts), dtype=bool)
    return Bodies(log.parts, poses, seen, oriented, covariance, noisy, LEAST_GIVEN_SCALE, _scene(poses, seen))


def _check_covariance(log: PoseLog, covariance: FloatArray) -> None:
    """Raise InvalidData for a covariance that is no positive definite matrix."""
    good = np.linalg.eigvalsh(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))[..., 0] > 0
    good &= (
        np.abs(covariance - np.swapaxes(covariance, -1, -2)).max(axis=(-2, -1))
        <= SYMMETRIC_WITHIN * np.abs(covariance).max()
    )
    if not np.all(good):
        row, part = np.argwhere(~good)[0]
        raise InvalidData(
            f"the covariance of '{log.parts[part]}' in row {row} is not symmetric and positive definite; "
            "give one that is, or none at all: the noise is then estimated"
        )


def with_reference(bodies: Bodies, reference: str) -> Bodies:
    """The bodies with the reference frame before them: a static one, identity, without noise."""
    T = len(bodies.seen)
    first = np.ones((T, 1), dtype=bool)
    covariance = bodies.covariance
    return replace(
        bodies,
        names=(reference, *bodies.names),
        T_ref_body=np.concatenate([se3.identity(T, 1), bodies.T_ref_body], axis=1),
        seen=np.concatenate([first, bodies.seen], axis=1),
        oriented=np.concatenate([first, bodies.oriented], axis=1),
        covariance=None if covariance is None else np.concatenate([np.zeros((T, 1, 6, 6)), covariance], axis=1),
        noisy=np.concatenate([[False], bodies.noisy]),
    )


def _finite_covariance(covariance: FloatArray, seen: BoolArray, oriented: BoolArray) -> FloatArray:
    """Identity where unseen, and in the rotation block where there is no orientation."""
    full = np.where(seen[..., None, None], covariance, np.eye(6))
    flat = ~oriented[..., None, None] & ((np.arange(6) >= 3)[:, None] | (np.arange(6) >= 3))
    return np.where(flat, np.eye(6), full)


def _scene(poses: FloatArray, seen: BoolArray) -> float:
    """Volume [m^3] of a cube as large as the scene is long."""
    p = poses[seen][:, :3, 3]
    if not len(p):
        return LEAST_SCENE_M**3
    return float(max(np.max(p.max(axis=0) - p.min(axis=0)), LEAST_SCENE_M)) ** 3


def oriented_pairs(bodies: Bodies, pairs: IntArray) -> IntArray:
    """Pairs (P, 2), turned where only the second has orientations: the parent of a pair needs them."""
    frames = bodies.oriented.sum(axis=0)
    swap = (frames[pairs[:, 0]] == 0) & (frames[pairs[:, 1]] > 0)
    return np.where(swap[:, None], pairs[:, ::-1], pairs)


def pair_tracks(bodies: Bodies, pairs: IntArray, *, at_most: int | None = None) -> PairTracks:
    """Relative poses of pairs (P, 2) of bodies, parent first, with their noise.

    Args:
        bodies: where the poses are.
        pairs: (P, 2).
        at_most: frames to keep of each pair, spread evenly over those that it was seen in; all frames of the log if
            None.
    """
    a, b = pairs[:, :1], pairs[:, 1:]
    rows = np.arange(len(bodies.seen))[None]
    if at_most is not None:
        rows = _spread_rows(bodies.oriented[:, a[:, 0]] & bodies.seen[:, b[:, 0]], at_most)
    seen = bodies.oriented[rows, a] & bodies.seen[rows, b]
    oriented = seen & bodies.oriented[rows, b]
    T_a_b = np.where(
        seen[..., None, None], se3.inverse(bodies.T_ref_body[rows, a]) @ bodies.T_ref_body[rows, b], np.eye(4)
    )
    if bodies.covariance is None:
        noise = unknown_noise(T_a_b, bodies.noisy[a[:, 0]], bodies.noisy[b[:, 0]])
    else:
        noise = given_noise(T_a_b, bodies.covariance[rows, a], bodies.covariance[rows, b], bodies.least_scale)
    return PairTracks(T_a_b, seen, oriented, noise, bodies.scene_m3)


def _spread_rows(seen: BoolArray, at_most: int) -> IntArray:
    """(P, N) rows of frames, N <= at_most, spread evenly over the frames (T, P) in which each pair was seen, in order.

    A pair that was seen less often is filled up with frames in which it was not seen.
    """
    count = seen.sum(axis=0)
    N = int(min(at_most, max(count.max(initial=0), 1)))
    order = np.argsort(~seen, axis=0, kind="stable").T  # seen frames first, each kind in order of time
    position = np.where(count[:, None] > N, (np.arange(N) * count[:, None]) // N, np.arange(N))
    return np.sort(np.take_along_axis(order, position, axis=-1), axis=-1)


def scaled_by_part(bodies: Bodies, variances: FloatArray) -> Bodies:
    """The bodies with the covariances that a first look at the data found.

    Args:
        bodies: one for each part.
        variances: (K, 1) factors of given covariances, or (K, 2) variances of position [m^2] and orientation [rad^2].
    """
    if bodies.covariance is not None:
        covariance = bodies.covariance * variances[:, 0, None, None]
    else:
        diagonal = np.repeat(variances, 3, axis=-1)
        covariance = np.broadcast_to(diagonal[:, None, :] * np.eye(6), (*bodies.seen.shape, 6, 6))
    covariance = np.where(bodies.noisy[:, None, None], covariance, 0.0)
    return replace(bodies, covariance=covariance, least_scale=LEAST_ESTIMATED_SCALE)


@dataclass(frozen=True, eq=False)
class Group:
    """Parts (indices) that are one body, and their mounts T_body_part (M, 4, 4); the first one's is the identity."""

    members: tuple[int, ...]
    mounts: FloatArray


def information_of(bodies: Bodies) -> FloatArray:
    """(T, K, 6, 6) inverse covariances; zero for what was not measured and for a reference."""
    if bodies.covariance is None:
        raise ValueError("information needs covariances")
    measured = np.concatenate(
        [np.repeat(bodies.seen[..., None], 3, -1), np.repeat(bodies.oriented[..., None], 3, -1)], axis=-1
    )
    both = measured[..., :, None] & measured[..., None, :] & bodies.noisy[:, None, None]
    inverse: FloatArray = np.linalg.inv(np.where(both, bodies.covariance, np.eye(6)))
    return np.where(both, inverse, 0.0)


def inlier_probability(e: FloatArray, information: FloatArray, scene_m3: float) -> FloatArray:
    """(...,) probability that a measured pose is none of the outliers, by its residual (..., 6); 0 if not measured."""
    chi2 = np.einsum("...i,...ij,...j->...", e, information, e)
    measured = np.diagonal(information, axis1=-2, axis2=-1) > 0
    _, logdet = np.linalg.slogdet(information + np.where(measured, 0.0, 1.0)[..., None] * np.eye(6))
    dimensions = measured.sum(axis=-1)
    outside = np.log(scene_m3) * (dimensions > 0) + np.log(ROTATION_VOLUME) * (dimensions > 3)
    odds = 0.5 * (logdet - dimensions * np.log(2 * np.pi) - chi2) + outside
    odds = odds + np.log((1 - OUTLIER_SHARE_START) / OUTLIER_SHARE_START)
    return np.asarray((dimensions > 0) * expit(odds), dtype=np.float64)


def _solve(H: FloatArray, g: FloatArray) -> FloatArray:
    """H^-1 g; zero along axes that were not measured."""
    idle = np.diagonal(H, axis1=-2, axis2=-1) <= 0
    solved = np.linalg.solve(H + idle[..., None] * np.eye(6), g[..., None])
    return np.asarray(solved[..., 0], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Fused:
    """One body: T_ref_body (T, 4, 4), its information (T, 6, 6), where it is known (T,), inlier (T, M) of its parts."""

    T_ref_body: FloatArray
    information: FloatArray
    known: BoolArray
    inlier: FloatArray


def fuse(bodies: Bodies, group: Group) -> Fused:
    """Body pose in each frame from the group's parts, by Gauss-Newton on T @ exp(xi).

    Each part's residual is e = log((T M)^-1 T_part) and changes by -Ad(M^-1) xi. A group with the reference frame in
    it stands still there: its pose is the identity throughout.
    """
    k = list(group.members)
    T_part, information = bodies.T_ref_body[:, k], information_of(bodies.take(k))
    if not bodies.noisy[k].all():
        e = se3.log(se3.inverse(group.mounts) @ T_part)
        everywhere = np.ones(len(T_part), dtype=bool)
        inlier = inlier_probability(e, information, bodies.scene_m3)
        return Fused(se3.identity(len(T_part)), np.zeros((len(T_part), 6, 6)), everywhere, inlier)
    Ad = se3.adjoint(se3.inverse(group.mounts))
    pose = _first_poses(T_part, information, group.mounts)
    inlier, told = np.ones(T_part.shape[:2]), np.zeros((len(T_part), 6, 6))
    known: BoolArray = np.zeros(len(T_part), dtype=bool)
    for _ in range(FUSE_ITERATIONS):  # Gauss-Newton: each step starts where the last one ended
        e = se3.log(se3.inverse(pose[:, None] @ group.mounts) @ T_part)
        inlier = inlier_probability(e, information, bodies.scene_m3)
        weighted = np.swapaxes(Ad, -1, -2) @ (information * inlier[..., None, None])
        known = (inlier * bodies.oriented[:, k]).max(axis=1) > INLIER_ABOVE
        told = np.where(known[:, None, None], (weighted @ Ad).sum(axis=1), np.eye(6))
        g = (weighted @ e[..., None])[..., 0].sum(axis=1)
        pose = pose @ se3.exp(np.where(known[:, None], _solve(told, g), 0.0))
    return Fused(pose, told, known, inlier)


def _first_poses(T_part: FloatArray, information: FloatArray, mounts: FloatArray) -> FloatArray:
    """(T, 4, 4) body pose by the part that tells most about its orientation."""
    best = np.argmax(np.trace(information[..., 3:, 3:], axis1=-2, axis2=-1), axis=1)
    return (T_part @ se3.inverse(mounts))[np.arange(len(T_part)), best]


def refined_mounts(bodies: Bodies, group: Group) -> Group:
    """Mounts improved by turns: body poses from the mounts, then mounts from the body poses."""
    if len(group.members) == 1:
        return group
    k = list(group.members)
    T_part, information = bodies.T_ref_body[:, k], information_of(bodies.take(k))
    for _ in range(MOUNT_ROUNDS):  # each round needs the last one's mounts
        fused = fuse(bodies, group)
        e = se3.log(se3.inverse(fused.T_ref_body[:, None] @ group.mounts) @ T_part)
        weighted = information * (fused.inlier * fused.known[:, None])[..., None, None]
        step = _solve(weighted.sum(axis=0), (weighted @ e[..., None])[..., 0].sum(axis=0))
        mounts = group.mounts @ se3.exp(step)
        group = Group(group.members, se3.inverse(mounts[0]) @ mounts)
    return group


def fused_bodies(bodies: Bodies, groups: Sequence[Group]) -> Bodies:
    """One body for each group, named by its first part; seen where any part with an orientation was."""
    found = [_fused_body(bodies, group) for group in groups]
    poses, seen, oriented, covariance = (np.stack(column, axis=1) for column in zip(*found, strict=True))
    return replace(
        bodies,
        names=tuple(bodies.names[group.members[0]] for group in groups),
        T_ref_body=poses,
        seen=seen,
        oriented=oriented,
        covariance=covariance,
        noisy=np.array([bodies.noisy[list(group.members)].all() for group in groups]),
    )


def _fused_body(bodies: Bodies, group: Group) -> tuple[FloatArray, BoolArray, BoolArray, FloatArray]:
    """Pose, seen, oriented and covariance of one body over the frames."""
    first = group.members[0]
    if bodies.covariance is None:
        raise ValueError("a body needs covariances")
    if len(group.members) == 1:
        return (
            bodies.T_ref_body[:, first],
            bodies.seen[:, first],
            bodies.oriented[:, first],
            bodies.covariance[:, first],
        )
    fused = fuse(bodies, group)
    known = fused.known[:, None, None]
    exact = not bodies.noisy[list(group.members)].all()
    covariance = (
        np.zeros_like(fused.information) if exact else np.linalg.inv(np.where(known, fused.information, np.eye(6)))
    )
    return np.where(known, fused.T_ref_body, np.eye(4)), fused.known, fused.known, covariance
