"""What a tree is fitted to, poses of its parts or corners of their markers, as the least squares on it ask for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray

IntArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class PartEquations:
    """Half the weighted squared residuals of each part, by its twist and by the numbers that all parts share.

    Attributes:
        information: (T, K, 6 + e, 6 + e) second derivatives, the e shared numbers last.
        pull: (T, K, 6 + e) gradients.
    """

    information: FloatArray
    pull: FloatArray


class TreeData(Protocol):
    """Things measured of K parts in T frames, C a frame at most: a pose a part, or a marker's corners each."""

    @property
    def shape(self) -> tuple[int, int]:
        """(T, C)."""
        ...

    def take(self, rows: slice | IntArray) -> Self:
        """Some of the frames."""
        ...

    def chi2(self, T_ref_part: FloatArray, shared: FloatArray) -> FloatArray:
        """(T, C) whitened squared residuals of model poses (T, K, 4, 4) and shared numbers (e,); 0 unseen."""
        ...

    def on_parts(
        self, T_ref_part: FloatArray, shared: FloatArray, centre: FloatArray, weights: FloatArray
    ) -> PartEquations:
        """Equations by twists along the reference's axes about `centre` (T, 3); weights (T, C)."""
        ...

    def heat(self, chi2: FloatArray) -> FloatArray:
        """(C,) factors, at least 1, of the variances of what as a whole doesn't fit yet."""
        ...

    def hotter(self, heat: FloatArray) -> Self:
        """With variances so many times as large (C,)."""
        ...

    def weights(self, chi2: FloatArray) -> FloatArray:
        """(T, C) probability that each is no outlier."""
        ...

    def costs(self, chi2: FloatArray) -> FloatArray:
        """(T, C) -2 log likelihood of each, inlier or outlier, but for a constant."""
        ...
