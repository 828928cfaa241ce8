"""Reads a fitted joint: axis, point and zero pose with a definite sign and zero, states, deviations, residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.selection import Scores
from station.kinematics import se3
from station.kinematics.joints import JointFrames, JointType
from station.kinematics.tree import Joint
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# Share of the range: a motion that ends nearer to its start than this goes nowhere, and its first excursion gives the
# sign.
NET_MOTION = 0.1
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # half turn about x: turns z over


@dataclass(frozen=True, eq=False)
class JointReading:
    """A fitted joint between two bodies, told in the frames of the parts that name them.

    Attributes:
        type: of the joint.
        frames: T_parent_axis and T_axis_child, (4, 4) each.
        covariance: (6 + m, 6 + m) of a right perturbation of T_parent_axis and of the form's m numbers.
        q: (T, s) states.
        state_covariance: (T, s, s) of changes of the states, but for one that all frames share. The states' zero, which
            is where the joint was in its first good frame, is a choice and no measurement: a deviation is that of a
            state against others, and who holds states against another instrument's takes out one constant first.
        seen: (T,) both bodies were seen.
        good: (T,) seen, and no outlier.
        residual: (T, 6) [m, rad] of the relative pose.
        placed: (T,) good, and there is a residual.
        oriented: (T,) good, and there is a residual of the orientation.
        spread: (2,) largest deviations of position and orientation of the parts on both bodies, as multiples of what
            the pairs or the log said; large where they move otherwise than the tree allows.
    """

    type: JointType
    frames: JointFrames
    covariance: FloatArray
    q: FloatArray
    state_covariance: FloatArray
    seen: BoolArray
    good: BoolArray
    residual: FloatArray
    placed: BoolArray
    oriented: BoolArray
    spread: FloatArray

    @property
    def std(self) -> FloatArray:
        """(T, s) deviations of the states; NaN where there is none."""
        variance = np.diagonal(self.state_covariance, axis1=-2, axis2=-1)
        return np.where(self.good[:, None], np.sqrt(np.maximum(variance, 0.0)), np.nan)

    def settled(self) -> JointReading:
        """With a definite sign, zero and point, deviations those of the states' numbers; states NaN where not good."""
        changes = np.broadcast_to(np.eye(self.type.states), self.state_covariance.shape)
        frames, q, changes = self.type.upright(self.frames, self.q, changes)
        if self.type.states and self.good.any():
            frames, q, changes = with_zero(self.type, frames, q, changes, self.good)
            if self.type.has_axis:
                frames, q, changes = with_sign(frames, q, changes, self.good)
                frames = _nearest_point(self.type, frames, q[self.good]) if self.type.has_point else frames
        changes = self.type.column_changes(q, changes)
        moved = np.eye(len(self.covariance))
        moved[:6, :6] = se3.adjoint(se3.inverse(frames.T_parent_axis) @ self.frames.T_parent_axis)
        return replace(
            self,
            frames=frames,
            q=np.where(self.good[:, None], q, np.nan),
            state_covariance=changes @ self.state_covariance @ np.swapaxes(changes, -1, -2),
            covariance=moved @ self.covariance @ moved.T,
        )

    def joint(self, parent: str, child: str, scores: Scores, pair: int) -> Joint:
        """The joint as a tree holds it; read a settled one."""
        geometry = self.type.geometry(self.frames)
        known = self.type.extent(self.q[self.good]) if self.type.states else np.zeros(0)
        variance = np.diagonal(self.covariance)
        point_variance = variance[0] + variance[1] + (0.0 if self.type.has_axis else variance[2])
        return Joint(
            name=f"{parent}__{child}",
            type=self.type.name,
            parent=parent,
            child=child,
            axis_parent=geometry.axis_parent,
            point_parent_m=geometry.point_parent_m,
            T_parent_child_zero=geometry.T_parent_child_zero,
            pitch_m_per_rad=geometry.pitch_m_per_rad,
            state_min=float(known.min()) if known.size else None,
            state_max=float(known.max()) if known.size else None,
            scores={"criterion": scores.criterion, **{name: float(s[pair]) for name, s in scores.by_type.items()}},
            probability=scores.probabilities(pair),
            rms_rotation_rad=_rms(self.residual[:, 3:], self.oriented),
            rms_translation_m=_rms(self.residual[:, :3], self.placed),
            frames=int(self.seen.sum()),
            outliers=int((self.seen & ~self.good).sum()),
            axis_std_rad=None if geometry.axis_parent is None else float(np.sqrt(variance[3] + variance[4])),
            point_std_m=None if geometry.point_parent_m is None else float(np.sqrt(point_variance)),
            pitch_std_m_per_rad=self.pitch_std_m_per_rad,
        )

    @property
    def pitch_std_m_per_rad(self) -> float | None:
        """Deviation of a screw's pitch; None for the other types."""
        return float(np.sqrt(self.covariance[6, 6])) if self.type.form_freedoms else None


def with_zero(
    joint: JointType, frames: JointFrames, q: FloatArray, changes: FloatArray, good: BoolArray
) -> tuple[JointFrames, FloatArray, FloatArray]:
    """The joint with states (T, s), and their changes (T, s, k), that are zero in the first good frame."""
    first = np.flatnonzero(good)[0]
    frames, q, changes = joint.from_zero(frames, q, changes, q[first])
    return frames, _going_on(joint, q, good), changes


def _going_on(joint: JointType, q: FloatArray, good: BoolArray) -> FloatArray:
    """(T, s) states without jumps of a full turn between good frames; others by the turn nearest to the one before."""
    smooth = joint.continuous(q[good])
    before = np.maximum(np.cumsum(good) - 1, 0)
    found = joint.nearest_turn(q, smooth[before])
    found[good] = smooth
    return found


def with_sign(
    frames: JointFrames, q: FloatArray, changes: FloatArray, good: BoolArray
) -> tuple[JointFrames, FloatArray, FloatArray]:
    """The joint with its axis turned so that states (T, 1) that begin at zero grow over the motion.

    A motion that ends where it began is told by its larger excursion.
    """
    told = q[good, 0]
    low, high, net = told.min(), told.max(), told[-1]
    if abs(net) < NET_MOTION * (high - low):
        net = high + low
    if net >= 0:
        return frames, q, changes
    return JointFrames(frames.T_parent_axis @ FLIP, FLIP @ frames.T_axis_child, frames.form), -q, -changes


def _nearest_point(joint: JointType, frames: JointFrames, q: FloatArray) -> JointFrames:
    """Origin of the axis frame moved along the axis to the child's mean position at states (T, s)."""
    height = float((joint.axis_motion(q, frames.form) @ frames.T_axis_child)[:, 2, 3].mean())
    along = se3.translation(np.array([0.0, 0.0, height]))
    return JointFrames(frames.T_parent_axis @ along, se3.inverse(along) @ frames.T_axis_child, frames.form)


def _rms(residual: FloatArray, good: BoolArray) -> float | None:
    """Root mean square of the norms of residuals (T, 3) over good frames; None without any."""
    return float(np.linalg.norm(residual[good]) / np.sqrt(good.sum())) if good.any() else None
