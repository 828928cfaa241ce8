"""The simulated views are what they say: against the station's own projection and tracking, row by row and noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.intrinsics import project
from station.kinematics import se3
from station.quadrilaterals import shift_edges
from station.tracking import views_of
from tests.fit.image.seen_objects import Scene, pixels, tilts
from tests.fit.image.simulated_views import Seeing, Watched, corners_px, shifted, watched

SMALL = Scene(joints=3, kinds=("revolute", "prismatic", "screw"), frames=40, trackers=(1, 2), markers=(1, 2))
EXACT = Seeing(sigma_px=1e-9)


def modelled(found: Watched) -> np.ndarray:
    """(N, 4, 2) by the station's own projection of the true poses."""
    T = found.made.T_ref_part[found.views.frame, found.views.part[found.views.marker]]
    points = found.views.points_m[found.views.marker]
    return project(found.true_camera, points @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3])


@pytest.mark.parametrize("root_moves", [False, True])
def test_corners_are_those_of_the_true_tree(root_moves: bool) -> None:
    found = watched(1, replace(SMALL, root_moves=root_moves), EXACT)
    np.testing.assert_allclose(found.views.corners_px, modelled(found), atol=1e-7)  # px
    tree, states = found.tree, found.states
    T_root_part = tree.forward(states.q)
    for part in tree.bodies:
        T = found.truth.T_ref_part[:, found.made.parts.index(tree.root)] @ T_root_part[part]
        np.testing.assert_allclose(T, found.truth.T_ref_part[:, found.made.parts.index(part)], atol=1e-12)


def test_views_are_those_of_the_stations_own_tracking() -> None:
    found = watched(2, SMALL, Seeing(missing=0.1))
    own = views_of(found.observations, found.table, found.views.camera, sigma_px=found.seeing.sigma_px)
    assert own.parts == found.views.parts
    for name in ("t_s", "marker_id", "part", "frame", "marker"):
        np.testing.assert_array_equal(getattr(own, name), getattr(found.views, name))
    for name in ("points_m", "corners_px", "covariance_px2", "T_ref_part"):
        np.testing.assert_allclose(getattr(own, name), getattr(found.views, name), atol=1e-12)


@pytest.mark.parametrize("tilt_deg", [(0.0, 20.0), (50.0, 75.0)])
def test_markers_stay_in_the_picture_at_the_tilts_asked_for(tilt_deg: tuple[float, float]) -> None:
    found = watched(3, replace(SMALL, tilt_deg=tilt_deg, course="steps"), EXACT)
    T = found.made.T_ref_part[:, list(found.seen.part_of)] @ found.seen.T_part_marker
    tilt_deg_seen = np.degrees(tilts(T))
    assert tilt_deg[0] <= tilt_deg_seen.min()
    assert tilt_deg_seen.max() <= tilt_deg[1]
    assert np.all((found.views.corners_px > 0) & (found.views.corners_px < (640, 480)))


def test_a_rolling_shutter_shows_each_corner_at_its_own_rows_time() -> None:
    found = watched(4, replace(SMALL, root_moves=True), replace(EXACT, readout_s=0.025))
    px = corners_px(found.seen, found.true_camera, found.views.t_s, 0.025)
    late_s = (px[7, 2, 3, 1] / 480 - 0.5) * 0.025
    T = found.seen.at(np.array([found.views.t_s[7] + late_s])).T_ref_part[0]
    np.testing.assert_allclose(pixels(found.true_camera, found.seen.corners_m(T)[2, 3]), px[7, 2, 3], atol=1e-9)
    still = corners_px(found.seen, found.true_camera, found.views.t_s)
    assert np.abs(px - still).max() > 0.5  # px


def test_an_edge_shift_moves_edges_outward() -> None:
    px = watched(5, SMALL, EXACT).views.corners_px
    np.testing.assert_allclose(shifted(px, -0.3), shift_edges(px, -0.3), atol=1e-9)


@pytest.mark.parametrize("correlated", [False, True])
def test_noise_has_the_covariance_that_is_told(correlated: bool) -> None:
    found = watched(6, replace(SMALL, frames=300), Seeing(sigma_px=0.2, correlated=correlated, stated=0.5))
    white = np.linalg.solve(np.linalg.cholesky(found.views.covariance_px2), found.error_px[..., None])[..., 0]
    spread = white.T @ white / len(white)
    # Stated at half of what it is; a sum of N squares errs by sqrt(2 / N) = 3 %, of which 5 are allowed.
    np.testing.assert_allclose(spread, 4 * np.eye(8), atol=4 * 5 * np.sqrt(2 / len(white)))


def test_outliers_and_missing_sightings_are_as_many_as_asked_for() -> None:
    found = watched(7, replace(SMALL, frames=300), Seeing(missing=0.2, outliers=0.05))
    shown = found.views.t_s.size * len(found.views.marker_id)
    assert len(found.views) / shown == pytest.approx(0.8, abs=0.03)
    assert found.outlier.mean() == pytest.approx(0.05, abs=0.015)
    assert np.linalg.norm(found.error_px[found.outlier], axis=-1).min() > 5.0  # px


def test_poses_are_near_the_truth() -> None:
    found = watched(8, replace(SMALL, tilt_deg=(25.0, 60.0)), Seeing(sigma_px=0.05, correlated=True))
    off = se3.log(se3.inverse(found.truth.T_ref_part) @ found.poses.T_ref_part)
    assert np.median(np.linalg.norm(off[..., 3:], axis=-1)) < np.radians(0.5)
    assert np.median(np.linalg.norm(off[..., :3], axis=-1)) < 0.002  # m
