"""Calibrations in the files of OpenCV and ROS: what cv2 writes and ROS's tools write is read, what they mean otherwise
is refused in words.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.intrinsics import CameraModel
from station.errors import InvalidFile
from station.formats.camera import format_camera
from station.formats.camera_files import format_camera_opencv, format_camera_ros, read_camera
from station.formats.rig import load_calibration
from station.rig_reading import read_rig

CAMERA = CameraModel(
    size_px=(1280, 720),
    matrix=np.array([[1000 / 3, 0, 640.1], [0, 1001 / 3, 359.9], [0, 0, 1]]),
    distortion=np.array([0.1, -0.2, 1e-5, -3e-4, 1 / 7]),
    rms_px=0.1 + 0.2,
)
# As ROS's camera_calibration writes it.
ROS = """image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [526.6908296825479, 0, 312.3333507245396, 0, 525.7542623070541, 246.2279496394374, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [1.864e-2, -8.07953154457166e-02, 0.00067, -1e-05, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [516.2, 0, 310.36, 0, 0, 514.04, 246.88, 0, 0, 0, 1, 0]
"""
# As `rostopic echo -n 1 camera_info` prints a message.
ROS_MESSAGE = """header:
  seq: 4
  stamp: {secs: 1305031102, nsecs: 175304}
  frame_id: optical
height: 480
width: 640
distortion_model: "plumb_bob"
D: [0.1, -0.2, 0.0, 0.0, 0.0]
K: [525.0, 0.0, 319.5, 0.0,
    526.0, 239.5, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [525.0, 0.0, 319.5, 0.0, 0.0, 526.0, 239.5, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: False
---
"""


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def write_by_opencv(path: Path, camera: CameraModel, distortion: np.ndarray | None = None) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Sat 28 Nov")
    storage.write("image_width", camera.size_px[0])
    storage.write("image_height", camera.size_px[1])
    storage.write("camera_matrix", camera.matrix)
    storage.write("distortion_coefficients", camera.distortion if distortion is None else distortion)
    storage.write("avg_reprojection_error", camera.rms_px or 0.0)
    storage.release()
    return path


def assert_same(have: CameraModel, want: CameraModel) -> None:
    assert have.size_px == want.size_px
    np.testing.assert_array_equal(have.matrix, want.matrix)
    np.testing.assert_array_equal(have.distortion, want.distortion)


@pytest.mark.parametrize("ending", ["yaml", "yml", "xml"])
def test_what_opencv_writes_is_read_bit_for_bit(tmp_path: Path, ending: str) -> None:
    camera = read_camera(write_by_opencv(tmp_path / f"c.{ending}", CAMERA))
    assert_same(camera, CAMERA)
    assert (camera.rms_px, camera.when) == (CAMERA.rms_px, "Sat 28 Nov")


@pytest.mark.parametrize("ending", ["yaml", "xml"])
@pytest.mark.parametrize("shape", [(4, 1), (1, 5), (8, 1), (1, 12), (14,)])
def test_coefficients_beyond_the_fifth_are_read_if_they_are_zero(
    tmp_path: Path, ending: str, shape: tuple[int, ...]
) -> None:
    distortion = np.zeros(shape)
    distortion.ravel()[:4] = CAMERA.distortion[:4]
    camera = read_camera(write_by_opencv(tmp_path / f"c.{ending}", CAMERA, distortion))
    np.testing.assert_array_equal(camera.distortion, [*CAMERA.distortion[:4], 0.0])
    if distortion.size > 5:
        distortion.ravel()[-1] = 1e-6
        with pytest.raises(InvalidFile, match=r"c\.(yaml|xml): distortion has \d+ coefficients, and the ones after"):
            read_camera(write_by_opencv(tmp_path / f"c.{ending}", CAMERA, distortion))


def test_the_header_of_opencv_before_5_is_read(tmp_path: Path) -> None:
    text = write_by_opencv(tmp_path / "c.yaml", CAMERA).read_text().replace("%YAML 1.2", "%YAML:1.0")
    assert text.startswith("%YAML:1.0")
    assert_same(read_camera(write(tmp_path, "old.yaml", text)), CAMERA)


def test_opencv_reads_what_is_written_for_it(tmp_path: Path) -> None:
    path = write(tmp_path, "c.yaml", format_camera_opencv(CAMERA))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    matrix, distortion = storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()
    size = storage.getNode("image_width").real(), storage.getNode("image_height").real()
    storage.release()
    assert size == CAMERA.size_px
    np.testing.assert_array_equal(matrix, CAMERA.matrix)
    np.testing.assert_array_equal(distortion.ravel(), CAMERA.distortion)
    assert_same(read_camera(path), CAMERA)


def test_a_file_of_ros_is_read(tmp_path: Path) -> None:
    camera = read_camera(write(tmp_path, "ros.yaml", ROS))
    assert camera.size_px == (640, 480)
    assert (camera.matrix[0, 0], camera.matrix[1, 2]) == (526.6908296825479, 246.2279496394374)
    np.testing.assert_array_equal(camera.distortion, [0.01864, -0.0807953154457166, 0.00067, -1e-5, 0])


def test_a_message_of_ros_is_read(tmp_path: Path) -> None:
    camera = read_camera(write(tmp_path, "message.yaml", ROS_MESSAGE))
    assert camera.size_px == (640, 480)
    np.testing.assert_array_equal(camera.matrix, [[525, 0, 319.5], [0, 526, 239.5], [0, 0, 1]])
    np.testing.assert_array_equal(camera.distortion, [0.1, -0.2, 0, 0, 0])


def test_a_file_for_ros_reads_back(tmp_path: Path) -> None:
    text = format_camera_ros(CAMERA)
    assert_same(read_camera(write(tmp_path, "c.yaml", text)), CAMERA)
    assert "distortion_model: plumb_bob" in text and "projection_matrix" in text


def test_camera_toml_is_read_as_before(tmp_path: Path) -> None:
    camera = replace(CAMERA, edge_shift_px=-0.3)
    read = read_camera(write(tmp_path, "c.toml", format_camera(camera)))
    assert_same(read, camera)
    assert read.edge_shift_px == -0.3


def test_a_rig_names_a_calibration_of_ros(tmp_path: Path) -> None:
    table = read_rig("demo")[0]
    table = table.model_copy(update={"camera": table.camera.model_copy(update={"calibration": "ros.yaml"})})
    write(tmp_path, "ros.yaml", ROS)
    assert load_calibration(table, tmp_path, "rig.toml").matrix[0, 0] == 526.6908296825479


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("plumb_bob", "equidistant", r"a lens of the model 'equidistant'; the station has k1 k2 p1 p2 k3 alone"),
        ("plumb_bob", "rational_polynomial", None),  # five coefficients of eight: the others are zero
        ("cols: 5\n  data: [", "cols: 6\n  data: [9, ", "6 coefficients of distortion; want 4, 5, 8, 12 or 14"),
        ("1.864e-2", "nan", "camera distortion has values that are not finite"),
        ("1.864e-2", "k1", "the distortion is no table of numbers"),
        ("  data: [1.864e-2", "  values: [1.864e-2", "the distortion is no table of numbers: it has no data"),
        ("image_width: 640\n", "", "has no image_width: a calibration holds for one size of image"),
        ("image_width: 640", "image_width: 640.5", r"the image size is \[640.5, 480.0\]"),
        ("camera_matrix", "matrix", "has no camera matrix: no camera_matrix or"),
        ("rows: 3", "K: [1]", None),  # not at the top level
        ("image_width", "K: [1]\nimage_width", "has both camera_matrix and K; leave one"),
        ("[526.6908296825479, 0,", "[526.6908296825479,", "the camera matrix has 8 numbers; want 9"),
        ("[526.6908296825479, 0,", "[526.6908296825479, 2.0,", "no skew"),
        ("[526.6908296825479, 0,", "[0, 0,", "want both above zero"),
        ("image_width", "binning_x: 2\nimage_width", "binning_x is 2; want the calibration of whole images"),
        ("image_width", "roi: {x_offset: 8, width: 320, height: 480}\nimage_width", "its roi is a part of the image"),
        ("image_width", "roi: {x_offset: 0, width: 640, height: 480}\nimage_width", None),
        ("image_width", "fisheye_model: 1\nimage_width", "a lens of the model"),
        (ROS, "", "has 0 documents"),
        (ROS, "- 1\n- 2\n", "has no names in it"),
        (ROS, "a: [1\n", "is no YAML"),
    ],
)
def test_what_the_model_cannot_tell_is_refused_in_words(
    tmp_path: Path, old: str, new: str, message: str | None
) -> None:
    path = write(tmp_path, "ros.yaml", ROS.replace(old, new, 1))
    if message is None:
        read_camera(path)
        return
    with pytest.raises(InvalidFile, match=message) as refusal:
        read_camera(path)
    assert "ros.yaml" in str(refusal.value) and str(refusal.value).count("\n") <= 4


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("c.xml", "<robot/>", "has <robot> at its root"),
        ("c.xml", "", "is no XML"),
        ("c.json", "{}", "ends in '.json'"),
        ("camera", "", "has no ending"),
        ("c.toml", "", "has no schema; this station reads 'camera/1'"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, name: str, content: str, message: str) -> None:
    with pytest.raises(InvalidFile, match=message):
        read_camera(write(tmp_path, name, content))


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match=r"no calibration '.*nowhere\.yaml'"):
        read_camera(tmp_path / "nowhere.yaml")


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cameras")


@given(text=st.text(max_size=60), at=st.integers(0, len(ROS)), ending=st.sampled_from(["yaml", "xml", "toml"]))
@settings(max_examples=200)
def test_whatever_is_in_a_file_it_is_a_camera_or_a_refusal(scratch: Path, text: str, at: int, ending: str) -> None:
    path = write(scratch, f"c.{ending}", ROS[:at] + text + ROS[at:])
    try:
        camera = read_camera(path)
    except InvalidFile as refusal:
        assert path.name in str(refusal)
    else:
        assert camera.matrix[0, 0] > 0


@given(st.lists(st.floats(-1e3, 1e3), min_size=5, max_size=5), st.floats(1e-3, 1e6), st.integers(1, 10**5))
@settings(max_examples=100)
def test_any_camera_reads_back_from_both_files(scratch: Path, d: list[float], focal_px: float, width: int) -> None:
    matrix = np.array([[focal_px, 0, -focal_px / 3], [0, focal_px / 7, 1e-9], [0, 0, 1]])
    camera = CameraModel((width, 3), matrix, np.array(d))
    for text in (format_camera_opencv(camera), format_camera_ros(camera)):
        assert_same(read_camera(write(scratch, "c.yaml", text)), camera)
