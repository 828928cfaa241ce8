"""From a log of poses to a kinematic tree and the states of its joints.

0. parts that repeat another one are left out (copies);
1. every pair of parts: fit every joint type to their relative poses, score them (pairwise, selection);
2. the minimum spanning tree over the scores (structure);
3. parts that are rigid to each other become one body, told by all of them (subclusters, bodies); those that are rigid
   to the log's reference frame stand still, and share one pose for all frames;
4. again from 1 with bodies for parts, until no rigid joint is left;
5. where several bodies move along one line, take the likeliest of their trees (ambiguity);
6. orient the joints from the root outward, fit all of a tree at once (whole_tree), read off axes and states
(tree_reading), and say what is uncertain (remarks).

Many logs are learned side by side (asking): their pairs are fitted together, which for small objects is several times
as fast, and makes no difference to what is found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData
from station.fit.ambiguity import settled
from station.fit.asking import COMPARING, SURVEYING, Asking, answered_all
from station.fit.assembly import assembled
from station.fit.bodies import Group, bodies_of_log, scaled_by_part, with_reference
from station.fit.comparison import MIN_FRAMES, PairTable, compare_pairs
from station.fit.copies import without_copies
from station.fit.fusion import fused_bodies, refined_mounts
from station.fit.image.simpler import explains_as_well
from station.fit.image.views import Views
from station.fit.known_joints import KnownJoints
from station.fit.options import FitOptions, check_options
from station.fit.parallel import products_in_one_thread
from station.fit.result import Fit
from station.fit.rigid_pairs import RigidPairs
from station.fit.second_looks import looked_again
from station.fit.standing import with_standing
from station.fit.structure import components, shallowest
from station.fit.subclusters import merged, singles
from station.fit.tree_reading import REFERENCE, Structure
from station.logs import FloatArray, PoseLog

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]


def learn(log: PoseLog, options: FitOptions | None = None, views: Views | None = None) -> Fit:
    """Learn the kinematic tree of the parts of a log.

    Args:
        log: poses of the parts.
        options: how to learn.
        views: the corners that the poses are from; the tree is then refined on them (image).

    Raises:
        InvalidData: for options that don't exist, for a log in which no two parts were seen together often enough, for
            views of other parts or times.
    """
    (found,) = learn_all([log], options, [views])
    if isinstance(found, InvalidData):
        raise found
    return found


def learn_all(
    logs: Sequence[PoseLog], options: FitOptions | None = None, views: Sequence[Views | None] | None = None
) -> list[Fit | InvalidData]:
    """Learn the kinematic trees of many logs; for each what `learn` would return or raise.

    Logs of small objects with as many frames are learned in much less time than one after another.
    """
    options = FitOptions() if options is None else options
    if options.method == "paper":
        return [_by_paper(log, options) for log in logs]
    with products_in_one_thread():
        return answered_all(
            [_learning(log, options, seen) for log, seen in zip(logs, views or [None] * len(logs), strict=True)]
        )


def _by_paper(log: PoseLog, options: FitOptions) -> Fit | InvalidData:
    from station.fit.paper import learn_paper  # only who asks for it waits for it

    try:
        _check(log, options)
        return learn_paper(log, options)
    except InvalidData as error:
        return error


def _learning(log: PoseLog, options: FitOptions, views: Views | None) -> Asking[Fit]:
    _check(log, options)
    _check_views(log, options, views)
    include, copies = _included(log, options), without_copies(log)
    options = replace(options, root=copies.original(options.root))
    seen = views if options.refine in ("image", None) else None
    fit = yield from _learned(copies.log, options, include, seen)
    if seen is not None:
        fit = yield from looked_again(fit, copies.log, seen, lambda other: _learned(other, options, include, seen))
    return copies.added(fit, log.parts)


def _learned(log: PoseLog, options: FitOptions, include: bool, views: Views | None) -> Asking[Fit]:
    joints_only = replace(options, joint_types=options.joints)
    known, before = RigidPairs(), None
    while True:
        found = yield from _find_structure(log, joints_only, include, known)
        structure, doubts = yield from settled(found, options.joints)
        roots = _roots(structure, log, options, include)
        fit, rigid = yield from assembled(log, options, structure, roots, doubts, include, views)
        if before is not None and not explains_as_well(fit.image, before.image):
            return before
        more = known.plus(rigid, len(structure.parts.names))
        if len(more) == len(known):
            return fit
        known, before = more, fit  # what corners say to be rigid, the poses were too coarse to tell


def _included(log: PoseLog, options: FitOptions) -> bool:
    """Whether the reference is a part."""
    return options.include_reference or len(log.parts) == 1


def _check(log: PoseLog, options: FitOptions) -> None:
    include = _included(log, options)
    if not log.parts:
        raise InvalidData("the log has no parts; want at least one")
    if include and log.reference in log.parts:
        raise InvalidData(f"a part has the reference frame's name '{log.reference}'; rename one")
    check_options(options, (*log.parts, log.reference) if include else log.parts)
    if include and options.root_static is False:
        raise InvalidData(f"'{log.reference}' is a part of the tree and stands still; leave open whether the root does")


def _check_views(log: PoseLog, options: FitOptions, views: Views | None) -> None:
    if views is None:
        if options.refine == "image":
            raise InvalidData("poses alone can't be refined on the image: no corners; refine on the poses")
        return
    if not np.array_equal(views.t_s, log.t_s):
        raise InvalidData(f"views of {len(views.t_s)} frames at other times than the log's {len(log.t_s)}")
    missing = [part for part in log.parts if part not in views.parts]
    if missing:
        raise InvalidData(f"the views have no part '{missing[0]}'; have {', '.join(views.parts)}")


def _find_structure(log: PoseLog, options: FitOptions, include: bool, told: RigidPairs) -> Asking[Structure]:
    parts = with_reference(bodies_of_log(log), log.reference)
    groups, bodies, edges = singles(len(parts.names)), parts, np.zeros((0, 2), dtype=np.intp)
    known, fitted = KnownJoints.none(edges, options.joint_types), None
    for level in count():  # bodies of one round are the parts of the next; each round but the first merges some
        alone = _only_rigid(groups, include)
        pairs = _all_pairs(len(bodies.names), without=alone if options.root_static is False else None)
        table = yield from compare_pairs(
            bodies,
            pairs,
            options.joint_types,
            options.criterion,
            effort=COMPARING if level else SURVEYING,
            only_rigid=alone,
            known=known,
        )
        if level == 0 and not table.enough.any():
            raise InvalidData(_too_few(log))
        chosen = table.edges
        rigid = _rigid_edges(table, chosen)
        edges, known, fitted = table.pairs[chosen], table.joints, table.fitted_edges
        if level > 0 and not rigid.size:
            break
        if level == 0:
            parts = scaled_by_part(parts, _variances(table, chosen, len(parts.names)))
        fixed, T_a_b = table.pairs[rigid], table.T_a_b[rigid]
        if level == 0:
            more = told.plus(RigidPairs(fixed, T_a_b), len(parts.names))
            fixed, T_a_b = more.pairs, more.T_a_b
        if level == 0 and options.root_static and not include:
            fixed, T_a_b = with_standing(parts, fixed, T_a_b, options.root)
        before, groups = groups, merged(groups, fixed, T_a_b)
        groups, known = refined_mounts(parts, groups), known.renumbered(_numbers_of(before, groups))
        bodies = fused_bodies(parts, groups)
    return Structure(parts, groups, bodies, edges, known, fitted)


def _numbers_of(groups: Sequence[Group], merged: Sequence[Group]) -> IntArray:
    """(K,) which merged group has the frame of each group, that of its first member; -1 if none has."""
    number = {group.members[0]: k for k, group in enumerate(merged)}
    return np.array([number.get(group.members[0], -1) for group in groups], dtype=np.intp)


def _too_few(log: PoseLog) -> str:
    seen = np.array(log.seen).sum(axis=0)
    counts = ", ".join(f"{part} {n}" for part, n in zip(log.parts, seen, strict=True))
    return f"no two parts were seen together in {MIN_FRAMES} frames or more; seen: {counts} of {len(log.t_s)} frames"


def _all_pairs(count: int, without: BoolArray | None) -> IntArray:
    """(P, 2) pairs of bodies, but for some (K,) that are in none."""
    pairs = np.stack(np.triu_indices(count, k=1), axis=-1).astype(np.intp)
    return pairs if without is None else pairs[~without[pairs].any(axis=-1)]


def _only_rigid(groups: Sequence[Group], include: bool) -> BoolArray:
    """(K,) bodies that no movable joint may join: unless it is a part, the reference only holds what stands still."""
    return np.array([not include and group.members == (REFERENCE,) for group in groups], dtype=bool)


def _rigid_edges(table: PairTable, chosen: IntArray) -> IntArray:
    """The forest's rigid edges; first those that are so for sure, since fused bodies tell more about the others."""
    rigid = chosen[table.rigid[chosen]]
    surely = rigid[table.scores.surely_rigid[rigid]]
    return surely if surely.size else rigid


def _variances(table: PairTable, edges: IntArray, parts: int) -> FloatArray:
    """(K, S) noise variances of each part: the mean over its edges of the forest, or over all edges if it has none."""
    if not edges.size:
        edges = np.flatnonzero(table.enough)
    scales, pairs = table.scales[edges], table.pairs[edges]
    found = np.tile(scales.mean(axis=0), (parts, 1))
    for part in set(pairs.ravel().tolist()):
        found[part] = scales[(pairs == part).any(axis=-1)].mean(axis=0)
    return found


def _roots(structure: Structure, log: PoseLog, options: FitOptions, include: bool) -> list[int]:
    """Root body of each tree, the log's own root first; unless included, a reference that holds nothing is no tree."""
    groups, edges = structure.groups, structure.edges
    label = components(len(groups), edges)
    trees = [[k for k in range(len(groups)) if label[k] == low] for low in sorted(set(label))]
    alone = [k for k, group in enumerate(groups) if group.members == (REFERENCE,)]
    trees = [tree for tree in trees if include or tree != alone]
    wanted = None if options.root is None else structure.parts.names.index(options.root)
    roots = [_root_of(tree, structure, wanted) for tree in trees]
    size = [(_holds(groups[root], wanted), len(tree)) for root, tree in zip(roots, trees, strict=True)]
    first = max(range(len(roots)), key=lambda i: (*size[i], -i))
    return [roots[first], *(root for i, root in enumerate(roots) if i != first)]


def _holds(group: Group, part: int | None) -> bool:
    return part is not None and part in group.members


def _root_of(tree: list[int], structure: Structure, wanted: int | None) -> int:
    """The wanted body, else the one that stands still, else the one that makes the tree shallowest."""
    for part in (wanted, REFERENCE):
        for k in tree:
            if _holds(structure.groups[k], part):
                return k
    return shallowest(tree, structure.edges)
