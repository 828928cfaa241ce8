"""Errors gathered in bins, of viewing angle or of time, beside what the fit predicts for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.compare import JointComparison
from station.logs import FloatArray

# Fewer frames than this say nothing of a root mean square.
LEAST_FRAMES = 5


@dataclass(frozen=True, eq=False)
class Binned:
    """Root mean squares in B bins, NaN where a bin has too few frames.

    Attributes:
        edges: (B + 1,).
        error: (B,) of the errors.
        predicted: (B,) of the standard deviations that the detection states.
        frames: (B,) with both.
    """

    edges: FloatArray
    error: FloatArray
    predicted: FloatArray
    frames: NDArray[np.int64]

    @property
    def centres(self) -> FloatArray:
        """(B,) middles of the bins."""
        return (self.edges[1:] + self.edges[:-1]) / 2


def binned(along: FloatArray, error: FloatArray, std: FloatArray, edges: FloatArray) -> Binned:
    """Errors (T,) and their standard deviations (T,) in the bins of `along` (T,) that `edges` bound; NaN counts not."""
    known = np.isfinite(along) & np.isfinite(error)
    bins = np.clip(np.searchsorted(edges, along[known], side="right") - 1, 0, len(edges) - 2)
    inside = (along[known] >= edges[0]) & (along[known] <= edges[-1])
    bins, error, std = bins[inside], error[known][inside], std[known][inside]
    frames = np.bincount(bins, minlength=len(edges) - 1)
    return Binned(edges, _rms(bins, error, frames), _rms(bins, std, frames), frames)


def _rms(bins: NDArray[np.int64], values: FloatArray, frames: NDArray[np.int64]) -> FloatArray:
    """NaN where a bin has too few frames, or one whose value is unknown."""
    squares = np.bincount(bins, weights=values**2, minlength=len(frames))
    enough = frames >= LEAST_FRAMES
    return np.where(enough, np.sqrt(squares / np.maximum(frames, 1)), np.nan)


def errors_of(joint: JointComparison) -> FloatArray:
    """(T,) detected - read-back, - command where there is no read-back [rad or m]."""
    return joint.detected - (joint.measured if joint.against_measured is not None else joint.commanded)
