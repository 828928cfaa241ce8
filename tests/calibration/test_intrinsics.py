import cv2
import numpy as np
import pytest

from calibration.errors import CalibrationError
from calibration.intrinsics import CameraModel, project, project_jacobian

MATRIX = np.array([[600.0, 0, 321.5], [0, 602.0, 238.0], [0, 0, 1]])
DISTORTION = np.array([-0.31, 0.12, 0.002, -0.003, 0.05])


def camera(**changes: object) -> CameraModel:
    return CameraModel(**{"size_px": (640, 480), "matrix": MATRIX, "distortion": DISTORTION} | changes)  # type: ignore[arg-type]


def points(count: int = 200) -> np.ndarray:
    rng = np.random.default_rng(4)
    return np.column_stack([rng.uniform(-0.3, 0.3, (count, 2)), rng.uniform(0.4, 1.5, count)])


def test_project_agrees_with_opencv() -> None:
    p = points()
    truth, _ = cv2.projectPoints(p, np.zeros(3), np.zeros(3), MATRIX, DISTORTION)
    np.testing.assert_allclose(project(camera(), p), truth.reshape(-1, 2), atol=1e-9)  # px, rounding


def test_project_jacobian_agrees_with_finite_differences() -> None:
    p, step_m = points(), 1e-6
    steps = step_m * np.eye(3)
    numeric = np.stack([(project(camera(), p + s) - project(camera(), p - s)) / (2 * step_m) for s in steps], axis=-1)
    np.testing.assert_allclose(project_jacobian(camera(), p), numeric, rtol=1e-6, atol=1e-4)  # px/m of some 1000


def test_points_behind_the_camera_have_no_image() -> None:
    behind = np.array([[0.0, 0.0, -1.0], [0.1, 0.0, 0.0]])
    assert np.all(np.isnan(project(camera(), behind)))
    assert np.all(np.isnan(project_jacobian(camera(), behind)))


def test_a_camera_is_frozen_and_its_own() -> None:
    matrix = MATRIX.copy()
    model = camera(matrix=matrix)
    matrix[0, 0] = 1.0
    assert model.matrix[0, 0] == 600.0
    with pytest.raises(ValueError, match="read-only"):
        model.matrix[0, 0] = 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"size_px": (640, 0)}, "size_px"),
        ({"size_px": (640,)}, "size_px"),
        ({"size_px": (640.5, 480)}, "size_px"),
        ({"matrix": MATRIX.T}, "camera matrix must be"),
        ({"matrix": np.diag([-600.0, 600.0, 1.0])}, "focal lengths"),
        ({"matrix": MATRIX[:2]}, r"matrix has shape \(2, 3\); want \(3, 3\)"),
        ({"matrix": MATRIX * np.nan}, "not finite"),
        ({"distortion": np.zeros(4)}, r"distortion has shape \(4,\); want \(5,\)"),
        ({"rms_px": -0.1}, "rms_px"),
        ({"edge_shift_px": np.nan}, "edge_shift_px"),
        ({"readout_s": -1.0}, "readout_s"),
        ({"matrix_std": -np.ones((3, 3))}, "negative standard deviations"),
        ({"distortion_std": np.zeros(3)}, "distortion_std has shape"),
    ],
)
def test_what_is_no_camera_is_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        camera(**changes)


def test_a_scaled_camera_sees_the_same_picture_at_another_size() -> None:
    camera = CameraModel(
        size_px=(1280, 720),
        matrix=np.array([[900.0, 0, 640.5], [0, 910, 350.25], [0, 0, 1]]),
        distortion=np.array([0.1, -0.2, 1e-3, -2e-3, 0.01]),
        rms_px=0.4,
        edge_shift_px=-0.3,
        matrix_std=np.array([[2.0, 0, 1], [0, 2, 1], [0, 0, 0]]),
    )
    half = camera.scaled_to((640, 360))
    points = np.random.default_rng(0).uniform((-0.4, -0.2, 0.8), (0.4, 0.2, 1.2), (50, 3))
    # Pixel (0, 0) is the middle of the top-left pixel: the picture's own corner is at (-0.5, -0.5) at any size.
    np.testing.assert_allclose(project(half, points), (project(camera, points) + 0.5) / 2 - 0.5, atol=1e-9)
    assert (half.size_px, half.rms_px, half.edge_shift_px) == ((640, 360), 0.2, None)
    np.testing.assert_allclose(half.matrix_std, camera.matrix_std / 2)
