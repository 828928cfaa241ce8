"""What corners say of parts' poses, frame by frame: two candidates for each part, from all of its markers together.

A part's markers are fitted together, in the image: what one of them, seen from the front, leaves open the others tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.corner_noise import chi2_quantile
from station.perception.markers import MarkerTable
from station.perception.observations import COORDINATES, SOLUTIONS, IntArray, ObservationLog
from station.perception.point_poses import Sights, Solved, sights_of, solve_poses
from station.perception.pose import (
    UNIT_CORNERS,
    inverse_information,
    same_pose,
    square_covariance,
    viewing_angles,
    without_edge_shift,
)
from station.perception.square_pose import square_poses

# Poses are unreliable past 70 to 72 deg between the normal and the line of sight (measured on rendered frames).
TILT_GATE_RAD = np.deg2rad(75.0)
# A marker whose RMS error is above this many standard deviations is not the square that the model thinks it is.
RMS_GATE_SIGMAS = 5.0
# Errors up to this quantile of their distribution are chance; beyond, they inflate covariances.
CHANCE = 0.99
# Markers solved at once: some tens of megabytes.
SOLVED_AT_ONCE = 5000


@dataclass(frozen=True, eq=False)
class PoseHypotheses:
    """Candidate poses of K parts in F frames, the likelier by the frame's own corners first.

    Attributes:
        t_s: (F,) times.
        parts: K names.
        T_cam_part: (F, K, 2, 4, 4); all-NaN where there is no such candidate.
        covariance: (F, K, 2, 6, 6) of the right perturbation [m, rad]; NaN where there is no candidate.
        chi2: (F, K, 2) squared errors of the corners in units of their covariances; inf where there is no candidate.
        weight: (F, K) what chi2 counts beside other frames that show the same errors, see `evidence_weights`.
    """

    t_s: FloatArray
    parts: tuple[str, ...]
    T_cam_part: FloatArray
    covariance: FloatArray
    chi2: FloatArray
    weight: FloatArray

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(F, K) there is at least one candidate."""
        return np.isfinite(self.chi2[..., 0])

    @property
    def log_likelihood(self) -> FloatArray:
        """(F, K, 2) of the candidates by their own frame's corners, up to a constant; -inf where there is none."""
        return -0.5 * self.weight[..., None] * self.chi2


def part_of_row(observations: ObservationLog, table: MarkerTable) -> IntArray:
    """(N,) column of each observation's part; -1 for markers that aren't in the table."""
    part_of_marker = [table.parts.index(marker.part) for marker in table.markers]
    return np.append(part_of_marker, -1)[table.rows(observations.marker_id)]


def estimate_hypotheses(
    observations: ObservationLog,
    table: MarkerTable,
    camera: CameraModel,
    covariance_px2: FloatArray,
    weight: FloatArray,
) -> PoseHypotheses:
    """Candidates for all parts of a table in all frames.

    Args:
        observations: their corners; the poses in them aren't used.
        table: markers that aren't in it are left out.
        camera: the camera that saw them.
        covariance_px2: (N, 8, 8) of the corners' coordinates.
        weight: (N,) of each observation's squared errors, for the choice of a candidate alone.
    """
    part = part_of_row(observations, table)
    rows = np.flatnonzero(part >= 0)
    views = _Views(
        observations.frame[rows] * len(table.parts) + part[rows],
        table.rows(observations.marker_id[rows]),
        without_edge_shift(observations.corners_px[rows], camera),
        covariance_px2[rows],
        weight[rows],
    )
    chunks = [slice(k, k + SOLVED_AT_ONCE) for k in range(0, len(rows), SOLVED_AT_ONCE)]
    found = _Found.nothing(len(observations.t_s) * len(table.parts))
    alone = [_alone(views[chunk], table, camera) for chunk in chunks]  # in chunks for the sake of memory
    if alone:
        _fill(found, views, _Candidates.joined(alone), table, camera)
    shape = (len(observations.t_s), len(table.parts))
    return PoseHypotheses(
        observations.t_s,
        table.parts,
        found.T.reshape(*shape, SOLUTIONS, 4, 4),
        found.covariance.reshape(*shape, SOLUTIONS, 6, 6),
        found.chi2.reshape(*shape, SOLUTIONS),
        found.weight.reshape(shape),
    )


@dataclass(frozen=True, eq=False)
class _Views:
    """Markers seen: N rows of the place (frame and part in one number), the table's row, corners and weights."""

    place: IntArray
    marker: IntArray
    seen_px: FloatArray
    covariance_px2: FloatArray
    weight: FloatArray

    def __getitem__(self, rows: slice | IntArray | NDArray[np.bool_]) -> _Views:
        return _Views(
            self.place[rows], self.marker[rows], self.seen_px[rows], self.covariance_px2[rows], self.weight[rows]
        )

    def __len__(self) -> int:
        return len(self.place)


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Up to two poses for each of N: T (N, 2, 4, 4), covariance (N, 2, 6, 6), chi2 (N, 2)."""

    T: FloatArray
    covariance: FloatArray
    chi2: FloatArray

    @staticmethod
    def joined(several: list[_Candidates]) -> _Candidates:
        return _Candidates(
            np.concatenate([c.T for c in several]),
            np.concatenate([c.covariance for c in several]),
            np.concatenate([c.chi2 for c in several]),
        )


@dataclass(frozen=True, eq=False)
class _Found:
    """Arrays of the result, all places in one row, to be filled."""

    T: FloatArray
    covariance: FloatArray
    chi2: FloatArray
    weight: FloatArray

    @staticmethod
    def nothing(places: int) -> _Found:
        return _Found(
            np.full((places, SOLUTIONS, 4, 4), np.nan),
            np.full((places, SOLUTIONS, 6, 6), np.nan),
            np.full((places, SOLUTIONS), np.inf),
            np.ones(places),
        )

    def put(self, places: IntArray, candidates: _Candidates, weight: FloatArray) -> None:
        self.T[places], self.covariance[places] = candidates.T, candidates.covariance
        self.chi2[places], self.weight[places] = candidates.chi2, weight


def _alone(views: _Views, table: MarkerTable, camera: CameraModel) -> _Candidates:
    """Each marker's own two poses, in the camera."""
    size_m = np.array([m.size_m for m in table.markers])[views.marker]
    sights = sights_of(size_m[:, None, None] * UNIT_CORNERS, views.seen_px, views.covariance_px2[:, None], camera)
    both = sights[np.repeat(np.arange(len(views)), SOLUTIONS)]
    solved = solve_poses(both, square_poses(sights.rays, size_m).reshape(-1, 4, 4))
    covariance = square_covariance(both, solved.T, solved.information)
    return _best_two(solved, covariance, SOLUTIONS, COORDINATES)


def _best_two(solved: Solved, covariance: FloatArray, starts: int, coordinates: int) -> _Candidates:
    """The best and the next best that is another, of poses found from `starts` starts for each.

    A worse error than chance allows inflates the covariance.
    """
    chi2 = np.where(solved.settled, solved.chi2, np.inf).reshape(-1, starts)
    T, information = solved.T.reshape(-1, starts, 4, 4), solved.information.reshape(-1, starts, 6, 6)
    rows = np.arange(len(chi2))
    best = np.argmin(chi2, axis=1)
    others = np.array(chi2)
    for s in range(starts):  # a few
        others[same_pose(T[rows, best], T[:, s], information[rows, best]), s] = np.inf
    pick = rows[:, None], np.stack([best, np.argmin(others, axis=1)], axis=1)
    chosen = np.stack([chi2[rows, best], others.min(axis=1)], axis=1)
    none = np.isinf(chosen)[..., None, None]
    inflation = np.maximum(np.where(np.isinf(chosen), 1.0, chosen) / chi2_quantile(CHANCE, coordinates - 6), 1.0)
    covariance = covariance.reshape(-1, starts, 6, 6)[pick] * inflation[..., None, None]
    return _Candidates(np.where(none, np.nan, T[pick]), np.where(none, np.nan, covariance), chosen)


def _usable(alone: _Candidates) -> NDArray[np.bool_]:
    """Whether (N,) each marker can be used: not too oblique, its corners those of a square."""
    tilted = viewing_angles(alone.T[:, 0]) <= TILT_GATE_RAD
    square = alone.chi2[:, 0] <= COORDINATES * RMS_GATE_SIGMAS**2
    return tilted & square & np.all(np.isfinite(alone.covariance[:, 0]), axis=(-2, -1))  # NaN compares false


def _fill(found: _Found, views: _Views, alone: _Candidates, table: MarkerTable, camera: CameraModel) -> None:
    """Put each place's candidates: those of its only usable marker, or of all together."""
    usable = np.flatnonzero(_usable(alone))
    usable = usable[np.argsort(views.place[usable], kind="stable")]
    places, first, counts = np.unique(views.place[usable], return_index=True, return_counts=True)
    mounts = np.stack([marker.mount for marker in table.markers])
    for count in np.unique(counts):  # parts with one marker, with two, ...
        chosen = counts == count
        members = usable[first[chosen][:, None] + np.arange(count)]
        if count == 1:
            row = members[:, 0]
            candidates = _on_part(_Candidates(alone.T[row], alone.covariance[row], alone.chi2[row]), mounts, views[row])
        else:
            candidates = _together(members, views, alone, table, camera)
        found.put(places[chosen], candidates, views.weight[members].min(axis=1))


def _on_part(candidates: _Candidates, mounts: FloatArray, views: _Views) -> _Candidates:
    """Poses of the parts from those of their markers: T_cam_marker exp(xi) inverse(M) = T_cam_part exp(Ad_M xi)."""
    M = mounts[views.marker][:, None]
    Ad = se3.adjoint(M)
    return _Candidates(
        candidates.T @ se3.inverse(M), Ad @ candidates.covariance @ np.swapaxes(Ad, -1, -2), candidates.chi2
    )


def _together(
    members: IntArray, views: _Views, alone: _Candidates, table: MarkerTable, camera: CameraModel
) -> _Candidates:
    """Candidates (G) for parts that each show the markers of rows `members` (G, m), from the start of every one."""
    groups, count = members.shape
    mounts = np.stack([marker.mount for marker in table.markers])[views.marker[members]]
    corners_m = np.stack([marker.size_m * UNIT_CORNERS for marker in table.markers])[views.marker[members]]
    points_m = (mounts[:, :, None, :3, :3] @ corners_m[..., None])[..., 0] + mounts[:, :, None, :3, 3]
    sights = sights_of(
        points_m.reshape(groups, -1, 3),
        views.seen_px[members].reshape(groups, -1, 2),
        views.covariance_px2[members],
        camera,
    )
    starts = (alone.T[members] @ se3.inverse(mounts)[:, :, None]).reshape(-1, 4, 4)
    solved = solve_poses(_repeated(sights, SOLUTIONS * count), starts)
    return _best_two(solved, inverse_information(solved.information), SOLUTIONS * count, COORDINATES * count)


def _repeated(sights: Sights, times: int) -> Sights:
    return sights[np.repeat(np.arange(len(sights)), times)]
