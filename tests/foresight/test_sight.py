"""Markers in the image, against OpenCV's projection and the perception's own angle."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calibration.intrinsics import CameraModel
from station.foresight.sight import imaged, sight
from station.kinematics import se3
from station.perception.pose import viewing_angles
from tests.foresight.scenes import CAMERA, DISTANCE_M, FACING, SIZE_M, at, mount, scene

Q = np.linspace(-1.2, 1.2, 25)


def still(q: np.ndarray) -> dict[str, np.ndarray]:
    return {"joint": np.broadcast_to(q, (3, *q.shape))}


def test_corners_are_where_opencv_projects_them():
    made = scene()
    seen = sight(made, still(Q))
    s = SIZE_M / 2
    corners_m = np.array([[-s, s, 0], [s, s, 0], [s, -s, 0], [-s, -s, 0]])
    for row, where in enumerate((at(-0.15, 0, 0), at(0.05, 0, -0.05))):
        for k, q in enumerate(Q):
            turn = se3.pose(se3.exp_so3(np.array([0, q, 0])), np.zeros(3)) if row else np.eye(4)
            T = at(0, 0, DISTANCE_M) @ turn @ where @ FACING
            px, _ = cv2.projectPoints(
                corners_m, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], CAMERA.matrix, CAMERA.distortion
            )
            assert seen.corners_px[k, row] == pytest.approx(np.reshape(px, (4, 2)), abs=1e-6)


def test_tilt_is_what_perception_says_of_a_pose():
    seen = sight(scene(), still(Q))
    assert seen.tilt_rad == pytest.approx(viewing_angles(seen.T_camera_marker), abs=1e-12)


def test_size_and_width_of_a_turned_marker_are_those_of_its_square():
    """In the middle of the image: f size / distance, and across, times the cosine of the tilt; perspective is 4 %."""
    made = scene(mounts=[mount(1, "arm", FACING)])
    seen = sight(made, still(np.array([0.0, 1.0])))
    face_on_px = 601 * SIZE_M / DISTANCE_M
    assert seen.size_px[:, 0] == pytest.approx([face_on_px] * 2, rel=0.05)
    assert seen.across_px[:, 0] == pytest.approx([face_on_px, face_on_px * np.cos(1.0)], rel=0.05)


def test_smear_is_how_far_the_fastest_corner_goes_while_the_shutter_is_open():
    made = scene("prismatic", mounts=[mount(1, "arm", FACING)], exposure_s=0.01)
    speed_m_s = 0.2
    exposed = {"joint": speed_m_s * 0.01 * np.array([[-0.5], [0.0], [0.5]])}
    seen = sight(made, exposed)
    assert seen.smear_px[0, 0] == pytest.approx(602 * speed_m_s * 0.01 / DISTANCE_M, rel=0.01)
    assert seen.speed_px_s[0, 0] == pytest.approx(seen.smear_px[0, 0] / 0.01)


def test_what_is_behind_the_camera_has_no_image():
    made = scene(mounts=[mount(1, "arm", at(0, 0, -2 * DISTANCE_M))])
    assert np.all(np.isnan(sight(made, still(np.zeros(1))).corners_px))


def test_a_folded_lens_model_brings_nothing_from_far_outside_into_the_image():
    barrel = CameraModel((640, 480), np.array([[300.0, 0, 320], [0, 300.0, 240], [0, 0, 1]]), [-0.3, 0, 0, 0, 0])
    # r (1 - 0.3 r^2) turns around at r = 1.05: at r = 1.8 the model alone has it back in the image.
    assert np.isfinite(imaged(barrel, np.array([0.9, 0.0, 1.0]))).all()
    assert np.isnan(imaged(barrel, np.array([1.8, 0.0, 1.0]))).all()
