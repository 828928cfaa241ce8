"""Calibrations from rendered views: good sets are called good and are, bad ones are called bad in words."""

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from calibration.camera_calibration import CameraCalibration, calibrate_camera
from calibration.camera_fit import parameters_of
from calibration.edge_shift import edge_offsets, estimate_edge_shift
from calibration.errors import CalibrationError
from calibration.verdict import Grade
from calibration.wrong_board import edge_spread_px, explain_missing
from station.calibrating.files import write_calibration
from station.commands.cameras import marker_refinement
from station.formats.camera import parse_camera
from station.simulate.scene import CameraOptics
from tests.board_sets import (
    BAD_SETS,
    BOARD,
    good_poses,
    rendered,
    shots_of,
    some_camera,
    true_parameters,
)
from tests.calibration.test_board_detection import projected

REFINE = marker_refinement(BOARD)


def good_set(seed: int, jpeg: int | None = None, **changes: float) -> tuple[CameraOptics, CameraCalibration]:
    rng = np.random.default_rng(seed)
    optics = replace(some_camera(rng), **changes)
    return optics, calibrate_camera(shots_of(rendered(optics, good_poses(optics, rng), seed, jpeg=jpeg)), BOARD, REFINE)


@pytest.fixture(scope="module")
def good() -> tuple[CameraOptics, CameraCalibration]:
    return good_set(20)


def test_a_good_set_is_called_good_and_its_numbers_hold(good):
    optics, done = good
    assert done.verdict.grade is Grade.GOOD and done.verdict.remarks == ()
    error = np.abs(parameters_of(done.camera) - true_parameters(optics))
    assert np.all(error[:4] < 3 * done.fit.std[:4])
    assert np.all(done.fit.std[:4] < 0.6)  # px of some 600
    assert done.held_out is not None and done.camera.rms_px is not None
    assert done.held_out.rms_px < 1.3 * done.camera.rms_px
    assert done.marker_share == pytest.approx(1.0, abs=0.01)


def test_jpeg_and_noise_are_within_what_is_stated():
    optics, done = good_set(21, jpeg=70, noise_grey=4.0)
    error = np.abs(parameters_of(done.camera) - true_parameters(optics))
    assert np.all(error[:4] < 3 * done.fit.std[:4]) and done.verdict.grade is Grade.GOOD


def test_what_is_written_reads_back(good, tmp_path: Path):
    _, done = good
    write_calibration(tmp_path, done, BOARD, datetime.now(UTC))
    camera = parse_camera((tmp_path / "camera.toml").read_text("utf-8"), "camera.toml")
    np.testing.assert_array_equal(camera.matrix, done.camera.matrix)
    assert camera.edge_shift_std_px == done.camera.edge_shift_std_px is not None
    document = json.loads((tmp_path / "calibration.json").read_text("utf-8"))
    assert document["schema"] == "calibration/1" and document["verdict"]["grade"] == "good"
    assert document["parameters"]["fx"]["std"] == pytest.approx(done.fit.std[0])
    assert len(document["views"]) == len(done.shots) and np.shape(document["covariance"]) == (9, 9)
    assert (tmp_path / "coverage.png").stat().st_size > 1000


# What each bad set must be told, in words.
SAID = {
    "all frontal": "views are tilted",
    "all in one corner": "never shows a corner of the board",
    "blurred": "they are blurred",
    "moving": "they are blurred",
    "four views": "only 4 views",
    "described with other columns": "on a board of 7 squares across",
    "described with another dictionary": "markers of DICT_5X5_50",
    "described with larger markers": "it is another board's",
}


@pytest.mark.parametrize("name", BAD_SETS)
def test_a_bad_set_is_called_bad_in_words(name: str):
    rng = np.random.default_rng(22)
    board, images = BAD_SETS[name](some_camera(rng), rng)
    shots = shots_of(images, board)
    if len(shots) < 3:
        assert SAID[name] in explain_missing(images, board)
        return
    done = calibrate_camera(shots, board, REFINE)
    assert done.verdict.grade is Grade.BAD
    remark = next(each for each in done.verdict.remarks if SAID[name] in each.what)
    assert remark.grade is Grade.BAD and remark.do
    assert np.all(np.isfinite(done.fit.std))
    assert np.all(np.abs(parameters_of(done.camera)[:2] / 640 - 1) < 1)  # nothing wild


def test_slightly_blurred_views_are_found_and_called_blurred():
    _, done = good_set(23, blur_px=1.6, noise_grey=1.0)
    assert done.verdict.grade is not Grade.GOOD
    assert any("are blurred" in remark.what for remark in done.verdict.remarks)


def test_a_plain_wall_is_no_board_and_sharp_edges_are_sharp():
    wall = [np.full((480, 640, 3), 128, np.uint8)] * 3
    assert "no marker of any dictionary" in explain_missing(wall, BOARD)
    optics = some_camera(np.random.default_rng(1))
    (image,) = rendered(optics, good_poses(optics, np.random.default_rng(0), 1), 0)
    assert edge_spread_px(image[..., 0]) < 1.5


def test_images_of_several_sizes_are_refused():
    rng = np.random.default_rng(24)
    optics = some_camera(rng)
    larger = replace(optics, size_px=(800, 600))
    poses = good_poses(optics, rng, 3)
    shots = shots_of([*rendered(optics, poses, 0), *rendered(larger, poses, 0)])
    with pytest.raises(CalibrationError, match=r"several sizes: 640x480 px \(0.png\), 800x600 px"):
        calibrate_camera(shots, BOARD)


@pytest.mark.parametrize("gamma", [1.4, 2.2, 3.0])
def test_the_edge_shift_is_that_of_the_detector_on_true_corners(gamma: float):
    optics, done = good_set(25, gamma=gamma, blur_px=1.0, noise_grey=1.5)
    rng = np.random.default_rng(25)
    poses = good_poses(replace(some_camera(rng), gamma=gamma), rng)
    offsets = []
    for shot in done.shots:
        T = poses[int(Path(shot.name).stem)]
        ids, corners = REFINE(shot.image, shot.view.marker_ids, shot.view.marker_corners_px, done.camera)
        offsets.append(edge_offsets(corners, projected(optics, T, BOARD.marker_points()[ids])).ravel())
    true_px = float(np.median(np.concatenate(offsets)))
    assert done.edge_shift is not None
    assert abs(done.edge_shift.shift_px - true_px) < 3 * done.edge_shift.std_px
    assert done.edge_shift.std_px < 0.03
    assert (abs(true_px) > 0.05) == (gamma != 2.2)  # linear light is that of gamma 2.2


def test_an_edge_shift_needs_markers_and_survives_strays():
    rng = np.random.default_rng(0)
    true_px = np.array([(0, 0), (40, 0), (40, 40), (0, 40)]) + rng.uniform(0, 400, (60, 1, 2))
    outward = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    seen_px = true_px - 0.2 * outward + rng.normal(scale=0.05, size=true_px.shape)
    seen_px[7] += 3.0 * outward
    shift = estimate_edge_shift(seen_px, true_px, np.arange(60) // 6)
    assert abs(shift.shift_px + 0.2) < 3 * shift.std_px < 0.1 and shift.markers == 59
    with pytest.raises(CalibrationError, match="3 markers tell no edge shift"):
        estimate_edge_shift(seen_px[:3], true_px[:3], np.zeros(3, np.int64))


def test_a_view_that_fits_no_camera_with_the_others_is_left_out(good):
    _, done = good
    shots = list(done.shots)
    odd = shots[4]
    points = BOARD.corner_points()[odd.view.ids, :2]
    bent = odd.view.corners_px + 60 * np.sin(40 * points)  # as of a sheet that was not flat
    shots[4] = replace(odd, view=replace(odd.view, corners_px=bent))
    again = calibrate_camera(shots, BOARD)
    assert again.left_out == (odd.name,)
    assert np.all(np.abs(parameters_of(again.camera) - parameters_of(done.camera))[:4] < 3 * done.fit.std[:4])
