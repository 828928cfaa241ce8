"""How well a tree's axes can be known at all: Cramer-Rao bounds from true poses and the noise's covariance.

All of the tree is unknown at once: every joint's axis, point, pitch and zero pose, the mounts of all trackers but the
one that names each body, a static root's pose; and in each frame the joints' states and a moving root's pose, which
the Schur complement takes out. The derivatives are exact: a change of any of these numbers moves all that hangs from it
by a twist, brought into each tracker's own frame, where its noise is.

The bound is of Gaussian noise with that covariance, known to the estimator. Of other noise with the same covariance it
is what the best linear estimate attains for small errors (Gauss-Markov), least squares among others, but no bound:
where the density's support moves with the parameters, as that of uniform noise does, the theorem of Cramer and Rao
fails, and estimates that look at the extreme errors alone come nearer than it allows. Nor does it hold for estimates
that are biased, such as those of smoothed poses, or that know more, such as that the motion is smooth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.joints import JointFrames
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray, JointLog, PoseLog

IntArray = NDArray[np.intp]
# Relative eigenvalue of a scaled information matrix below which nothing is observed: rounding.
OBSERVED_ABOVE = 1e-11
# Share of a unit vector above which it is counted among what isn't observed.
UNOBSERVED_SHARE = 1e-3


@dataclass(frozen=True, eq=False)
class JointBound:
    """Least covariance of one joint's geometry, in the frame of its parent part.

    Attributes:
        joint: its name.
        axis: (2, 2) [rad^2] of the axis' direction, across it; (0, 0) for a type without one.
        point: (2, 2) [m^2] across the axis, of its point nearest the child's mean position; (3, 3) of a spherical
            joint's centre; (0, 0) for a type without one.

    What is not observed has infinite variances.
    """

    joint: str
    axis: FloatArray
    point: FloatArray

    @property
    def axis_rad(self) -> float | None:
        """Root mean square of the angle between estimated and true axis; None for a type without one."""
        return float(np.sqrt(np.trace(self.axis))) if self.axis.size else None

    @property
    def point_m(self) -> float | None:
        """Root mean square of the distance of the estimated point from the true axis; None for a type without one."""
        return float(np.sqrt(np.trace(self.point))) if self.point.size else None


def tree_bounds(
    tree: KinematicTree,
    truth: PoseLog,
    states: JointLog,
    covariance: ArrayLike,
    *,
    root_moves: bool,
    seen: ArrayLike | None = None,
) -> tuple[JointBound, ...]:
    """Bounds of the tree's movable joints, in their order.

    Args:
        tree: the true tree.
        truth: true poses of its parts in all frames, without noise.
        states: true states of its joints at the same times.
        covariance: of each pose's right perturbation [m, rad], (6, 6) or (T, K, 6, 6); independent from pose to pose.
        root_moves: whether the roots go anyhow from frame to frame, or stand still somewhere.
        seen: (T, K) whether a pose was seen; all if None.

    Raises:
        InvalidData: for a part without a true pose, rigid joints, a covariance that is none.
    """
    problem = _problem(tree, truth, covariance, seen)
    found = [bound for root in tree.tree_roots for bound in _bounds_of(problem, states, root, root_moves=root_moves)]
    by_name = {bound.joint: bound for bound in found}
    return tuple(by_name[joint.name] for joint in tree.joints)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The tree, true poses (T, K, 4, 4) of its parts, and W (T, K, 6, 6) with W^T W the inverse covariances."""

    tree: KinematicTree
    T_ref_part: FloatArray
    whitening: FloatArray

    def pose(self, part: str) -> FloatArray:
        """(T, 4, 4)."""
        return self.T_ref_part[:, self.tree.parts.index(part)]


def _problem(tree: KinematicTree, truth: PoseLog, covariance: ArrayLike, seen: ArrayLike | None) -> _Problem:
    lost = [part for part in tree.parts if part not in truth.parts]
    if lost:
        raise InvalidData(f"no true poses of {', '.join(lost)}; have {', '.join(truth.parts)}")
    rigid = [joint.name for joint in tree.joints if not joint.kind.states]
    if rigid:
        raise InvalidData(f"rigid joints {', '.join(rigid)}; want their parts in rigid groups")
    columns = [truth.parts.index(part) for part in tree.parts]
    T_ref_part = truth.T_ref_part[:, columns]
    if not np.isfinite(T_ref_part).all():
        raise InvalidData("true poses are missing in some frames; want all, and say by `seen` what was seen")
    shape = T_ref_part.shape[:2]
    there = np.ones(shape) if seen is None else np.asarray(seen, dtype=np.float64)[:, columns]
    whitening = _whitening(np.asarray(covariance, dtype=np.float64))
    return _Problem(tree, T_ref_part, np.broadcast_to(whitening, (*shape, 6, 6)) * there[..., None, None])


def _whitening(covariance: FloatArray) -> FloatArray:
    """W (..., 6, 6) with W^T W the inverse covariance."""
    wrong = "the covariance of the noise is not finite and positive definite; want (..., 6, 6) of [m, rad]"
    if covariance.shape[-2:] != (6, 6) or not np.isfinite(covariance).all():
        raise InvalidData(wrong)
    try:
        whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError:
        raise InvalidData(wrong) from None
    return np.asarray(whitening, dtype=np.float64)


@dataclass(eq=False)
class _Twists:
    """Twists (T, 6, n) in the reference frame of blocks of numbers, each with the rows of the parts that they move."""

    blocks: list[tuple[IntArray, FloatArray]] = field(default_factory=list[tuple[IntArray, FloatArray]])

    def add(self, parts: list[int], twists: FloatArray) -> slice:
        """The columns of a new block."""
        start = self.numbers
        self.blocks.append((np.array(parts, dtype=np.intp), twists))
        return slice(start, start + twists.shape[-1])

    @property
    def numbers(self) -> int:
        return sum(twists.shape[-1] for _, twists in self.blocks)

    def derivative(self, whitened_inverse: FloatArray) -> FloatArray:
        """(T, 6 K, n) of the whitened poses, for what brings twists to them, (T, K, 6, 6)."""
        frames, K = whitened_inverse.shape[:2]
        found = np.zeros((frames, K, 6, self.numbers))
        start = 0
        for parts, twists in self.blocks:
            end = start + twists.shape[-1]
            found[:, parts, :, start:end] = whitened_inverse[:, parts] @ twists[:, None]
            start = end
        return found.reshape(frames, 6 * K, -1)


def _bounds_of(problem: _Problem, states: JointLog, root: str, *, root_moves: bool) -> list[JointBound]:
    """Bounds of the joints of one tree."""
    tree = problem.tree
    joints = list(tree.outward(root))
    fixed, per_frame = _Twists(), _Twists()
    carried = _carried(tree, root)
    to_ref = se3.adjoint(problem.pose(root))
    (per_frame if root_moves else fixed).add(carried[root], to_ref)
    columns: list[tuple[slice, slice]] = []
    for joint in joints:
        columns.append(_add_joint(problem, joint, states, carried[joint.child], fixed, per_frame))
    for body in carried:
        for part in _trackers(tree, body):
            fixed.add([tree.parts.index(part)], se3.adjoint(problem.pose(part)))
    inverse = problem.whitening @ se3.adjoint(se3.inverse(problem.T_ref_part))
    covariance = _covariance(fixed.derivative(inverse), per_frame.derivative(inverse))
    return [
        JointBound(joint.name, covariance[axis, axis], covariance[point, point])
        for joint, (axis, point) in zip(joints, columns, strict=True)
    ]


def _trackers(tree: KinematicTree, body: str) -> list[str]:
    """The parts of a body beside its named one."""
    return [part for group in tree.rigid_groups if body in group for part in group if part != body]


def _carried(tree: KinematicTree, root: str) -> Mapping[str, list[int]]:
    """Rows of the parts that each body of a tree carries: its own, and those of all that hangs from it."""
    joints = list(tree.outward(root))
    found = {
        body: [tree.parts.index(part) for part in (body, *_trackers(tree, body))]
        for body in (root, *(joint.child for joint in joints))
    }
    for joint in reversed(joints):  # the far ones first
        found[joint.parent] = found[joint.parent] + found[joint.child]
    return found


def _add_joint(
    problem: _Problem, joint: Joint, states: JointLog, moved: list[int], fixed: _Twists, per_frame: _Twists
) -> tuple[slice, slice]:
    """Adds a joint's numbers; returns the columns of its axis' direction and of its point."""
    kind, frames = joint.kind, _frames(problem, joint)
    T_ref_axis = problem.pose(joint.parent) @ frames.T_parent_axis
    T_ref_moved = problem.pose(joint.child) @ se3.inverse(frames.T_axis_child)
    at_axis, at_moved = se3.adjoint(T_ref_axis), se3.adjoint(T_ref_moved)
    q = np.stack([states.state(column) for column in joint.columns], axis=-1)
    per_frame.add(moved, at_moved @ kind.state_twists(frames.form))
    shifts = [i for i in kind.axis_freedoms if i < 3]
    turns = [i for i in kind.axis_freedoms if i >= 3]
    point = fixed.add(moved, at_axis[..., shifts])
    axis = fixed.add(moved, at_axis[..., turns])
    fixed.add(moved, at_moved[..., list(kind.child_freedoms)])
    fixed.add(moved, at_moved @ kind.form_twists(q, frames.form))
    return axis, point


def _frames(problem: _Problem, joint: Joint) -> JointFrames:
    """The joint's frames, that of its axis at the point nearest the child's mean position."""
    T_parent_child = se3.inverse(problem.pose(joint.parent)) @ problem.pose(joint.child)
    frames = joint.kind.frames(joint.geometry)
    if joint.axis_parent is None:
        return frames
    along_m = float((se3.inverse(frames.T_parent_axis) @ T_parent_child)[:, 2, 3].mean())
    shift = se3.translation([0.0, 0.0, along_m])
    return JointFrames(frames.T_parent_axis @ shift, se3.inverse(shift) @ frames.T_axis_child, frames.form)


def _covariance(A: FloatArray, B: FloatArray) -> FloatArray:
    """(n, n) of the fixed numbers, with derivatives A (T, m, n) by them and B (T, m, s) by each frame's own numbers."""
    B_t = np.swapaxes(B, -1, -2)
    own = np.linalg.pinv(B_t @ B, rcond=OBSERVED_ABOVE, hermitian=True)
    A_free = A - B @ (own @ (B_t @ A))
    rows = A_free.reshape(-1, A.shape[-1])
    H = rows.T @ rows
    scale = np.sqrt(np.where(np.diagonal(H) > 0, np.diagonal(H), 1.0))
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    seen = values > OBSERVED_ABOVE * values[-1]
    known = vectors[:, seen] / scale[:, None]
    covariance = (known / values[seen]) @ known.T
    hidden = np.linalg.norm(vectors[:, ~seen], axis=-1) > UNOBSERVED_SHARE
    covariance[hidden, hidden] = np.inf
    return covariance
