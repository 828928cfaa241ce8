"""What is taken for likely of a joint before any data: where it may be, how large it is, how far it moves.

Lengths are told in metres of the lab (`PairTracks.lab_m`): in a scene of more than a metre they are as much longer.
"""

from __future__ import annotations

import numpy as np

from station.fit.pairwise import JointFit
from station.kinematics.joints import JointType
from station.logs import FloatArray

# Deviations of where an axis or a part is [m], and of how it is turned [rad]: that of an angle of which nothing is
# known. So is the distance of a part from the axis about which it turns: a hinge's arm is a metre or so at most.
ARM_M, TURN_STD_RAD = 1.0, float(np.pi / np.sqrt(3))
PITCH_M_PER_RAD = 0.05
# Logarithm of the largest over the least size that a motion may have, in units of the noise.
RANGE = float(np.log(1e3))


def arm_m(fit: JointFit) -> FloatArray:
    """(P,) distance of the child from the joint's axis or centre; 0 for a type that has neither."""
    p = fit.model.frames.T_axis_child[:, :3, 3]
    if not fit.joint.has_point:
        return np.zeros(len(p))
    return np.linalg.norm(p[:, :2] if fit.joint.has_axis else p, axis=-1)


def number_deviations(joint: JointType, lab_m: float) -> FloatArray:
    """(n,) of a joint's numbers, in the order of `stepped_frames`."""
    freedoms = np.array([*joint.axis_freedoms, *joint.child_freedoms])
    of_frames = np.where(freedoms < 3, ARM_M * lab_m, TURN_STD_RAD)
    return np.concatenate([of_frames, np.full(joint.form_freedoms, PITCH_M_PER_RAD * lab_m)])


def mean_deviation(joint: JointType, lab_m: float) -> float:
    """Of the states' mean [m or rad]."""
    return ARM_M * lab_m if joint.unit == "m" else TURN_STD_RAD


def size_price(fit: JointFit, lab_m: float) -> FloatArray:
    """(P,) -2 log density of the arm and the pitch, against none."""
    arm, pitch = arm_m(fit) / (ARM_M * lab_m), fit.model.frames.form / (PITCH_M_PER_RAD * lab_m)
    return arm**2 + np.sum(pitch**2, axis=-1)
