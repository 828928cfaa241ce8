"""Bodies of a tree that move in each other by no more than a detector's errors make of bodies that are one.

Edges are seen shifted by what the camera's gamma, its blur and the pixels do to a marker as it is seen there. Such an
error is the same whenever the marker is seen in the same way, so that it doesn't average out, and the deviations of
corners know nothing of it. Two trackers on one body then seem to move in each other by hundredths of a pixel. What
tells that from a true motion: it is a function of where the body is in the picture and how it is turned, and a true
motion, unless it is coupled to the others, is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from station.fit.image.corner_data import CornerData
from station.fit.image.detector_errors import REPEATED_PX
from station.fit.image.views import COORDINATES
from station.fit.tree_elimination import FrameStates
from station.fit.tree_equations import Moved, moved_by
from station.fit.tree_motion import TreePoses, tree_poses
from station.fit.tree_problem import Problem
from station.fit.tree_solver import Solution
from station.kinematics import se3
from station.kinematics.joints.base import BALANCE_M
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# What a body's pose must explain, at least, of the motion beyond the noise.
EXPLAINED = 0.6
# Frames beyond this quantile of one number are counted apart, and may be so many: flips that are left say nothing.
USUAL, ODD_SHARE = 2 * float(gammaincinv(0.5, 0.999)), 0.02
# Standard deviations by which the motion may exceed the noise by chance.
CHANCE_SIGMAS = 4.0
LEAST_FRAMES = 10
# Bodies whose places in each other change by more, at the median, are not looked into.
NEAR_PX = 1.0
# Share of a pose's variance below which it has no direction there; and as multiples of the motion: errors of hundredths
# of a pixel change with places that are pixels apart.
FLAT, FARTHER = 1e-3, 30.0
# Polynomials of the pose up to this degree, with at least so many frames for a term, foretell pieces of time this many.
MOST_DEGREE, FRAMES_A_TERM, PIECES = 4, 6, 10


def seem_to_move(problem: Problem[CornerData], solution: Solution) -> tuple[tuple[int, int], ...]:
    """Pairs of a skeleton's bodies that move in each other by no more than chance and repeated errors explain.

    Args:
        problem: with the scales of the noise.
        solution: its states.
    """
    poses, told = tree_poses(problem.skeleton, solution.model), _told(problem, solution)
    near = [pair for pair in combinations(range(len(poses.bodies)), 2) if _is_near(problem, poses, told, pair)]
    if not near:
        return ()
    motions = [_mean_motion(problem, poses, told, pair) for pair in near]

    def of_chunk(rows: slice, chunk: FrameStates) -> list[_Seen]:
        return _seen_moved(problem, solution, motions, rows, chunk)

    chunks = solution.last.each_rows(of_chunk)
    sums = [_Seen.joined([chunk[i] for chunk in chunks]) for i in range(len(near))]
    found: list[tuple[int, int]] = []
    for pair, motion, seen in zip(near, motions, sums, strict=True):
        inner = min(pair, key=lambda body: len(problem.skeleton.paths[body]))  # the motion isn't in its pose
        if _is_none(poses.bodies[inner], motion, seen):
            found.append(pair)
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Motion:
    """How a body moves in another: twists off the mean (T, 6) in its own frame, and the frames that tell them (T,)."""

    pair: tuple[int, int]
    off: FloatArray
    known: BoolArray


@dataclass(frozen=True, eq=False)
class _Seen:
    """What a motion does in the picture to the markers of both bodies, by frame.

    Attributes:
        square: (T,) of the corners' displacements [px^2].
        noise: (T,) of it that is expected of the states' own deviations; chance: (T,) half its variance.
        coordinates: (T,) how many.
        metric: (T, 6, 6) `square` by the twist.
    """

    square: FloatArray
    noise: FloatArray
    chance: FloatArray
    coordinates: FloatArray
    metric: FloatArray

    @staticmethod
    def joined(some: list[_Seen]) -> _Seen:
        """Those of frames one after another."""
        of = [(each.square, each.noise, each.chance, each.coordinates, each.metric) for each in some]
        return _Seen(*(np.concatenate(arrays) for arrays in zip(*of, strict=True)))


def _told(problem: Problem[CornerData], solution: Solution) -> BoolArray:
    """(T, bodies) whether a body was seen, and all states between it and the root are observed."""
    skeleton, data = problem.skeleton, problem.measured
    told = np.concatenate(solution.last.each_chunk(lambda chunk: chunk.told))
    found = np.zeros((len(told), len(skeleton.joints) + 1), dtype=bool)
    for m, k in enumerate(data.part.tolist()):  # markers are few
        found[:, skeleton.body_of[k]] |= data.seen[:, m]
    for body, path in enumerate(skeleton.paths):
        for j in path:
            found[:, body] &= told[:, skeleton.state_columns(j)].all(axis=-1)
    return found


def _is_near(problem: Problem[CornerData], poses: TreePoses, told: BoolArray, pair: tuple[int, int]) -> bool:
    """Whether a part of one body keeps its place in the other, about."""
    a, b = pair
    both = told[:, a] & told[:, b]
    parts = [k for k, body in enumerate(problem.skeleton.body_of) if body == b]
    if both.sum() < LEAST_FRAMES or not parts:
        return False
    p_ref = poses.parts[both, parts[0], :3, 3]
    T_ref_a = poses.bodies[a][both]
    p_a = np.einsum("tji,tj->ti", T_ref_a[:, :3, :3], p_ref - T_ref_a[:, :3, 3])
    off = np.linalg.norm(p_a - np.median(p_a, axis=0), axis=-1)
    focal = float(problem.measured.views.camera.matrix[0, 0])
    return bool(np.median(off * focal / p_ref[:, 2]) < NEAR_PX)


def _mean_motion(problem: Problem[CornerData], poses: TreePoses, told: BoolArray, pair: tuple[int, int]) -> _Motion:
    a, b = pair
    known = told[:, a] & told[:, b]
    T_a_b = se3.inverse(poses.bodies[a]) @ poses.bodies[b]
    return _Motion(pair, se3.log(se3.inverse(se3.mean(T_a_b[known])) @ T_a_b), known)


def _seen_moved(
    problem: Problem[CornerData], solution: Solution, motions: list[_Motion], rows: slice, chunk: FrameStates
) -> list[_Seen]:
    model, data = solution.model.take(rows), problem.measured.take(rows)
    moved = moved_by(problem.skeleton, model)
    _, whitened = data.derivatives(moved.poses.parts, model.shared, moved.centre)
    by_px = np.zeros((*data.shape, COORDINATES, 6))
    scale = np.broadcast_to(data.scale, data.shape)[data.seen]
    by_px[data.seen] = np.linalg.solve(data.whitener[data.seen], scale[:, None, None] * whitened[data.seen][..., :6])
    return [_one_moved(problem, moved, by_px, motion, rows, chunk) for motion in motions]


def _one_moved(
    problem: Problem[CornerData], moved: Moved, by_px: FloatArray, motion: _Motion, rows: slice, chunk: FrameStates
) -> _Seen:
    skeleton, data = problem.skeleton, problem.measured
    columns = [m for m, k in enumerate(data.part.tolist()) if skeleton.body_of[k] in motion.pair]
    counts = data.seen[rows][:, columns] & motion.known[rows, None]
    a, b = motion.pair
    about = moved.poses.bodies[b].copy()
    about[:, :3, 3] -= moved.centre
    J = by_px[:, columns] * counts[..., None, None]
    by_twist = (J @ se3.adjoint(about)[:, None]).reshape(len(J), -1, 6)
    twists = np.zeros((len(J), 6, skeleton.states))
    for body, sign in ((a, -1.0), (b, 1.0)):
        twists[..., moved.bodies[body].states] += sign * moved.bodies[body].by_states[:, :6]
    spread = J.reshape(len(J), -1, 6) @ (twists @ np.swapaxes(chunk.root, -1, -2))
    gram = np.swapaxes(spread, -1, -2) @ spread
    shift = (by_twist @ motion.off[rows, :, None])[..., 0]
    return _Seen(
        square=np.sum(shift**2, axis=-1),
        noise=np.trace(gram, axis1=-2, axis2=-1),
        chance=np.sum(gram**2, axis=(-2, -1)),
        coordinates=COORDINATES * counts.sum(axis=-1, dtype=np.float64),
        metric=np.swapaxes(by_twist, -1, -2) @ by_twist,
    )


def _is_none(T_ref_body: FloatArray, motion: _Motion, seen: _Seen) -> bool:
    """Whether a motion is no more than chance and repeated errors make."""
    counted = motion.known & (seen.coordinates > 0)
    usual = seen.square <= USUAL * (seen.noise + seen.coordinates * REPEATED_PX**2)
    rows = np.flatnonzero(counted & usual)
    if len(rows) < LEAST_FRAMES or len(rows) < (1 - ODD_SHARE) * counted.sum():
        return False
    n, square, noise = seen.coordinates[rows], seen.square[rows], seen.noise[rows]
    weight = 1 / (noise / n + REPEATED_PX**2)
    beyond, chance = np.sum(weight * (square - noise)), np.sqrt(2 * np.sum(weight**2 * seen.chance[rows]))
    if beyond <= CHANCE_SIGMAS * chance:
        return True
    if beyond > REPEATED_PX**2 * np.sum(weight * n):
        return False
    share = beyond / np.sum(weight * square)
    off = motion.off[rows]
    return _explained(_in_pixels(off, seen.metric[rows]), _places(T_ref_body[rows], off)) > EXPLAINED * share


def _in_pixels(off: FloatArray, metric: FloatArray) -> FloatArray:
    """Twists (T, 6) in units of what they do in the picture, on average over the frames, about their mean."""
    values, vectors = np.linalg.eigh(metric.mean(axis=0))
    seen = off @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    return seen - seen.mean(axis=0)


def _places(T_ref_body: FloatArray, off: FloatArray) -> FloatArray:
    """(T, n) where a body is and how it is turned, in the directions in which that changes, of unit variance.

    Args:
        T_ref_body: (T, 4, 4).
        off: (T, 6) twists of the motion that this may explain.
    """
    turned = se3.log(se3.inverse(se3.mean(T_ref_body)) @ T_ref_body)[:, 3:]
    pose = np.concatenate([T_ref_body[:, :3, 3], BALANCE_M * turned], axis=-1)
    U, size, _ = np.linalg.svd(pose - pose.mean(axis=0), full_matrices=False)
    least = FARTHER**2 * np.sum((off * np.repeat([1.0, BALANCE_M], 3)) ** 2)
    return U[:, size**2 > np.maximum(FLAT * np.sum(size**2), least)] * np.sqrt(len(U))


def _explained(x: FloatArray, place: FloatArray) -> float:
    """Share of the variance of numbers (T, k) that places (T, n) foretell, in pieces of time from all others.

    By polynomials: the best of their degrees.
    """
    piece = np.arange(len(x)) * PIECES // len(x)
    terms, found = np.ones((len(x), 1)), 0.0
    for degree in range(1, MOST_DEGREE + 1):
        more = [np.prod(place[:, c], axis=-1) for c in _products(place.shape[-1], degree)]
        if not more or (terms.shape[-1] + len(more)) * FRAMES_A_TERM > len(x):
            break
        terms = np.concatenate([terms, np.stack(more, axis=-1)], axis=-1)
        left = np.zeros_like(x)
        for k in range(PIECES):
            others, here = piece != k, piece == k
            left[here] = x[here] - terms[here] @ np.linalg.lstsq(terms[others], x[others])[0]
        found = max(found, 1 - float(np.sum(left**2)) / max(float(np.sum(x**2)), 1e-300))
    return found


def _products(numbers: int, degree: int) -> list[list[int]]:
    return [list(each) for each in combinations_with_replacement(range(numbers), degree)]
