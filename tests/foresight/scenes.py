"""Small scenes for the tests of forecasts: one slide or hinge that carries a marker, before a webcam."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.intrinsics import CameraModel
from station.foresight.scene import Block, Link, Mount, Scene
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray
from station.motion import JointLimits, Motion, MotionStep, Plan, plan_motion

CAMERA = CameraModel(
    size_px=(640, 480),
    matrix=np.array([[600.0, 0, 321.5], [0, 602.0, 238.0], [0, 0, 1]]),
    distortion=np.array([0.06, -0.12, 0.0008, -0.0005, 0.01]),
)
SIZE_M, CELLS = 0.05, 6
# A marker that faces the camera, upright: x right, y up, z to the camera.
FACING = np.diag([1.0, -1.0, -1.0, 1.0])
DISTANCE_M = 0.6


def at(x: float, y: float, z: float) -> FloatArray:
    return se3.translation(np.array([x, y, z]))


def mount(marker_id: int, body: str, T_body_marker: FloatArray) -> Mount:
    return Mount(marker_id, f"{body}_part", body, T_body_marker, SIZE_M, SIZE_M / CELLS, CELLS)


def block(body: str, T_body_block: FloatArray, size_m: Sequence[float]) -> Block:
    return Block(body, T_body_block, np.array(size_m), (80, 80, 80))


def scene(
    kind: str = "revolute",
    mounts: Sequence[Mount] | None = None,
    blocks: Sequence[Block] = (),
    exposure_s: float = 0.008,
) -> Scene:
    """A base 0.6 m before the camera, its frame turned as the camera's, and an arm on a joint along or about y."""
    joint = Joint(
        name="joint",
        type=kind,
        parent="base",
        child="arm",
        axis_parent=np.array([0.0, 1.0, 0.0]),
        point_parent_m=np.zeros(3) if kind == "revolute" else None,
        T_parent_child_zero=np.eye(4),
    )
    tree = KinematicTree(root="base", parts=("base", "arm"), rigid_groups=(), trees=(("base", "arm"),), joints=(joint,))
    default = (mount(0, "base", at(-0.15, 0, 0) @ FACING), mount(1, "arm", at(0.05, 0, -0.05) @ FACING))
    return Scene(
        tree=tree,
        links={"joint": Link()},
        resting={},
        T_camera_root={"base": at(0, 0, DISTANCE_M)},
        camera=CAMERA,
        exposure_s=exposure_s,
        mounts=tuple(default if mounts is None else mounts),
        blocks=tuple(blocks),
    )


def plan(*targets: float, speed: float = 1.0, mode: str = "step", unit: str = "rad", hold_s: float = 0.2) -> Plan:
    """A motion of "joint" through targets, rad or m."""
    steps = tuple(MotionStep({"joint": target}, speed, hold_s) for target in targets)
    limits = JointLimits("joint", -10.0, 10.0, 20.0, unit=unit)  # pyright: ignore[reportArgumentType]
    return plan_motion(Motion("made", steps, mode), [limits])  # pyright: ignore[reportArgumentType]
