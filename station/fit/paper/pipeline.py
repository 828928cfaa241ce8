"""The paper's pipeline: from a log of poses to a kinematic tree and the states of its joints (Figure 3).

1. frames in which some part is unseen are discarded (IV-D);
2. the poses are smoothed by a low-pass filter (IV-D);
3. for each pair of parts the relative poses, and Algorithm 1: rigid, prismatic and revolute joints matched by the
   metric (16), compared by AIC (24);
4. the minimum spanning tree over the AIC (III-A);
5. rigid subclusters are eliminated (III-A, Table I).

Where the paper can't be followed to the letter, the docstring at the place says so with the equation's number;
docs/paper_and_station.md shows what each such place costs. Uncertainties aren't part of the method: covariances of the
log are not used, and nothing gets a standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData
from station.fit.excitation import SMALL_TRAVEL
from station.fit.options import FitOptions
from station.fit.paper.elimination import Edge, Skeleton
from station.fit.paper.matching import Match, match_joints
from station.fit.paper.reading import ReadJoint, oriented, read_joint, still_body
from station.fit.paper.steps import PaperSteps
from station.fit.result import Fit
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.logs import JointLog, PoseLog

BoolArray = NDArray[np.bool_]

# Algorithm 1 starts from three different time points.
MIN_FRAMES = 3


def learn_paper(log: PoseLog, options: FitOptions | None = None, steps: PaperSteps | None = None) -> Fit:
    """Learn the kinematic tree of the parts of a log by the paper's method.

    All parts end up in one tree: the method knows no parts without a joint. The root is the body of `options.root`,
    else the log's reference frame if it is a part, else the body whose poses spread least by the cost; the paper names
    none. Frames that are discarded have no states.

    Raises:
        InvalidData: for options that the method doesn't have, and for a log with too few frames in which every part was
            seen with its orientation.
    """
    options = FitOptions() if options is None else options
    steps = PaperSteps() if steps is None else steps
    include = options.include_reference or len(log.parts) == 1
    _check(log, options, steps, include=include)
    complete = _complete(log)
    parts = steps.smoothing(_kept(log, complete, include=include))
    matches, edges = _joined(parts, options.joint_types, steps)
    skeleton = steps.elimination(len(parts.parts), edges)
    root = _root(parts, skeleton, options, steps, include=include)
    skeleton = oriented(skeleton, root)
    names = [parts.parts[group.members[0]] for group in skeleton.groups]
    read = [read_joint(edge, matches[edge.match], names, steps.criterion.name) for edge in skeleton.edges]
    tree = KinematicTree(
        root=names[root],
        parts=parts.parts,
        rigid_groups=tuple(
            tuple(parts.parts[k] for k in group.members) for group in skeleton.groups if len(group.members) > 1
        ),
        trees=((names[root], *(names[edge.child] for edge in skeleton.edges)),),
        joints=tuple(each.joint for each in read),
        method={
            "name": "paper",
            "criterion": steps.criterion.name,
            "joint_types": list(options.joint_types),
            "seed": steps.seed,
        },
        warnings=_warnings(complete, [each.joint for each in read]),
        mounts={
            parts.parts[k]: T
            for group in skeleton.groups
            for k, T in zip(group.members[1:], group.mounts[1:], strict=True)
        },
    )
    return Fit(tree, _states(log, complete, read))


def _check(log: PoseLog, options: FitOptions, steps: PaperSteps, *, include: bool) -> None:
    unknown = [name for name in options.joint_types if name not in steps.starts]
    if unknown or not options.joint_types:
        have = ", ".join(options.joint_types) or "none"
        raise InvalidData(f"joint types {have}; method 'paper' has {', '.join(steps.starts)}: choose one or more")
    if options.criterion not in (FitOptions().criterion, steps.criterion.name):
        raise InvalidData(f"criterion '{options.criterion}'; method 'paper' has {steps.criterion.name} only")
    if not log.parts:
        raise InvalidData("the log has no parts; want at least one")
    if include and log.reference in log.parts:
        raise InvalidData(f"a part has the reference frame's name '{log.reference}'; rename one")
    names = (log.reference, *log.parts) if include else log.parts
    if options.root is not None and options.root not in names:
        raise InvalidData(f"no part '{options.root}' for a root; have {', '.join(names)}")


def _complete(log: PoseLog) -> BoolArray:
    """(T,) frames in which every part was seen, with its orientation; the others are discarded (IV-D)."""
    known = log.seen
    if log.covariance is not None:
        known = known & ~np.isinf(log.covariance).any(axis=(-2, -1))
    complete: BoolArray = np.all(known, axis=-1)
    if complete.sum() < MIN_FRAMES:
        counts = ", ".join(f"{part} {n}" for part, n in zip(log.parts, known.sum(axis=0), strict=True))
        raise InvalidData(
            f"{complete.sum()} of {len(complete)} frames have every part with its orientation; method 'paper' uses no "
            f"others and wants {MIN_FRAMES}; seen: {counts}; leave parts out, or use method 'station'"
        )
    return complete


def _kept(log: PoseLog, complete: BoolArray, *, include: bool) -> PoseLog:
    """The complete frames, with the reference frame as the first part if it is one."""
    poses, names = log.T_ref_part[complete], log.parts
    if include:
        poses, names = np.concatenate([se3.identity(len(poses), 1), poses], axis=1), (log.reference, *names)
    return PoseLog(log.t_s[complete], log.reference, names, poses)


def _joined(parts: PoseLog, joint_types: Sequence[str], steps: PaperSteps) -> tuple[list[Match], list[Edge]]:
    """What Algorithm 1 finds for every pair, and the joints between the pairs that the structure chooses."""
    rng = np.random.default_rng(steps.seed)
    pairs = np.stack(np.triu_indices(len(parts.parts), k=1), axis=-1).astype(np.intp)
    T_part_ref, T_ref_part = (np.swapaxes(T, 0, 1) for T in (se3.inverse(parts.T_ref_part), parts.T_ref_part))
    matches = match_joints(T_part_ref[pairs[:, 0]] @ T_ref_part[pairs[:, 1]], joint_types, steps, rng)
    scores = np.array([match.scores[match.best] for match in matches])
    chosen: list[int] = steps.structure(len(parts.parts), pairs, scores).tolist()
    return matches, [Edge(int(pairs[i, 0]), int(pairs[i, 1]), matches[i].joint, i) for i in chosen]


def _root(parts: PoseLog, skeleton: Skeleton, options: FitOptions, steps: PaperSteps, *, include: bool) -> int:
    wanted = parts.reference if options.root is None and include else options.root
    if wanted is None:
        return still_body(parts, skeleton, steps.cost)
    part = parts.parts.index(wanted)
    return next(k for k, group in enumerate(skeleton.groups) if part in group.members)


def _states(log: PoseLog, complete: BoolArray, read: Sequence[ReadJoint]) -> JointLog:
    q = np.full((len(log.t_s), len(read)), np.nan)
    if read:
        q[complete] = np.stack([each.q for each in read], axis=-1)
    return JointLog(log.t_s, tuple(each.joint.name for each in read), q, tuple(each.joint.unit for each in read))


def _warnings(complete: BoolArray, joints: Sequence[Joint]) -> tuple[str, ...]:
    found: list[str] = []
    if not complete.all():
        discarded = len(complete) - int(complete.sum())
        found.append(f"{discarded} of {len(complete)} frames were discarded: some part was unseen in them")
    for joint in joints:
        travel = (joint.state_max or 0.0) - (joint.state_min or 0.0)
        if travel < SMALL_TRAVEL[joint.unit]:
            moved = f"{np.degrees(travel):.1f} deg" if joint.unit == "rad" else f"{travel * 1e3:.1f} mm"
            found.append(f"{joint.name} moved only {moved}: its axis may not be identifiable")
    if not joints:
        found.append("no part moved against another: the tree has no joints")
    return tuple(found)
