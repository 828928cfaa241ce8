"""Made objects as the whole-tree fit has them: a skeleton, the true model, and what was measured with known noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from station.fit.bodies import bodies_of_log, scaled_by_part
from station.fit.skeleton import Skeleton, TreeJoint, TreeModel
from station.fit.tree_residuals import Measured, measured_parts
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames, JointGeometry
from station.logs import PoseLog
from tests.benchmarks.made_joints import MadeJoint, MadeObject


def true_frames(joint: MadeJoint) -> JointFrames:
    kind = JOINT_TYPES[joint.type]
    axis, point = (joint.axis if kind.has_axis else None), (joint.point_m if kind.has_point else None)
    pitch = joint.pitch_m_per_rad if kind.form_freedoms else None
    return kind.frames(JointGeometry(axis, point, joint.T_parent_child_zero, pitch))


def true_tree(made: MadeObject) -> tuple[Skeleton, TreeModel]:
    """Each body's first tracker gives it its frame; a root that does not move has the reference's."""
    moves = made.root == "moving"
    firsts = {body: made.body_of.index(body) for body in sorted(set(made.body_of))}
    T_body_frame = {body: made.T_body_part[k] for body, k in firsts.items()}
    if not moves:
        T_body_frame[0] = se3.inverse(made.T_ref_root[0])
    joints, frames = [], []
    for joint in made.joints:
        f = true_frames(joint)
        at_parent = se3.inverse(T_body_frame[joint.parent]) @ f.T_parent_axis
        frames.append(JointFrames(at_parent, f.T_axis_child @ T_body_frame[joint.child], f.form))
        joints.append(TreeJoint(joint.parent, joint.child, JOINT_TYPES[joint.type]))
    free = tuple(k != firsts[body] or (body == 0 and not moves) for k, body in enumerate(made.body_of))
    mounts = [se3.inverse(T_body_frame[body]) @ made.T_body_part[k] for k, body in enumerate(made.body_of)]
    root = made.T_ref_root @ T_body_frame[0] if moves else se3.identity(len(made.T_ref_root))
    model = TreeModel(root, tuple(frames), np.concatenate(made.q, axis=-1), np.stack(mounts))
    return Skeleton(tuple(joints), made.body_of, free, root_moves=moves), model


def measured_of(log: PoseLog, std_m: float, std_rad: float) -> Measured:
    bodies = scaled_by_part(bodies_of_log(log), np.tile([std_m**2, std_rad**2], (len(log.parts), 1)))
    return measured_parts(bodies, range(len(log.parts)))


def turned_tree(skeleton: Skeleton, model: TreeModel) -> tuple[Skeleton, TreeModel]:
    """The same with every joint named from its far end."""
    joints, frames, q = [], [], model.q.copy()
    for j, (joint, f) in enumerate(zip(skeleton.joints, model.frames, strict=True)):
        columns = skeleton.state_columns(j)
        back, q[:, columns], _ = joint.type.reversed(f, q[:, columns], np.zeros((len(q), joint.type.states, 0)))
        frames.append(back)
        joints.append(TreeJoint(joint.child, joint.parent, joint.type, turned=True))
    return replace(skeleton, joints=tuple(joints)), replace(model, frames=tuple(frames), q=q)
