"""Calibrated cameras in the files of others: OpenCV's FileStorage (YAML, XML) and ROS's camera_info (YAML).

`read_camera` is the one place that reads any of them, and camera.toml. All have the same pinhole model with its pixel
(0, 0) in the middle of the top-left pixel; the station has OpenCV's first five coefficients of distortion, so a file
with more is read only if the others are zero.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from calibration.errors import CalibrationError
from calibration.intrinsics import DISTORTION_COEFFICIENTS, CameraModel
from station.errors import InvalidFile
from station.formats.camera import parse_camera
from station.formats.text import read_text
from station.logs import FloatArray

READABLE = (
    "can read camera.toml, OpenCV's FileStorage (.yaml, .yml, .xml: camera_matrix, distortion_coefficients, "
    "image_width, image_height)",
    "and ROS's camera_info (.yaml)",
)
# The names that OpenCV's samples, ROS's files and ROS's messages give to the same things.
MATRIX_KEYS = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "camera_Matrix", "K", "k", "mtx")
DISTORTION_KEYS = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "dist_coeffs",
    "distCoeffs",
    "dist_coeff",
    "D",
    "d",
    "dist",
)
WIDTH_KEYS, HEIGHT_KEYS = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")
SIZE_KEYS = ("image_size", "imageSize")
RMS_KEYS = ("avg_reprojection_error", "Avg_Reprojection_Error", "rms")
WHEN_KEYS = ("calibration_time", "calibration_Time")
MODEL_KEY = "distortion_model"
# cv::projectPoints takes these numbers of coefficients; REP 104 names the first five plumb_bob, eight of them
# rational_polynomial. No coefficient is no distortion.
COEFFICIENT_COUNTS = (0, 4, 5, 8, 12, 14)
PINHOLE_MODELS = ("plumb_bob", "rational_polynomial")

Entries = Mapping[str, Any]


def read_camera(path: str | PathLike[str]) -> CameraModel:
    """Read a calibrated camera: camera.toml, OpenCV's FileStorage (YAML or XML), ROS's camera_info (YAML).

    Raises:
        InvalidFile: with the file's name, for what is missing, of another form, or a lens that the station's model
            can't tell (fisheye, rational, thin prism, tilted sensor).
    """
    path = Path(path)
    text, ending = read_text(path, "calibration"), path.suffix.lower()
    if ending == ".toml":
        return parse_camera(text, str(path))
    if ending == ".xml":
        return camera_of(_xml_entries(text, str(path)), str(path))
    if ending in (".yaml", ".yml"):
        return camera_of(_yaml_entries(text, str(path)), str(path))
    raise _unreadable(str(path), f"ends in '{ending}'" if ending else "has no ending")


def camera_of(entries: Entries, name: str) -> CameraModel:
    """The camera in the entries of an OpenCV or ROS file, whose numbers may be texts; raises InvalidFile."""
    matrix = _numbers(_one(entries, MATRIX_KEYS, name, "camera matrix"), name, "camera matrix")
    if matrix.size != 9:
        raise InvalidFile(f"{name}: the camera matrix has {matrix.size} numbers; want 9, rows first")
    _check_whole_image(entries, name)
    try:
        return CameraModel(
            size_px=_size(entries, name),
            matrix=matrix.reshape(3, 3),
            distortion=_distortion(entries, name),
            rms_px=_optional_number(entries, RMS_KEYS, name),
            when=next((str(entries[key]) for key in WHEN_KEYS if key in entries), None),
        )
    except CalibrationError as error:
        raise InvalidFile(f"{name}: {error}") from error


def format_camera_opencv(camera: CameraModel) -> str:
    """The camera as YAML for `cv2.FileStorage`, under the names of OpenCV's own calibration sample."""
    lines = [
        "%YAML:1.0",
        "---",
        f"image_width: {camera.size_px[0]}",
        f"image_height: {camera.size_px[1]}",
        *_opencv_matrix("camera_matrix", camera.matrix),
        *_opencv_matrix("distortion_coefficients", camera.distortion[:, None]),
    ]
    if camera.rms_px is not None:
        lines.append(f"avg_reprojection_error: {float(camera.rms_px)!r}")
    return "\n".join(lines) + "\n"


def format_camera_ros(camera: CameraModel, camera_name: str = "camera") -> str:
    """The camera as ROS's camera_info YAML (camera_calibration_parsers), unrectified: P is the camera matrix."""
    projection = np.column_stack([camera.matrix, np.zeros(3)])
    lines = [
        f"image_width: {camera.size_px[0]}",
        f"image_height: {camera.size_px[1]}",
        f"camera_name: {camera_name}",
        *_ros_matrix("camera_matrix", camera.matrix),
        "distortion_model: plumb_bob",
        *_ros_matrix("distortion_coefficients", camera.distortion[None]),
        *_ros_matrix("rectification_matrix", np.eye(3)),
        *_ros_matrix("projection_matrix", projection),
    ]
    return "\n".join(lines) + "\n"


def _opencv_matrix(key: str, matrix: FloatArray) -> list[str]:
    return [
        f"{key}: !!opencv-matrix",
        f"   rows: {matrix.shape[0]}",
        f"   cols: {matrix.shape[1]}",
        "   dt: d",
        f"   data: {matrix.ravel().tolist()}",
    ]


def _ros_matrix(key: str, matrix: FloatArray) -> list[str]:
    return [
        f"{key}:",
        f"  rows: {matrix.shape[0]}",
        f"  cols: {matrix.shape[1]}",
        f"  data: {matrix.ravel().tolist()}",
    ]


def _yaml_entries(text: str, name: str) -> Entries:
    """The first document's mapping; every scalar stays text, and tags such as opencv-matrix don't count."""
    import yaml

    if text.startswith("%YAML"):  # OpenCV writes %YAML:1.0, which is no directive of YAML
        text = text.partition("\n")[2]
    try:
        documents = [document for document in yaml.load_all(text, yaml.BaseLoader) if document]
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InvalidFile(f"{name} is no YAML: {' '.join(str(error).split()):.200}") from error
    if len(documents) != 1 or not isinstance(documents[0], dict):
        have = f"has {len(documents)} documents" if len(documents) != 1 else "has no names in it"
        raise _unreadable(name, have)
    return documents[0]


def _xml_entries(text: str, name: str) -> Entries:
    """Elements of the top level: matrices as OpenCV's YAML has them, others as the words in them."""
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise InvalidFile(f"{name} is no XML: {error}") from error
    if root.tag != "opencv_storage":
        raise _unreadable(name, f"has <{root.tag}> at its root, not <opencv_storage>")
    return {element.tag: _xml_value(element) for element in root}


def _xml_value(element: ET.Element) -> Any:
    data = element.find("data")
    if data is not None:  # an opencv-matrix, or an opencv-nd-matrix of one dimension
        return {"data": (data.text or "").split()}
    text = (element.text or "").strip()
    if text.startswith('"'):
        return text.strip('"')
    words = text.split()
    return words[0] if len(words) == 1 else words


def _one(entries: Entries, keys: Sequence[str], name: str, what: str) -> Any:
    """The value under the one of these keys that is there."""
    there = [key for key in keys if key in entries]
    if len(there) > 1:
        raise InvalidFile(f"{name} has both {' and '.join(there)}; leave one")
    if not there:
        have = ", ".join(map(str, list(entries)[:8])) or "nothing"
        raise _unreadable(name, f"has no {what}: no {' or '.join(keys[:3])}; it has {have:.200}")
    return entries[there[0]]


def _numbers(value: Any, name: str, what: str) -> FloatArray:
    """All numbers of a matrix {rows, cols, data}, of a list or of lists in a list, rows first."""
    if isinstance(value, dict):
        value = value.get("data")
    try:
        if value is None:
            raise ValueError("it has no data")
        return np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise InvalidFile(f"{name}: the {what} is no table of numbers: {error}") from error


def _number(value: Any, name: str, what: str) -> float:
    numbers = _numbers(value, name, what)
    if numbers.size != 1:
        raise InvalidFile(f"{name}: {what} is {value!s:.40}; want one number")
    return float(numbers[0])


def _optional_number(entries: Entries, keys: Sequence[str], name: str) -> float | None:
    return next((_number(entries[key], name, key) for key in keys if key in entries), None)


def _size(entries: Entries, name: str) -> tuple[int, int]:
    given = [key for key in SIZE_KEYS if key in entries]
    if given:
        size = _numbers(entries[given[0]], name, "image size")
    else:
        missing = [keys[0] for keys in (WIDTH_KEYS, HEIGHT_KEYS) if not any(key in entries for key in keys)]
        if missing:
            raise InvalidFile(
                f"{name} has no {' and no '.join(missing)}: a calibration holds for one size of image\n"
                "add the size of the images that it was made from"
            )
        size = np.array(
            [_number(_one(entries, keys, name, keys[0]), name, keys[0]) for keys in (WIDTH_KEYS, HEIGHT_KEYS)]
        )
    if size.size != 2 or not np.all(np.isfinite(size)) or np.any(size != np.round(size)):
        raise InvalidFile(f"{name}: the image size is {size.tolist()}; want width and height, whole numbers")
    return int(size[0]), int(size[1])


def _distortion(entries: Entries, name: str) -> FloatArray:
    """(5,) coefficients; raises InvalidFile where the lens needs others."""
    model = str(entries.get(MODEL_KEY) or "").strip()
    if (model and model not in PINHOLE_MODELS) or _is_true(entries.get("fisheye_model", "0")):
        raise InvalidFile(
            f"{name}: a lens of the model '{model or 'fisheye'}'; the station has k1 k2 p1 p2 k3 alone\n"
            "calibrate again with OpenCV's or ROS's plumb_bob model, or by: station calibrate camera"
        )
    found = _numbers(_one(entries, DISTORTION_KEYS, name, "distortion"), name, "distortion")
    if found.size not in COEFFICIENT_COUNTS:
        raise InvalidFile(f"{name}: {found.size} coefficients of distortion; want 4, 5, 8, 12 or 14")
    more = found[DISTORTION_COEFFICIENTS:]
    if np.any(more != 0):
        raise InvalidFile(
            f"{name}: distortion has {found.size} coefficients, and the ones after k1 k2 p1 p2 k3 aren't zero;\n"
            "the station has those five alone: calibrate again without the rational, thin prism and tilted models"
        )
    return np.concatenate([found, np.zeros(DISTORTION_COEFFICIENTS)])[:DISTORTION_COEFFICIENTS]


def _check_whole_image(entries: Entries, name: str) -> None:
    """Raise InvalidFile where ROS's message is of a part of the image, or of one with pixels put together."""
    for key in ("binning_x", "binning_y"):
        if key in entries and _number(entries[key], name, key) not in (0, 1):
            raise InvalidFile(f"{name}: {key} is {entries[key]}; want the calibration of whole images, without binning")
    roi = entries.get("roi")
    if not isinstance(roi, dict):
        return
    x, y, width, height = (_number(roi.get(key, 0), name, key) for key in ("x_offset", "y_offset", "width", "height"))
    if (x, y) != (0, 0) or ((width, height) != (0, 0) and (width, height) != _size(entries, name)):
        raise InvalidFile(f"{name}: its roi is a part of the image; want the calibration of whole images")


def _is_true(value: Any) -> bool:
    return str(value).strip().lower() in ("1", "true", "yes")


def _unreadable(name: str, why: str) -> InvalidFile:
    return InvalidFile("\n".join([f"{name} {why}", *READABLE]))
