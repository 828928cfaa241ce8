"""Whether the sizes of a part's markers agree with their mounts: a wrong size_mm shows as a part of the wrong scale.

A pose's rotation doesn't depend on the size, its translation is in proportion to it. So two markers i, j of a part
satisfy `k_j t_j - k_i t_i = R_part (m_j - m_i)`: t seen in the camera, m from the mounts, and k the true size over the
one in the table. Each frame that shows both gives k_i and k_j; their medians are over all such frames. Without two
markers on a part nothing tells the scale, and nothing is said.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from station.kinematics import se3
from station.logs import FloatArray
from station.perception.markers import Marker, MarkerTable
from station.perception.observations import FrameMarkers

# Two markers whose parts are turned against each other by more than this: one shows the wrong pose solution.
AGREE_WITHIN_RAD = np.deg2rad(10.0)
# Worth a word: off by more than this share, which careless mounts don't reach, in at least so many frames, and by
# so many standard errors.
NOTABLE_SHARE = 0.05
LEAST_FRAMES = 10
NOTABLE_SIGMAS = 5.0
MAD_TO_SIGMA = 1.4826
MEDIAN_OVER_MEAN = float(np.sqrt(np.pi / 2))  # standard error of a median of Gaussian values, over that of their mean


@dataclass(frozen=True)
class SizeDoubt:
    """A marker that looks as if its black square had another size than the table's: `looks_m` for `size_m`."""

    marker_id: int
    part: str
    size_m: float
    looks_m: float
    std_m: float

    def __str__(self) -> str:
        return (
            f"marker {self.marker_id} on {self.part} looks {1e3 * self.looks_m:.1f} mm wide "
            f"(std {1e3 * self.std_m:.1f} mm) by the other markers and the mounts of that part; the table says "
            f"{1e3 * self.size_m:.1f} mm: measure its black square, and the mounts"
        )


class SizeCheck:
    """Collects, frame by frame, what the markers of one part tell of each other's sizes."""

    def __init__(self, table: MarkerTable) -> None:
        self._markers = {marker.id: marker for marker in table.markers}
        self._factors: dict[int, array[float]] = defaultdict(lambda: array("f"))

    def add(self, markers: FrameMarkers) -> None:
        """Take a frame's markers into account."""
        seen = dict(zip(markers.marker_id.tolist(), markers.T_cam_marker[:, 0], strict=True))
        for i, j in combinations(sorted(seen), 2):  # a few markers; most parts have one
            if self._markers[i].part != self._markers[j].part:
                continue
            factors = size_factors(self._markers[i], seen[i], self._markers[j], seen[j])
            if factors is not None:
                self._factors[i].append(factors[0])
                self._factors[j].append(factors[1])

    def doubts(self) -> tuple[SizeDoubt, ...]:
        """Markers whose sizes, or mounts, can't be what the table says."""
        found = (self._doubt(self._markers[n], np.asarray(k)) for n, k in sorted(self._factors.items()))
        return tuple(doubt for doubt in found if doubt is not None)

    def _doubt(self, marker: Marker, factors: FloatArray) -> SizeDoubt | None:
        if len(factors) < LEAST_FRAMES:
            return None
        factor = float(np.median(factors))
        spread = MAD_TO_SIGMA * float(np.median(np.abs(factors - factor)))
        std = MEDIAN_OVER_MEAN * spread / np.sqrt(len(factors))
        if abs(factor - 1) < max(NOTABLE_SHARE, NOTABLE_SIGMAS * std):
            return None
        return SizeDoubt(marker.id, marker.part, marker.size_m, factor * marker.size_m, std * marker.size_m)


def size_factors(i: Marker, T_cam_i: FloatArray, j: Marker, T_cam_j: FloatArray) -> FloatArray | None:
    """(2,) true size over the table's of two markers of one part; None where their rotations disagree, or say nothing.

    Least squares of three equations; the part's rotation is the mean of what the two say.
    """
    R_cam_part = [T[:3, :3] @ marker.mount[:3, :3].T for marker, T in ((i, T_cam_i), (j, T_cam_j))]
    if se3.angle(R_cam_part[0].T @ R_cam_part[1]) > AGREE_WITHIN_RAD:
        return None
    R = se3.project_to_so3(0.5 * (R_cam_part[0] + R_cam_part[1]))
    between = R @ (j.mount[:3, 3] - i.mount[:3, 3])
    columns = np.stack([-T_cam_i[:3, 3], T_cam_j[:3, 3]], axis=-1)
    factors, _, rank, _ = np.linalg.lstsq(columns, between, rcond=None)
    return np.asarray(factors, dtype=np.float64) if rank == 2 and np.all(factors > 0) else None
