import numpy as np
import pytest

from calibration.intrinsics import CameraModel
from station.errors import InvalidFile
from station.formats.camera import format_camera, parse_camera

NAME = "lab/camera.toml"
GOOD = """schema = "camera/1"
size_px = [640, 480]
matrix = [[600, 0, 320.5], [0, 601.25, 240], [0, 0, 1]]
distortion = [0.1, -0.2, 0, 0, 0.0]
"""


def test_the_required_keys_are_enough() -> None:
    camera = parse_camera(GOOD, NAME)
    assert camera.size_px == (640, 480)
    np.testing.assert_array_equal(camera.matrix, [[600, 0, 320.5], [0, 601.25, 240], [0, 0, 1]])
    np.testing.assert_array_equal(camera.distortion, [0.1, -0.2, 0, 0, 0])
    assert camera.rms_px is camera.edge_shift_px is camera.readout_s is camera.when is camera.matrix_std is None


def test_a_camera_reads_back_bit_for_bit() -> None:
    rng = np.random.default_rng(0)
    camera = CameraModel(
        size_px=(1280, 720),
        matrix=np.array([[1000 / 3, 0, 640.1], [0, 1001 / 3, 359.9], [0, 0, 1]]),
        distortion=rng.normal(size=5),
        rms_px=0.1 + 0.2,
        edge_shift_px=-0.305,
        readout_s=1 / 45,
        when='2025-01-02 "after focus"\n\\ again',
        matrix_std=rng.uniform(size=(3, 3)),
        distortion_std=rng.uniform(size=5) * 1e-9,
    )
    again = parse_camera(format_camera(camera), NAME)
    assert (again.size_px, again.rms_px, again.edge_shift_px) == (camera.size_px, camera.rms_px, camera.edge_shift_px)
    assert (again.readout_s, again.when) == (camera.readout_s, camera.when)
    for key in ("matrix", "distortion", "matrix_std", "distortion_std"):
        np.testing.assert_array_equal(getattr(again, key), getattr(camera, key))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("distortion =", "focus = 3\ndistortion =", "focus: unknown key; known here: size_px, matrix"),
        ("[640, 480]", '[640, "480"]', "size_px 2: input should be a valid integer; have '480'"),
        ("[640, 480]", "[640.5, 480]", "size_px 1: input should be a valid integer; have 640.5"),
        ("[640, 480]", "[640]", "size_px: list should have at least 2 items"),
        ("601.25", "true", "matrix 2 2: input should be a valid number; have True"),
        ("601.25", "nan", "matrix 2 2: input should be a finite number; have nan"),
        ("601.25", "-601.25", "focal lengths are 600, -601.25 px; want both above zero"),
        ("-0.2, 0, 0, 0.0", "-0.2", "distortion: list should have at least 5 items"),
        ("camera/1", "camera/2", "has schema 'camera/2'; this station reads 'camera/1'"),
        ('schema = "camera/1"\n', "", "has no schema; this station reads 'camera/1'"),
        ("size_px = [640, 480]\n", "", "size_px: missing"),
        ("matrix = [[", "matrix = [", "is no TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_its_name_the_key_and_the_wish(old: str, new: str, message: str) -> None:
    assert old in GOOD
    with pytest.raises(InvalidFile, match=message) as caught:
        parse_camera(GOOD.replace(old, new), NAME)
    assert str(caught.value).startswith(NAME)
    assert len(str(caught.value).splitlines()) <= 5
