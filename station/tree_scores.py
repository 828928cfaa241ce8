"""How near a found kinematic tree comes to the true one: bodies, joints between them, types, axes, points, states.

A tree is undirected here: another root, joints told from their child, bodies named by another of their trackers are no
mistakes. A rigid joint makes one body of two, as a rigid group does. What a found joint says is brought to the frame of
the true joint's parent part before it is compared; a found body may be named by a part that is mounted elsewhere on the
true one, and where it is mounted a log of true poses tells.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.joints.base import wrapped
from station.kinematics.tree import Joint, KinematicTree, connected_bodies
from station.logs import FloatArray, JointLog, PoseLog

Body = frozenset[str]
Edge = frozenset[Body]


@dataclass(frozen=True)
class JointScore:
    """What was found of one true joint.

    Attributes:
        joint: the true joint's name.
        true_type: its type.
        found_type: type of the one found joint between parts of its two bodies, however many bodies were made of them;
            "rigid" where its parent and child were found to be one body; None where there is no such joint, or several.
        found_joint: that joint's name; None where there is none.
        axis_error_rad: angle between the two axes, whichever way they point, 0 to pi / 2; None for another type, a type
            without an axis, or a parent part whose mount is unknown. So are the next two.
        point_error_m: from the found joint's point to the true axis; between the centres of spherical joints.
        state_rms: root mean square of found less true state [rad or m], the mean difference taken off, since a joint's
            zero is arbitrary; None where states weren't given too, and for joints with several.
    """

    joint: str
    true_type: str
    found_type: str | None
    found_joint: str | None = None
    axis_error_rad: float | None = None
    point_error_m: float | None = None
    state_rms: float | None = None


@dataclass(frozen=True)
class TreeScores:
    """A found tree against the true one.

    Attributes:
        groups_correct: the parts are told apart into the true bodies.
        structure_correct: so they are, and joints connect the bodies that true ones connect, and no others.
        types_correct: so they do, and have the true ones' types.
        joints: of the true tree's movable joints, in its order.
        mistakes: a plain sentence for each mistake of the first kind that there is; none if all is right.
    """

    groups_correct: bool
    structure_correct: bool
    types_correct: bool
    joints: tuple[JointScore, ...]
    mistakes: tuple[str, ...]


def score_tree(
    found: KinematicTree,
    true: KinematicTree,
    truth: PoseLog | None = None,
    *,
    found_states: JointLog | None = None,
    true_states: JointLog | None = None,
) -> TreeScores:
    """Hold a found tree against the true one.

    Args:
        found: a fit's.
        true: of the same parts.
        truth: true poses of the parts, without noise: they tell where trackers are mounted. Without them a joint's axis
            and point are compared only if its parent (or child, where found and true joint are told from opposite
            ends) is the same part in both.
        found_states: of `found`, NaN where a state wasn't found.
        true_states: of `true`, at the same times.

    Raises:
        InvalidData: for trees of different parts; states of different numbers of times.
    """
    _check(found, true, found_states, true_states)
    match = _matched(found, true, truth)
    groups = set(match.found_body.values()) == set(match.true_body.values())
    structure = groups and set(match.links) == set(match.edges)
    states = None if found_states is None or true_states is None else (found_states, true_states)
    scores = tuple(_joint_score(match, edge, joint, states) for edge, joint in match.edges.items())
    types = structure and all(score.found_type == score.true_type for score in scores)
    return TreeScores(groups, structure, types, scores, tuple(_mistakes(match, scores)))


@dataclass(frozen=True, eq=False)
class _Match:
    """Both trees side by side.

    Attributes:
        found_body: body of each part in the found tree.
        true_body: in the true one.
        links: found joints by the true bodies that their two bodies are pieces of; none of bodies mixed from several.
        edges: true joints by the true bodies that they connect.
        truth: true poses, which tell mounts.
    """

    found_body: dict[str, Body]
    true_body: dict[str, Body]
    links: dict[Edge, list[Joint]]
    edges: dict[Edge, Joint]
    truth: PoseLog | None


def _matched(found: KinematicTree, true: KinematicTree, truth: PoseLog | None) -> _Match:
    found_body, true_body = _bodies(found), _bodies(true)
    links: dict[Edge, list[Joint]] = {}
    for joint in found.movable:
        pieces = [{true_body[part] for part in found_body[end]} for end in (joint.parent, joint.child)]
        if all(len(of) == 1 for of in pieces):
            links.setdefault(frozenset(pieces[0] | pieces[1]), []).append(joint)
    edges = {frozenset((true_body[joint.parent], true_body[joint.child])): joint for joint in true.movable}
    return _Match(found_body, true_body, links, edges, truth)


def _check(
    found: KinematicTree, true: KinematicTree, found_states: JointLog | None, true_states: JointLog | None
) -> None:
    odd, lost = sorted(set(found.parts) - set(true.parts)), sorted(set(true.parts) - set(found.parts))
    if odd or lost:
        raise InvalidData(
            f"the found tree and the true one differ in parts: {_listed(odd)} only in the found one, {_listed(lost)} "
            "only in the true one; want trees of the same parts"
        )
    if found_states is not None and true_states is not None and len(found_states.t_s) != len(true_states.t_s):
        have = f"{len(found_states.t_s)} found, {len(true_states.t_s)} true"
        raise InvalidData(f"states at different numbers of times: {have}; want them at the same times")


def _bodies(tree: KinematicTree) -> dict[str, Body]:
    """The body of each part: what rigid groups and rigid joints hold together."""
    group_of = {name: group for group in tree.rigid_groups for name in group}
    rigid = [joint for joint in tree.joints if not joint.kind.states]
    found: dict[str, Body] = {}
    for names in connected_bodies(tree.bodies, rigid):
        body = frozenset(part for name in names for part in group_of.get(name, (name,)))
        found.update((part, body) for part in body)
    return found


def _joint_score(match: _Match, edge: Edge, true: Joint, states: tuple[JointLog, JointLog] | None) -> JointScore:
    if match.found_body[true.parent] == match.found_body[true.child]:
        return JointScore(true.name, true.type, "rigid")
    links = match.links.get(edge, [])
    if len(links) != 1:
        return JointScore(true.name, true.type, None)
    found = links[0]
    told = _told_as(match, found, true) if found.type == true.type else None
    if told is None:
        return JointScore(true.name, true.type, found.type, found.name)
    axis, point = told
    rms = None
    if states is not None and true.kind.states == 1:
        q, q_true = states[0].state(found.name), states[1].state(true.name)
        rms = _state_rms(_sign(axis, true.axis_parent) * q, q_true, true.unit)
    return JointScore(
        true.name,
        true.type,
        found.type,
        found.name,
        _angle(axis, true.axis_parent),
        _distance(point, true.point_parent_m, true.axis_parent),
        rms,
    )


def _told_as(match: _Match, found: Joint, true: Joint) -> tuple[FloatArray | None, FloatArray | None] | None:
    """A found joint's axis and point (3,) each, in the frame of the true joint's parent part; None if unknown."""
    near = found if found.parent in match.true_body[true.parent] else found.reversed()
    T_true_found = _mount(match.truth, true.parent, near.parent)
    if T_true_found is None:
        return None
    R, p = T_true_found[:3, :3], T_true_found[:3, 3]
    axis = None if near.axis_parent is None else R @ near.axis_parent
    return axis, None if near.point_parent_m is None else R @ near.point_parent_m + p


def _mount(truth: PoseLog | None, part: str, other: str) -> FloatArray | None:
    """(4, 4) pose of another part of the same body in a part; None where nothing tells it."""
    if part == other:
        return np.eye(4)
    if truth is None or not {part, other} <= set(truth.parts):
        return None
    a, b = truth.parts.index(part), truth.parts.index(other)
    both = np.flatnonzero(truth.seen[:, a] & truth.seen[:, b])
    if not both.size:
        return None
    return se3.inverse(truth.T_ref_part[both[0], a]) @ truth.T_ref_part[both[0], b]


def _angle(axis: FloatArray | None, other: FloatArray | None) -> float | None:
    """Between two unit vectors (3,) as lines."""
    if axis is None or other is None:
        return None
    return float(np.arctan2(np.linalg.norm(np.cross(axis, other)), abs(axis @ other)))


def _sign(axis: FloatArray | None, other: FloatArray | None) -> int:
    """-1 for axes (3,) that point against each other, else 1."""
    return -1 if axis is not None and other is not None and axis @ other < 0 else 1


def _distance(point: FloatArray | None, true_point: FloatArray | None, true_axis: FloatArray | None) -> float | None:
    """From a point (3,) to the true axis, or to the true centre of a joint without one."""
    if point is None or true_point is None:
        return None
    offset = point - true_point
    return float(np.linalg.norm(offset if true_axis is None else np.cross(true_axis, offset)))


def _state_rms(found: FloatArray, true: FloatArray, unit: str) -> float | None:
    """Of found less true states (T,), without the mean; of angles the whole turns are left out."""
    known = np.isfinite(found - true)
    difference = np.asarray(found[known] - true[known], dtype=np.float64)
    if not difference.size:
        return None
    if unit == "rad":
        middle = math.atan2(np.sin(difference).mean(), np.cos(difference).mean())
        difference = wrapped(difference - middle)
    return float(np.std(difference))


def _mistakes(match: _Match, scores: Iterable[JointScore]) -> Iterable[str]:
    """Sentences on the first kind of mistake: bodies, else joints between them, else types."""
    found, true = set(match.found_body.values()), set(match.true_body.values())
    if found != true:
        odd = ", ".join(sorted("+".join(sorted(body)) for body in found - true))
        yield f"{len(found)} bodies instead of {len(true)}: {odd}"
        return
    odd, lost = set(match.links) - set(match.edges), set(match.edges) - set(match.links)
    if odd or lost:
        yield f"joints {_edges_text(odd)} instead of {_edges_text(lost)}"
        return
    for score in scores:
        if score.found_type != score.true_type:
            yield f"{score.joint} is {score.true_type}, called {score.found_type}"


def _edges_text(edges: Collection[Edge]) -> str:
    ends = (("+".join(sorted(body)) for body in edge) for edge in edges)
    return _listed(sorted(" to ".join(sorted(pair)) for pair in ends))


def _listed(names: Collection[str]) -> str:
    return ", ".join(names) or "none"
