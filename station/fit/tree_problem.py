"""One branch of a tree and what was measured of it, worked on in chunks of frames on all cores.

Sums over the chunks are made in order, so that results don't depend on the cores.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np

from station.fit.parallel import each
from station.fit.skeleton import Skeleton, TreeModel
from station.fit.tree_data import TreeData
from station.fit.tree_elimination import UNOBSERVED, FrameStates, Reduced, eliminated
from station.fit.tree_equations import equations
from station.fit.tree_motion import tree_poses
from station.logs import FloatArray

Found = TypeVar("Found")
Data = TypeVar("Data", bound=TreeData)

# Numbers in the arrays of one chunk of frames, 8 bytes each. Fewer, and calls cost more than numbers do.
CHUNK_NUMBERS = 3_000_000
# Groups of chunks of which each holds a sum of its own: enough for all cores, and the same on any computer.
GROUPS = 16
# Numbers of couplings that are kept between the uses of a linearisation, 8 bytes each; the rest is made anew.
HELD_NUMBERS = 15_000_000


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the numbers that all parts share before anything is measured: values and deviations (e,)."""

    values: FloatArray
    std: FloatArray

    def cost(self, shared: FloatArray) -> float:
        """-2 log density of shared numbers (e,), but for a constant."""
        return float(np.sum(((shared - self.values) / self.std) ** 2))

    def equations(self, skeleton: Skeleton, shared: FloatArray) -> Reduced:
        """As if it had been measured."""
        n, columns = skeleton.parameters, skeleton.shared_columns
        information, g = np.zeros(n), np.zeros(n)
        information[columns] = self.std**-2.0
        g[columns] = (shared - self.values) * information[columns]
        return Reduced(np.diag(information), g, information, 0.0, 0.0)


NO_PRIOR = Prior(np.zeros(0), np.zeros(0))


@dataclass(frozen=True, eq=False)
class Problem(Generic[Data]):
    """A branch and what was measured of it, in chunks of frames."""

    skeleton: Skeleton
    measured: Data
    prior: Prior = NO_PRIOR

    @property
    def chunks(self) -> list[slice]:
        """Frames that are worked on at once; in an even number of chunks, so that two cores have the same to do."""
        T, K = self.measured.shape
        n, s = self.skeleton.parameters, self.skeleton.states
        most = max(CHUNK_NUMBERS // (200 * K + (s + 20) * (n + s)), 1)
        count = -(-T // most)
        ends = [round(i * T / (count + count % 2)) for i in range(count + count % 2 + 1)] if count > 1 else [0, T]
        return [slice(start, stop) for start, stop in pairwise(ends)]

    def chi2(self, model: TreeModel) -> FloatArray:
        """(T, C) whitened squared residuals."""

        def of_chunk(rows: slice) -> FloatArray:
            poses = tree_poses(self.skeleton, model.take(rows))
            return self.measured.take(rows).chi2(poses.parts, model.shared)

        return np.concatenate(each(of_chunk, self.chunks))

    def linearised(self, model: TreeModel, inlier: FloatArray, damping: float) -> Linearised:
        """Equations at a model, what was measured weighted by `inlier` (T, C)."""

        def of_chunk(rows: slice) -> tuple[Reduced, FrameStates]:
            found = equations(self.skeleton, model.take(rows), self.measured.take(rows), inlier[rows])
            return eliminated(self.skeleton, found, damping)

        def of_group(group: Sequence[slice]) -> tuple[Reduced, list[FrameStates]]:
            total, states = of_chunk(group[0])
            kept = [_kept(states, group[0])]
            for rows in group[1:]:  # memory asks for this loop: each has a matrix of all parameters
                reduced, states = of_chunk(rows)
                total, kept = total.plus(reduced), [*kept, _kept(states, rows)]
            return total, kept

        chunks = self.chunks
        share = -(-len(chunks) // GROUPS)
        found = each(of_group, [chunks[i : i + share] for i in range(0, len(chunks), share)])
        total = self.prior.equations(self.skeleton, model.shared)
        for reduced, _ in found:
            total = total.plus(reduced)
        held = tuple(states for _, group in found for states in group)
        return Linearised(total, damping, tuple(chunks), held, lambda rows: of_chunk(rows)[1])


def _kept(states: FrameStates, rows: slice) -> FrameStates:
    """Without the largest arrays, if those of the frames up to there are too many to keep."""
    numbers = sum(Z[0].size for Z in states.Z)
    return states if rows.stop * numbers <= HELD_NUMBERS else replace(states, Z=())


@dataclass(frozen=True, eq=False)
class Linearised:
    """Equations of all frames.

    Attributes:
        reduced: of the parameters.
        damping: relative, that they were made with.
        rows: frames of each chunk.
        held: states of each chunk.
        again: makes those of which not all was kept.
    """

    reduced: Reduced
    damping: float
    rows: Sequence[slice]
    held: Sequence[FrameStates]
    again: Callable[[slice], FrameStates]

    def each_chunk(self, function: Callable[[FrameStates], Found]) -> list[Found]:
        """Results of a function of the states of each chunk."""
        return self.each_rows(lambda rows, states: function(states))

    def each_rows(self, function: Callable[[slice, FrameStates], Found]) -> list[Found]:
        """Results of a function of each chunk's frames and states."""

        def of_chunk(work: tuple[slice, FrameStates]) -> Found:
            rows, held = work
            return function(rows, held if held.Z else self.again(rows))

        return each(of_chunk, list(zip(self.rows, self.held, strict=True)))

    def step(self) -> FloatArray:
        """(n,) change of the parameters; their columns are scaled so that one damping suits metres and radians."""
        scale = 1 / np.sqrt(np.where(self.reduced.unreduced > 0, self.reduced.unreduced, 1.0))
        scaled = self.reduced.H * np.outer(scale, scale) + (self.damping + UNOBSERVED) * np.eye(len(scale))
        return -scale * np.linalg.solve(scaled, scale * self.reduced.g)

    def states_step(self, step: FloatArray) -> FloatArray:
        """(T, s) best change of the states for a change of the parameters."""
        return np.concatenate(self.each_chunk(lambda chunk: chunk.states_step(step)))
