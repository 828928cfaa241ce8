"""The data that flows: PoseLog (poses of parts over time) and JointLog (states of joints over time)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from station.errors import InvalidData

FloatArray = NDArray[np.float64]

SLUG = re.compile(r"[a-z][a-z0-9_]*")
# Dimensionless. A rotation whose R^T R differs from the identity by more than this came from a bug, not from rounding.
ROTATION_TOLERANCE = 1e-6


def frozen_floats(values: ArrayLike) -> FloatArray:
    """A read-only float64 copy of `values`."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def check_slugs(names: Sequence[str], what: str) -> None:
    """Raise InvalidData unless the names are distinct slugs `[a-z][a-z0-9_]*`."""
    for name in names:
        if not SLUG.fullmatch(name):
            raise InvalidData(f"{what} '{name}' is no name; names match [a-z][a-z0-9_]*")
    if len(set(names)) != len(names):
        twice = sorted({name for name in names if list(names).count(name) > 1})
        raise InvalidData(f"{what} named twice: {', '.join(twice)}")


def check_times(t_s: FloatArray) -> None:
    """Raise InvalidData unless the times (T,) are finite and strictly increasing."""
    if t_s.ndim != 1 or not np.all(np.isfinite(t_s)):
        raise InvalidData(f"times must be one list of finite seconds; have shape {t_s.shape}")
    falls = np.flatnonzero(np.diff(t_s) <= 0)
    if falls.size:
        row = int(falls[0]) + 1
        raise InvalidData(f"times must increase: t = {t_s[row]:g} s in row {row} follows {t_s[row - 1]:g} s")


def _check_poses(T_ref_part: FloatArray, parts: tuple[str, ...]) -> None:
    seen = ~np.all(np.isnan(T_ref_part), axis=(-2, -1))
    poses = T_ref_part[seen]
    R = poses[:, :3, :3]
    deviation = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-2, -1), initial=0.0)
    good = (deviation < ROTATION_TOLERANCE) & (np.linalg.det(R) > 0)  # NaN compares false
    good &= np.all(np.isfinite(poses[:, :3, 3]), axis=-1) & np.all(poses[:, 3] == (0, 0, 0, 1), axis=-1)
    if not np.all(good):
        row, part = np.argwhere(seen)[np.flatnonzero(~good)[0]]
        raise InvalidData(f"the pose of '{parts[part]}' in row {row} is no rigid motion (a part not seen is all NaN)")


@dataclass(frozen=True, eq=False, slots=True)
class PoseLog:
    """Poses of K parts at T times, checked and frozen.

    Attributes:
        t_s: (T,) strictly increasing seconds.
        reference: the frame the poses are in, "camera" or "world".
        parts: K distinct slugs.
        T_ref_part: (T, K, 4, 4) poses; all-NaN where a part was not seen.
        covariance: (T, K, 6, 6) of the right perturbation [m, rad]; None where unknown (it is then estimated);
            infinite variance where a direction was not observed.

    Raises:
        InvalidData: for shapes that don't agree, falling times, names that are no slugs, poses that are no rigid
            motions.
    """

    t_s: FloatArray
    reference: str
    parts: tuple[str, ...]
    T_ref_part: FloatArray
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_floats(self.t_s))
        object.__setattr__(self, "parts", tuple(self.parts))
        object.__setattr__(self, "T_ref_part", frozen_floats(self.T_ref_part))
        check_times(self.t_s)
        check_slugs(self.parts, "part")
        shape = (len(self.t_s), len(self.parts))
        if self.T_ref_part.shape != (*shape, 4, 4):
            raise InvalidData(f"poses have shape {self.T_ref_part.shape}; want {(*shape, 4, 4)} (times, parts, 4, 4)")
        _check_poses(self.T_ref_part, self.parts)
        if self.covariance is not None:
            object.__setattr__(self, "covariance", frozen_floats(self.covariance))
            if self.covariance.shape != (*shape, 6, 6):
                raise InvalidData(f"covariance has shape {self.covariance.shape}; want {(*shape, 6, 6)}")

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(T, K) whether each part was seen."""
        return ~np.isnan(self.T_ref_part[:, :, 0, 0])


@dataclass(frozen=True, eq=False, slots=True)
class JointLog:
    """States of J joints at T times, checked and frozen: commands, read-back and detected states.

    Attributes:
        t_s: (T,) strictly increasing seconds.
        joints: J distinct slugs.
        q: (T, J) continuous states (never wrapped); NaN where there is none.
        units: J units, "rad" or "m".
        std: (T, J) standard deviations in the same units, or None where they are not estimates.

    Raises:
        InvalidData: for shapes that don't agree, falling times, names that are no slugs, other units.
    """

    t_s: FloatArray
    joints: tuple[str, ...]
    q: FloatArray
    units: tuple[str, ...]
    std: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_floats(self.t_s))
        object.__setattr__(self, "joints", tuple(self.joints))
        object.__setattr__(self, "q", frozen_floats(self.q))
        object.__setattr__(self, "units", tuple(self.units))
        check_times(self.t_s)
        check_slugs(self.joints, "joint")
        shape = (len(self.t_s), len(self.joints))
        if self.q.shape != shape:
            raise InvalidData(f"joint states have shape {self.q.shape}; want {shape} (times, joints)")
        if len(self.units) != len(self.joints) or not set(self.units) <= {"rad", "m"}:
            raise InvalidData(f"units {self.units}; want one of rad, m for each of {len(self.joints)} joints")
        if self.std is not None:
            object.__setattr__(self, "std", frozen_floats(self.std))
            if self.std.shape != shape:
                raise InvalidData(f"standard deviations have shape {self.std.shape}; want {shape}")

    def state(self, joint: str) -> FloatArray:
        """(T,) states of one joint; raises InvalidData for a name that isn't there."""
        if joint not in self.joints:
            raise InvalidData(f"no joint '{joint}'; have {', '.join(self.joints) or 'none'}")
        return self.q[:, self.joints.index(joint)]
