"""What a camera saw of markers over time: a row for each detected marker, with its corners and both pose solutions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

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


def _frozen_ints(values: object) -> IntArray:
    array = np.array(values, dtype=np.int64)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class ObservationLog:
    """Markers detected in F frames, N in all, checked and frozen.

    Attributes:
        t_s: (F,) strictly increasing frame times; frames without a marker are in it too.
        frame: (N,) row of `t_s`, never falling.
        marker_id: (N,) number in the dictionary; a marker is seen at most once a frame.
        corners_px: (N, 4, 2) as detected (distorted, no edge shift undone), clockwise from the marker's top left.
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
    T_cam_marker: FloatArray
    rms_px: FloatArray

    def __post_init__(self) -> None:
        for name in ("t_s", "corners_px", "T_cam_marker", "rms_px"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name)))
        for name in ("frame", "marker_id"):
            object.__setattr__(self, name, _frozen_ints(getattr(self, name)))
        check_times(self.t_s)
        self._check_shapes()
        self._check_rows()

    def _check_shapes(self) -> None:
        count = len(self.frame)
        want = {
            "frame": (count,),
            "marker_id": (count,),
            "corners_px": (count, CORNERS, 2),
            "T_cam_marker": (count, SOLUTIONS, 4, 4),
            "rms_px": (count, SOLUTIONS),
        }
        for name, shape in want.items():
            if (have := getattr(self, name).shape) != shape:
                raise InvalidData(f"observations: {name} has shape {have}; want {shape}")

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
        self._marker_id: list[IntArray] = []
        self._corners_px: list[FloatArray] = []
        self._T_cam_marker: list[FloatArray] = []
        self._rms_px: list[FloatArray] = []

    def add(self, t_s: float, marker_id: IntArray, corners_px: FloatArray, poses: MarkerPoses) -> None:
        """Add a frame at time `t_s`: ids (M,), corners (M, 4, 2) and poses of its M markers; M may be 0."""
        count = len(marker_id)
        self._t_s.append(t_s)
        self._marker_id.append(np.asarray(marker_id, dtype=np.int64))
        self._corners_px.append(np.reshape(corners_px, (count, CORNERS, 2)))
        self._T_cam_marker.append(np.reshape(poses.T_cam_marker, (count, SOLUTIONS, 4, 4)))
        self._rms_px.append(np.reshape(poses.rms_px, (count, SOLUTIONS)))

    def build(self) -> ObservationLog:
        """The log of all frames added so far."""
        counts = [len(ids) for ids in self._marker_id]
        return ObservationLog(
            t_s=np.array(self._t_s),
            frame=np.repeat(np.arange(len(counts)), counts),
            marker_id=np.concatenate([np.zeros(0, np.int64), *self._marker_id]),
            corners_px=np.concatenate([np.zeros((0, CORNERS, 2)), *self._corners_px]),
            T_cam_marker=np.concatenate([np.zeros((0, SOLUTIONS, 4, 4)), *self._T_cam_marker]),
            rms_px=np.concatenate([np.zeros((0, SOLUTIONS)), *self._rms_px]),
        )
