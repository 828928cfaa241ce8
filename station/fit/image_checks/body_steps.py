"""A body that moves once: the camera was touched, and the fit took what stands still for something that moves.

A tree whose root doesn't stand still has a pose of its own in each frame, which does all that a camera's move does. So
here the poses of its bodies themselves are asked whether they are two: one before some time, and one after it.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from station.fit.image.image_fit import ImageFit
from station.fit.image_checks.abruptness import LEAST_TICKS
from station.fit.image_checks.changes import BLOCKS, FAINT, Effect, as_chi2, log_chance_of_a_step
from station.fit.image_checks.directions import CAMERA, TWIST, Rows
from station.fit.image_checks.sums import Sums, scene_centre
from station.kinematics import se3
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray

# Most deviations of poses from the two, as multiples of those that corners' noise makes.
STILL_DEVIATIONS = 3.0


def body_step(tree: KinematicTree, image: ImageFit, rows: Rows, own: Sums, body: str) -> Effect | None:
    """The step of a body; None where it moves otherwise, or was seen too little.

    Args:
        tree: that was fitted.
        image: of it.
        rows: of the image.
        own: sums over time.
        body: of the tree.
    """
    poses, information = _poses(tree, image, rows, body)
    seen = np.flatnonzero(information[:, 0, 0] > 0)
    if len(seen) < 2 * LEAST_TICKS:
        return None
    centre = se3.translation(scene_centre(image))
    middle = poses[seen[len(seen) // 2]]
    twists = se3.log(se3.inverse(centre) @ poses[seen] @ se3.inverse(middle) @ centre)
    back = se3.adjoint(se3.inverse(poses[seen]) @ centre)
    W = np.swapaxes(back, -1, -2) @ information[seen] @ back
    before_W, before_s = np.cumsum(W, axis=0), np.cumsum((W @ twists[..., None])[..., 0], axis=0)
    cuts = np.arange(LEAST_TICKS, len(seen) - LEAST_TICKS + 1)
    gain = _gain(before_W[cuts - 1], before_s[cuts - 1], before_W[-1], before_s[-1])
    best = int(cuts[np.argmax(gain)])
    first = _mean(before_W[best - 1], before_s[best - 1])
    second = _mean(before_W[-1] - before_W[best - 1], before_s[-1] - before_s[best - 1])
    left = twists - np.where(np.arange(len(seen))[:, None] < best, first, second)
    squared = np.einsum("ti,tij,tj->t", left, W, left)
    noise = max(float(np.median(squared) / (2.0 * gammaincinv(TWIST / 2, 0.5))), _between_blocks(W, left), 1.0)
    if noise > STILL_DEVIATIONS**2:
        return None
    freedom = float(TWIST * (len(seen) - 2))
    ratio = (len(seen) / LEAST_TICKS - 1.0) ** 2
    log_p = log_chance_of_a_step(as_chi2(gain.max() / noise, freedom), TWIST, ratio)
    spread = _pinv(before_W[best - 1]) + _pinv(before_W[-1] - before_W[best - 1])
    covariance, information = noise * spread, _pinv(spread)
    likely = np.zeros(len(own.start_s))
    np.add.at(likely, own.tick[seen[cuts]], np.exp(0.5 * (gain - gain.max()) / noise))
    profile = (np.arange(len(likely)) >= own.tick[seen[best]]).astype(np.float64)
    gap = np.concatenate([own.start_s[:1], own.end_s[:-1]]), own.start_s
    size = second - first
    return Effect(
        CAMERA,
        profile,
        size,
        covariance,
        information,
        float(gain.max()) / noise,
        float(gain.max()),
        log_p,
        TWIST,
        noise,
        freedom,
        likely / likely.sum(),
        gap,
    )


def _between_blocks(W: FloatArray, left: FloatArray) -> float:
    """Variance of the means of blocks of time over what single poses' informations say.

    Without the two that are farthest off, as the camera may have been moving for a while.
    """
    first = np.unique(np.linspace(0, len(W), BLOCKS, endpoint=False).astype(np.intp))
    of_W = np.add.reduceat(W, first, axis=0)
    of_s = np.add.reduceat((W @ left[..., None])[..., 0], first, axis=0)
    squared = np.einsum("bi,bij,bj->b", of_s, _pinv(of_W), of_s)
    return float(np.mean(np.sort(squared)[:-2])) / TWIST if len(squared) > 2 else 1.0


def _poses(tree: KinematicTree, image: ImageFit, rows: Rows, body: str) -> tuple[FloatArray, FloatArray]:
    """(T, 4, 4) of a body, and (T, 6, 6) information of its own markers about right perturbations of it."""
    views = image.views
    poses = image.T_ref_part[:, views.parts.index(body)] if body in views.parts else se3.identity(len(views.t_s))
    frame, part = views.frame[rows.rows], views.part[views.marker[rows.rows]]
    members = [k for k, name in enumerate(views.parts) if name in tree.parts and tree.body_of(name) == body]
    mine = np.isin(part, members) & np.isfinite(poses[frame]).all(axis=(1, 2))
    to_part = se3.adjoint(se3.inverse(image.T_ref_part[frame[mine], part[mine]]) @ poses[frame[mine]])
    J = rows.by_pose[mine] @ to_part
    information = np.zeros((len(poses), TWIST, TWIST))
    np.add.at(information, frame[mine], np.swapaxes(J, -1, -2) @ J)
    return poses, information


def _pinv(W: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.pinv(W, rcond=FAINT**2, hermitian=True), dtype=np.float64)


def _mean(W: FloatArray, s: FloatArray) -> FloatArray:
    return _pinv(W) @ s


def _gain(W: FloatArray, s: FloatArray, all_W: FloatArray, all_s: FloatArray) -> FloatArray:
    """(m,) by how much two means explain more than one."""
    after_W, after_s = all_W - W, all_s - s

    def explained(of_W: FloatArray, of_s: FloatArray) -> FloatArray:
        return np.einsum("...i,...ij,...j->...", of_s, _pinv(of_W), of_s)

    return explained(W, s) + explained(after_W, after_s) - explained(all_W, all_s)
