"""Joint types, one file each, and their registry."""

from __future__ import annotations

from station.kinematics.joints.base import JointFrames, JointGeometry, JointType
from station.kinematics.joints.prismatic import Prismatic
from station.kinematics.joints.revolute import Revolute
from station.kinematics.joints.rigid import Rigid
from station.kinematics.joints.screw import Screw
from station.kinematics.joints.spherical import Spherical

JOINT_TYPES: dict[str, JointType] = {
    joint.name: joint for joint in (Rigid(), Prismatic(), Revolute(), Screw(), Spherical())
}

__all__ = ["JOINT_TYPES", "JointFrames", "JointGeometry", "JointType"]
