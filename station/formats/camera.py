"""camera.toml: a calibrated camera as text, read strictly and written so that it reads back the same."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from calibration.errors import CalibrationError
from calibration.intrinsics import CameraModel
from station.errors import InvalidFile
from station.formats.toml_models import StrictModel, parse

CAMERA_SCHEMA = "camera/1"

Row3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Matrix3 = Annotated[list[Row3], Field(min_length=3, max_length=3)]
Distortion = Annotated[list[float], Field(min_length=5, max_length=5)]
Size = Annotated[list[int], Field(min_length=2, max_length=2)]


class CameraTable(StrictModel):
    """The keys of camera.toml, and of a rig's inline `[camera.calibration]`; see `CameraModel` for what they mean."""

    size_px: Size
    matrix: Matrix3
    distortion: Distortion
    rms_px: float | None = None
    edge_shift_px: float | None = None
    edge_shift_std_px: float | None = None
    readout_s: float | None = None
    when: str | None = None
    matrix_std: Matrix3 | None = None
    distortion_std: Distortion | None = None

    def to_camera(self) -> CameraModel:
        """The camera model; raises CalibrationError for values that can't be a camera's."""
        return CameraModel(
            size_px=(self.size_px[0], self.size_px[1]),
            matrix=np.array(self.matrix),
            distortion=np.array(self.distortion),
            rms_px=self.rms_px,
            edge_shift_px=self.edge_shift_px,
            edge_shift_std_px=self.edge_shift_std_px,
            readout_s=self.readout_s,
            when=self.when,
            matrix_std=None if self.matrix_std is None else np.array(self.matrix_std),
            distortion_std=None if self.distortion_std is None else np.array(self.distortion_std),
        )


def parse_camera(text: str, name: str) -> CameraModel:
    """The camera in a camera.toml text; raises InvalidFile, with the file's `name`, for anything else."""
    table = parse(CameraTable, text, name, CAMERA_SCHEMA)
    try:
        return table.to_camera()
    except CalibrationError as error:
        raise InvalidFile(f"{name}: {error}") from error


def format_camera(camera: CameraModel) -> str:
    """camera.toml's text; floats are written so that `parse_camera` gives the very same numbers."""
    lines = [
        f'schema = "{CAMERA_SCHEMA}"',
        f"size_px = [{camera.size_px[0]}, {camera.size_px[1]}]",
        f"matrix = {_rows(camera.matrix)}",
        f"distortion = {camera.distortion.tolist()}",
    ]
    for key in ("rms_px", "edge_shift_px", "edge_shift_std_px", "readout_s"):
        if (value := getattr(camera, key)) is not None:
            lines.append(f"{key} = {float(value)!r}")
    if camera.when is not None:
        lines.append(f"when = {quoted(camera.when)}")
    if camera.matrix_std is not None:
        lines.append(f"matrix_std = {_rows(camera.matrix_std)}")
    if camera.distortion_std is not None:
        lines.append(f"distortion_std = {camera.distortion_std.tolist()}")
    return "\n".join(lines) + "\n"


def quoted(text: str) -> str:
    """A TOML basic string: quotes, backslashes and control characters escaped."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04X}" for c in escaped) + '"'


def _rows(matrix: np.ndarray) -> str:
    """A matrix as a TOML array, a line for each row."""
    return "[\n" + "".join(f"    {row},\n" for row in matrix.tolist()) + "]"
