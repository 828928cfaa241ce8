"""Corners of markers on a tree's parts, whitened, as the least squares on a tree ask for them.

A sighting is drawn from the corners' own covariance, or, an outlier, from one of a ladder of wider ones: a marker
half hidden, a reflex, a wrong decoding. So the farther off, the less it pulls. Each marker's deviations have a scale
of their own beside those stated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, logsumexp, softmax

from station.fit.image.camera_numbers import Unknowns
from station.fit.image.projection import by_twists, corner_places, projected, with_derivatives
from station.fit.image.shutter import Motion, motion_of, moved_points, point_motions
from station.fit.image.views import COORDINATES, CORNERS, IntArray, Views
from station.fit.tree_data import PartEquations
from station.fit.tree_residuals import BETTER_SHARE, HOT, better_ones
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# Deviations of sightings as multiples of their own, and how many have them.
LADDER = np.array([1.0, 5.0, 25.0, 125.0, 625.0])
SHARES = np.array([0.97, 0.012, 0.008, 0.005, 0.005])
LOG_DENSITIES = np.log(SHARES) - COORDINATES * np.log(LADDER)
# What a sighting that is no outlier costs beside its squared residual.
CONSTANT = -2 * float(LOG_DENSITIES[0])
# Squared residual up to which the better corners' usually are.
USUAL = float(2.0 * gammaincinv(COORDINATES / 2, BETTER_SHARE))
# Residual of a corner that the model puts behind the camera.
BEHIND_PX = 1e4


@dataclass(frozen=True, eq=False)
class CornerData:
    """Corners of M markers on K parts in T frames.

    Attributes:
        unknowns: of the camera; the numbers that all share.
        views: for what doesn't change from frame to frame.
        part: (M,) which of the tree's parts each is on.
        points_m: (M, 4, 3) corners in the parts' frames.
        seen: (T, M).
        px: (T, M, 4, 2) corners.
        whitener: (T, M, 8, 8) W with W^T W the inverse covariance as stated; zero unseen.
        motion: for a rolling shutter; None without.
        scale: (M,) deviations as multiples of those stated.
    """

    unknowns: Unknowns
    views: Views
    part: IntArray
    points_m: FloatArray
    seen: BoolArray
    px: FloatArray
    whitener: FloatArray
    motion: Motion | None
    scale: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        """(T, M)."""
        return self.seen.shape[0], self.seen.shape[1]

    def take(self, rows: slice | IntArray) -> CornerData:
        """Some of the frames."""
        return replace(
            self,
            seen=self.seen[rows],
            px=self.px[rows],
            whitener=self.whitener[rows],
            motion=None if self.motion is None else self.motion.take(rows),
        )

    def of_marker(self, marker: int) -> CornerData:
        """One of the markers alone, on a part that is the only one."""
        one = slice(marker, marker + 1)
        return replace(
            self,
            part=np.zeros(1, dtype=np.intp),
            points_m=self.points_m[one],
            seen=self.seen[:, one],
            px=self.px[:, one],
            whitener=self.whitener[:, one],
            motion=None if self.motion is None else self.motion.of_markers(one),
            scale=self.scale[one],
        )

    def places(self, T_ref_part: FloatArray, readout_s: float) -> FloatArray:
        """(T, M, 4, 3) corners in the camera's frame, each at its own time, by the parts' poses (T, K, 4, 4)."""
        T_ref_marker, points_m = T_ref_part[:, self.part], self.points_m
        if self.motion is None:
            return corner_places(T_ref_marker, points_m)
        xi, _ = self.motion.at(readout_s)
        return corner_places(T_ref_marker, moved_points(xi, points_m))

    def residual_px(self, T_ref_part: FloatArray, shared: FloatArray) -> FloatArray:
        """(T, M, 8) measured less model; 0 unseen."""
        numbers = self.unknowns.at(shared)
        px = projected(self.views.camera, numbers, self.places(T_ref_part, numbers.readout_s))
        return self._less(px)

    def _less(self, px: FloatArray) -> FloatArray:
        off = np.where(np.isnan(px), BEHIND_PX, self.px - px) * self.seen[..., None, None]
        return off.reshape(*self.shape, COORDINATES)

    def whitened(self, residual_px: FloatArray) -> FloatArray:
        """(T, M, 8) residuals in deviations."""
        return (self.whitener @ residual_px[..., None])[..., 0] / self.scale[:, None]

    def chi2(self, T_ref_part: FloatArray, shared: FloatArray) -> FloatArray:
        """(T, M) whitened squared residuals."""
        whitened = self.whitened(self.residual_px(T_ref_part, shared))
        return np.einsum("tmi,tmi->tm", whitened, whitened)

    def derivatives(
        self, T_ref_part: FloatArray, shared: FloatArray, centre: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals (T, M, 8), and their derivatives (T, M, 8, 6 + e) by the parts' twists about `centre`
        (T, 3) and by the shared numbers.
        """
        numbers = self.unknowns.at(shared)
        p_ref = self.places(T_ref_part, numbers.readout_s)
        found = with_derivatives(self.views.camera, numbers, p_ref)
        of_camera = {
            "edge_shift_px": lambda: found.by_shift_px,
            "focal": lambda: found.from_centre_px / numbers.focal,
            "readout_s": lambda: self._by_readout(T_ref_part, numbers.readout_s, found.by_place),
        }
        columns = [of_camera[name]()[..., None] for name in self.unknowns.names]
        by_all = np.concatenate([by_twists(found, p_ref, centre), *columns], axis=-1)
        known = np.nan_to_num(by_all.reshape(*self.shape, COORDINATES, -1))
        whitener = self.whitener / self.scale[:, None, None]
        return (whitener @ self._less(found.px)[..., None])[..., 0], -whitener @ known

    def _by_readout(self, T_ref_part: FloatArray, readout_s: float, by_place: FloatArray) -> FloatArray:
        """(T, M, 4, 2) motion of the corners by the readout."""
        if self.motion is None:
            return np.zeros(self.px.shape)
        xi, by_readout = self.motion.at(readout_s)
        moves = point_motions(xi, by_readout, self.points_m)
        turned = moves @ np.swapaxes(T_ref_part[:, self.part, :3, :3], -1, -2)
        return (by_place @ turned[..., None])[..., 0]

    def on_parts(
        self, T_ref_part: FloatArray, shared: FloatArray, centre: FloatArray, weights: FloatArray
    ) -> PartEquations:
        """Equations of the parts, each the sum of its markers'; weights (T, M)."""
        whitened, by = self.derivatives(T_ref_part, shared, centre)
        weighted_t = np.ascontiguousarray(np.swapaxes(by, -1, -2)) * weights[..., None, None]
        of_marker = weighted_t @ by, (weighted_t @ whitened[..., None])[..., 0]
        return PartEquations(*(self._summed(of, T_ref_part.shape[1]) for of in of_marker))

    def _summed(self, of_marker: FloatArray, parts: int) -> FloatArray:
        """(T, K, ...) sums of each part's markers (T, M, ...)."""
        found = np.zeros((of_marker.shape[0], parts, *of_marker.shape[2:]))
        for m, k in enumerate(self.part):  # markers are few
            found[:, k] += of_marker[:, m]
        return found

    def heat(self, chi2: FloatArray) -> FloatArray:
        """(M,) factors, at least 1, of the variances of markers that as a whole are not where they belong yet."""
        against_usual = np.where(self.seen, chi2 / USUAL, np.inf)
        return np.maximum(better_ones(against_usual, self.seen) / HOT, 1.0)

    def hotter(self, heat: FloatArray) -> CornerData:
        """With variances so many times as large (M,)."""
        return replace(self, scale=self.scale * np.sqrt(heat))

    def inliers(self, chi2: FloatArray) -> FloatArray:
        """(T, M) probability that a sighting is no outlier; 0 unseen."""
        return _probabilities(chi2)[0] * self.seen

    def weights(self, chi2: FloatArray) -> FloatArray:
        """(T, M) what squared residuals count: those of an outlier little, but they still pull."""
        return np.tensordot(LADDER**-2, _probabilities(chi2), 1) * self.seen

    def costs(self, chi2: FloatArray) -> FloatArray:
        """(T, M) -2 log likelihood of each sighting, but for a constant."""
        return costs_of_squares(chi2) * self.seen


def costs_of_squares(chi2: FloatArray) -> FloatArray:
    """(...) -2 log likelihood of sightings with squared residuals (...) in deviations, but for a constant."""
    return -2 * np.asarray(logsumexp(_log_densities(chi2), axis=0), dtype=np.float64)


def _log_densities(chi2: FloatArray) -> FloatArray:
    """(5, ...) of the ladder's steps."""
    steps = (-1,) + (1,) * chi2.ndim
    return LOG_DENSITIES.reshape(steps) - 0.5 * chi2 * LADDER.reshape(steps) ** -2


def _probabilities(chi2: FloatArray) -> FloatArray:
    """(5, T, M) that a sighting is of each step of the ladder."""
    return np.asarray(softmax(_log_densities(chi2), axis=0), dtype=np.float64)


def corner_data(views: Views, parts: tuple[str, ...], unknowns: Unknowns) -> CornerData:
    """What was seen of a tree's parts, in their order, a marker a column; nothing moves yet."""
    some = views.of_parts(parts)
    shape = len(some.t_s), len(some.marker_id)
    at = some.frame, some.marker
    seen = np.zeros(shape, dtype=bool)
    px = np.zeros((*shape, CORNERS, 2))
    whitener = np.zeros((*shape, COORDINATES, COORDINATES))
    seen[at], px[at] = True, some.corners_px
    if len(some):
        whitener[at] = np.linalg.inv(np.linalg.cholesky(some.covariance_px2))
    rolling = unknowns.given.readout_s > 0 or "readout_s" in unknowns.names
    row = px[..., 1] / some.camera.size_px[1] - 0.5
    motion = motion_of(some.t_s, row, seen) if rolling else None
    return CornerData(unknowns, some, some.part, some.points_m, seen, px, whitener, motion, np.ones(shape[1]))
