"""Where parts are while a rolling shutter reads the picture, by how they move between its frames.

Each row is seen at its own time, and so each corner. A part's pose there is interpolated along its motion through the
frames before and after: twists from its pose in a frame to those in its neighbours, which a parabola in time passes
through, or a line where there is but one neighbour.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.image.views import IntArray
from station.kinematics import se3
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# A motion isn't interpolated over a longer time: a part can turn back within it.
LONGEST_GAP_S = 0.15


@dataclass(frozen=True, eq=False)
class Motion:
    """How M markers' parts go on from T frames.

    Attributes:
        row: (T, M, 4) of each corner, from -1/2 at the top to 1/2 at the bottom of the picture.
        step_s: (T, 2) time to the frame before and the one after; any other than 0 where there is none.
        twist: (T, M, 2, 6) right twists of the parts from their pose in a frame to those in the two; zero where there
            is none.
        known: (T, M, 2) whether there is one.
    """

    row: FloatArray
    step_s: FloatArray
    twist: FloatArray
    known: BoolArray

    def take(self, rows: slice | IntArray) -> Motion:
        """Some of the frames."""
        return Motion(self.row[rows], self.step_s[rows], self.twist[rows], self.known[rows])

    def of_markers(self, columns: slice) -> Motion:
        """Some of the markers."""
        return Motion(self.row[:, columns], self.step_s, self.twist[:, columns], self.known[:, columns])

    def through(self, T_ref_marker: FloatArray) -> Motion:
        """The motion of markers that go through poses (T, M, 4, 4)."""
        change = se3.log(se3.inverse(T_ref_marker[:-1]) @ T_ref_marker[1:])
        back = se3.log(se3.inverse(T_ref_marker[1:]) @ T_ref_marker[:-1])
        twist = np.zeros(self.twist.shape)
        twist[1:, :, 0], twist[:-1, :, 1] = back, change
        return replace(self, twist=np.where(self.known[..., None], twist, 0.0))

    def at(self, readout_s: float) -> tuple[FloatArray, FloatArray]:
        """Twists (T, M, 4, 6) from a frame's poses to those at its corners' times, and their change by the readout."""
        s, (b, a) = readout_s * self.row, np.moveaxis(self.step_s, -1, 0)[:, :, None, None]
        before, after = np.moveaxis(self.known, -1, 0)[..., None]
        both = before & after
        weights = [
            np.where(both, s * (s - a) / (b * (b - a)), np.where(before, s / b, 0.0)),
            np.where(both, s * (s - b) / (a * (a - b)), np.where(after, s / a, 0.0)),
        ]
        slopes = [
            np.where(both, (2 * s - a) / (b * (b - a)), np.where(before, 1 / b, 0.0)) * self.row,
            np.where(both, (2 * s - b) / (a * (a - b)), np.where(after, 1 / a, 0.0)) * self.row,
        ]
        xi, by_readout = (
            of[0][..., None] * self.twist[:, :, None, 0] + of[1][..., None] * self.twist[:, :, None, 1]
            for of in (weights, slopes)
        )
        return xi, by_readout


def motion_of(t_s: FloatArray, row: FloatArray, seen: BoolArray) -> Motion:
    """Frames at times (T,) in which markers were seen (T, M), rows of corners (T, M, 4); nothing moves yet."""
    step = np.diff(t_s)
    near = step <= LONGEST_GAP_S
    step_s = np.stack([-np.append(1.0, step), np.append(step, 1.0)], axis=-1)
    both = seen[1:] & seen[:-1] & near[:, None]
    none = np.zeros((1, seen.shape[1]), dtype=bool)
    known = np.stack([np.concatenate([none, both]), np.concatenate([both, none])], axis=-1)
    return Motion(row, step_s, np.zeros((*seen.shape, 2, 6)), known)


def moved_points(xi: FloatArray, p: FloatArray) -> FloatArray:
    """exp(xi) p (..., 3) for small twists (..., 6) [m, rad]: to the third order, 4e-6 of the distance at 0.1 rad."""
    v, w = xi[..., :3], xi[..., 3:]
    first = v + np.cross(w, p)
    second = np.cross(w, first)
    return p + first + second / 2 + np.cross(w, second) / 6


def point_motions(xi: FloatArray, by: FloatArray, p: FloatArray) -> FloatArray:
    """(..., 3) change of `moved_points` where the twists change by (..., 6)."""
    v, w, by_v, by_w = xi[..., :3], xi[..., 3:], by[..., :3], by[..., 3:]
    first, by_first = v + np.cross(w, p), by_v + np.cross(by_w, p)
    second, by_second = np.cross(w, first), np.cross(by_w, first) + np.cross(w, by_first)
    return by_first + by_second / 2 + (np.cross(by_w, second) + np.cross(w, by_second)) / 6
