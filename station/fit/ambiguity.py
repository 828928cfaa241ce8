"""Joints whose place in the tree is no more than likely: several bodies that slide along, or turn about, one line.

Two parallel drawers of a cabinet slide along each other as well as along the cabinet; so do doors on coaxial hinges.
Every tree of such bodies explains all poses alike. What differs are the states that it needs: those of the true joints
are independent motions, those of others are sums of them. So each pair's motion is told by its steps, STEPS over the
record, which have a Cauchy density of the pair's own size: large motions cost more than small ones, and two joints that
move at once more than one. Steps that go on alike count for fewer. The cheapest tree is taken; a body that stands still
is likelier to carry the others. What the alternatives would cost more is told as odds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from station.fit.asking import COMPARING, SCREENING, Asking, Effort, Explained, ask
from station.fit.bodies import Bodies, oriented_pairs
from station.fit.comparison import MIN_FRAMES, question_of
from station.fit.noise import INLIER_ABOVE, time_of_correlation
from station.fit.pairwise import JointFit
from station.fit.state_spread import continuous_states
from station.fit.structure import components, outward, spanning_forest
from station.fit.tree_reading import REFERENCE, Structure
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray

IntArray = NDArray[np.intp]

STEPS = 40
# Odds for a body that stands still, as against one that moves, to be the one that others hang from.
STILL_ODDS = 3.0
# Odds below which an alternative is worth telling.
SURE_ODDS = 10.0
# Angle [rad] between two motions below which a pair is looked at; a turn of one radian counts as TURN_M.
ALIKE_RAD, TURN_M = float(np.radians(15.0)), 0.3
# Ratio of variances of residuals: a pair that fits so much worse than the tree's joints is none.
MISFIT = 2.0
MIN_STATES = 3
CAUCHY_ROUNDS = 30


@dataclass(frozen=True)
class Doubt:
    """An edge of the tree that may as well be another: bodies of both, and the odds for the first."""

    edge: tuple[int, int]
    other: tuple[int, int]
    odds: float


@dataclass(frozen=True, eq=False)
class _Slides:
    """Pairs of bodies (P, 2) with the fits of their likeliest joints of one state, in the order of the pairs."""

    pairs: IntArray
    fits: tuple[JointFit, ...]

    @staticmethod
    def of(structure: Structure, pairs: IntArray, joint_types: Sequence[str], effort: Effort) -> Asking[_Slides]:
        bodies, known = structure.bodies, structure.known
        pairs = oriented_pairs(bodies, pairs)

        def told(found: Explained) -> list[JointFit]:
            best = [found.scores.best_type(i) for i in range(len(found.tracks.seen))]
            return [found.fits[name].take(np.array([i])) for i, name in enumerate(best)]

        question = question_of(bodies, pairs, joint_types, effort, "evidence", free=False, told=told, known=known)
        found = yield from ask(question)
        return _Slides(pairs, tuple(fit for piece in found for fit in piece))

    def take(self, rows: Sequence[int]) -> _Slides:
        return _Slides(self.pairs[list(rows)], tuple(self.fits[i] for i in rows))

    def joined(self, other: _Slides) -> _Slides:
        return _Slides(np.concatenate([self.pairs, other.pairs]), (*self.fits, *other.fits))


def settled(structure: Structure, joint_types: Sequence[str]) -> Asking[tuple[Structure, tuple[Doubt, ...]]]:
    """The structure with the likeliest edges among bodies that move along one line, and which are in doubt."""
    movable = [name for name in joint_types if JOINT_TYPES[name].states == 1]
    if len(structure.edges) < 2 or not movable:
        return structure, ()
    fitted = structure.fitted
    if fitted is not None and len(fitted.pairs) == len(structure.edges):
        slides = _Slides(fitted.pairs, tuple(fitted.likeliest(movable)))
    else:
        slides = yield from _Slides.of(structure, structure.edges, movable, SCREENING)
    edges, doubts = list(range(len(slides.pairs))), list[Doubt]()
    kept: list[tuple[int, int]] = []
    for rows in _along_one_line(slides):  # such lines are few
        chosen, doubted = yield from _settled_line(structure, slides.pairs[rows], movable)
        kept += chosen
        doubts += doubted
        edges = [edge for edge in edges if edge not in rows]
    kept += [_pair(slides.pairs[edge]) for edge in edges]
    found = np.array(sorted(kept), dtype=np.intp)
    return replace(structure, edges=found), tuple(doubts)


def _pair(pair: IntArray) -> tuple[int, int]:
    return int(pair.min()), int(pair.max())


def _along_one_line(slides: _Slides) -> list[list[int]]:
    """Rows of edges that are connected and move alike, two or more."""
    alike: list[tuple[int, int]] = []
    for i in range(len(slides.fits)):  # a tree's edges are few
        for j in range(i):
            shared = set(slides.pairs[i].tolist()) & set(slides.pairs[j].tolist())
            same_type = slides.fits[i].joint is slides.fits[j].joint
            if shared and same_type and _move_alike(slides, i, j, shared.pop()):
                alike.append((i, j))
    label = components(len(slides.fits), np.array(alike, dtype=np.intp).reshape(-1, 2))
    lines = [[i for i, low in enumerate(label) if low == first] for first in sorted(set(label))]
    return [line for line in lines if len(line) > 1]


def _move_alike(slides: _Slides, i: int, j: int, body: int) -> bool:
    """Whether two joints of a body move others in the same way, at the mean place of the first one's other body."""
    p = _mean_pose(slides, i, body)[:3, 3]
    moves: list[FloatArray] = []
    for k in (i, j):
        v, w = np.split(_twist(slides, k, body), 2)
        moves.append(np.concatenate([v + np.cross(w, p), TURN_M * w]))
    a, b = moves
    across = (a @ a) * b - (a @ b) * a
    return bool(np.arctan2(np.linalg.norm(across), np.linalg.norm(a) * abs(a @ b)) < ALIKE_RAD)


def _twist(slides: _Slides, k: int, body: int) -> FloatArray:
    """(6,) motion of a joint's child by its state, in the frame of one of its bodies: the same in all states."""
    fit = slides.fits[k]
    frames = fit.model.frames.take(0)
    along = fit.joint.state_twists(frames.form)[:, 0]
    of_parent = slides.pairs[k, 0] == body
    return se3.adjoint(frames.T_parent_axis if of_parent else se3.inverse(frames.T_axis_child)) @ along


def _mean_pose(slides: _Slides, k: int, body: int) -> FloatArray:
    """(4, 4) pose of a joint's other body in this one, in the middle of the states."""
    fit = slides.fits[k]
    frames, q = fit.model.frames.take(0), np.median(fit.model.q[0], axis=0)
    T = frames.T_parent_axis @ fit.joint.axis_motion(q, frames.form) @ frames.T_axis_child
    return T if slides.pairs[k, 0] == body else se3.inverse(T)


def _settled_line(
    structure: Structure, along: IntArray, joint_types: Sequence[str]
) -> Asking[tuple[list[tuple[int, int]], list[Doubt]]]:
    """The cheapest tree of the bodies of some edges (E, 2), and what speaks for others."""
    bodies = sorted({int(body) for body in along.ravel()})
    known = {_pair(pair) for pair in along}
    others = [
        (a, b)
        for a, b in combinations(bodies, 2)
        if (a, b) not in known and _common(structure.bodies, a, b) >= MIN_FRAMES
    ]
    if not others:
        return list(known), []
    pairs = np.array(others, dtype=np.intp).reshape(-1, 2)
    edges = yield from _Slides.of(structure, along, joint_types, COMPARING)
    candidates = yield from _Slides.of(structure, pairs, joint_types, COMPARING)
    worst = max(float(fit.model.scales.max()) for fit in edges.fits)
    as_good = [
        i
        for i, fit in enumerate(candidates.fits)
        if fit.joint is edges.fits[0].joint and float(fit.model.scales.max()) <= MISFIT * worst
    ]
    pairs = edges.joined(candidates.take(as_good))
    costs = _costs(structure, pairs)
    number = {body: i for i, body in enumerate(bodies)}
    ends = np.array([[number[int(a)], number[int(b)]] for a, b in pairs.pairs], dtype=np.intp)
    chosen = spanning_forest(len(bodies), ends, costs - costs.max() - 1.0).tolist()
    doubts = [_doubt(pairs, ends, costs, chosen, other) for other in range(len(costs)) if other not in chosen]
    return [_pair(pairs.pairs[i]) for i in chosen], [doubt for doubt in doubts if doubt.odds < SURE_ODDS]


def _common(bodies: Bodies, a: int, b: int) -> int:
    """Frames in which two bodies were seen, and one of them with its orientation."""
    either = bodies.oriented[:, a] | bodies.oriented[:, b]
    return int(np.sum(bodies.seen[:, a] & bodies.seen[:, b] & either))


def _doubt(pairs: _Slides, ends: IntArray, costs: FloatArray, chosen: list[int], other: int) -> Doubt:
    """The dearest edge of the tree in whose place another pair could be."""
    above = {int(b): (int(a), chosen[i]) for a, b, i in outward(int(ends[other, 0]), ends[chosen])}
    body, path = int(ends[other, 1]), list[int]()
    while body != int(ends[other, 0]):
        body, edge = above[body]
        path.append(edge)
    edge = max(path, key=lambda i: float(costs[i]))
    odds = float(np.exp(0.5 * (costs[other] - costs[edge])))
    return Doubt(_pair(pairs.pairs[edge]), _pair(pairs.pairs[other]), odds)


def _costs(structure: Structure, pairs: _Slides) -> FloatArray:
    """(P,) -2 log density of each pair's motion by its steps, but for what all share."""
    steps = [_steps(fit) for fit in pairs.fits]
    times = [float(time_of_correlation(d[None, :, None], np.ones((1, len(d)), bool), np.ones(1))[0]) for d, _ in steps]
    costs = np.array([_cauchy(d, noise) for d, noise in steps]) / np.median(times)
    still = [k for k, group in enumerate(structure.groups) if REFERENCE in group.members]
    return costs - 2 * np.log(STILL_ODDS) * np.isin(pairs.pairs, still).any(axis=-1)


def _steps(fit: JointFit) -> tuple[FloatArray, float]:
    """Changes of a pair's states over equal parts of its good frames, and the variance of their noise."""
    good = fit.inlier[0] > INLIER_ABOVE
    q = continuous_states(fit)[0, good, 0]
    if len(q) < MIN_STATES:
        return np.zeros(2), 1.0
    at = np.linspace(0, len(q) - 1, min(STEPS + 1, len(q))).round().astype(np.intp)
    information = float(fit.state_information[0, good, 0, 0].mean())
    return np.diff(q[at]), 2 / max(information, np.finfo(float).tiny)


def _cauchy(d: FloatArray, noise: float) -> float:
    """-2 log likelihood of numbers with a Cauchy density of the best scale, which is the noise at least."""
    scale = max(float(np.median(d**2)), noise)
    for _ in range(CAUCHY_ROUNDS):  # each round weighs by the last scale
        scale = max(float(np.mean(2 * d**2 / (1 + d**2 / scale))), noise)
    return float(np.sum(np.log(scale) + 2 * np.log1p(d**2 / scale)))
