"""The seam between poses and trees: sides of poses that corners and time leave open, chosen as a fitted tree allows.

A part's rotation is told by what is rigid to it, and, but for the joint's own state, by the body that it hangs from or
that hangs from it. Only ambiguous choices are made anew, and only by parts whose own choice is sure in that frame.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from station.kinematics import se3
from station.kinematics.joint import Joint
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray
from station.perception.choice import CAMERA_FRAME, Choice, choose_by_prediction
from station.perception.observations import SOLUTIONS
from station.tracking import TrackedParts

# A tree's own error: a prediction is never taken as better than this.
TREE_SIGMA_RAD = np.deg2rad(0.3)
# Frames in which two parts of a body were both sure, to know how they sit on it.
LEAST_FRAMES = 5


def choose_by_tree(tracked: TrackedParts, tree: KinematicTree) -> Choice:
    """The choice with ambiguous poses put on the side that the tree allows; the others as they were."""
    bodies = _Bodies(tracked, tree)
    choice = tracked.choice
    for joint in (None, *tree.joints):  # first by trackers of the same body, then joint by joint
        for told, by, turned in _pairs(bodies, tree, joint):
            R, spread = bodies.prediction(choice, told, by, joint, turned=turned)
            choice = choose_by_prediction(tracked.hypotheses, choice, R, spread)
    return choice


def _pairs(bodies: _Bodies, tree: KinematicTree, joint: Joint | None) -> Iterator[tuple[str, str, bool]]:
    """(part, part that tells of it, whether the telling one hangs below): of one body, or across a joint."""
    for told in bodies.parts:
        for by in bodies.parts_and_camera:
            if by == told:
                continue
            ends = tree.body_of(told), tree.body_of(by)
            if (joint is None and ends[0] == ends[1]) or (joint is not None and ends == (joint.child, joint.parent)):
                yield told, by, False
            elif joint is not None and ends == (joint.parent, joint.child):
                yield told, by, True


class _Bodies:
    """Where the trackers sit on their bodies, and what they tell of each other."""

    def __init__(self, tracked: TrackedParts, tree: KinematicTree) -> None:
        self._hypotheses = tracked.hypotheses
        names = tracked.hypotheses.parts
        self.parts = tuple(name for name in names if name in tree.parts)
        self.parts_and_camera = (*self.parts, *((CAMERA_FRAME,) if CAMERA_FRAME in tree.parts else ()))
        self._mounts = {name: self._mount(tracked.choice, name, tree.body_of(name)) for name in self.parts_and_camera}

    def _sure(self, choice: Choice, part: str) -> tuple[FloatArray, FloatArray]:
        """Poses (F, 4, 4) of a part where its choice is sure, NaN elsewhere, and covariances (F, 6, 6)."""
        h = self._hypotheses
        if part == CAMERA_FRAME:
            return se3.identity(len(h.t_s)), np.zeros((len(h.t_s), 6, 6))
        k = h.parts.index(part)
        rows = np.arange(len(h.t_s))
        sure = (h.seen[:, k] & ~choice.ambiguous[:, k])[:, None, None]
        at = rows, k, choice.chosen[:, k]
        return np.where(sure, h.T_cam_part[at], np.nan), np.where(sure, h.covariance[at], np.nan)

    def _mount(self, choice: Choice, part: str, body: str) -> FloatArray | None:
        """Pose (4, 4) of a part on its body, whose frame is that of the part that names it; None if not known."""
        if part == body:
            return np.eye(4)
        relative = se3.inverse(self._sure(choice, body)[0]) @ self._sure(choice, part)[0]
        relative = relative[~np.isnan(relative[:, 0, 0])]
        return se3.mean(relative) if len(relative) >= LEAST_FRAMES else None

    def prediction(
        self, choice: Choice, told: str, by: str, joint: Joint | None, *, turned: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Rotations (F, K, 2, 3, 3) of `told` as `by` tells them, nearest to each candidate, and their covariances.

        NaN where nothing is told. With `turned`, `by` is on the joint's child.
        """
        h = self._hypotheses
        shape = (*h.chi2.shape[:2], SOLUTIONS, 3, 3)
        R, spread = np.full(shape, np.nan), np.full(shape, np.nan)
        mount_told, mount_by = self._mounts[told], self._mounts[by]
        k = h.parts.index(told)
        if mount_told is None or mount_by is None or not choice.ambiguous[:, k].any():
            return R, spread
        T_by, covariance = self._sure(choice, by)
        T_body_by = T_by @ se3.inverse(mount_by)
        T_body = h.T_cam_part[:, k] @ se3.inverse(mount_told)
        nearest = T_body_by[:, None] @ _allowed(joint, se3.inverse(T_body_by)[:, None] @ T_body, turned=turned)
        R[:, k] = (nearest @ mount_told)[..., :3, :3]
        # Turned into the told part's frame: a small rotation of `by` is the same one of the camera's, seen from there.
        across = np.swapaxes(R[:, k], -1, -2) @ T_by[:, None, :3, :3]
        spread[:, k] = across @ covariance[:, None, 3:, 3:] @ np.swapaxes(across, -1, -2) + TREE_SIGMA_RAD**2 * np.eye(
            3
        )
        return R, spread


def _allowed(joint: Joint | None, T_by_told: FloatArray, *, turned: bool) -> FloatArray:
    """The relative pose nearest to T_by_told (..., 4, 4) that the joint allows; of one body there is but one."""
    if joint is None:
        return np.where(np.isnan(T_by_told), np.nan, np.eye(4))
    T_parent_child = se3.inverse(T_by_told) if turned else T_by_told
    seen = ~np.isnan(T_parent_child[..., 0, 0])
    allowed = np.full(T_parent_child.shape, np.nan)
    states = joint.kind.inverse(joint.geometry, T_parent_child[seen])
    allowed[seen] = joint.forward(states)
    return se3.inverse(allowed) if turned else allowed
