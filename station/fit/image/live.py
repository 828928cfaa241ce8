"""Joint states from the corners of one frame after another, the tree known: for whoever looks on while it moves.

Each frame's states, and the root's pose, are the least squares of its own corners: steps from where the frame before
ended, and from the poses of single markers where that leads nowhere. The tree's geometry stays as it is. Of a root that
stands still the frames before tell the pose too, the last ones most; one that was pushed is found out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from station.errors import InvalidData
from station.fit.image.camera_numbers import CameraNumbers, Unknowns
from station.fit.image.corner_data import CornerData, corner_data
from station.fit.image.live_chain import Chain, chains_of
from station.fit.image.live_steps import RIDGE, Solved, Still, solved
from station.fit.image.shutter import LONGEST_GAP_S, Motion
from station.fit.image.views import COORDINATES, Views
from station.fit.skeleton import TreeModel
from station.kinematics import se3
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# What frames before tell of a root that stands still counts so much less with each frame: some twenty of them count.
# More would tell little: the errors of a marker that stands still are the same in all frames, for the most part.
KEPT = 0.95
# A root has moved where its frame is so much likelier, in -2 log likelihood, without what was known of it.
MOVED = 40.0
# The covariances' own word on the noise counts like so many residuals; the last frames' count at most like so many.
FIRST_RESIDUALS, LAST_RESIDUALS = 160.0, 4000.0
# A frame doesn't fit where its squared residuals are above this quantile of their distribution.
CHANCE = 1 - 1e-4
# The variances that are reckoned with grow by no more than this factor for what one frame says.
MOST_NOISE = 4.0
# Half of all squared residuals of a marker are below this.
USUAL = float(2.0 * gammaincinv(COORDINATES / 2.0, 0.5))


@dataclass(frozen=True, eq=False)
class SeenStates:
    """States in one frame.

    Attributes:
        t_s: of the frame.
        q: (C,) as the tree's `columns` say; NaN where a body at either end of the joint wasn't seen.
        std: (C,) standard deviations by the corners' covariances, with the noise that the last frames had.
        fits: whether all that was seen agrees with the tree.
    """

    t_s: float
    q: FloatArray
    std: FloatArray
    fits: bool


class StateFollower:
    """Follows a tree's states from frame to frame.

    Args:
        tree: parts whose place on their body it doesn't tell are left out.
        parts: that markers are on; those that the tree doesn't have are left out.
        numbers: of the camera, as a fit found them; the calibration's own if None.
        still: whether the root stands still.

    Raises:
        InvalidData: no part with markers is one of the tree's.
    """

    def __init__(
        self, tree: KinematicTree, parts: Sequence[str], numbers: CameraNumbers | None = None, *, still: bool = True
    ) -> None:
        chains = chains_of(tree, [part for part in parts if part in tree.parts])
        if not chains:
            raise InvalidData(
                f"no marker is on a part of the tree; the tree has {', '.join(tree.parts)}, "
                f"the markers are on {', '.join(parts) or 'nothing'}"
            )
        self._columns, self._numbers = len(tree.columns), numbers
        self._followed = [(chain, _Followed(chain, still=still)) for chain in chains]

    def follow(self, views: Views) -> SeenStates:
        """The states in a frame; `views` are of it alone, and later than those of the frame before."""
        camera = views.camera
        known = self._numbers or CameraNumbers(edge_shift_px=camera.edge_shift_px or 0.0, readout_s=views.readout_s)
        q, std, fits = np.full(self._columns, np.nan), np.full(self._columns, np.nan), True
        for chain, followed in self._followed:  # mostly one
            data = corner_data(views, chain.parts, Unknowns((), known, ()))
            if data.seen.any():
                q[chain.columns], std[chain.columns], agrees = followed.take(data)
                fits = fits and agrees
        return SeenStates(float(views.t_s[0]), q, std, fits)


class _Followed:
    """One tree of the forest, from frame to frame."""

    def __init__(self, chain: Chain, *, still: bool) -> None:
        self._chain, self._stands = chain, still
        self._still: Still | None = None
        self._last: tuple[CornerData, Solved] | None = None
        self._going = np.zeros((len(chain.parts), 6))  # twists of the parts to where they were before, in a second
        self._noise, self._residuals = 1.0, FIRST_RESIDUALS

    def take(self, data: CornerData) -> tuple[FloatArray, FloatArray, bool]:
        """States, their deviations, and whether the frame fits."""
        data = replace(data, scale=np.full(data.scale.shape, np.sqrt(self._noise)))
        if data.motion is not None:
            data = self._in_motion(data, data.motion)
        found = self._found(data)
        if found is None:
            nothing = np.full(len(self._chain.columns), np.nan)
            return nothing, nothing, False
        if data.motion is not None and self._last is not None:  # once more, with how it moved indeed
            before, last = self._last
            back = se3.log(se3.inverse(found.T_ref_part) @ last.T_ref_part)
            self._going = back / (data.views.t_s[0] - before.views.t_s[0])
            data = self._in_motion(data, data.motion)
            found = solved(self._chain, data, found.model, self._still)
        found = self._going_on(found)
        fits = self._fits(found, data)
        self._learn(found, data, fits=fits)
        q, std = self._told(found, data)
        self._last = data, self._without_untold(found, q)
        return q, std, fits

    def _going_on(self, found: Solved) -> Solved:
        """Told by the full turns that are nearest to the last frame's: steps may have gone round."""
        if self._last is None:
            return found
        q = self._chain.nearest_turn(found.model.q[0], self._last[1].model.q[0])
        return replace(found, model=replace(found.model, q=q[None]))

    def _without_untold(self, found: Solved, q: FloatArray) -> Solved:
        """With the last frame's states of joints that this one doesn't tell: outliers still pull at them a little."""
        if self._last is None:
            return found
        kept = np.where(np.isfinite(q), q, self._last[1].model.q[0])
        return replace(found, model=replace(found.model, q=kept[None]))

    def _in_motion(self, data: CornerData, motion: Motion) -> CornerData:
        """With how the parts move on while a rolling shutter reads the frame: as they came from the frame before."""
        if self._last is None:
            return data
        before = self._last[0]
        step_s = float(data.views.t_s[0] - before.views.t_s[0])
        known, twist = np.zeros(motion.known.shape, dtype=bool), np.zeros(motion.twist.shape)
        known[..., 0] = data.seen & before.seen & (step_s <= LONGEST_GAP_S)
        twist[:, :, 0] = np.where(known[..., :1], step_s * self._going[data.part], 0.0)
        return replace(data, motion=replace(motion, step_s=np.array([[-step_s, 1.0]]), twist=twist, known=known))

    def _found(self, data: CornerData) -> Solved | None:
        """The likeliest states: those near the last frame's, if they fit; else the best of all starts."""
        found = [] if self._last is None else [solved(self._chain, data, self._last[1].model, self._still)]
        if found and self._fits(found[0], data):
            return found[0]
        for start in self._starts(data, self._still):
            found += [solved(self._chain, data, start, self._still, trusting=trusting) for trusting in (True, False)]
        best = min(found, key=lambda each: each.cost, default=None)
        if self._still is None or best is None or self._fits(best, data):
            return best
        free = [solved(self._chain, data, start, None) for start in self._starts(data, None)]
        moved = min(free, key=lambda each: each.cost, default=best)
        if moved.cost > best.cost - MOVED:
            return best
        self._still = None
        return moved

    def _starts(self, data: CornerData, still: Still | None) -> Iterator[TreeModel]:
        q = np.zeros(self._chain.skeleton.joint_states) if self._last is None else self._last[1].model.q[0]
        return self._chain.starts(data, None if still is None else still.T_ref_root, q)

    def _left(self, data: CornerData) -> float:
        """Numbers that were measured less those that were fitted, at least 1."""
        fitted = self._chain.skeleton.joint_states + (0 if self._still else 6)
        return float(max(COORDINATES * int(data.seen.sum()) - fitted, 1))

    def _fits(self, found: Solved, data: CornerData) -> bool:
        return float(found.chi2.sum()) <= float(2.0 * gammaincinv(self._left(data) / 2.0, CHANCE))

    def _learn(self, found: Solved, data: CornerData, *, fits: bool) -> None:
        """Where the root stands, and how noisy corners are."""
        if self._stands and (fits or self._still is None):
            self._still = Still(found.model.T_ref_root[0], KEPT * found.root_information())
        left, measured = self._left(data), COORDINATES * int(data.seen.sum())
        if left < COORDINATES:
            return
        usual = float(np.median(found.chi2[data.seen[0]])) / USUAL * measured / left
        told = min(usual, MOST_NOISE) * self._noise
        self._noise = (self._residuals * self._noise + left * told) / (self._residuals + left)
        self._residuals = min(self._residuals + left, LAST_RESIDUALS)

    def _told(self, found: Solved, data: CornerData) -> tuple[FloatArray, FloatArray]:
        """States of joints of which both bodies were seen, and their deviations; NaN of the others."""
        chain, s = self._chain, self._chain.skeleton.joint_states
        bodies = {chain.skeleton.body_of[int(k)] for k in data.part[found.good]}
        if self._still is not None:
            bodies.add(0)
        covariance = np.linalg.inv(found.information + RIDGE * np.eye(s + 6))[:s, :s]
        q = found.model.q[0]
        changes, told = chain.changes(q), chain.told(bodies)
        variance = np.diagonal(changes @ covariance @ changes.T)
        return np.where(told, q, np.nan), np.where(told, np.sqrt(variance), np.nan)
