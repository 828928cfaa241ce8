"""Names of the links and joints that a URDF has beyond a tree's own, and its angles."""

from __future__ import annotations

import numpy as np

from station.kinematics import se3
from station.logs import FloatArray

AXIS_SUFFIX = "-axis"  # the link on a joint's axis
ZERO_SUFFIX = "-zero"  # the fixed joint from there to the child
MOUNT_SUFFIX = "-mount"  # the fixed joint of a further tracker
FLOATING_SUFFIX = "-floating"  # the joint of a tree that nothing connects
ADVANCE_SUFFIX = "-advance"  # the joint along a screw's axis
# A ball's joints, the first at the parent, and their axes.
BALL_AXES = {"yaw": (0.0, 0.0, 1.0), "pitch": (0.0, 1.0, 0.0), "roll": (1.0, 0.0, 0.0)}
# URDF demands a range of a prismatic joint; beyond this one there is none.
UNBOUNDED_M = 1000.0


def advanced_link(joint: str) -> str:
    """The link that a screw's advance moves."""
    return f"{joint}-advanced"


def turned_link(joint: str, angle: str) -> str:
    """The link that one of a ball's joints turns."""
    return f"{joint}-after-{angle}"


def roll_pitch_yaw(R: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angles (...,) with `R = Rz(yaw) Ry(pitch) Rx(roll)` (..., 3, 3); exact to rounding also where pitch is a quarter
    turn.

    The first column tells the yaw; R turned back by it tells the others, so that the roll makes up for a yaw that
    rounding determines.
    """
    yaw = np.arctan2(R[..., 1, 0], R[..., 0, 0])
    c, s = np.cos(yaw)[..., None], np.sin(yaw)[..., None]
    forward, left = c * R[..., 0, :] + s * R[..., 1, :], c * R[..., 1, :] - s * R[..., 0, :]  # rows of Rz(-yaw) @ R
    return np.arctan2(-left[..., 2], left[..., 1]), np.arctan2(-R[..., 2, 0], forward[..., 0]), yaw


def rotation(roll: float, pitch: float, yaw: float) -> FloatArray:
    """(3, 3) of URDF's angles."""
    x, y, z = se3.exp_so3(np.diag([roll, pitch, yaw]))
    return z @ y @ x
