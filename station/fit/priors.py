"""What is taken for likely of a joint before any data: where it may be, how large it is, how far it moves.

Lengths are told in metres of the lab (`PairTracks.lab_m`): in a scene of more than a metre they are as much longer.
"""

from __future__ import annotations

import numpy as np

from station.fit.pairwise import JointFit, parameter_covariance
from station.kinematics.joints import JointType
from station.logs import FloatArray

# Deviations of where an axis or a part is [m], and of how it is turned [rad]: that of an angle of which nothing is
# known. So is the distance of a part from the axis about which it turns: a hinge's arm is a metre or so at most.
ARM_M, TURN_STD_RAD = 1.0, float(np.pi / np.sqrt(3))
PITCH_M_PER_RAD = 0.05
# Of the second and third of a ball's turns, about directions across the largest.
LESSER_TURN_RAD = float(np.radians(20.0))
# Logarithm of the largest over the least size that a motion may have, in units of the noise.
RANGE = float(np.log(1e3))
# Arms, as shares of what the data say, among which the likeliest is sought; and one that is none [m].
SHORTER, SHORT_M = np.geomspace(0.02, 1.0, 40), 1e-9


def arm_m(fit: JointFit) -> FloatArray:
    """(P,) distance of the child from the joint's axis or centre; 0 for a type that has neither."""
    p = fit.model.frames.T_axis_child[:, :3, 3]
    if not fit.joint.has_point:
        return np.zeros(len(p))
    return np.linalg.norm(p[:, :2] if fit.joint.has_axis else p, axis=-1)


def number_deviations(joint: JointType, lab_m: FloatArray) -> FloatArray:
    """(P, n) of a joint's numbers, in the order of `stepped_frames`."""
    freedoms = np.array([*joint.axis_freedoms, *joint.child_freedoms])
    of_frames = np.where(freedoms < 3, ARM_M * lab_m[:, None], TURN_STD_RAD)
    of_form = np.repeat(PITCH_M_PER_RAD * lab_m[:, None], joint.form_freedoms, axis=-1)
    return np.concatenate([of_frames, of_form], axis=-1)


def mean_deviation(joint: JointType, lab_m: FloatArray) -> FloatArray:
    """(P,) of the states' mean [m or rad]."""
    return ARM_M * lab_m if joint.unit == "m" else np.full(len(lab_m), TURN_STD_RAD)


def size_price(fit: JointFit, lab_m: FloatArray, time: FloatArray) -> FloatArray:
    """(P,) -2 log density of the arm and the pitch, against none, for frames that repeat errors `time` (P,) times."""
    pitch = fit.model.frames.form / (PITCH_M_PER_RAD * lab_m[:, None])
    return _arm_price(fit, ARM_M * lab_m, time) + np.sum(pitch**2, axis=-1)


def _arm_price(fit: JointFit, usual_m: FloatArray, time: FloatArray) -> FloatArray:
    """(P,) at the likeliest arm by data and prior together: of an arc that is nearly straight the data tell the
    curvature alone, and that not well, so that an arm of 5 m may as well be one of 2 m.
    """
    arm, joint = np.maximum(arm_m(fit), SHORT_M), fit.joint
    if not joint.has_point:
        return np.zeros(len(arm))
    first = len(joint.axis_freedoms)
    columns = [first + i for i, freedom in enumerate(joint.child_freedoms) if freedom < (2 if joint.has_axis else 3)]
    along = fit.model.frames.T_axis_child[:, : len(columns), 3] / arm[:, None]
    covariance = parameter_covariance(fit.information)[:, columns][:, :, columns]
    variance = np.maximum(time * np.einsum("pi,pij,pj->p", along, covariance, along), SHORT_M**2)[:, None]
    usual_m, arm = usual_m[:, None], arm[:, None]
    told = usual_m**2 / variance
    better_told = np.log1p(told / SHORTER**4) - np.log1p(told)  # the same curvature tells a shorter arm better
    off = (1 / SHORTER - 1) ** 2 * arm**2 / variance
    return np.min(off + better_told + (SHORTER * arm / usual_m) ** 2, axis=-1)
