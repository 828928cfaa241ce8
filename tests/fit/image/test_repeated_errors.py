"""What errors that repeat themselves from picture to picture leave of the certainty of what all frames share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.fit.image.repeated_errors import _repeated_information, repeat_times, shared_covariance
from station.fit.tree_solver import refined
from station.logs import FloatArray
from tests.fit.image.seen_objects import Scene
from tests.fit.image.simulated_views import Seeing, Watched, watched
from tests.fit.image.test_corner_data import problem_of

REPEATED = 15


def with_repeated_errors(w: Watched, markers: list[int]) -> Watched:
    """Errors of some markers that stay the same over frames on end."""
    views, rng = w.views, np.random.default_rng(8)
    rows = np.isin(views.marker, markers)
    fresh = rng.normal(size=(len(views.t_s), len(views.marker_id), 8))
    held = fresh[views.frame // REPEATED * REPEATED, views.marker]
    error = (np.linalg.cholesky(views.covariance_px2) @ held[..., None])[..., 0]
    exact = views.corners_px.reshape(-1, 8) - w.error_px
    corners = np.where(rows[:, None], exact + error, views.corners_px.reshape(-1, 8))
    return replace(w, views=replace(views, corners_px=corners.reshape(-1, 4, 2)))


@pytest.fixture(scope="module")
def still() -> Watched:
    return watched(11, Scene(joints=2, kinds=("revolute",), frames=450), Seeing(sigma_px=0.1))


def test_the_markers_shares_of_the_information_are_all_of_it(still: Watched) -> None:
    problem, model = problem_of(still)
    solution = refined(problem, refined(problem, model).model)
    ones = np.ones(len(problem.measured.part))
    shares = solution.last.each_rows(lambda rows, states: _repeated_information(problem, solution, rows, states, ones))
    prior = problem.prior.equations(problem.skeleton, model.shared).H
    H = solution.last.reduced.H
    np.testing.assert_allclose(np.sum(shares, axis=0), H - prior, atol=1e-5 * np.abs(H).max())


def test_errors_that_are_new_in_every_picture_are_counted_as_such(still: Watched) -> None:
    problem, model = problem_of(still)
    times = repeat_times(problem, refined(problem, model))
    assert times.max() < 1.5


def deviations_of_parameters(w: Watched) -> FloatArray:
    problem, model = problem_of(w, ())
    return np.sqrt(np.diagonal(shared_covariance(problem, refined(problem, model))))


def test_errors_that_all_markers_repeat_widen_everything_by_the_root_of_their_number(still: Watched) -> None:
    everything = list(range(len(still.views.marker_id)))
    usual, wider = deviations_of_parameters(still), deviations_of_parameters(with_repeated_errors(still, everything))
    np.testing.assert_allclose(wider / usual, np.sqrt(REPEATED), rtol=0.3)


def test_errors_that_the_still_root_repeats_widen_what_it_tells_and_nothing_else(still: Watched) -> None:
    root = [m for m, k in enumerate(still.views.part) if still.made.body_of[k] == 0]
    problem, _ = problem_of(still, ())
    usual, wider = deviations_of_parameters(still), deviations_of_parameters(with_repeated_errors(still, root))
    mount = problem.skeleton.mount_columns(int(still.views.part[root[0]]))
    np.testing.assert_allclose((wider / usual)[mount], np.sqrt(REPEATED), rtol=0.3)
    others = [j for j in range(problem.skeleton.parameters) if j not in range(mount.start, mount.stop)]
    np.testing.assert_allclose((wider / usual)[others], 1.0, rtol=0.15)
