"""Joint types, one file each, and their registry."""

from __future__ import annotations

from station.kinematics.joints.base import JointFrames, JointGeometry, JointType
from station.kinematics.joints.prismatic import Prismatic
from station.kinematics.joints.revolute import Revolute
from station.kinematics.joints.rigid import Rigid

JOINT_TYPES: dict[str, JointType] = {joint.name: joint for joint in (Rigid(), Prismatic(), Revolute())}

__all__ = ["JOINT_TYPES", "JointFrames", "JointGeometry", "JointType"]
