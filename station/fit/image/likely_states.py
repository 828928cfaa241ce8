"""States of the frames in which corners don't fit, where least squares would stay at a wrong answer.

A marker that was seen alone may be told by either of its two poses; a body between others may not have been seen at
all, and what is beyond it looks like outliers; one frame in the midst of a motion may have nothing to start from. Here,
with the parameters as they are, states are sought from several starts, and the likeliest are taken:

- as they are;
- those of the frames around, between them and at their pace from either side;
- those that the markers tell: the root where one of them puts it through the joints between, by either of its two
  poses; then each body where one of its own markers puts it, or where it was, from the root outward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from station.fit.image.carried_states import carried
from station.fit.image.corner_data import CornerData
from station.fit.image.frame_search import chi2_of, costs_of, sought, tails_of
from station.fit.image.views import COORDINATES, SOLUTIONS
from station.fit.skeleton import Skeleton, TreeModel
from station.fit.tree_motion import tree_poses
from station.fit.tree_problem import Problem
from station.kinematics import se3
from station.kinematics.joints import JointFrames
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# A squared residual that chance exceeds so seldom is looked into.
CHANCE = 1e-4
ODD = float(chdtri(COORDINATES, CHANCE))
# Steps of the search from far off, and of the last ones, from the likeliest.
FAR_ROUNDS, NEAR_ROUNDS = 10, 5
# Where the root moves: so many of the places in which markers put it are looked into.
ROOTS = 3
# In -2 log likelihood of a frame: less is no other answer.
BETTER = 1.0


@dataclass(frozen=True, eq=False)
class Told:
    """Poses of parts as each marker alone tells them.

    Attributes:
        T_ref_part: (T, M, 2, 4, 4) by both solutions, the likelier first; the identity where there is none.
        known: (T, M, 2) whether there is one.
    """

    T_ref_part: FloatArray
    known: BoolArray

    @staticmethod
    def of(data: CornerData) -> Told:
        """Those of all frames of some views; `data` is whole."""
        views = data.views
        found = np.full((*data.shape, SOLUTIONS, 4, 4), np.nan)
        found[views.frame, views.marker] = views.T_ref_part
        known: BoolArray = np.all(np.isfinite(found), axis=(-2, -1))
        return Told(np.where(np.expand_dims(known, (-2, -1)), found, np.eye(4)), known)

    def take(self, rows: IntArray) -> Told:
        """Some of the frames."""
        return Told(self.T_ref_part[rows], self.known[rows])


def is_odd(data: CornerData, chi2: FloatArray) -> BoolArray:
    """(T,) whether some sighting is farther off than chance allows, by squared residuals (T, M)."""
    return np.any(data.seen & (chi2 > ODD), axis=-1)


def with_likely_states(
    skeleton: Skeleton, model: TreeModel, data: CornerData, told: Told, odd: BoolArray
) -> tuple[TreeModel, BoolArray]:
    """The model with likelier states in odd frames (T,), and where (T,) they are others than before."""
    rows, changed = np.flatnonzero(odd), np.zeros(len(odd), dtype=bool)
    if not rows.size:
        return model, changed
    some, before = data.take(rows), model.take(rows)
    around = carried(skeleton, model, data.views.t_s, rows, ~odd)
    likeliest = _likeliest(
        skeleton, some, [before, *around, *_by_markers(skeleton, before, some, told.take(rows), around)]
    )
    better = costs_of(skeleton, likeliest, some) < costs_of(skeleton, before, some) - BETTER
    changed[rows[better]] = True
    return model.with_states(rows[better], likeliest.take(np.flatnonzero(better))), changed


def mended(problem: Problem[CornerData], before: TreeModel, after: TreeModel, rows: IntArray) -> TreeModel:
    """The model after a step of all numbers, in some frames with states sought from both those after and before it."""
    some = problem.measured.take(rows)
    starts = [after.take(rows), replace(after, T_ref_root=before.T_ref_root[rows], q=before.q[rows])]
    every = some.take(np.tile(np.arange(len(rows)), 2))
    found = sought(problem.skeleton, stacked(starts), every, NEAR_ROUNDS, tails=False)
    best = costs_of(problem.skeleton, found, every).reshape(2, -1).argmin(axis=0)
    return after.with_states(rows, found.take(best * len(rows) + np.arange(len(rows))))


def stacked(models: Sequence[TreeModel]) -> TreeModel:
    """The frames of models that share their parameters, one after another."""
    return replace(
        models[0],
        T_ref_root=np.concatenate([model.T_ref_root for model in models]),
        q=np.concatenate([model.q for model in models]),
    )


def _likeliest(skeleton: Skeleton, data: CornerData, starts: Sequence[TreeModel]) -> TreeModel:
    """Where the best of the starts leads, frame by frame."""
    frames = len(data.seen)
    every = data.take(np.tile(np.arange(frames), len(starts)))
    found = sought(skeleton, stacked(starts), every, FAR_ROUNDS, tails=True)
    best = costs_of(skeleton, found, every).reshape(len(starts), frames).argmin(axis=0)
    return sought(skeleton, found.take(best * frames + np.arange(frames)), data, NEAR_ROUNDS, tails=False)


def _by_markers(
    skeleton: Skeleton, model: TreeModel, data: CornerData, told: Told, around: Sequence[TreeModel]
) -> list[TreeModel]:
    """States that the markers tell, one for each place of the root that is looked into."""
    if not skeleton.root_moves:
        return [with_bodies_told(skeleton, model, data, told, around)]
    places = [model.T_ref_root, *(other.T_ref_root for other in around), *_roots(skeleton, model, data, told)]
    costs = np.stack([_tails(skeleton, replace(model, T_ref_root=T), data) for T in places])
    order, frames = np.argsort(costs, axis=0, kind="stable"), np.arange(len(model.q))
    roots = np.stack(places)
    return [
        with_bodies_told(skeleton, replace(model, T_ref_root=roots[order[i], frames]), data, told, around)
        for i in range(min(ROOTS, len(places)))
    ]


def _tails(skeleton: Skeleton, model: TreeModel, data: CornerData) -> FloatArray:
    return tails_of(data, chi2_of(skeleton, model, data)).sum(axis=-1)


def _roots(skeleton: Skeleton, model: TreeModel, data: CornerData, told: Told) -> list[FloatArray]:
    """(T, 4, 4) poses of the root by each marker's two poses through the joints between; the model's where none."""
    T_part_root = se3.inverse(tree_poses(skeleton, model).parts) @ model.T_ref_root[:, None]
    return [
        np.where(told.known[:, m, i, None, None], told.T_ref_part[:, m, i] @ T_part_root[:, k], model.T_ref_root)
        for m, k in enumerate(data.part)
        for i in range(SOLUTIONS)
    ]


def with_bodies_told(
    skeleton: Skeleton,
    model: TreeModel,
    data: CornerData,
    told: Told,
    around: Sequence[TreeModel],
    joints: Sequence[int] | None = None,
) -> TreeModel:
    """The model with each body where the likeliest of its own markers puts it, or where it is, or the frames around
    have it; from the root outward, those that hang from some joints only, or all.
    """
    for j in range(len(skeleton.joints)) if joints is None else joints:  # a body needs those before it
        columns, kind = skeleton.state_columns(j), skeleton.joints[j].type
        members = markers_on(skeleton, data, skeleton.joints[j].far)
        before = model.q[:, columns]
        proposals = [before, *(other.q[:, columns] for other in around), *_states_told(skeleton, model, data, told, j)]
        best, chosen = np.full(len(before), np.inf), before
        for q in proposals:
            q = kind.nearest_turn(q, before)
            cost = tails_of(data, chi2_of(skeleton, with_joint(model, columns, q), data))[:, members].sum(axis=-1)
            chosen, best = np.where((cost < best)[:, None], q, chosen), np.minimum(cost, best)
        model = with_joint(model, columns, chosen)
    return model


def markers_on(skeleton: Skeleton, data: CornerData, body: int) -> list[int]:
    """Markers on a body."""
    return [m for m, k in enumerate(data.part.tolist()) if skeleton.body_of[k] == body]


def with_joint(model: TreeModel, columns: slice, q: FloatArray) -> TreeModel:
    """The model with other states (T, s) of one joint."""
    return replace(model, q=np.concatenate([model.q[:, : columns.start], q, model.q[:, columns.stop :]], axis=-1))


def _states_told(skeleton: Skeleton, model: TreeModel, data: CornerData, told: Told, j: int) -> list[FloatArray]:
    """(T, s) states of a joint by both poses of each marker on its far body; the model's where there is none."""
    q = model.q[:, skeleton.state_columns(j)]
    return [
        np.where(
            told.known[:, m, i, None], state_told(skeleton, model, j, int(data.part[m]), told.T_ref_part[:, m, i]), q
        )
        for m in markers_on(skeleton, data, skeleton.joints[j].far)
        for i in range(SOLUTIONS)
    ]


def state_told(skeleton: Skeleton, model: TreeModel, j: int, part: int, T_ref_part: FloatArray) -> FloatArray:
    """(T, s) states of a joint that put a part of its far body nearest to poses (T, 4, 4)."""
    joint, frames, sign = skeleton.joints[j], model.frames[j], 1.0
    if joint.turned:  # M(q)^-1 is M(-q)
        near, far = se3.inverse(frames.T_axis_child), se3.inverse(frames.T_parent_axis)
        frames, sign = JointFrames(near, far, frames.form), -1.0
    T_axis_ref = se3.inverse(tree_poses(skeleton, model).bodies[joint.near] @ frames.T_parent_axis)
    zero = frames.T_axis_child @ model.mounts[part]
    return sign * joint.type.axis_state(T_axis_ref @ T_ref_part, zero, frames.form)
