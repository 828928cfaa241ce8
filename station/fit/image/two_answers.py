"""Frames that corners tell in two ways: a marker seen nearly from its front, turned over, looks nearly the same.

Where a joint hangs on such a marker alone its state has two minima of nearly the same likelihood. From each sighting
the other one is sought: the part turned over about the line of sight to the marker, its body's state told by that, then
those of the bodies beyond, and all states of the frame searched from there. A likelier answer is taken. One that is as
likely but for chance is decided by the frames around, where these surely tell one of them; if not, it is told.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.image.carried_states import carried, carrying_error, from_to
from station.fit.image.corner_data import CornerData
from station.fit.image.frame_search import chi2_of, costs_of, sought, state_equations
from station.fit.image.likely_states import Told, is_odd, stacked, state_told, with_bodies_told, with_joint
from station.fit.skeleton import Skeleton, TreeModel
from station.fit.tree_motion import tree_poses
from station.kinematics import se3
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# In -2 log likelihood: two answers that differ by less are both possible; odds of 1000. What the frames around tell
# weighs twice as much.
UNDECIDED = 2 * float(np.log(1000.0))
AROUND = 2 * UNDECIDED
# In the same units, less is no other answer.
BETTER = 1.0
# A marker that is dearer by more when it is turned over is not going to be as good, nor one that by itself keeps so
# much more than what is undecided.
TURNED_OVER, MARGIN = 200.0, 10.0
ALONE_ROUNDS, ALONE_DAMPING = 3, 1e-3
# Steps of the searches, and what a frame may be dearer after them.
SEARCHES = ((3, 60.0), (8, UNDECIDED))
# Answers that are nearer to each other, in deviations of the states, are one, or as good as that.
APART = 4.0
# Share of the way to the other answer up to which the frames around tell the one; and up to how many missing frames.
NEAR, GAPS = 0.25, (1, 4, 12)


@dataclass(frozen=True, eq=False)
class Others:
    """Other answers than the states of a model.

    Attributes:
        frame: (n,).
        model: the other states there.
        dearer: (n,) -2 log likelihood ratio against it, with what the frames around tell.
        apart: (n, s) from the model's states, as `moved` takes them.
        deviations: (n, s) the same in standard deviations.
    """

    frame: IntArray
    model: TreeModel
    dearer: FloatArray
    apart: FloatArray
    deviations: FloatArray

    def take(self, rows: IntArray) -> Others:
        """Some of them."""
        return Others(
            self.frame[rows], self.model.take(rows), self.dearer[rows], self.apart[rows], self.deviations[rows]
        )

    @property
    def probability(self) -> FloatArray:
        """(n,) against the model's alone."""
        return 1 / (1 + np.exp(np.maximum(self.dearer, 0.0) / 2))

    def likelier(self) -> Others:
        """Those that are likelier than the model, one a frame."""
        order = np.argsort(self.dearer, kind="stable")
        order = order[self.dearer[order] < -BETTER]
        _, first = np.unique(self.frame[order], return_index=True)
        return self.take(order[first])

    def undecided(self) -> Others:
        """Those that are nearly as likely as the model."""
        return self.take(np.flatnonzero(self.dearer < UNDECIDED))


def other_answers(skeleton: Skeleton, model: TreeModel, data: CornerData) -> Others:
    """What else the corners may tell, with the parameters as they are."""
    rows, starts = _turned_over(skeleton, model, data)
    some, cost = data.take(rows), costs_of(skeleton, model.take(rows), data.take(rows))
    for rounds, limit in SEARCHES:
        starts = sought(skeleton, starts, some, rounds, tails=False)
        kept = np.flatnonzero(costs_of(skeleton, starts, some) < cost + limit)
        rows, starts, some, cost = rows[kept], starts.take(kept), some.take(kept), cost[kept]
    here = model.take(rows)
    if not rows.size:
        nothing = np.zeros((0, skeleton.states))
        return Others(rows, here, np.zeros(0), nothing, nothing)
    apart = from_to(skeleton, here, starts)
    weights = some.weights(chi2_of(skeleton, here, some))
    deviations = np.abs(apart) / state_equations(skeleton, here, some, weights).std
    found = Others(rows, starts, costs_of(skeleton, starts, some) - cost, apart, deviations)
    found = found.take(np.flatnonzero(deviations.max(axis=-1, initial=0.0) > APART))
    return replace(found, dearer=found.dearer + _told_around(skeleton, model, data, found))


def _told_around(skeleton: Skeleton, model: TreeModel, data: CornerData, others: Others) -> FloatArray:
    """(n,) what the frames around add to -2 log likelihood ratios: something if they tell one answer, and tell surely.

    How surely is known from frames without other answers: by how far these are told wrongly by those around them.
    """
    good = ~is_odd(data, chi2_of(skeleton, model, data))
    good[others.frame] = False
    t_s, known = data.views.t_s, np.flatnonzero(good)
    if not len(others.frame) or len(known) < 2:
        return np.zeros(len(others.frame))
    between, *_ = carried(skeleton, model, t_s, others.frame, good)
    at = np.clip(np.searchsorted(known, others.frame), 1, len(known) - 1)
    missing = known[at] - known[at - 1] - 1
    inside = (others.frame > known[0]) & (others.frame < known[-1])
    weight = (others.deviations / np.where(others.apart != 0, others.apart, 1.0)) ** 2
    length = np.sum(weight * others.apart**2, axis=-1)
    share = np.sum(weight * others.apart * from_to(skeleton, model.take(others.frame), between), axis=-1) / length
    off = np.full(others.apart.shape, np.inf)
    for frames in GAPS[::-1]:
        off[missing <= frames] = carrying_error(skeleton, model, t_s, known, frames)
    sure = inside & (np.sum(weight * np.abs(others.apart) * off, axis=-1) < NEAR * length)
    return AROUND * sure * ((share < NEAR).astype(np.float64) - (share > 1 - NEAR))


def _turned_over(skeleton: Skeleton, model: TreeModel, data: CornerData) -> tuple[IntArray, TreeModel]:
    """Frames (n,) and states in them, with one marker each turned over that looks nearly the same then."""
    poses, told = tree_poses(skeleton, model).parts, Told.of(data)
    rows, starts = [np.zeros(0, dtype=np.intp)], [model.take(np.zeros(0, dtype=np.intp))]
    for m, k in enumerate(data.part.tolist()):  # markers are few
        if not (skeleton.body_of[k] or skeleton.root_moves):
            continue
        alone = data.of_marker(m)
        chi2 = alone.chi2(poses[:, k, None], model.shared)[:, 0]
        turned = turned_over(poses[:, k], data.points_m[m])
        dearer = alone.chi2(turned[:, None], model.shared)[:, 0] - chi2
        some = np.flatnonzero(alone.seen[:, 0] & (dearer < TURNED_OVER))
        if not some.size:
            continue
        turned, as_best = _settled(alone.take(some), turned[some], model.shared)
        alike = as_best - chi2[some] < UNDECIDED + MARGIN
        some, turned = some[alike], turned[alike]
        rows.append(some)
        starts.append(_with_part(skeleton, model.take(some), data.take(some), told.take(some), k, turned))
    return np.concatenate(rows), stacked(starts)


def turned_over(T_ref_part: FloatArray, points_m: FloatArray) -> FloatArray:
    """Poses (T, 4, 4) of a part with a marker, corners (4, 3) on it, that is tilted the other way at the same place.

    From far off it looks the same: along the axis that it is tilted about nothing changes, across it all is as short.
    """
    R = T_ref_part[:, :3, :3]
    centre = R @ points_m.mean(axis=0) + T_ref_part[:, :3, 3]
    normal = R @ np.cross(points_m[1] - points_m[0], points_m[3] - points_m[0])
    sight = centre * np.sign(np.sum(normal * centre, axis=-1, keepdims=True))
    across = np.cross(normal, sight)
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    tilt = np.arctan2(length, np.sum(normal * sight, axis=-1, keepdims=True))
    turn = se3.exp_so3(2 * tilt * across / np.where(length > 0, length, 1.0))
    place = centre + (turn @ (T_ref_part[:, :3, 3] - centre)[..., None])[..., 0]
    return se3.pose(turn @ R, place)


def _settled(data: CornerData, T_ref_part: FloatArray, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where a lone marker's corners fit best near poses (n, 4, 4), and squared residuals (n,) there."""
    best, chi2 = T_ref_part, data.chi2(T_ref_part[:, None], shared)[:, 0]
    tried = best
    for _ in range(ALONE_ROUNDS):
        centre = tried[:, :3, 3]
        whitened, by = data.derivatives(tried[:, None], shared, centre)
        J, J_t = by[:, 0, :, :6], np.swapaxes(by[:, 0, :, :6], -1, -2)
        normal = J_t @ J
        lifted = ALONE_DAMPING * np.diagonal(normal, axis1=-2, axis2=-1) + np.finfo(np.float64).tiny
        step = -np.linalg.solve(normal + lifted[..., None] * np.eye(6), J_t @ whitened[:, 0, :, None])[..., 0]
        tried = se3.pose(se3.exp_so3(step[:, 3:]) @ tried[:, :3, :3], centre + step[:, :3])
        tried_chi2 = data.chi2(tried[:, None], shared)[:, 0]
        better = tried_chi2 < chi2
        best, chi2 = np.where(better[:, None, None], tried, best), np.where(better, tried_chi2, chi2)
    return best, chi2


def _with_part(
    skeleton: Skeleton, model: TreeModel, data: CornerData, told: Told, part: int, T_ref_part: FloatArray
) -> TreeModel:
    """States that put a part where it then is (T, 4, 4), and the bodies that hang from its own where they fit."""
    body = skeleton.body_of[part]
    if not body:
        root = T_ref_part @ se3.inverse(model.mounts[part])
        return with_bodies_told(skeleton, replace(model, T_ref_root=root), data, told, ())
    j = skeleton.paths[body][-1]
    columns, kind = skeleton.state_columns(j), skeleton.joints[j].type
    q = kind.nearest_turn(state_told(skeleton, model, j, part, T_ref_part), model.q[:, columns])
    beyond = [i for i, joint in enumerate(skeleton.joints) if j in skeleton.paths[joint.far][:-1]]
    return with_bodies_told(skeleton, with_joint(model, columns, q), data, told, (), beyond)
