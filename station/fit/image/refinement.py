"""A whole tree refined on the corners of its markers: every joint, mount, state, and the camera's numbers at once.

The steps are those of the fit to poses (tree_solver): each frame's states eliminated, so that time is linear in frames.
What moves while a rolling shutter reads a frame is taken from the frames around as they are, and again when these are
better known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.image.at_rest import AtRest, at_rest
from station.fit.image.camera_numbers import Unknowns
from station.fit.image.corner_data import CornerData, corner_data
from station.fit.image.corner_noise import scales_of
from station.fit.image.doubts import parts_elsewhere, unexplained, with_other_answers
from station.fit.image.image_fit import ImageFit
from station.fit.image.likely_states import Told, is_odd, mended, with_likely_states
from station.fit.image.misfits import misfits
from station.fit.image.repeated_errors import shared_covariance
from station.fit.image.two_answers import Others, other_answers
from station.fit.image.views import COORDINATES, Views
from station.fit.skeleton import Skeleton, TreeModel
from station.fit.tree_motion import tree_poses
from station.fit.tree_problem import Prior, Problem
from station.fit.tree_solver import Solution, refined
from station.fit.whole_tree import TreeFit, state_covariances
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# Rounds of the noise and of the motion between frames, which each makes better known.
ROUNDS = 10
# Relative change of a marker's scale, and change of the residuals in deviations (root mean square), that ask for
# another.
SCALE_CHANGE, MOTION_CHANGE = 0.03, 0.01
# Times that states of frames that don't fit are sought anew with better parameters.
SEEKING_ROUNDS = 3
# Times that frames go over to other answers.
ANSWER_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class Refined:
    """A tree fitted to corners: as the fit to poses has it, without what all parts share, and what else was found."""

    fit: TreeFit
    image: ImageFit
    rest: AtRest


def refine_image(
    skeleton: Skeleton, model: TreeModel, parts: tuple[str, ...], views: Views, unknowns: Unknowns
) -> Refined:
    """Least squares on corners, from a start.

    Args:
        skeleton: joints, bodies and K parts.
        model: parameters and states to start from, by the parts' poses.
        parts: K names of the skeleton's parts.
        views: of all of them.
        unknowns: what of the camera is estimated.
    """
    skeleton = replace(skeleton, shared=len(unknowns.names))
    model = replace(model, shared=unknowns.start)
    prior = Prior(unknowns.start, np.array(unknowns.prior_std))
    return _told(*_solved(Problem(skeleton, corner_data(views, parts, unknowns), prior), model))


def _solved(problem: Problem[CornerData], model: TreeModel) -> tuple[Problem[CornerData], Solution, Others]:
    """The likeliest parameters and states, with the noise that each marker turned out to have, and other answers."""
    problem = _moving(problem, model)
    problem, solution = _settled(problem, refined(problem, model, mended))
    problem, solution = _with_noise(problem, solution)
    problem, solution = _settled(problem, solution)  # by the noise that there is some frames may be odd that were not
    others = other_answers(problem.skeleton, solution.model, problem.measured)
    for _ in range(ANSWER_ROUNDS):  # better parameters may tell other answers
        likelier = others.likelier()
        if not likelier.frame.size:
            break
        model = solution.model.with_states(likelier.frame, likelier.model)
        problem = _moving(problem, model)
        solution = refined(problem, model, mended)
        others = other_answers(problem.skeleton, solution.model, problem.measured)
    return problem, solution, others.undecided()


def _with_noise(problem: Problem[CornerData], solution: Solution) -> tuple[Problem[CornerData], Solution]:
    """With the noise of each marker, and the motion while frames are read, as they turn out to be."""
    for _ in range(ROUNDS):  # better weights and motions tell them better
        scale = scales_of(problem, solution)
        change = np.abs(np.log(scale / problem.measured.scale)).max(initial=0.0)
        after = _moving(replace(problem, measured=replace(problem.measured, scale=scale)), solution.model)
        if change <= SCALE_CHANGE and _motion_change(problem, after, solution.model) <= MOTION_CHANGE:
            break
        problem, solution = after, refined(after, solution.model, mended)
    return problem, solution


def _settled(problem: Problem[CornerData], solution: Solution) -> tuple[Problem[CornerData], Solution]:
    """With the states of frames that don't fit sought anew, and all refined together, again and again."""
    told, in_vain = Told.of(problem.measured), np.zeros(len(solution.chi2), dtype=bool)
    for _ in range(SEEKING_ROUNDS):  # better parameters may tell better states, and these better parameters
        heat = problem.measured.heat(solution.chi2)
        hot, chi2 = problem.measured.hotter(heat), solution.chi2 / heat
        odd = is_odd(hot, chi2) & ~in_vain
        likely, changed = with_likely_states(problem.skeleton, solution.model, hot, told, odd)
        if not changed.any():
            break
        in_vain |= odd & ~changed
        problem = _moving(problem, likely)
        solution = refined(problem, likely, mended)
    return problem, solution


def _moving(problem: Problem[CornerData], model: TreeModel) -> Problem[CornerData]:
    """The problem with the parts' motion while a frame is read as the model has it."""
    data = problem.measured
    if data.motion is None:
        return problem
    T_ref_marker = tree_poses(problem.skeleton, model).parts[:, data.part]
    return replace(problem, measured=replace(data, motion=data.motion.through(T_ref_marker)))


def _motion_change(before: Problem[CornerData], after: Problem[CornerData], model: TreeModel) -> float:
    """Root mean square change of the whitened residuals by another motion within the frames."""
    if before.measured.motion is None:
        return 0.0
    T_ref_part = tree_poses(before.skeleton, model).parts
    change = [problem.measured.residual_px(T_ref_part, model.shared) for problem in (before, after)]
    whitened = after.measured.whitened(change[1] - change[0])
    return float(np.sqrt(np.sum(whitened**2) / max(COORDINATES * after.measured.seen.sum(), 1)))


def _told(problem: Problem[CornerData], solution: Solution, others: Others) -> Refined:
    skeleton, data, model = problem.skeleton, problem.measured, solution.model
    inlier = data.inliers(solution.chi2)
    poses = tree_poses(skeleton, model).parts
    residual_px = data.residual_px(poses, model.shared)
    covariance = shared_covariance(problem, solution)
    states = state_covariances(skeleton, solution.last, covariance, 1.0)
    own = slice(0, skeleton.parameters - skeleton.shared)
    states = with_other_answers(skeleton, states, others)
    two = parts_elsewhere(skeleton, others, len(inlier))
    fit = TreeFit(model, covariance[own, own], states, _of_parts(data, inlier), _spread(data))
    variances = np.diagonal(covariance)[skeleton.shared_columns]
    misfit, alike = misfits(data, residual_px, inlier)
    at = data.views.frame, data.views.marker
    image = ImageFit(
        views=data.views,
        T_ref_part=np.where(_known(skeleton, solution)[..., None, None], poses, np.nan),
        numbers=data.unknowns.at(model.shared),
        numbers_std=data.unknowns.stds(np.sqrt(variances)),
        residual_px=residual_px[at],
        chi2=solution.chi2[at],
        inlier=inlier[at],
        scale=data.scale,
        doubtful=unexplained(data, solution.chi2)[at] | two[:, data.part][at],
        alike=alike,
        misfit=misfit,
        two_answers=two,
    )
    return Refined(fit, image, at_rest(problem, solution, covariance, states))


def _of_parts(data: CornerData, inlier: FloatArray) -> FloatArray:
    """(T, K) probability that the best of a part's markers (T, M) is no outlier."""
    found = np.zeros((len(inlier), len(data.views.parts)))
    for m, k in enumerate(data.part):  # markers are few
        found[:, k] = np.maximum(found[:, k], inlier[:, m])
    return found


def _spread(data: CornerData) -> FloatArray:
    """(K, 2) largest scale of the markers of each part; 1 where none was seen."""
    found = np.ones(len(data.views.parts))
    for k in set(data.part.tolist()):
        found[k] = data.scale[data.part == k].max()
    return np.stack([found, found], axis=-1)


def _known(skeleton: Skeleton, solution: Solution) -> BoolArray:
    """(T, K) whether all states between a part and the reference were observed."""
    told = np.concatenate(solution.last.each_chunk(lambda chunk: chunk.told))
    known = {0: told[:, skeleton.joint_states :].all(axis=-1)}
    for j, joint in enumerate(skeleton.joints):  # the near ones come first
        known[joint.far] = known[joint.near] & told[:, skeleton.state_columns(j)].all(axis=-1)
    return np.stack([known[body] for body in skeleton.body_of], axis=-1)
