"""What doesn't move after all: joints without travel and bodies that stand still, by what corners tell of states.

Poses of a marker seen from the front scatter in a way that no normal distribution has, so that rigid bodies may seem
to have a joint, or a root that stands still to move. States that a tree's corners tell don't: where all of them are one
and the same but for their own deviations, the joint is none. Where a tracker of a body was taken for one of its own,
what doesn't move need not be a joint: it may hang from another body, and go along (seeming_motion).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from station.fit.image.corner_data import CornerData
from station.fit.image.seeming_motion import seem_to_move
from station.fit.pairwise import small_inverse
from station.fit.tree_elimination import FrameStates
from station.fit.tree_equations import moved_by
from station.fit.tree_motion import tree_poses
from station.fit.tree_problem import Problem
from station.fit.tree_solver import Solution
from station.kinematics import se3
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# Frames beyond this quantile are counted apart, and may be so many: flips that are left say nothing of travel.
USUAL, ODD_SHARE = 0.999, 0.02
# Standard deviations of chi squared by which all others together may exceed its mean.
CHANCE_SIGMAS = 4.0
LEAST_FRAMES = 10
# With corners so many times as far off as stated, it is the tree that is wrong, and states say nothing.
MOST_SCALE = 2.0


@dataclass(frozen=True)
class AtRest:
    """Joints of a skeleton without travel, bodies that stand still though its root is free to move, and pairs of bodies
    that only seem to move in each other.
    """

    joints: tuple[int, ...]
    bodies: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...] = ()


def at_rest(
    problem: Problem[CornerData], solution: Solution, covariance: FloatArray, state_covariance: tuple[FloatArray, ...]
) -> AtRest:
    """What moves by no more than chance.

    Args:
        problem: with the scales of the noise.
        solution: its states.
        covariance: (n, n) of the parameters.
        state_covariance: (T, s, s) of each joint's.
    """
    skeleton, q = problem.skeleton, solution.model.q
    far_off = problem.measured.part[problem.measured.scale > MOST_SCALE]
    noisy: set[int] = {skeleton.body_of[int(k)] for k in far_off}
    joints = tuple(
        j
        for j, joint in enumerate(skeleton.joints)
        if noisy.isdisjoint((joint.near, joint.far))
        and _is_one(q[:, skeleton.state_columns(j)], small_inverse(state_covariance[j]))
    )
    bodies = _standing(problem, solution, covariance) if skeleton.root_moves else ()
    pairs = tuple(pair for pair in seem_to_move(problem, solution) if noisy.isdisjoint(pair))
    return AtRest(joints, tuple(body for body in bodies if body not in noisy), pairs)


def _is_one(x: FloatArray, information: FloatArray) -> bool:
    """Whether numbers (T, s) are the same but for chance; those without information (T, s, s) don't count."""
    known = np.isfinite(information).all(axis=(-2, -1))
    return _but_for_errors(x[known], information[known], np.zeros((int(known.sum()), x.shape[-1], 0)))


def _but_for_errors(x: FloatArray, information: FloatArray, by_errors: FloatArray) -> bool:
    """Whether numbers (T, s) are the same but for chance: errors of their own, and some that all frames share.

    Args:
        x: numbers.
        information: (T, s, s) of them if nothing that is shared had errors.
        by_errors: (T, s, n) how they change with n errors, independent and of unit variance, that all share.
    """
    if len(x) < LEAST_FRAMES:
        return False
    limit = 2.0 * float(gammaincinv(len(x.T) / 2, USUAL))
    square, _ = _left(x, information, by_errors, np.ones(len(x), dtype=bool))
    square, taken = _left(x, information, by_errors, square <= limit)  # odd frames mustn't draw the errors
    usual: BoolArray = square <= limit
    freedoms = float(x.shape[-1] * (usual.sum() - 1))
    within = float(np.sum(square[usual])) + taken <= freedoms + CHANCE_SIGMAS * np.sqrt(2 * max(freedoms, 0.0))
    return within and float(np.mean(~usual)) <= ODD_SHARE


def _left(x: FloatArray, information: FloatArray, by_errors: FloatArray, usual: BoolArray) -> tuple[FloatArray, float]:
    """(T,) squares that numbers leave which are one but for errors, and the square of those that all frames share."""
    s, n = x.shape[-1], by_errors.shape[-1]
    D = np.concatenate([np.broadcast_to(np.eye(s), (len(x), s, s)), by_errors], axis=-1)
    weighted_t = np.swapaxes(D[usual], -1, -2) @ information[usual]
    normal = np.sum(weighted_t @ D[usual], axis=0)
    normal[range(s, s + n), range(s, s + n)] += 1.0
    inverse = np.asarray(np.linalg.pinv(normal, hermitian=True), dtype=np.float64)
    best = inverse @ np.sum(weighted_t @ x[usual, :, None], axis=0)[:, 0]
    off = x - D @ best
    return np.einsum("ti,tij,tj->t", off, information, off), float(np.sum(best[s:] ** 2))


def _standing(problem: Problem[CornerData], solution: Solution, covariance: FloatArray) -> tuple[int, ...]:
    """Bodies of a tree whose root has a pose in each frame that stand still."""
    skeleton, model = problem.skeleton, solution.model
    values, vectors = np.linalg.eigh(covariance)
    errors = vectors * np.sqrt(np.maximum(values, 0.0))
    chunks = solution.last.each_rows(lambda rows, chunk: _spreads(problem, solution, rows, chunk, errors))
    spreads = [np.concatenate([chunk[i] for chunk in chunks]) for i in (0, 1)]
    found: list[int] = []
    for body, T in enumerate(tree_poses(skeleton, model).bodies):
        own, by_errors = (spread[:, body] for spread in spreads)
        known = np.isfinite(own).all(axis=(-2, -1))
        if not known.any():
            continue
        off = se3.log(se3.inverse(se3.mean(T[known])) @ T[known])
        information = np.asarray(np.linalg.pinv(own[known], hermitian=True), dtype=np.float64)
        if _but_for_errors(off, information, by_errors[known]):
            found.append(body)
    return tuple(found)


def _spreads(
    problem: Problem[CornerData], solution: Solution, rows: slice, chunk: FrameStates, errors: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Right perturbations of the bodies' poses: covariances (T, bodies, 6, 6) by their frame's states alone, NaN where
    a state on the way to the body was not observed; and (T, bodies, 6, n) by errors (n, n) of the parameters.
    """
    skeleton = problem.skeleton
    moved, coupling = moved_by(skeleton, solution.model.take(rows)), chunk.coupling()
    own: list[FloatArray] = []
    shared: list[FloatArray] = []
    for body, T in enumerate(moved.poses.bodies):
        twists = moved.bodies[body]
        about = T.copy()
        about[:, :3, 3] -= moved.centre
        to_body = se3.adjoint(se3.inverse(about))
        B = to_body @ twists.by_states[:, :6]
        spread = B @ np.swapaxes(chunk.root[..., twists.states], -1, -2)
        told = np.all(chunk.told[:, twists.states], axis=-1, keepdims=True)[..., None]
        own.append(np.where(told, spread @ np.swapaxes(spread, -1, -2), np.nan))
        by_parameters = -B @ coupling[:, twists.states]
        by_parameters[..., twists.parameters] += to_body @ twists.by_parameters[:, :6]
        shared.append(by_parameters @ errors)
    return np.stack(own, axis=1), np.stack(shared, axis=1)
