"""What a camera saw of markers over time: a row for each detected marker, with its corners and both pose solutions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData
from station.logs import FloatArray, check_times, frozen_floats

if TYPE_CHECKING:
    from station.perception.pose import MarkerPoses

IntArray = NDArray[np.int64]

# The square-marker pose problem has at most two solutions (IPPE).
SOLUTIONS = 2
CORNERS = 4
COORDINATES = 2 * CORNERS
# What is known of each marker of a frame.
MARKER_SHAPES: dict[str, tuple[int, ...]] = {
    "marker_id": (),
    "corners_px": (CORNERS, 2),
    "corner_covariance_px2": (CORNERS, 2, 2),
    "T_cam_marker": (SOLUTIONS, 4, 4),
    "rms_px": (SOLUTIONS,),
}


def _frozen_ints(values: object) -> IntArray:
    array = np.array(values, dtype=np.int64)
    array.setflags(write=False)
    return array


def _freeze_markers(of: FrameMarkers | ObservationLog, count: int, what: str) -> None:
    """Freeze the arrays of `count` markers; raises InvalidData for shapes that don't agree."""
    object.__setattr__(of, "marker_id", _frozen_ints(of.marker_id))
    for name, shape in MARKER_SHAPES.items():
        if name != "marker_id":
            object.__setattr__(of, name, frozen_floats(getattr(of, name)))
        if (have := getattr(of, name).shape) != (count, *shape):
            raise InvalidData(f"{what}: {name} has shape {have}; want {(count, *shape)}")


@dataclass(frozen=True, eq=False)
class FrameMarkers:
    """The M markers of one frame, checked and frozen; attributes as in ObservationLog.

    Raises:
        InvalidData: for shapes that don't agree.
    """

    marker_id: IntArray
    corners_px: FloatArray
    corner_covariance_px2: FloatArray
    T_cam_marker: FloatArray
    rms_px: FloatArray

    def __post_init__(self) -> None:
        _freeze_markers(self, len(self.marker_id), "markers of a frame")

    def __len__(self) -> int:
        return len(self.marker_id)


@dataclass(frozen=True, eq=False)
class ObservationLog:
    """Markers detected in F frames, N in all, checked and frozen.

    Attributes:
        t_s: (F,) strictly increasing frame times; frames without a marker are in it too.
        frame: (N,) row of `t_s`, never falling.
        marker_id: (N,) number in the dictionary; a marker is seen at most once a frame.
        corners_px: (N, 4, 2) as detected (distorted, no edge shift undone), clockwise from the marker's top left.
        corner_covariance_px2: (N, 4, 2, 2) of each corner, of two lines' independent errors (see `joint_covariance`);
            NaN = not known.
        T_cam_marker: (N, 2, 4, 4) both pose solutions, the one with the lower error first; all-NaN where there is none.
        rms_px: (N, 2) RMS reprojection error of each, over the eight coordinates; NaN where there is none.

    Raises:
        InvalidData: for shapes that don't agree, falling times, frames falling or out of range, a marker twice
            in a frame.
    """

    t_s: FloatArray
    frame: IntArray
    marker_id: IntArray
    corners_px: FloatArray
    corner_covariance_px2: FloatArray
    T_cam_marker: FloatArray
    rms_px: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_floats(self.t_s))
        object.__setattr__(self, "frame", _frozen_ints(self.frame))
        check_times(self.t_s)
        _freeze_markers(self, len(self.frame), "observations")
        self._check_rows()

    def _check_rows(self) -> None:
        if not len(self.frame):
            return
        if np.any(np.diff(self.frame) < 0) or self.frame[0] < 0 or self.frame[-1] >= len(self.t_s):
            raise InvalidData(f"observations: frames must not fall and lie within 0 to {len(self.t_s) - 1}")
        seen = np.stack([self.frame, self.marker_id], axis=1)
        if len(np.unique(seen, axis=0)) != len(seen):
            raise InvalidData("observations: a marker appears twice in one frame")
        if not np.all(np.isfinite(self.corners_px)):
            raise InvalidData("observations: corners must be finite")

    def __len__(self) -> int:
        return len(self.frame)

    def with_poses(self, poses: MarkerPoses) -> ObservationLog:
        """The same observations with other poses of the N rows, such as those of another calibration."""
        return replace(self, T_cam_marker=poses.T_cam_marker, rms_px=poses.rms_px)


class ObservationBuilder:
    """Collects the markers of one frame after another into an ObservationLog."""

    def __init__(self) -> None:
        self._t_s: list[float] = []
        self._frames: list[FrameMarkers] = []

    def add(self, t_s: float, markers: FrameMarkers) -> None:
        """Add a frame at time `t_s`, with or without markers."""
        self._t_s.append(t_s)
        self._frames.append(markers)

    def build(self) -> ObservationLog:
        """The log of all frames added so far."""
        counts = [len(markers) for markers in self._frames]
        columns: dict[str, Any] = {
            name: np.concatenate([np.zeros((0, *shape)), *(getattr(markers, name) for markers in self._frames)])
            for name, shape in MARKER_SHAPES.items()
        }
        return ObservationLog(np.array(self._t_s), np.repeat(np.arange(len(counts)), counts), **columns)
