"""Each frame's states eliminated from a tree's normal equations.

Frames are independent given the parameters, so with H_ss^-1 = R^T R of each frame,

    H = H_pp - sum Z^T Z,   Z = R H_sp,

and the states follow from the parameters' step. A joint's states are coupled to the numbers of the joints between it
and the root, and of what hangs from it. With the outermost states eliminated first, rows of R and Z keep that pattern
(no fill-in; Davis, Direct Methods for Sparse Linear Systems, chapter 4), so that only these columns are multiplied.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.skeleton import Skeleton
from station.fit.tree_equations import Equations
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# Share of each number's own information that is added to it: nothing, but for one that nothing else observes.
UNOBSERVED = 1e-11
# A state that keeps less than this share of its information when those farther out are eliminated is not observed; nor
# is one that has more than the other share in such a direction.
WEAK_PIVOT, WEAK_SHARE = 1e-7, 1e-3


@dataclass(frozen=True, eq=False)
class Reduced:
    """Equations of the parameters alone.

    Attributes:
        H: (n, n).
        g: (n,).
        unreduced: (n,) diagonal of H before the states were eliminated.
        promise: half of what the states alone promise to take off the weighted squared residuals.
        observed: numbers of states that were observed, over all frames.
    """

    H: FloatArray
    g: FloatArray
    unreduced: FloatArray
    promise: float
    observed: float

    def plus(self, other: Reduced) -> Reduced:
        """Those of both's frames."""
        return Reduced(
            self.H + other.H,
            self.g + other.g,
            self.unreduced + other.unreduced,
            self.promise + other.promise,
            self.observed + other.observed,
        )


@dataclass(frozen=True, eq=False)
class FrameStates:
    """What the best states of T frames are for given parameters.

    Attributes:
        root: (T, s, s) R with R^T R = H_ss^-1, rows in the order of the states.
        told: (T, s) whether a state was observed.
        rows: states of each block of rows: a joint's, the root's.
        columns: the n parameters that these are coupled to.
        Z: (T, rows, columns + 1) of each block, R H_sp and, last, R g_s; none where there was no room to keep them.
        parameters: n.
    """

    root: FloatArray
    told: BoolArray
    rows: tuple[slice, ...]
    columns: tuple[IntArray, ...]
    Z: tuple[FloatArray, ...]
    parameters: int

    def states_step(self, step: FloatArray) -> FloatArray:
        """(T, s) best change of the states for a change (n,) of the parameters."""
        found = np.zeros(self.told.shape)
        for rows, columns, Z in zip(self.rows, self.columns, self.Z, strict=True):
            found[:, rows] = Z[..., -1] + Z[..., :-1] @ step[columns]
        return -(np.swapaxes(self.root, -1, -2) @ found[..., None])[..., 0]

    def coupling(self) -> FloatArray:
        """(T, s, n) how the best states change with the parameters, but for the sign."""
        found = np.zeros((*self.told.shape, self.parameters))
        for rows, columns, Z in zip(self.rows, self.columns, self.Z, strict=True):
            found[:, rows, columns] = Z[..., :-1]
        return np.swapaxes(self.root, -1, -2) @ found

    def coupling_times(self, M: FloatArray) -> FloatArray:
        """(T, s, m) the same times a matrix (n, m)."""
        found = np.zeros((*self.told.shape, M.shape[-1]))
        for rows, columns, Z in zip(self.rows, self.columns, self.Z, strict=True):
            flat = np.ascontiguousarray(Z[..., :-1]).reshape(-1, len(columns))
            found[:, rows] = (flat @ M[columns]).reshape(len(Z), -1, M.shape[-1])
        return np.swapaxes(self.root, -1, -2) @ found


def eliminated(skeleton: Skeleton, found: Equations, damping: float) -> tuple[Reduced, FrameStates]:
    """Equations of the parameters alone; `damping` is relative to each state's own information.

    Directions of states that nothing observes, such as those between a body that was not seen and a root that moves,
    stay as they are.
    """
    n = skeleton.parameters
    unit_root, scaled, scale, told = _roots(skeleton, found.H_ss, damping)
    root = unit_root * scale[..., None, :]
    dense, of_gradient = root @ found.H_sp, root @ found.g_s[..., None]
    rows, columns = zip(*skeleton.coupled, strict=True) if skeleton.coupled else ((), ())
    H, g, promise = found.H_pp.copy(), found.g_p.copy(), 0.0
    blocks: list[FloatArray] = []
    for some, at in zip(rows, columns, strict=True):
        block = np.concatenate([dense[:, some, at], of_gradient[:, some]], axis=-1)
        flat = block.reshape(-1, len(at) + 1)
        taken = flat.T @ flat
        H[at[:, None], at] -= taken[:-1, :-1]
        g[at] -= taken[:-1, -1]
        promise += 0.5 * float(taken[-1, -1])
        blocks.append(block)
    observed = float(np.sum((unit_root @ scaled) * unit_root))
    reduced = Reduced(0.5 * (H + H.T), g, np.diagonal(found.H_pp).copy(), promise, observed)
    return reduced, FrameStates(root, told, rows, columns, tuple(blocks), n)


def _roots(
    skeleton: Skeleton, H_ss: FloatArray, damping: float
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """R of the scaled equations, these (T, s, s), their scale (T, s), and which states (T, s) were observed."""
    order = skeleton.outermost_first
    diagonal = np.diagonal(H_ss, axis1=-2, axis2=-1)
    told = diagonal > 0
    scale = 1 / np.sqrt(np.where(told, diagonal, 1.0))
    scaled = H_ss * scale[..., :, None] * scale[..., None, :]
    lifted = scaled[:, order[:, None], order]
    np.einsum("tii->ti", lifted)[...] += np.where(told, UNOBSERVED + damping, 1.0)[:, order]
    factor = np.asarray(np.linalg.cholesky(lifted), dtype=np.float64)
    inverse = np.asarray(np.linalg.inv(factor), dtype=np.float64)
    weak = np.diagonal(factor, axis1=-2, axis2=-1) ** 2 < WEAK_PIVOT
    if weak.any():  # the row of such a pivot is a direction that was not observed
        length = np.linalg.norm(inverse, axis=-1, keepdims=True)
        blind = np.sum(np.where(weak[..., None], inverse / length, 0.0) ** 2, axis=-2)
        told[:, order] &= blind < WEAK_SHARE
        inverse = np.where(weak[..., None], 0.0, inverse)
    unit_root = np.empty_like(inverse)
    unit_root[:, order[:, None], order] = inverse
    return unit_root, scaled, scale, told
