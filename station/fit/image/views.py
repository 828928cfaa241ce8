"""What one camera saw of the markers on parts: corners and how well they are known, all that the fit looks at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel
from station.errors import InvalidData
from station.logs import FloatArray, check_times, frozen_floats

IntArray = NDArray[np.intp]

CORNERS, COORDINATES = 4, 8
SOLUTIONS = 2


def _frozen_ints(values: object) -> IntArray:
    array = np.array(values, dtype=np.intp)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Views:
    """N sightings of M markers on K parts in T frames, in the order of frames, checked and frozen.

    Attributes:
        t_s: (T,) of the frames.
        parts: K names.
        marker_id: (M,) of each marker in its dictionary.
        part: (M,) which of the parts it is on.
        points_m: (M, 4, 3) its corners in the part's frame, as detected: from its top left, clockwise.
        frame: (N,) of each sighting, never falling.
        marker: (N,) which of the markers.
        corners_px: (N, 4, 2) as detected: distorted, with the edge shift in them, each row at its own time.
        covariance_px2: (N, 8, 8) of the coordinates u0, v0, u1, ...
        T_ref_part: (N, 2, 4, 4) the part's pose in the camera by both solutions of that marker, the likelier first; NaN
            where there is none.
        camera: that saw them.
        readout_s: time from the first to the last row of its rolling shutter; 0 for none. A frame's time is that of its
            middle row.

    Raises:
        InvalidData: for shapes that don't agree, frames that fall or are out of range, a marker twice in a frame,
            corners that are not finite, covariances that are none.
    """

    t_s: FloatArray
    parts: tuple[str, ...]
    marker_id: IntArray
    part: IntArray
    points_m: FloatArray
    frame: IntArray
    marker: IntArray
    corners_px: FloatArray
    covariance_px2: FloatArray
    T_ref_part: FloatArray
    camera: CameraModel
    readout_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("marker_id", "part", "frame", "marker"):
            object.__setattr__(self, name, _frozen_ints(getattr(self, name)))
        for name in ("t_s", "points_m", "corners_px", "covariance_px2", "T_ref_part"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name)))
        check_times(self.t_s)
        self._check_shapes()
        self._check_rows()

    def _check_shapes(self) -> None:
        M, N = len(self.marker_id), len(self.frame)
        want = {
            "part": (M,),
            "points_m": (M, CORNERS, 3),
            "marker": (N,),
            "corners_px": (N, CORNERS, 2),
            "covariance_px2": (N, COORDINATES, COORDINATES),
            "T_ref_part": (N, SOLUTIONS, 4, 4),
        }
        for name, shape in want.items():
            if (have := getattr(self, name).shape) != shape:
                raise InvalidData(f"views: {name} has shape {have}; want {shape}")
        if not (np.isfinite(self.readout_s) and self.readout_s >= 0):
            raise InvalidData(f"views: the readout is {self.readout_s:g} s; want 0 or more")

    def _check_rows(self) -> None:
        for name, size in (("part", len(self.parts)), ("frame", len(self.t_s)), ("marker", len(self.marker_id))):
            of = getattr(self, name)
            if of.size and (of.min() < 0 or of.max() >= size):
                raise InvalidData(f"views: {name} goes from {of.min()} to {of.max()}; want 0 to {size - 1}")
        if np.any(np.diff(self.frame) < 0):
            raise InvalidData("views: frames must not fall")
        if len(np.unique(self.frame * len(self.marker_id) + self.marker)) != len(self.frame):
            raise InvalidData("views: a marker appears twice in one frame")
        for name in ("points_m", "corners_px", "covariance_px2"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise InvalidData(f"views: {name} must be finite")

    def __len__(self) -> int:
        return len(self.frame)

    def of_parts(self, parts: tuple[str, ...]) -> Views:
        """What was seen of some parts, in their order; raises InvalidData for a part that is none."""
        unknown = [name for name in parts if name not in self.parts]
        if unknown:
            raise InvalidData(f"views: no part '{unknown[0]}'; have {', '.join(self.parts)}")
        number = {self.parts.index(name): k for k, name in enumerate(parts)}
        markers = np.flatnonzero(np.isin(self.part, list(number)))
        rows = np.flatnonzero(np.isin(self.marker, markers))
        return Views(
            self.t_s,
            tuple(parts),
            self.marker_id[markers],
            np.array([number[int(k)] for k in self.part[markers]], dtype=np.intp),
            self.points_m[markers],
            self.frame[rows],
            np.searchsorted(markers, self.marker[rows]),
            self.corners_px[rows],
            self.covariance_px2[rows],
            self.T_ref_part[rows],
            self.camera,
            self.readout_s,
        )
