"""What a recording holds for the viewer alone: the camera, markers in space and over the image, names and colours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import cycle, islice
from typing import Literal

import numpy as np
import rerun as rr

from calibration.intrinsics import CameraModel
from station.logs import FloatArray
from station.perception.markers import Marker, MarkerTable
from station.perception.observations import FrameMarkers
from station.recording.layout import (
    CAMERA_FRAME,
    IMAGE,
    IMAGE_FRAME,
    MARKERS,
    OVERLAY,
    SERVO_QUANTITIES,
    TRANSFORMS,
    marker_frame,
)

# The viewer's pixel (0, 0) is the corner of the top-left pixel, ours its centre, px.
PIXEL_CENTRE_PX = 0.5
# Distance of the image from the camera in the 3D view, m.
IMAGE_DISTANCE_M = 0.15

# The first corner's dot over the image, points of the screen.
DOT_POINTS = 3.0

Colour = tuple[int, int, int]
WHITE, BLACK = 255, 0
AXIS_COLOURS: tuple[Colour, ...] = ((255, 80, 80), (80, 220, 80), (90, 120, 255))  # x, y, z
STRANGER: Colour = (255, 0, 255)
# A colour a joint and a part (Tableau 10).
PALETTE: tuple[Colour, ...] = (
    (31, 119, 180),
    (255, 127, 14),
    (44, 160, 44),
    (214, 39, 40),
    (148, 103, 189),
    (140, 86, 75),
    (227, 119, 194),
    (127, 127, 127),
    (188, 189, 34),
    (23, 190, 207),
)


def colours(count: int) -> list[Colour]:
    """The first `count` colours; they repeat after ten."""
    return list(islice(cycle(PALETTE), count))


def mixed(colour: Colour, grey: int, share: float) -> Colour:
    """The colour with a share of a grey level."""
    red, green, blue = (round(c + (grey - c) * share) for c in colour)
    return red, green, blue


def commanded_series(joints: Sequence[str], units: Sequence[str]) -> rr.SeriesLines:
    """Thin and pale, and steps, since a command holds until the next."""
    pale = [mixed(colour, WHITE, 0.5) for colour in colours(len(joints))]
    return _series(joints, units, "commanded", pale, 1.0, "StepAfter")


def measured_series(joints: Sequence[str], units: Sequence[str]) -> rr.SeriesLines:
    """The read-back in the joint's colour."""
    return _series(joints, units, "measured", colours(len(joints)), 1.5, "Linear")


def detected_series(joints: Sequence[str], units: Sequence[str]) -> rr.SeriesLines:
    """The detected states, thick and dark, behind the others."""
    dark = [mixed(colour, BLACK, 0.35) for colour in colours(len(joints))]
    return _series(joints, units, "detected", dark, 4.0, "Linear")


def seen_series(columns: Sequence[str], units: Sequence[str]) -> rr.SeriesLines:
    """The states that were detected while it was recorded, as dark as detected ones, and thinner."""
    dark = [mixed(colour, BLACK, 0.35) for colour in colours(len(columns))]
    return _series(columns, units, "seen", dark, 2.5, "Linear")


def servo_series(ids: Sequence[int]) -> rr.SeriesLines:
    """Temperature, voltage, load and speed of each servo, in its colour."""
    return rr.SeriesLines(
        names=[f"servo {n} {quantity}" for quantity in SERVO_QUANTITIES.values() for n in ids],
        colors=colours(len(ids)) * len(SERVO_QUANTITIES),
        widths=[1.5] * (len(ids) * len(SERVO_QUANTITIES)),
    )


def _series(
    joints: Sequence[str],
    units: Sequence[str],
    what: str,
    colour: list[Colour],
    width: float,
    interpolation: Literal["Linear", "StepAfter"],
) -> rr.SeriesLines:
    return rr.SeriesLines(
        names=[f"{joint} {what} ({unit})" for joint, unit in zip(joints, units, strict=True)],
        colors=colour,
        widths=[width] * len(joints),
        interpolation_mode=interpolation,
    )


def log_camera(stream: rr.RecordingStream, camera: CameraModel) -> None:
    """The camera's frustum in space, as a pinhole: lens distortion is not drawn."""
    matrix = camera.matrix.copy()
    matrix[:2, 2] += PIXEL_CENTRE_PX
    pinhole = rr.Pinhole(
        image_from_camera=matrix,
        resolution=camera.size_px,
        parent_frame=CAMERA_FRAME,
        child_frame=IMAGE_FRAME,
        image_plane_distance=IMAGE_DISTANCE_M,
    )
    stream.log(IMAGE, pinhole, rr.CoordinateFrame(IMAGE_FRAME), static=True)
    stream.log(OVERLAY, rr.CoordinateFrame(IMAGE_FRAME), static=True)


class MarkersInView:
    """What is drawn of the table's markers in space: those that are seen are where they are, the others disappear."""

    def __init__(self, table: MarkerTable) -> None:
        self._shapes = _marker_shapes(table)
        self._shown: set[int] = set()

    def begin(self) -> Iterator[tuple[str, list[rr.AsComponents]]]:
        """What to log before the first frame, by entity: the viewer reports a frame without a pose as an error."""
        for n in self._shapes:
            yield TRANSFORMS, [_marker_pose(n, np.eye(4))]

    def show(self, markers: FrameMarkers) -> Iterator[tuple[str, list[rr.AsComponents]]]:
        """What to log of one frame, by entity; a row of the transforms is the pose of one child frame."""
        poses = zip(markers.marker_id.tolist(), markers.T_cam_marker[:, 0], strict=True)
        seen = {n: T for n, T in poses if n in self._shapes and np.isfinite(T).all()}
        for n in self._shown - seen.keys():
            yield _marker_entity(n), [rr.Clear(recursive=False)]
        for n in seen.keys() - self._shown:
            yield _marker_entity(n), self._shapes[n]
        for n, T in seen.items():
            yield TRANSFORMS, [_marker_pose(n, T)]
        self._shown = set(seen)


def _marker_shapes(table: MarkerTable) -> dict[int, list[rr.AsComponents]]:
    """What is drawn of each of the table's markers, in its frame: the square in its part's colour, and its axes."""
    colour = _part_colours(table)
    return {marker.id: _marker_shape(marker, colour[marker.part]) for marker in table.markers}


def _part_colours(table: MarkerTable) -> dict[str, Colour]:
    return dict(zip(table.parts, colours(len(table.parts)), strict=True))


def _marker_shape(marker: Marker, colour: Colour) -> list[rr.AsComponents]:
    half = marker.size_m / 2
    corners = np.array([(-half, half, 0), (half, half, 0), (half, -half, 0), (-half, -half, 0)])
    square = rr.Mesh3D(vertex_positions=corners, triangle_indices=[(0, 2, 1), (0, 3, 2)], albedo_factor=colour)
    return [square, rr.Arrows3D(vectors=np.eye(3) * half, colors=AXIS_COLOURS)]


def _marker_entity(marker_id: int) -> str:
    """The entity of what is drawn of a marker."""
    return f"{MARKERS}/{marker_frame(marker_id)}"


def log_marker_frames(stream: rr.RecordingStream, table: MarkerTable) -> None:
    """Put what is drawn of each marker in the marker's frame."""
    for marker in table.markers:
        stream.log(_marker_entity(marker.id), rr.CoordinateFrame(marker_frame(marker.id)), static=True)


def _marker_pose(marker_id: int, T_cam_marker: FloatArray) -> rr.Transform3D:
    """The pose (4, 4) of one marker's frame."""
    return rr.Transform3D(
        translation=T_cam_marker[:3, 3],
        mat3x3=T_cam_marker[:3, :3],
        parent_frame=CAMERA_FRAME,
        child_frame=marker_frame(marker_id),
    )


def outlines(table: MarkerTable, markers: FrameMarkers) -> tuple[rr.LineStrips2D, rr.Points2D]:
    """The detected squares over the image, first corner and number; without any, those drawn before disappear."""
    colour = _part_colours(table)
    parts = [table.markers[row].part if row >= 0 else None for row in table.rows(markers.marker_id)]
    tints = [STRANGER if part is None else colour[part] for part in parts]
    labels = [f"{n}" if part else f"{n} is not in the table" for n, part in zip(markers.marker_id, parts, strict=True)]
    corners = markers.corners_px + PIXEL_CENTRE_PX
    strips = rr.LineStrips2D(list(corners[:, [0, 1, 2, 3, 0]]), colors=tints)
    dots = rr.Points2D(corners[:, 0], colors=tints, labels=labels, radii=rr.Radius.ui_points(DOT_POINTS))
    return strips, dots
