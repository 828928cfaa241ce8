"""A fit put together from the readings of its trees: joints named and scored, states in columns, what is to be said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from station.fit.ambiguity import Doubt
from station.fit.asking import Asking
from station.fit.bodies import Group
from station.fit.image.doubts import remarks_on_corners
from station.fit.image.image_fit import joined
from station.fit.image.views import Views
from station.fit.options import FitOptions
from station.fit.reading import JointReading
from station.fit.remarks import remarks
from station.fit.result import Fit
from station.fit.rigid_pairs import RigidPairs
from station.fit.selection import CRITERIA, Scores
from station.fit.structure import outward
from station.fit.telling import method_told
from station.fit.tree_reading import REFERENCE, Structure, TreeReading, named_member, read_tree
from station.kinematics.joints import JOINT_TYPES
from station.kinematics.tree import Joint, KinematicTree
from station.logs import JointLog, PoseLog


def assembled(
    log: PoseLog,
    options: FitOptions,
    structure: Structure,
    roots: list[int],
    doubts: Sequence[Doubt],
    include: bool,
    views: Views | None,
) -> Asking[tuple[Fit, RigidPairs]]:
    """The fit, and parts that its corners say to be rigid to each other though it has them move.

    Args:
        log: that was learned from.
        options: how.
        structure: bodies and edges.
        roots: body of each tree, the log's own first.
        doubts: where other trees are as likely.
        include: whether the reference is a part.
        views: of the corners; None without any.
    """
    joints_only = replace(options, joint_types=options.joints)
    trees: list[TreeReading] = []
    rigid = RigidPairs()
    for root in roots:
        trees.append((yield from read_tree(structure, root, joints_only, views, include=include)))
        rigid = rigid.plus(trees[-1].rigid, len(structure.parts.names))
    return _fit(log, options, structure, roots, doubts, include, trees), rigid


def _fit(
    log: PoseLog,
    options: FitOptions,
    structure: Structure,
    roots: list[int],
    doubts: Sequence[Doubt],
    include: bool,
    trees_read: Sequence[TreeReading],
) -> Fit:
    groups, names = structure.groups, structure.parts.names
    body_name = [names[group.members[named_member(group, include=include)]] for group in groups]
    read = [joint for tree in trees_read for joint in tree.joints]
    joints = [
        _scored(r.joint(body_name[a], body_name[b], scores, i), scores, i, options) for a, b, r, scores, i in read
    ]
    readings = [reading for _, _, reading, _, _ in read]
    bodies = [[root, *(b for _, b, _ in outward(root, structure.edges))] for root in roots]
    trees = tuple(tuple(body_name[k] for k in tree) for tree in bodies)
    by_edge = {tuple(sorted(item[:2])): joint for item, joint in zip(read, joints, strict=True)}
    told = [(by_edge[d.edge], body_name[d.other[0]], body_name[d.other[1]], d.odds) for d in doubts]
    images = [tree.image for tree in trees_read if tree.image is not None]
    image = joined(images) if images else None
    tree = KinematicTree(
        root=body_name[roots[0]],
        parts=names if include else names[1:],
        rigid_groups=_rigid_groups(groups, names, include=include),
        trees=trees,
        joints=tuple(joints),
        method=method_told(options, image, root_static=REFERENCE in groups[roots[0]].members),
        warnings=(*remarks(log, joints, readings, trees, told), *(() if image is None else remarks_on_corners(image))),
        mounts={names[part]: T for tree in trees_read for part, T in tree.mounts.items()},
    )
    return Fit(tree, _states(log, joints, readings), image)


def _rigid_groups(groups: Sequence[Group], names: Sequence[str], *, include: bool) -> tuple[tuple[str, ...], ...]:
    """Parts of the bodies that have several."""
    kept = [[i for i in group.members if include or i != REFERENCE] for group in groups]
    return tuple(tuple(names[i] for i in members) for members in kept if len(members) > 1)


def _scored(joint: Joint, scores: Scores, pair: int, options: FitOptions) -> Joint:
    """The joint with the scores of all criteria, and the probabilities of all candidates, by poses.

    Where corners say of the likeliest type that this one, a case of it, does as well, such types are none of them.
    """
    probability = scores.probabilities(pair, free=options.free)
    richer = {name for name, kind in JOINT_TYPES.items() if joint.type in kind.simpler}
    if scores.best_type(pair) in richer:
        left = {name: p for name, p in probability.items() if name not in richer}
        total = sum(left.values())
        probability = {name: p / total if total > 0 else float(name == joint.type) for name, p in left.items()}
    return replace(
        joint,
        scores={"criterion": scores.criterion, **scores.told(pair, scores.criterion, free=options.free)},
        criteria={name: scores.told(pair, name, free=options.free) for name in CRITERIA},
        probability=probability,
    )


def _states(log: PoseLog, joints: Sequence[Joint], readings: Sequence[JointReading]) -> JointLog:
    """Columns of all states of all joints."""
    nothing = np.zeros((len(log.t_s), 0))
    q = np.concatenate([nothing, *(r.q for r in readings)], axis=-1)
    std = np.concatenate([nothing, *(r.std for r in readings)], axis=-1)
    columns = [(name, joint.unit) for joint in joints for name in joint.columns]
    return JointLog(log.t_s, tuple(name for name, _ in columns), q, tuple(unit for _, unit in columns), std)
