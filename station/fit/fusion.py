"""Parts that are one body: where they are on it, and where it is, told by all of them.

A body's pose in a frame is the information-weighted mean of what its parts say that were seen in it and are no
outliers. Mounts and poses are improved by turns; the whole tree's fit has the last word on both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from station.fit.bodies import Bodies, Group
from station.fit.noise import INLIER_ABOVE
from station.fit.pair_model import OUTLIER_SHARE_START, ROTATION_VOLUME, residuals
from station.fit.parallel import each
from station.kinematics import se3
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

FUSE_ITERATIONS = 6
MOUNT_ROUNDS = 4
# A pose or a mount is settled when a step promises to change chi squared by less than this.
SETTLED = 0.01


@dataclass(frozen=True, eq=False)
class Fused:
    """One body: T_ref_body (T, 4, 4), its information (T, 6, 6), where it is known (T,), inlier (T, M) of its parts."""

    T_ref_body: FloatArray
    information: FloatArray
    known: BoolArray
    inlier: FloatArray


@dataclass(frozen=True, eq=False)
class _Parts:
    """What the M parts of a body say; arrays that don't change over the frames have one.

    Attributes:
        T_ref_part: (T, M, 4, 4).
        oriented: (T, M).
        information: (T or 1, M, 6, 6) of right perturbations; zero for what was not measured and for a reference.
        log_odds: (T or 1, M) of inlier against outlier at zero residual; -inf unseen.
        exact: the reference frame is one of them.
    """

    T_ref_part: FloatArray
    oriented: BoolArray
    information: FloatArray
    log_odds: FloatArray
    exact: bool


def _parts(bodies: Bodies, group: Group) -> _Parts:
    k = list(group.members)
    if bodies.covariance is None:
        raise ValueError("a body needs covariances")
    covariance = bodies.covariance[:, k] if bodies.covariance.strides[0] else bodies.covariance[:1, k]
    seen, oriented, noisy = bodies.seen[:, k], bodies.oriented[:, k], bodies.noisy[k]
    measured = np.repeat(np.stack([seen, oriented], axis=-1), 3, axis=-1) & noisy[:, None]
    if len(covariance) == 1 and measured[:, noisy].all():
        measured = measured[:1]
    both = measured[..., :, None] & measured[..., None, :]
    whole = np.where(both, covariance, np.eye(6))
    inverse = np.where(both, np.linalg.inv(whole), 0.0)
    dimensions = measured.sum(axis=-1)
    outside = np.log(bodies.scene_m3) * (dimensions > 0) + np.log(ROTATION_VOLUME) * (dimensions > 3)
    inside = -0.5 * np.linalg.slogdet(whole)[1] - 0.5 * dimensions * np.log(2 * np.pi)
    odds = inside + outside + np.log((1 - OUTLIER_SHARE_START) / OUTLIER_SHARE_START)
    log_odds = np.where(dimensions > 0, odds, -np.inf)
    return _Parts(bodies.T_ref_body[:, k], oriented, inverse, log_odds, not noisy.all())


def _errors(parts: _Parts, T_ref_body: FloatArray, mounts: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals e (T, M, 6), information @ e, and the probability (T, M) that a part's pose is no outlier."""
    e = residuals(parts.T_ref_part, T_ref_body[:, None] @ mounts)
    told = (parts.information @ e[..., None])[..., 0]
    return e, told, np.asarray(expit(parts.log_odds - 0.5 * np.sum(e * told, axis=-1)), dtype=np.float64)


def _solve(H: FloatArray, g: FloatArray) -> FloatArray:
    """H^-1 g; zero along axes that were not measured."""
    idle = np.diagonal(H, axis1=-2, axis2=-1) <= 0
    solved = np.linalg.solve(H + idle[..., None] * np.eye(6), g[..., None])
    return np.asarray(solved[..., 0], dtype=np.float64)


def fuse(bodies: Bodies, group: Group) -> Fused:
    """Body pose in each frame from the group's parts, by Gauss-Newton on T @ exp(xi).

    A group with the reference frame in it stands still there: its pose is the identity throughout.
    """
    parts = _parts(bodies, group)
    return _fused(parts, group.mounts, _first_poses(parts, group.mounts))


def _fused(parts: _Parts, mounts: FloatArray, pose: FloatArray) -> Fused:
    """Each part's residual changes by -Ad(M^-1) xi."""
    T = len(pose)
    if parts.exact:
        _, _, inlier = _errors(parts, pose, mounts)
        return Fused(pose, np.zeros((T, 6, 6)), np.ones(T, dtype=bool), inlier)
    Ad = se3.adjoint(se3.inverse(mounts))
    Ad_t = np.swapaxes(Ad, -1, -2)
    each_tells = Ad_t @ parts.information @ Ad
    inlier, whole = np.ones(parts.oriented.shape), np.zeros((T, 6, 6))
    known = np.zeros(T, dtype=bool)
    for _ in range(FUSE_ITERATIONS):  # Gauss-Newton: each step starts where the last one ended
        _, told, inlier = _errors(parts, pose, mounts)
        known = (inlier * parts.oriented).max(axis=1) > INLIER_ABOVE
        whole = np.where(known[:, None, None], (each_tells * inlier[..., None, None]).sum(axis=1), np.eye(6))
        g = (Ad_t @ (told * inlier[..., None])[..., None])[..., 0].sum(axis=1)
        step = np.where(known[:, None], _solve(whole, g), 0.0)
        pose = pose @ se3.exp(step)
        if not np.any(np.sum(step * g, axis=-1) > SETTLED):
            break
    return Fused(pose, whole, known, inlier)


def _first_poses(parts: _Parts, mounts: FloatArray) -> FloatArray:
    """(T, 4, 4) body pose by the part that tells most about its orientation; the identity with a reference."""
    if parts.exact:
        return se3.identity(len(parts.T_ref_part))
    most = np.argmax(np.trace(parts.information[..., 3:, 3:], axis1=-2, axis2=-1), axis=1)
    rows = np.arange(len(parts.T_ref_part))
    best = np.broadcast_to(most, rows.shape)
    return parts.T_ref_part[rows, best] @ se3.inverse(mounts)[best]


def refined_mounts(bodies: Bodies, groups: Sequence[Group]) -> tuple[Group, ...]:
    """Groups with better mounts."""
    return tuple(each(lambda group: _refined(bodies, group), groups))


def _refined(bodies: Bodies, group: Group) -> Group:
    """Body poses from the mounts, then mounts from the body poses, by turns."""
    if len(group.members) == 1:
        return group
    parts = _parts(bodies, group)
    mounts, pose = group.mounts, _first_poses(parts, group.mounts)
    for _ in range(MOUNT_ROUNDS):  # each round needs the last one's mounts
        fused = _fused(parts, mounts, pose)
        pose = fused.T_ref_body
        _, told, _ = _errors(parts, pose, mounts)
        weights = fused.inlier * fused.known[:, None]
        g = np.einsum("tm,tmi->mi", weights, told)
        step = _solve(_summed(weights, parts.information), g)
        moved = mounts @ se3.exp(step)
        mounts = se3.inverse(moved[0]) @ moved
        pose = pose @ moved[0]
        if not np.any(np.sum(step * g, axis=-1) > SETTLED):
            break
    return replace(group, mounts=mounts)


def _summed(weights: FloatArray, information: FloatArray) -> FloatArray:
    """(M, 6, 6) weighted sum over the frames."""
    if len(information) == 1:
        return weights.sum(axis=0)[:, None, None] * information[0]
    return np.einsum("tm,tmij->mij", weights, information)


def fused_bodies(bodies: Bodies, groups: Sequence[Group]) -> Bodies:
    """One body for each group, named by its first part; seen where any part with an orientation was."""
    found = each(lambda group: _fused_body(bodies, group), groups)
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
    k = group.members[0]
    if bodies.covariance is None:
        raise ValueError("a body needs covariances")
    if len(group.members) == 1:
        return bodies.T_ref_body[:, k], bodies.seen[:, k], bodies.oriented[:, k], bodies.covariance[:, k]
    fused = fuse(bodies, group)
    known = fused.known[:, None, None]
    if not bodies.noisy[list(group.members)].all():
        return fused.T_ref_body, fused.known, fused.known, np.zeros_like(fused.information)
    covariance = np.linalg.inv(np.where(known, fused.information, np.eye(6)))
    return np.where(known, fused.T_ref_body, np.eye(4)), fused.known, fused.known, covariance
