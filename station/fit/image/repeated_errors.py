"""Deviations of what all frames share, where the errors of corners repeat themselves from picture to picture.

A marker that stands still shows the same error in every picture: a thousand of them tell no more than a few. With H the
information as if all errors were independent, and S_m the share of it that marker m tells, once the frames' own states
are eliminated, the covariance is the sandwich

    H^-1 ( prior + sum over m of tau_m S_m ) H^-1,

tau_m the frames in which an error of marker m repeats itself (White, Econometrica 1982; Newey and West, 1987).
"""

from __future__ import annotations

import numpy as np

from station.fit.image.corner_data import CornerData
from station.fit.image.views import COORDINATES
from station.fit.noise import INLIER_ABOVE, time_of_correlation
from station.fit.pairwise import parameter_covariance
from station.fit.tree_elimination import FrameStates
from station.fit.tree_equations import moved_by
from station.fit.tree_motion import mount_twists, tree_poses, with_shared
from station.fit.tree_problem import Problem
from station.fit.tree_solver import Solution
from station.logs import FloatArray


def shared_covariance(problem: Problem[CornerData], solution: Solution) -> FloatArray:
    """(n, n) of the parameters, with repeated errors counted once."""
    reduced, times = solution.last.reduced, repeat_times(problem, solution)
    covariance = parameter_covariance(reduced.H, reduced.unreduced)
    if np.all(times <= 1):
        return covariance

    def beyond(rows: slice, chunk: FrameStates) -> FloatArray:
        return _repeated_information(problem, solution, rows, chunk, times - 1)

    more = np.sum(solution.last.each_rows(beyond), axis=0)
    return covariance + covariance @ more @ covariance


def repeat_times(problem: Problem[CornerData], solution: Solution) -> FloatArray:
    """(M,) frames in which an error of each marker repeats itself, at least 1."""
    data, model = problem.measured, solution.model
    whitened = data.whitened(data.residual_px(tree_poses(problem.skeleton, model).parts, model.shared))
    good = data.inliers(solution.chi2) > INLIER_ABOVE
    times = np.ones(len(data.part))
    for m in np.flatnonzero(good.any(axis=0)):  # markers are few, and memory asks for it
        times[m] = time_of_correlation(whitened[None, :, m], good[None, :, m], np.array([float(COORDINATES)]))[0]
    return times


def _repeated_information(
    problem: Problem[CornerData], solution: Solution, rows: slice, chunk: FrameStates, times: FloatArray
) -> FloatArray:
    """(n, n) sum of the markers' shares of the information in some frames, each so many times (M,)."""
    skeleton, data, model = problem.skeleton, problem.measured.take(rows), solution.model.take(rows)
    moved, coupling = moved_by(skeleton, model), chunk.coupling()
    _, by = data.derivatives(moved.poses.parts, model.shared, moved.centre)
    root = np.sqrt(solution.inlier[rows])
    found = np.zeros((skeleton.parameters, skeleton.parameters))
    for m in np.flatnonzero(times > 0).tolist():
        k = int(data.part[m])
        twists = moved.bodies[skeleton.body_of[k]]
        if skeleton.free_mount[k]:
            twists = twists.joined(with_shared(mount_twists(skeleton, moved.poses, k, moved.centre), skeleton.shared))
        weighted = by[:, m] * root[:, m, None, None]
        freed = -(weighted @ twists.by_states) @ coupling[:, twists.states]
        freed[..., twists.parameters] += weighted @ twists.by_parameters
        flat = freed.reshape(-1, skeleton.parameters)
        found += times[m] * (flat.T @ flat)
    return found
