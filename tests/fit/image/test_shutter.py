"""Motion while a rolling shutter reads a frame: exact for even motions, nothing where nothing is known."""

from __future__ import annotations

import numpy as np

from station.fit.image.shutter import LONGEST_GAP_S, motion_of, moved_points
from station.kinematics import se3

T_S = np.array([0.0, 0.03, 0.07, 0.1, 0.5])
ROW = np.tile(np.array([-0.5, -0.1, 0.2, 0.5]), (5, 1, 1))
READOUT_S = 0.025


def test_an_even_motion_is_followed_exactly_whatever_the_frames_times() -> None:
    xi = np.array([0.2, -0.1, 0.3, 0.5, -0.4, 0.6])
    poses = se3.exp(T_S[:, None, None] * xi)
    motion = motion_of(T_S, ROW, np.ones((5, 1), bool)).through(poses)
    found, by_readout = motion.at(READOUT_S)
    wanted = READOUT_S * ROW[..., None] * xi
    np.testing.assert_allclose(found[:4], wanted[:4], atol=1e-12)
    np.testing.assert_allclose(by_readout[:4], (ROW[..., None] * xi)[:4], atol=1e-12)


def test_a_motion_whose_speed_changes_evenly_is_followed_between_two_neighbours() -> None:
    times, xi = np.array([0.0, 0.03, 0.07]), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    angle = 0.5 * times + 2.0 * times**2
    motion = motion_of(times, ROW[:3], np.ones((3, 1), bool)).through(se3.exp(angle[:, None, None] * xi))
    s = READOUT_S * ROW[1]
    wanted = 0.5 * s + 2.0 * ((times[1] + s) ** 2 - times[1] ** 2)
    np.testing.assert_allclose(motion.at(READOUT_S)[0][1, ..., 5], wanted, atol=1e-12)


def test_nothing_is_interpolated_over_a_long_gap_or_where_a_marker_was_not_seen() -> None:
    seen = np.array([True, False, True, True, True])[:, None]
    motion = motion_of(T_S, ROW, seen).through(se3.exp(T_S[:, None, None] * np.ones(6)))
    assert T_S[4] - T_S[3] > LONGEST_GAP_S
    still = np.abs(motion.at(READOUT_S)[0]).max(axis=(1, 2, 3)) == 0
    np.testing.assert_array_equal(still, [True, True, False, False, True])


def test_the_readouts_derivative_is_that_of_a_finite_difference() -> None:
    rng = np.random.default_rng(0)
    poses = se3.exp(0.05 * rng.normal(size=(5, 1, 6)))
    motion = motion_of(T_S, ROW, np.ones((5, 1), bool)).through(poses)
    ends = [motion.at(READOUT_S + d)[0] for d in (1e-6, -1e-6)]
    np.testing.assert_allclose(motion.at(READOUT_S)[1], (ends[0] - ends[1]) / 2e-6, atol=1e-7)


def test_points_are_moved_as_by_the_exponential_of_a_small_twist() -> None:
    rng = np.random.default_rng(1)
    xi, p = rng.normal(size=(50, 6)), rng.normal(size=(50, 3))
    xi *= 0.1 / np.linalg.norm(xi, axis=-1, keepdims=True)
    wanted = (se3.exp(xi)[:, :3, :3] @ p[..., None])[..., 0] + se3.exp(xi)[:, :3, 3]
    np.testing.assert_allclose(moved_points(xi, p), wanted, atol=1.5e-5)
    assert np.abs(p - wanted).max() > 0.05
