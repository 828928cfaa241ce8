from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration.board_detection import BoardFinder
from calibration.camera_calibration import is_telling
from calibration.errors import CalibrationError
from calibration.view_quality import assess_view, cover, moved_px
from station.simulate.board_views import BoardRenderer, placed, turned
from station.simulate.scene import CameraOptics
from tests.board_sets import BOARD, good_poses, rendered, some_camera

MATRIX = np.array([[610.0, 0, 322.0], [0, 609.0, 243.0], [0, 0, 1]])
DISTORTION = np.array([0.06, -0.13, 0.0006, -0.0004, 0.05])
CLEAN = CameraOptics((640, 480), MATRIX, DISTORTION, blur_px=0.7, noise_grey=0.0)
FINDER = BoardFinder(BOARD)


def projected(optics: CameraOptics, T: np.ndarray, points: np.ndarray) -> np.ndarray:
    rvec, _ = cv2.Rodrigues(T[:3, :3])
    px, _ = cv2.projectPoints(points.reshape(-1, 3), rvec, T[:3, 3], optics.matrix, optics.distortion)
    return px.reshape(*points.shape[:-1], 2)


def view_of(optics: CameraOptics, T: np.ndarray, board=BOARD):
    image = BoardRenderer(board, optics, 0).render(T, 0)
    return FINDER.find(image), image


@pytest.mark.parametrize("gamma", [1.0, 2.2])
@pytest.mark.parametrize("tilt_deg", [0, 30, 45])
def test_rendered_corners_are_where_opencv_projects_them(tilt_deg: float, gamma: float):
    optics = replace(CLEAN, gamma=gamma)
    T = placed(BOARD, optics, (320, 240), 0.4, turned(np.radians(tilt_deg), 0.7, 0.2))
    view, _ = view_of(optics, T)
    error = view.corners_px - projected(optics, T, BOARD.corner_points()[view.ids])
    assert len(view) > 45
    assert np.abs(error.mean(axis=0)).max() < 0.015  # px: four standard deviations of a mean of 50
    assert 1.4826 * np.median(np.abs(error)) < 0.05  # the fit drops the few that are further off


def test_a_stretched_print_is_drawn_and_found_stretched():
    printed = BOARD.measured((96.0, 104.0))
    T = placed(printed, CLEAN, (320, 240), 0.45, turned(0.3, 0.7, 0.2))
    view, _ = view_of(CLEAN, T, printed)
    error = view.corners_px - projected(CLEAN, T, printed.corner_points()[view.ids])
    assert np.sqrt(np.mean(error**2)) < 0.05


def test_a_board_that_is_partly_out_of_the_image_is_found_in_part():
    T = placed(BOARD, CLEAN, (60, 80), 0.4, turned(0.3, 0.7, 0.2))
    view, _ = view_of(CLEAN, T)
    assert 8 < len(view) < BOARD.corner_count and is_telling(view, BOARD)
    assert np.all((view.corners_px > 0) & (view.corners_px < [640, 480]))


def test_no_board_is_found_where_there_is_none():
    assert not len(FINDER.find(np.full((480, 640), 128, np.uint8)))
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    assert not len(FINDER.find(noise))


@pytest.mark.parametrize("described", [{"columns": 6, "rows": 9}, {"columns": 8}, {"dictionary": "DICT_4X4_100"}])
def test_another_board_is_not_taken_for_this_one(described: dict[str, object]):
    images = rendered(CLEAN, good_poses(CLEAN, np.random.default_rng(0), 4), 0)
    finder = BoardFinder(replace(BOARD, **described))  # type: ignore[arg-type]
    assert not any(len(finder.find(image)) for image in images)


def test_a_row_more_in_the_description_does_no_harm():
    T = placed(BOARD, CLEAN, (320, 240), 0.4, turned(0.4, 0.7, 0.2))
    view, image = view_of(CLEAN, T)
    taller = BoardFinder(replace(BOARD, rows=11)).find(image)
    np.testing.assert_array_equal(taller.ids, view.ids)


def test_an_image_of_another_kind_is_refused():
    with pytest.raises(CalibrationError, match="want uint8"):
        FINDER.find(np.zeros((48, 64), np.float64))  # type: ignore[arg-type]


@pytest.mark.parametrize("blur_px", [0.6, 1.2, 2.0])
def test_the_blur_of_a_view_is_the_lenses(blur_px: float):
    optics = replace(CLEAN, blur_px=blur_px, noise_grey=1.5)
    view, image = view_of(optics, placed(BOARD, optics, (320, 240), 0.3, turned(0.3, 0.5, 0.2)))
    # The pixels and the gaps between samples add to the lens's: up to 0.4 px.
    want = np.hypot(blur_px, 0.3)
    assert abs(assess_view(view, image, BOARD).blur_px - want) < 0.25 * want


@pytest.mark.parametrize(
    ("axis_deg", "facing"),
    [(90, (-1, 0)), (-90, (1, 0)), (0, (0, 1)), (180, (0, -1))],
)
def test_tilt_and_facing_are_those_of_the_board(axis_deg: float, facing: tuple[float, float]):
    T = placed(BOARD, CLEAN, (322, 243), 0.4, turned(np.radians(30), np.radians(axis_deg), 0.0))
    view, image = view_of(CLEAN, T)
    quality = assess_view(view, image, BOARD, focal_px=610.0)
    assert quality.tilt_rad == pytest.approx(np.radians(30), abs=np.radians(1.0))
    np.testing.assert_allclose(quality.facing, facing, atol=0.05)
    # It faces right if its right edge is the one further away.
    edges = T @ np.array([[0, 0.1, 0, 1], [0.175, 0.1, 0, 1], [0.09, 0, 0, 1], [0.09, 0.25, 0, 1]]).T
    further = np.array([edges[2, 1] - edges[2, 0], edges[2, 3] - edges[2, 2]])
    np.testing.assert_array_equal(np.sign(np.round(further, 3)), facing)


def test_cover_and_moves_are_of_the_corners():
    optics = some_camera(np.random.default_rng(1))
    T = placed(BOARD, optics, (120, 140), 0.55 * optics.matrix[0, 0] / 610, turned(0.0, 0.0, 0.0))
    view, _ = view_of(optics, T)
    counts = cover([view, view])
    assert counts.sum() == 2 * len(view) and counts[:, 4:].sum() == 0
    moved = replace(view, corners_px=view.corners_px + np.array([3.0, 4.0]))
    assert moved_px(view, moved) == pytest.approx(5.0)
    assert moved_px(view, replace(view, ids=view.ids[:0], corners_px=view.corners_px[:0])) == np.inf
