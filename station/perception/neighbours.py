"""Where a part is turned to in a frame, told by the frames around it of which one can be sure.

Many frames together know a nearly frontal part's tilt well when each of them alone does not.
"""

from __future__ import annotations

import numpy as np

from station.kinematics import se3
from station.logs import FloatArray
from station.perception.choice import Choice, choose_by_prediction
from station.perception.hypotheses import PoseHypotheses
from station.perception.observations import IntArray

# Rotations are taken to change evenly over this long to both sides.
REACH_S = 0.4
# A prediction needs so many frames, and at most this much of a gap to the nearest of them.
LEAST_FRAMES = 6
NEAREST_S = 0.15
AXES = 3


def choose_by_neighbours(hypotheses: PoseHypotheses, choice: Choice) -> Choice:
    """Ambiguous choices made anew, each by a straight line through the rotations of the sure frames around it."""
    shape = choice.chosen.shape
    R, spread = np.full((*shape, AXES, AXES), np.nan), np.full((*shape, AXES, AXES), np.nan)
    sure = hypotheses.seen & ~choice.ambiguous
    for frame, part in np.argwhere(choice.ambiguous):  # few of all
        around = _around(hypotheses.t_s, sure[:, part], frame)
        if len(around):
            R[frame, part], spread[frame, part] = _line(hypotheses, choice, part, around, float(hypotheses.t_s[frame]))
    return choose_by_prediction(hypotheses, choice, R, spread)


def _around(t_s: FloatArray, sure: np.ndarray, frame: int) -> IntArray:
    """The sure frames around a frame; none if they are too few or too far."""
    first, last = np.searchsorted(t_s, (t_s[frame] - REACH_S, t_s[frame] + REACH_S))
    rows = first + np.flatnonzero(sure[first:last])
    far = len(rows) < LEAST_FRAMES or np.abs(t_s[rows] - t_s[frame]).min() > NEAREST_S
    return rows[:0] if far else rows


def _line(
    hypotheses: PoseHypotheses, choice: Choice, part: int, rows: IntArray, at_s: float
) -> tuple[FloatArray, FloatArray]:
    """Rotation (3, 3) at a time, and its covariance (3, 3), by weighted least squares on the rotations at `rows`.

    Residuals beyond what the frames' covariances allow, as of a part that doesn't turn evenly, widen it.
    """
    chosen = choice.chosen[rows, part]
    R = hypotheses.T_cam_part[rows, part, chosen, :3, :3]
    information = np.linalg.inv(hypotheses.covariance[rows, part, chosen, 3:, 3:])
    t_s = hypotheses.t_s[rows] - at_s
    middle = R[np.argmin(np.abs(t_s))]
    turn = se3.log_so3(middle.T @ R)
    A = np.concatenate([np.broadcast_to(np.eye(AXES), R.shape), t_s[:, None, None] * np.eye(AXES)], axis=-1)
    weighted = np.swapaxes(A, -1, -2) @ information
    covariance = np.linalg.inv((weighted @ A).sum(axis=0))
    line = covariance @ (weighted @ turn[..., None]).sum(axis=0)[:, 0]
    residual = turn - A @ line
    excess = np.einsum("ni,nij,nj->", residual, information, residual) / (AXES * (len(rows) - 2))
    return middle @ se3.exp_so3(line[:AXES]), covariance[:AXES, :AXES] * max(float(excess), 1.0)
