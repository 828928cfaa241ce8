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
        covariance: (6, 6) of a right perturbation of T_parent_axis.
        q: (T,) continuous states.
        std: (T,) their deviations.
        seen: (T,) both bodies were seen.
        good: (T,) seen, and no outlier.
        residual: (T, 6) [m, rad] of the relative pose.
        oriented: (T,) good, and the orientation was measured.
    """

    type: JointType
    frames: JointFrames
    covariance: FloatArray
    q: FloatArray
    std: FloatArray
    seen: BoolArray
    good: BoolArray
    residual: FloatArray
    oriented: BoolArray

    def settled(self) -> JointReading:
        """With a definite sign, zero and point; states NaN where not good."""
        frames, q, covariance = self.frames, self.q, self.covariance
        if self.type.states and self.good.any():
            frames, q, flipped = with_sign_and_zero(self.type, frames, q, self.good)
            if flipped:
                turn = np.kron(np.eye(2), FLIP[:3, :3])
                covariance = turn @ covariance @ turn.T
        along = frames.T_axis_child[2, 3]
        if self.type.has_axis and self.type.has_point:
            frames = _nearest_point(frames)
            moved = se3.adjoint(se3.translation(np.array([0.0, 0.0, -along])))
            covariance = moved @ covariance @ moved.T
        q, std = (np.where(self.good, values, np.nan) for values in (q, self.std))
        return replace(self, frames=frames, q=q, std=std, covariance=covariance)

    def joint(self, parent: str, child: str, scores: Scores, pair: int) -> Joint:
        """The joint as a tree holds it; read a settled one."""
        geometry = self.type.geometry(self.frames)
        known = self.q[self.good] if self.type.states else self.q[:0]
        variance = np.diagonal(self.covariance)
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
            rms_translation_m=_rms(self.residual[:, :3], self.good),
            frames=int(self.seen.sum()),
            outliers=int((self.seen & ~self.good).sum()),
            axis_std_rad=None if geometry.axis_parent is None else float(np.sqrt(variance[3] + variance[4])),
            point_std_m=None if geometry.point_parent_m is None else float(np.sqrt(variance[0] + variance[1])),
        )


def with_sign_and_zero(
    joint: JointType, frames: JointFrames, q: FloatArray, good: BoolArray
) -> tuple[JointFrames, FloatArray, bool]:
    """The joint with states (T,) that are zero in the first good frame and grow over the motion; whether its axis was
    turned.

    A motion that ends where it began is told by its larger excursion.
    """
    first, last = np.flatnonzero(good)[[0, -1]]
    low, high = q[good].min(), q[good].max()
    net = q[last] - q[first]
    if abs(net) < NET_MOTION * (high - low):
        net = (high - q[first]) - (q[first] - low)
    T_axis_child = joint.axis_motion(q[first, None], frames.form) @ frames.T_axis_child
    q = q - q[first]
    if net >= 0:
        return JointFrames(frames.T_parent_axis, T_axis_child, frames.form), q, False
    return JointFrames(frames.T_parent_axis @ FLIP, FLIP @ T_axis_child, frames.form), -q, True


def _nearest_point(frames: JointFrames) -> JointFrames:
    """Origin of the axis frame moved along the axis to the child."""
    along = se3.translation(np.array([0.0, 0.0, frames.T_axis_child[2, 3]]))
    return JointFrames(frames.T_parent_axis @ along, se3.inverse(along) @ frames.T_axis_child, frames.form)


def _rms(residual: FloatArray, good: BoolArray) -> float | None:
    """Root mean square of the norms of residuals (T, 3) over good frames; None without any."""
    return float(np.linalg.norm(residual[good]) / np.sqrt(good.sum())) if good.any() else None
