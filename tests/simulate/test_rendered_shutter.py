"""A rolling shutter's pictures against cv2.projectPoints, each point at the time of its own row."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest

from calibration.intrinsics import CameraModel
from station.errors import InvalidData
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.corners import MarkerDetector
from station.perception.markers import Marker, MarkerTable
from station.simulate import render
from station.simulate.render import CameraOptics
from station.stage import SHUTTER_BANDS
from station.tracking import observe_frames, track_parts
from tests.simulate.test_render import (
    EDGE_POINTS,
    NO_DISTORTION,
    SIZE_M,
    WEBCAM,
    box,
    errors_of_edges,
    marker_points,
    moving_renderer,
    moving_scene,
    optics,
    plate,
    pose,
    projected,
    renderer,
)

READOUT_S = 0.025
Motion = Callable[[float], FloatArray]
CORNERS = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * SIZE_M / 2


def knots_s(bands: int = SHUTTER_BANDS) -> FloatArray:
    return (np.arange(bands + 1) / bands - 0.5) * READOUT_S


def swinging(k: int) -> Motion:
    """A marker that swings as on an arm: 0.3 m from the axis at 1.5 rad/s, turning over at 3 rad/s, speeding up."""
    turn = 2 * np.pi * k / 7

    def motion(t_s: float) -> FloatArray:
        angle = turn + 1.5 * t_s + 0.5 * 6.0 * t_s**2
        across = pose((0.10 * np.cos(angle) * 3 - 0.3 * np.cos(turn), 0.3 * np.sin(angle) - 0.3 * np.sin(turn), 0.5))
        tilted = pose((0, 0, 0), (0.4 + 3.0 * t_s, 0.3, angle))
        T = across.copy()
        T[:3, :3] = tilted[:3, :3]
        return T

    return motion


def at_own_times(points_m: FloatArray, motion: Motion, camera: CameraOptics, later_s: float = 0.0) -> FloatArray:
    """Pixels (N, 2) of points (N, 3), each with the body where it was when the point's own row was exposed."""
    pixels = projected(points_m, motion(later_s), camera)
    for _ in range(5):  # the row decides the time, which decides the row; each time twenty times nearer
        times_s = (pixels[:, 1] / camera.size_px[1] - 0.5) * READOUT_S + later_s
        each = [projected(p[None], motion(t), camera) for p, t in zip(points_m, times_s, strict=True)]
        pixels = np.concatenate(each)
    return pixels


def drawn(motion: Motion, camera: CameraOptics, later_s: Sequence[float] = (0.0,), bands: int = SHUTTER_BANDS):
    poses = np.array([[[motion(t + later)] for t in knots_s(bands)] for later in later_s])
    return renderer([plate()], camera=camera).render(poses, 0)


def true_edges(motion: Motion, camera: CameraOptics, later_s: float = 0.0) -> FloatArray:
    return np.array([at_own_times(edge, motion, camera, later_s) for edge in marker_points(EDGE_POINTS)])


@pytest.mark.parametrize("distortion", [NO_DISTORTION, WEBCAM])
def test_edges_lie_where_each_rows_own_time_puts_them(distortion: Sequence[float]) -> None:
    camera = optics((640, 480), 600.0, distortion, blur_px=0.4)
    errors: list[FloatArray] = []
    still: list[FloatArray] = []
    for k in range(7):
        image = drawn(swinging(k), camera)
        errors.append(errors_of_edges(image, true_edges(swinging(k), camera)))
        one_time = [projected(edge, swinging(k)(0.0), camera) for edge in marker_points(EDGE_POINTS)]
        still.append(np.array(one_time) - true_edges(swinging(k), camera))
    # px. As for a global shutter (tests/simulate/test_render.py).
    assert abs(np.mean(errors)) < 0.003
    assert np.sqrt(np.mean(np.square(errors))) < 0.012
    assert np.abs(errors).max() < 0.06
    assert np.abs(still).max() > 1.0  # what leaving the shutter out of the truth would cost


def test_blur_and_shutter_work_together() -> None:
    """The mean light of several instants has its edges at the mean of theirs."""
    camera = optics((640, 480), 600.0, blur_px=0.4)
    later_s = (-0.002, 0.0, 0.002)
    errors = []
    for k in range(7):
        image = drawn(swinging(k), camera, later_s)
        truth = np.mean([true_edges(swinging(k), camera, later) for later in later_s], axis=0)
        errors.append(errors_of_edges(image, truth))
    assert abs(np.mean(errors)) < 0.005
    assert np.sqrt(np.mean(np.square(errors))) < 0.02  # px


def test_the_stations_corners_are_where_each_corners_own_time_puts_them() -> None:
    camera = optics((640, 480), 600.0, WEBCAM, blur_px=0.6, noise_grey=1.0, gamma=2.2)
    errors = []
    for k in range(7):
        found = MarkerDetector("DICT_4X4_50").detect(drawn(swinging(k), camera))
        assert found.ids.tolist() == [0]
        errors.append(found.corners_px[0] - at_own_times(CORNERS, swinging(k), camera))
    # px. The detector's own error is some 0.04.
    assert np.sqrt(np.mean(np.square(errors))) < 0.06
    assert np.abs(np.mean(errors, axis=0)).max() < 0.06


def test_poses_are_those_of_the_frames_time_when_the_readout_is_known() -> None:
    camera = optics((640, 480), 600.0, WEBCAM, blur_px=0.6, noise_grey=1.0, gamma=2.2)
    model = CameraModel(camera.size_px, camera.matrix, camera.distortion)
    table = MarkerTable("DICT_4X4_50", (Marker(0, "plate", SIZE_M),))
    motion, t_s = swinging(0), np.arange(-6, 7) / 30.0
    frames = [(t, drawn(lambda later, t=t: motion(t + later), camera)) for t in t_s]
    seen = observe_frames(frames, table, model)
    truth = np.stack([motion(t) for t in t_s])
    within, turned = {}, {}
    for readout_s in (0.0, READOUT_S):
        T = track_parts(seen, table, model, readout_s=readout_s).poses.T_ref_part[1:-1, 0]  # both neighbours seen
        apart = se3.log(se3.inverse(truth[1:-1]) @ T)
        within[readout_s] = np.linalg.norm(apart[:, :3], axis=1).max()
        turned[readout_s] = np.rad2deg(np.linalg.norm(apart[:, 3:], axis=1)).max()
    assert turned[0.0] > 1.0 and within[0.0] > 2e-3  # deg, m: what leaving the shutter out costs
    assert turned[READOUT_S] < 0.2 and within[READOUT_S] < 5e-4


def test_knots_that_show_the_same_are_a_global_shutter() -> None:
    def instants(frame: int) -> FloatArray:
        return np.array([moving_scene(frame), moving_scene(frame + 1)])

    for frame in range(4):
        rolling, at_once = moving_renderer(), moving_renderer()
        repeated = np.repeat(instants(frame)[:, None], 5, axis=1)
        np.testing.assert_array_equal(rolling.render(repeated, frame), at_once.render(instants(frame), frame))


def test_a_frame_is_the_same_however_cached() -> None:
    def knots(frame: int) -> FloatArray:
        return np.array([[moving_scene(frame + k) for k in range(3)]])

    one = moving_renderer()
    for k in (0, 1, 2, 3, 3, 1, 0):
        np.testing.assert_array_equal(one.render(knots(k), k), moving_renderer().render(knots(k), k))


def test_bands_meet_without_a_seam_whatever_the_height() -> None:
    """A box that fills the image is one colour, its rows as many as the image has, whatever rows the bands end at."""
    for height in (97, 98, 99, 100):
        camera = optics((64, height), 60.0)
        slid = np.array([[[pose((0.01 * k, 0, 0.1))] for k in range(5)]])
        image = renderer([], [box((9, 9, 0.02))], camera).render(slid, 0)
        assert image.shape == (height, 64, 3)
        levels = image.reshape(-1, 3).astype(int)
        assert np.all(levels[:, 2] > 2 * levels[:, 0])  # orange, no row of wall


def test_regions_of_interest_cut_nothing_of_what_moves_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = optics((160, 120), 120.0, WEBCAM)
    rng = np.random.default_rng(6)
    scenes: list[FloatArray] = []
    for _ in range(25):
        at, turn, step, roll = rng.uniform((-0.2, -0.2, 0.2), (0.2, 0.2, 0.6)), *rng.normal(size=(3, 3))
        scenes.append(np.array([[[pose(at + 0.01 * k * step, turn + 0.03 * k * roll)] for k in range(5)]]))
    parts = [plate()], [box((0.08, 0.08, 0.05))]
    cut = [renderer(*parts, camera).render(scene, 0) for scene in scenes]

    def whole_image(T_cam_quad: FloatArray, *_: object) -> np.ndarray:
        return np.tile(np.array([0, 0, 160, 120]), (len(T_cam_quad), 1))

    monkeypatch.setattr(render, "regions", whole_image)
    for scene, image in zip(scenes, cut, strict=True):
        uncut = renderer(*parts, camera).render(scene, 0)
        np.testing.assert_array_equal(uncut, image)


def test_poses_of_other_shapes_are_refused() -> None:
    for shape in ((0, 1, 1, 4, 4), (1, 0, 1, 4, 4), (1, 1, 1, 1, 4, 4)):
        with pytest.raises(InvalidData, match=r"\(instants, rows, bodies, 4, 4\)"):
            renderer([plate()]).render(np.zeros(shape), 0)


def test_a_marker_seen_by_a_rolling_shutter_is_skewed_not_blurred() -> None:
    camera = optics((640, 480), 600.0)

    def sideways(t_s: float) -> FloatArray:
        return pose((2.0 * t_s, 0, 0.5))

    found = MarkerDetector("DICT_4X4_50").detect(drawn(sideways, camera))
    left, _, _, low_left = found.corners_px[0]
    rows = low_left[1] - left[1]
    lean_px = 2.0 * 600.0 / 0.5 * READOUT_S * rows / 480  # speed in px/s times the time between the two corners
    assert low_left[0] - left[0] == pytest.approx(lean_px, abs=0.1)
    assert cv2.isContourConvex(found.corners_px[0].astype(np.float32))
