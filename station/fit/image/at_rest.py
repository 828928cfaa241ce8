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
from scipy.stats import chi2 as chi2_distribution

from station.fit.image.corner_data import CornerData
from station.fit.image.image_fit import ImageFit
from station.fit.image.seeming_motion import REPEATED_PX, seem_to_move
from station.fit.image.views import COORDINATES
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
# By so much a marker's noise, as estimated, may grow by chance; and so many more of all sightings be doubtful.
NOISE_GROWTH, MORE_DOUBTS = 1.1, 0.01


@dataclass(frozen=True)
class AtRest:
    """Joints of a skeleton without travel, bodies that stand still though its root is free to move, and pairs of bodies
    that only seem to move in each other.
    """

    joints: tuple[int, ...]
    bodies: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...] = ()


def at_rest(problem: Problem[CornerData], solution: Solution, state_covariance: tuple[FloatArray, ...]) -> AtRest:
    """What moves by no more than chance.

    Args:
        problem: with the scales of the noise.
        solution: its states.
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
    bodies = _standing(problem, solution) if skeleton.root_moves else ()
    pairs = tuple(pair for pair in seem_to_move(problem, solution) if noisy.isdisjoint(pair))
    return AtRest(joints, tuple(body for body in bodies if body not in noisy), pairs)


def explains_as_well(simpler: ImageFit | None, other: ImageFit | None) -> bool:
    """Whether a tree with less motion leaves no more of the corners unexplained than chance and repeated errors do."""
    if simpler is None or other is None:
        return simpler is other
    before = dict(zip(other.views.marker_id.tolist(), _noise_px2(other), strict=True))
    noise = dict(zip(simpler.views.marker_id.tolist(), _noise_px2(simpler), strict=True))
    if not before.keys() <= noise.keys():
        return False
    grown = any(noise[m] > NOISE_GROWTH**2 * px2 + REPEATED_PX**2 for m, px2 in before.items())
    return not grown and simpler.doubtful.sum() <= other.doubtful.sum() + MORE_DOUBTS * len(simpler.views)


def _noise_px2(image: ImageFit) -> list[float]:
    """Variance of a coordinate of each marker's corners; 0 of one that was not seen."""
    views = image.views
    stated = np.trace(views.covariance_px2, axis1=-2, axis2=-1) / COORDINATES
    counts = np.bincount(views.marker, minlength=len(views.marker_id))
    total = np.bincount(views.marker, stated, minlength=len(views.marker_id))
    return list((image.scale**2 * total / np.maximum(counts, 1)).tolist())


def _is_one(x: FloatArray, information: FloatArray) -> bool:
    """Whether numbers (T, s) are the same but for chance; those without information (T, s, s) don't count."""
    known = np.isfinite(information).all(axis=(-2, -1))
    x, W = x[known], information[known]
    if len(x) < LEAST_FRAMES:
        return False
    inverse = np.asarray(np.linalg.pinv(W.sum(axis=0), hermitian=True), dtype=np.float64)
    off = x - inverse @ np.sum((W @ x[..., None])[..., 0], axis=0)
    square = np.einsum("ti,tij,tj->t", off, W, off)
    usual: BoolArray = square <= chi2_distribution.ppf(USUAL, x.shape[-1])
    freedoms = float(x.shape[-1] * (usual.sum() - 1))
    within = float(np.sum(square[usual])) <= freedoms + CHANCE_SIGMAS * np.sqrt(2 * max(freedoms, 0.0))
    return within and float(np.mean(~usual)) <= ODD_SHARE


def _standing(problem: Problem[CornerData], solution: Solution) -> tuple[int, ...]:
    """Bodies of a tree whose root has a pose in each frame that stand still."""
    skeleton, model = problem.skeleton, solution.model
    poses = tree_poses(skeleton, model).bodies
    covariances = np.concatenate(solution.last.each_rows(lambda rows, chunk: _spreads(problem, solution, rows, chunk)))
    found: list[int] = []
    for body, T in enumerate(poses):
        known = np.isfinite(covariances[:, body]).all(axis=(-2, -1))
        if not known.any():
            continue
        off = se3.log(se3.inverse(se3.mean(T[known])) @ T[known])
        information = np.asarray(np.linalg.pinv(covariances[known, body], hermitian=True), dtype=np.float64)
        if _is_one(off, information):
            found.append(body)
    return tuple(found)


def _spreads(problem: Problem[CornerData], solution: Solution, rows: slice, chunk: FrameStates) -> FloatArray:
    """(T, bodies, 6, 6) covariances of the bodies' poses by their frame's states alone, right perturbations.

    NaN where a state on the way to the body was not observed.
    """
    skeleton = problem.skeleton
    moved = moved_by(skeleton, solution.model.take(rows))
    found: list[FloatArray] = []
    for body, T in enumerate(moved.poses.bodies):
        twists = moved.bodies[body]
        about = T.copy()
        about[:, :3, 3] -= moved.centre
        B = se3.adjoint(se3.inverse(about)) @ twists.by_states[:, :6]
        spread = B @ np.swapaxes(chunk.root[..., twists.states], -1, -2)
        told = np.all(chunk.told[:, twists.states], axis=-1, keepdims=True)[..., None]
        found.append(np.where(told, spread @ np.swapaxes(spread, -1, -2), np.nan))
    return np.stack(found, axis=1)
