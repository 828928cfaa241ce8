"""A log's corners as the fit in the image takes them."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.intrinsics import project
from station.fit.image.views import Views
from station.kinematics import se3
from station.perception.corner_noise import total_covariance
from station.perception.markers import Marker, MarkerTable
from station.perception.observations import ObservationLog
from station.tracking import views_of
from tests.noisy_corners import of_edges
from tests.test_tracking import CAMERA, DICTIONARY, SIZE_M, tilted, watch

SIDEWAYS = se3.exp(np.array([0.03, -0.01, 0.02, 0.1, -0.4, 0.2]))
TABLE = MarkerTable(
    DICTIONARY,
    (
        Marker(7, "lid", SIZE_M),
        Marker(3, "box", 0.03, se3.exp(np.array([-0.04, 0.0, 0.0, 0.0, 0.2, 0.0]))),
        Marker(5, "box", SIZE_M, SIDEWAYS),
    ),
)
FRAMES = 12


def seen(table: MarkerTable = TABLE, sigma_px: float = 0.0) -> tuple[ObservationLog, np.ndarray]:
    """Observations of a table's markers, and where its parts were (T, K, 4, 4)."""
    lid = tilted(np.linspace(20.0, 50.0, FRAMES))
    box = lid @ se3.exp(np.array([0.1, 0.02, 0.05, 0.0, 0.3, 0.5]))
    T_cam_part = np.stack([lid, box], axis=1)[:, : len(table.parts)]
    return watch(T_cam_part, table, sigma_px, noise=of_edges), T_cam_part


def predicted_px(views: Views, T_cam_part: np.ndarray) -> np.ndarray:
    """(N, 4, 2) corners of parts (T, K, 4, 4) by the views' own points."""
    T = T_cam_part[views.frame, views.part[views.marker]]
    points = views.points_m[views.marker]
    return project(views.camera, points @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3])


def test_corners_of_views_are_where_their_parts_put_them() -> None:
    observations, T_cam_part = seen()
    views = views_of(observations, TABLE, CAMERA)
    assert (views.parts, views.marker_id.tolist(), views.part.tolist()) == (("lid", "box"), [7, 3, 5], [0, 1, 1])
    assert len(views) == 3 * FRAMES
    np.testing.assert_allclose(views.corners_px, predicted_px(views, T_cam_part), atol=1e-9)


def test_the_likelier_solution_of_a_view_is_the_pose_of_its_part() -> None:
    observations, T_cam_part = seen()
    views = views_of(observations, TABLE, CAMERA)
    truth = T_cam_part[views.frame, views.part[views.marker]]
    np.testing.assert_allclose(views.T_ref_part[:, 0], truth, atol=1e-5)
    assert np.isfinite(views.T_ref_part[:, 1]).any()


def test_views_leave_out_markers_that_are_in_no_table_and_keep_every_frame() -> None:
    observations, _ = seen()
    views = views_of(observations, MarkerTable(DICTIONARY, TABLE.markers[1:]), CAMERA)
    assert views.parts == ("box",)
    assert set(views.marker_id[views.marker].tolist()) == {3, 5}
    np.testing.assert_array_equal(views.t_s, observations.t_s)


@pytest.mark.parametrize(("sigma_px", "readout_s"), [(None, None), (0.07, 0.02)])
def test_views_have_the_covariances_and_the_readout_that_poses_are_estimated_with(
    sigma_px: float | None, readout_s: float | None
) -> None:
    observations, _ = seen(sigma_px=0.1)
    camera = replace(CAMERA, readout_s=0.01)
    views = views_of(observations, TABLE, camera, sigma_px=sigma_px, readout_s=readout_s)
    want = total_covariance(observations, TABLE.sizes_m(observations.marker_id), camera, sigma_px)
    np.testing.assert_array_equal(views.covariance_px2, want)
    assert views.readout_s == (0.01 if readout_s is None else readout_s)
