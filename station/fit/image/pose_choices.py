"""Poses of markers that have two, chosen otherwise: logs that a tree may be learned from anew.

A far or small marker seen nearly from its front has two poses that its corners tell alike, and noise that is large
beside what is between them. What one log of poses makes of that may hide the tree, or tell another one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.image.camera_numbers import unknowns
from station.fit.image.corner_data import CornerData, corner_data
from station.fit.image.image_fit import ImageFit
from station.fit.image.likely_states import Told
from station.fit.image.two_answers import UNDECIDED
from station.fit.image.views import Views
from station.kinematics import se3
from station.logs import FloatArray, PoseLog

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# Of the square of what is between two poses, this share is variance where either is to be possible.
EITHER = 0.5


@dataclass(frozen=True, eq=False)
class TwoPoses:
    """Poses of a log that may be otherwise: of parts that show one marker, whose corners tell two nearly alike.

    Attributes:
        log: of K parts in T frames.
        frame: (n,) of each such pose.
        part: (n,) of the log's.
        T_ref_part: (n, 2, 4, 4) both, the likelier first.
        probability: (n,) of the second one.
    """

    log: PoseLog
    frame: IntArray
    part: IntArray
    T_ref_part: FloatArray
    probability: FloatArray

    @property
    def share(self) -> float:
        """Of the poses of the part that has most of them."""
        seen = np.maximum(np.array(self.log.seen).sum(axis=0), 1)
        return float(np.max(np.bincount(self.part, minlength=len(seen)) / seen, initial=0.0))

    def likelier(self) -> PoseLog:
        """Each by its own frame's corners alone."""
        return self._with(self.T_ref_part[:, 0])

    def between(self) -> PoseLog:
        """Their means, with covariances that reach both."""
        here, to_other, which = self._ways()
        share = np.where(which == 1, self.probability, 1 - self.probability)
        moved = here @ se3.exp(share[:, None] * to_other)
        return self._with(moved, (share * (1 - share))[:, None] * to_other, to_other)

    def wider(self) -> PoseLog:
        """As they are, with covariances that reach the other one."""
        here, to_other, _ = self._ways()
        return self._with(here, EITHER * to_other, to_other)

    def as_told(self, image: ImageFit, against: frozenset[str] = frozenset()) -> PoseLog:
        """Those that are nearest to where a tree has its parts, or the other ones of some parts that are told `against`
        it; of parts without a tree as they are.
        """
        column = np.array([image.views.parts.index(p) if p in image.views.parts else -1 for p in self.log.parts])
        tree = np.where((column >= 0)[None, :, None, None], image.T_ref_part[:, column], np.nan)[self.frame, self.part]
        known: BoolArray = np.all(np.isfinite(tree), axis=(-2, -1))
        tree = np.where(known[:, None, None], tree, np.eye(4))
        off = se3.angle((se3.inverse(tree)[:, None] @ self.T_ref_part)[..., :3, :3])
        turned = np.array([part in against for part in self.log.parts])[self.part]
        nearest = self.T_ref_part[np.arange(len(off)), np.where(turned, off.argmax(axis=1), off.argmin(axis=1))]
        return self._with(np.where(known[:, None, None], nearest, self._here))

    @property
    def _here(self) -> FloatArray:
        return self.log.T_ref_part[self.frame, self.part]

    def _ways(self) -> tuple[FloatArray, FloatArray, IntArray]:
        """(n, 4, 4) poses as they are; (n, 6) from each to the other one; which (n,) of the two that is."""
        here = self._here
        ways = se3.log(se3.inverse(here)[:, None] @ self.T_ref_part)
        other = np.argmax(np.linalg.norm(ways, axis=-1), axis=1)
        return here, ways[np.arange(len(ways)), other], other

    def _with(self, T: FloatArray, *factors: FloatArray) -> PoseLog:
        """The log with other poses, and with covariances larger by the product of two factors (n, 6)."""
        poses = self.log.T_ref_part.copy()
        poses[self.frame, self.part] = T
        covariance = self.log.covariance
        if factors and covariance is not None:
            covariance = covariance.copy()
            covariance[self.frame, self.part] += factors[0][:, :, None] * factors[1][:, None, :]
        return PoseLog(self.log.t_s, self.log.reference, self.log.parts, poses, covariance)


def two_poses(log: PoseLog, views: Views) -> TwoPoses:
    """What of a log may be otherwise, by the corners that it is from."""
    some = views.of_parts(log.parts)
    data = corner_data(some, log.parts, unknowns(some.camera, some.readout_s))
    told, squares = Told.of(data), _squares(data)
    dearer = squares[..., 1] - squares[..., 0]
    alone = data.seen.astype(np.float64) @ (data.part[:, None] == np.arange(len(log.parts))) == 1
    has_pose = np.array(log.seen)[:, data.part]
    frame, marker = np.nonzero(told.known.all(axis=-1) & has_pose & alone[:, data.part] & (np.abs(dearer) < UNDECIDED))
    probability = 1 / (1 + np.exp(dearer[frame, marker] / 2))
    return TwoPoses(log, frame, data.part[marker], told.T_ref_part[frame, marker], probability)


def _squares(data: CornerData) -> FloatArray:
    """(T, M, 2) squared residuals of each marker's two poses."""
    told, shared = Told.of(data), data.unknowns.start
    found = np.zeros((*data.shape, 2))
    for m in range(data.shape[1]):  # markers are few
        for i in (0, 1):
            found[:, m, i] = data.of_marker(m).chi2(told.T_ref_part[:, m, i, None], shared)[:, 0]
    return found
