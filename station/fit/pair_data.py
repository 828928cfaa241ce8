"""What was measured of pairs, with entries first, ready for least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.entrywise import entries_first
from station.fit.noise import Noise
from station.fit.whitening import GivenNoise, PairNoise, UnknownNoise, given_whitening
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class PairData:
    """Relative poses of P pairs over T frames.

    Attributes:
        R: (3, 3, P, T) and
        t: (3, P, T) of T_a_b.
        seen: (P, T) both parts were seen.
        oriented: (P, T) seen, and the orientation was measured.
        noise: of the relative poses.
        log_outlier: (P, T) logarithm of the density of an outlier [1/m^3 or 1/(m^3 rad^3)]; 0 unseen.
        scene_m: (P,) length of the scene.
    """

    R: FloatArray
    t: FloatArray
    seen: BoolArray
    oriented: BoolArray
    noise: PairNoise
    log_outlier: FloatArray
    scene_m: FloatArray

    def take(self, rows: IntArray | BoolArray) -> PairData:
        """The data of some of the pairs."""
        return PairData(
            self.R[:, :, rows],
            self.t[:, rows],
            self.seen[rows],
            self.oriented[rows],
            self.noise.take(rows),
            self.log_outlier[rows],
            self.scene_m[rows],
        )

    def frames(self, rows: IntArray, frames: IntArray) -> PairData:
        """Some frames (N,) of some pairs (N,), each as a pair of its own."""
        return PairData(
            self.R[:, :, rows, frames, None],
            self.t[:, rows, frames, None],
            self.seen[rows, frames, None],
            self.oriented[rows, frames, None],
            self.noise.frames(rows, frames),
            self.log_outlier[rows, frames, None],
            self.scene_m[rows],
        )


def pair_data(
    T_a_b: FloatArray, seen: BoolArray, oriented: BoolArray, noise: Noise, log_outlier: FloatArray, scene_m: FloatArray
) -> PairData:
    """Data of poses (P, T, 4, 4)."""
    R, t = entries_first(T_a_b)
    if noise.noisy is None:
        ours: PairNoise = GivenNoise(given_whitening(noise.shape, R, seen, oriented), noise.least)
    else:
        ours = UnknownNoise(t, noise.noisy, seen, oriented, noise.least)
    return PairData(R, t, seen, oriented, ours, log_outlier, scene_m)
