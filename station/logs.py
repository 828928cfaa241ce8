"""The data that flows: PoseLog (poses of parts over time) and JointLog (states of joints over time)."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from station.errors import InvalidData

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SLUG = re.compile(r"[a-z][a-z0-9_]*")
# Dimensionless. A rotation whose R^T R differs from the identity by more than this came from a bug, not from rounding.
ROTATION_TOLERANCE = 1e-6
# Metres. Nothing is farther away; the fourth power of a length, which some sums hold, stays far within float64.
FARTHEST_M = 1e12
# Metres or radians. No deviation is smaller; the inverse of its square stays far within float64.
SHARPEST = 1e-12
# Relative to the largest entry: rounding in whatever made the covariance.
SYMMETRIC_WITHIN = 1e-6
# Kinds of arrays that are real numbers: others, such as texts and dates, turn to floats without saying what was lost.
REAL_KINDS = "biufO"
# Poses or covariances, some megabytes.
CHECKED_AT_ONCE = 5000
AXES = ("x", "y", "z", "rx", "ry", "rz")


def frozen_floats(values: ArrayLike, what: str = "values") -> FloatArray:
    """A read-only float64 copy of `values`, NaN where a masked array is masked; raises InvalidData for no numbers."""
    try:
        array = np.asanyarray(values)
        if array.dtype.kind not in REAL_KINDS:
            raise InvalidData(f"{what}: have an array of {array.dtype}; want real numbers")
        masked = np.ma.getmaskarray(array) if isinstance(array, np.ma.MaskedArray) else None
        array = np.array(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidData(f"{what}: want an array of real numbers; {error}") from None
    if masked is not None:
        array[masked] = np.nan
    array.setflags(write=False)
    return array


def names_of(names: Iterable[str], what: str) -> tuple[str, ...]:
    """The names as a tuple; raises InvalidData for what is one text, or no names at all."""
    given = cast(object, names)
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InvalidData(f"{what}: have {given!r}; want a name for each, such as ('base', 'door')")
    return tuple(names)


def check_slugs(names: Sequence[str], what: str) -> None:
    """Raise InvalidData unless the names are distinct slugs `[a-z][a-z0-9_]*`."""
    for name in names:
        if not SLUG.fullmatch(str(name)):
            raise InvalidData(f"{what} '{name}' is no name; names match [a-z][a-z0-9_]*")
    if len(set(names)) != len(names):
        twice = sorted({name for name in names if list(names).count(name) > 1})
        raise InvalidData(f"{what} named twice: {', '.join(twice)}")


def check_times(t_s: FloatArray) -> None:
    """Raise InvalidData unless the times (T,) are finite and strictly increasing."""
    if t_s.ndim != 1:
        raise InvalidData(f"times must be one list of finite seconds; have shape {t_s.shape}")
    wild = np.flatnonzero(~np.isfinite(t_s))
    if wild.size:
        raise InvalidData(f"times must be one list of finite seconds; have {t_s[wild[0]]:g} in row {wild[0]}")
    falls = np.flatnonzero(t_s[1:] <= t_s[:-1])
    if falls.size:
        row = int(falls[0]) + 1
        raise InvalidData(
            f"times must increase: t = {t_s[row]:.15g} s in row {row} follows {t_s[row - 1]:.15g} s; "
            "sort the rows by time and keep one for each"
        )


def _first(bad: BoolArray) -> list[int]:
    """Index of the first True; none if there is none."""
    return np.argwhere(bad)[0].tolist() if bad.any() else []


def _check_seen(
    values: FloatArray,
    seen: BoolArray,
    what: str,
    parts: tuple[str, ...],
    fault: Callable[[FloatArray], tuple[int, str] | None],
) -> None:
    """Raise InvalidData for the first fault in the values (T, K, ...) of seen parts."""
    rows, columns = np.nonzero(seen)
    for start in range(0, len(rows), CHECKED_AT_ONCE):  # memory, not time, asks for this loop
        row, column = rows[start : start + CHECKED_AT_ONCE], columns[start : start + CHECKED_AT_ONCE]
        found = fault(values[row, column])
        if found is not None:
            i, why = found
            raise InvalidData(f"the {what} of '{parts[column[i]]}' in row {row[i]} {why}")


def _pose_fault(T: FloatArray) -> tuple[int, str] | None:
    """Which of the poses (N, 4, 4) of seen parts is none, and why; None if all are good."""
    odd = np.sum(~np.isfinite(T), axis=(-2, -1))
    if at := _first(odd > 0):
        return at[0], f"is no rigid motion: {odd[at[0]]} of 16 numbers are NaN or inf; a part not seen is NaN in all"
    if at := _first(np.any(T[:, 3] != (0, 0, 0, 1), axis=-1)):
        last = " ".join(f"{x:.3g}" for x in T[at[0], 3])
        return at[0], f"is no rigid motion: its last row is {last}; want 0 0 0 1"
    R = np.clip(T[:, :3, :3], -FARTHEST_M, FARTHEST_M)  # so that nothing overflows
    off = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-2, -1), initial=0.0)
    if at := _first(off >= ROTATION_TOLERANCE):
        want = f"want less than {ROTATION_TOLERANCE:g}"
        return at[0], f"is no rigid motion: R^T R of its rotation R is off the identity by {off[at[0]]:.2g}; {want}"
    if at := _first(np.linalg.det(R) < 0):
        return at[0], "is no rigid motion: its determinant is -1, a reflection; want right-handed axes, 1"
    far = np.abs(T[:, :3, 3]).max(axis=-1, initial=0.0)
    if at := _first(far > FARTHEST_M):
        return at[0], f"is {far[at[0]]:.3g} m away; want metres, {FARTHEST_M:g} at most"
    return None


def _covariance_fault(covariance: FloatArray) -> tuple[int, str] | None:
    """Which of (N, 6, 6) is no covariance, and why; None if all look like one (whether definite, the learner checks).

    Variances are infinite where not observed; NaN where unknown, all three of a position or of an orientation.
    """
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    least, most = SHARPEST**2, FARTHEST_M**2
    if at := _first(((variance < least) & (variance != 0)) | ((variance > most) & np.isfinite(variance))):
        want = f"want {least:g} to {most:g}, inf where not observed, NaN where unknown"
        return at[0], f"has a variance of {variance[at[0], at[1]]:g} for {AXES[at[1]]}; {want}"
    unknown = np.isnan(variance).reshape(-1, 2, 3).sum(axis=-1)
    if at := _first(unknown % 3 > 0):
        return at[0], f"is NaN for {unknown[at[0], at[1]]} of three variances; want all of a position or orientation"
    known = np.isfinite(variance)
    both = known[:, :, None] & known[:, None, :]
    between = np.where(both, covariance, 0.0)
    if at := _first(~np.isfinite(between)):
        i, j, k = at
        return i, f"has {covariance[i, j, k]:g} for {AXES[j]} with {AXES[k]}; want a finite number"
    largest = np.abs(between).max(axis=(-2, -1), keepdims=True, initial=0.0)
    gap = np.abs(between - np.swapaxes(between, -1, -2))
    if at := _first(gap > SYMMETRIC_WITHIN * largest):
        i, j, k = at
        there, back = between[i, j, k], between[i, k, j]
        return i, f"is not symmetric: {there:g} for {AXES[j]} with {AXES[k]}, {back:g} the other way round"
    return None


@dataclass(frozen=True, eq=False, slots=True)
class PoseLog:
    """Poses of K parts at T times, checked and frozen.

    Attributes:
        t_s: (T,) strictly increasing seconds.
        reference: the frame the poses are in, "camera" or "world".
        parts: K distinct slugs.
        T_ref_part: (T, K, 4, 4) poses; all-NaN where a part was not seen.
        covariance: (T, K, 6, 6) of the right perturbation [m, rad]; None where unknown (it is then estimated);
            infinite variance where a direction was not observed; NaN where this one alone is unknown.

    Raises:
        InvalidData: for shapes that don't agree, falling times, names that are no slugs, poses that are no rigid
            motions, covariances that are none.
    """

    t_s: FloatArray
    reference: str
    parts: tuple[str, ...]
    T_ref_part: FloatArray
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_floats(self.t_s, "times"))
        object.__setattr__(self, "parts", names_of(self.parts, "parts"))
        object.__setattr__(self, "T_ref_part", frozen_floats(self.T_ref_part, "poses"))
        check_times(self.t_s)
        check_slugs((self.reference,), "reference frame")
        check_slugs(self.parts, "part")
        shape = (len(self.t_s), len(self.parts))
        if self.T_ref_part.shape != (*shape, 4, 4):
            raise InvalidData(f"poses have shape {self.T_ref_part.shape}; want {(*shape, 4, 4)} (times, parts, 4, 4)")
        some = ~np.all(np.isnan(self.T_ref_part), axis=(-2, -1))
        _check_seen(self.T_ref_part, some, "pose", self.parts, _pose_fault)
        if self.covariance is not None:
            object.__setattr__(self, "covariance", frozen_floats(self.covariance, "covariance"))
            if self.covariance.shape != (*shape, 6, 6):
                raise InvalidData(f"covariance has shape {self.covariance.shape}; want {(*shape, 6, 6)}")
            _check_seen(self.covariance, some, "covariance", self.parts, _covariance_fault)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(T, K) whether each part was seen."""
        return ~np.isnan(self.T_ref_part[:, :, 0, 0])


def _check_states(values: FloatArray, bad: BoolArray, what: str, joints: tuple[str, ...]) -> None:
    """Raise InvalidData for the first bad one of values (T, J)."""
    if bad.any():
        row, joint = np.argwhere(bad)[0]
        raise InvalidData(
            f"the {what} of '{joints[joint]}' in row {row} is {values[row, joint]:g}; "
            "want a finite number, or NaN where there is none"
        )


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
        InvalidData: for shapes that don't agree, falling times, names that are no slugs, other units, infinite
            states, negative deviations.
    """

    t_s: FloatArray
    joints: tuple[str, ...]
    q: FloatArray
    units: tuple[str, ...]
    std: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_floats(self.t_s, "times"))
        object.__setattr__(self, "joints", names_of(self.joints, "joints"))
        object.__setattr__(self, "q", frozen_floats(self.q, "joint states"))
        object.__setattr__(self, "units", names_of(self.units, "units"))
        check_times(self.t_s)
        check_slugs(self.joints, "joint")
        shape = (len(self.t_s), len(self.joints))
        if self.q.shape != shape:
            raise InvalidData(f"joint states have shape {self.q.shape}; want {shape} (times, joints)")
        if len(self.units) != len(self.joints) or not set(self.units) <= {"rad", "m"}:
            raise InvalidData(f"units {self.units}; want one of rad, m for each of {len(self.joints)} joints")
        if self.std is not None:
            object.__setattr__(self, "std", frozen_floats(self.std, "standard deviations"))
            if self.std.shape != shape:
                raise InvalidData(f"standard deviations have shape {self.std.shape}; want {shape}")
            _check_states(self.std, self.std < 0, "standard deviation", self.joints)
        _check_states(self.q, np.isinf(self.q), "state", self.joints)

    def state(self, joint: str) -> FloatArray:
        """(T,) states of one joint; raises InvalidData for a name that isn't there."""
        if joint not in self.joints:
            raise InvalidData(f"no joint '{joint}'; have {', '.join(self.joints) or 'none'}")
        return self.q[:, self.joints.index(joint)]
