"""Parts that repeat another one: a tracker under two names, or a point of the same tracked body at a fixed offset.

The errors of such a part are the other's and tell nothing of their own. As trackers of one body the two would agree to
rounding, and all noise would seem to be as small. So a copy is told before the fit and counts once: its poses only fill
frames in which the other was not seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.noise import ROUNDING
from station.fit.result import Fit
from station.kinematics import se3
from station.kinematics.joints.base import BALANCE_M
from station.logs import FloatArray, PoseLog

BoolArray = NDArray[np.bool_]

# Frames, spread evenly, by which most pairs are seen to be none.
SAMPLE = 32
# A copy's offset changes by rounding, of numbers in files and of arithmetic, and by no more than this share of what the
# poses themselves change by.
WITHIN_M, SHARE = 50 * ROUNDING, 1e-3


@dataclass(frozen=True)
class Copies:
    """A log without its copies, which part each copy repeats, and where it is on that, (4, 4)."""

    log: PoseLog
    repeats: Mapping[str, str]
    offsets: Mapping[str, FloatArray]

    def original(self, part: str | None) -> str | None:
        """The part that stands for this one."""
        return part if part is None else self.repeats.get(part, part)

    def added(self, fit: Fit, names: tuple[str, ...]) -> Fit:
        """The fit with the copies on the bodies of what they repeat; `names` are all parts in their order."""
        if not self.repeats:
            return fit
        copies = [name for name in names if name in self.repeats]
        groups = [set(group) for group in fit.tree.rigid_groups]
        for copy in copies:
            body = next((group for group in groups if self.repeats[copy] in group), None)
            if body is None:
                groups.append({self.repeats[copy], copy})
            else:
                body.add(copy)
        order = (*(name for name in fit.tree.parts if name not in names), *names)
        in_order = sorted((tuple(sorted(group, key=order.index)) for group in groups), key=lambda g: order.index(g[0]))
        told = tuple(
            f"{copy} repeats {self.repeats[copy]} at a fixed offset, to rounding: the two are counted as one tracker"
            for copy in copies
        )
        mounts = dict(fit.tree.mounts)
        for copy in copies:
            if (original := self.repeats[copy]) in fit.tree.bodies or original in mounts:
                mounts[copy] = mounts.get(original, np.eye(4)) @ self.offsets[copy]
        tree = replace(
            fit.tree,
            mounts=mounts,
            parts=order,
            rigid_groups=tuple(in_order),
            warnings=(*told, *fit.tree.warnings),
        )
        return replace(fit, tree=tree)


def without_copies(log: PoseLog) -> Copies:
    """The log with parts that repeat an earlier one taken out."""
    seen, T_ref_part = np.array(log.seen), log.T_ref_part
    repeats: dict[int, tuple[int, FloatArray]] = {}
    for a, b in _alike(T_ref_part, seen):  # few but for exact poses
        if b in repeats or a in repeats:
            continue
        both = np.flatnonzero(seen[:, a] & seen[:, b])
        offset = se3.inverse(T_ref_part[both, a]) @ T_ref_part[both, b]
        if _repeats(_changes(offset), _changes(T_ref_part[both, b])):
            repeats[b] = a, offset[0]
    if not repeats:
        return Copies(log, {}, {})
    kept = [k for k in range(len(log.parts)) if k not in repeats]
    poses = T_ref_part.copy()
    covariance = None if log.covariance is None else log.covariance.copy()
    for b, (a, T_a_b) in repeats.items():
        rows = np.flatnonzero(seen[:, b] & np.isnan(poses[:, a, 0, 0]))
        poses[rows, a] = T_ref_part[rows, b] @ se3.inverse(T_a_b)
        if covariance is not None:
            covariance[rows, a] = _moved(covariance[rows, b], se3.adjoint(T_a_b))
    rest = PoseLog(
        log.t_s,
        log.reference,
        tuple(log.parts[k] for k in kept),
        poses[:, kept],
        None if covariance is None else covariance[:, kept],
    )
    return Copies(
        rest,
        {log.parts[b]: log.parts[a] for b, (a, _) in repeats.items()},
        {log.parts[b]: T_a_b for b, (_, T_a_b) in repeats.items()},
    )


def _alike(T_ref_part: FloatArray, seen: BoolArray) -> list[tuple[int, int]]:
    """Pairs of parts whose offset doesn't change in a few frames, in order."""
    sample = np.linspace(0, len(seen) - 1, min(SAMPLE, len(seen))).round().astype(np.intp)
    T, seen = T_ref_part[sample], seen[sample]
    a, b = np.triu_indices(T.shape[1], k=1)
    both = seen[:, a] & seen[:, b]
    rows, pair = np.nonzero(both)
    if not rows.size:
        return []
    first = np.argmax(both, axis=0)
    offset = se3.inverse(T[rows, a[pair]]) @ T[rows, b[pair]]
    before = se3.inverse(T[first, a])[pair] @ T[first, b][pair]
    change, moved = np.zeros(len(a)), np.zeros(len(a))
    np.maximum.at(change, pair, _size(before, offset))
    np.maximum.at(moved, pair, _size(T[first, b][pair], T[rows, b[pair]]))
    found = np.flatnonzero(_repeats(change, moved) & (both.sum(axis=0) > 1))
    return [(int(a[i]), int(b[i])) for i in found]


def _changes(T: FloatArray) -> np.float64:
    """How far poses (N, 4, 4) are from the first."""
    return np.float64(_size(T[:1], T).max(initial=0.0))


def _repeats(change: FloatArray | np.float64, moved: FloatArray | np.float64) -> BoolArray | np.bool_:
    """Whether offsets that change by so much [m] are those of copies whose poses change by so much."""
    return (change <= WITHIN_M) & (change < SHARE * moved)


def _size(one: FloatArray, other: FloatArray) -> FloatArray:
    """(...,) [m] between poses (..., 4, 4), a turn of one radian counting as BALANCE_M."""
    xi = se3.log(se3.inverse(one) @ other)
    return np.hypot(np.linalg.norm(xi[..., :3], axis=-1), BALANCE_M * np.linalg.norm(xi[..., 3:], axis=-1))


def _moved(covariance: FloatArray, Ad: FloatArray) -> FloatArray:
    """Covariances (N, 6, 6) of what is at an offset's other end; those that are not known whole stay as they are."""
    known = np.all(np.isfinite(covariance), axis=(-2, -1), keepdims=True)
    return np.where(known, Ad @ np.where(known, covariance, 0.0) @ Ad.T, covariance)
