"""Bodies: what joints connect. At first each tracked part is one; later several parts that are rigid to each other.

Covariances that are the same in all frames are views of one, with a stride of zero: of many parts over many frames, a
copy of each is most of the memory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData
from station.fit.noise import LEAST_ESTIMATED_SCALE, LEAST_GIVEN_SCALE, given_noise, unknown_noise
from station.fit.pair_model import PairTracks
from station.fit.rests import frames_to_count
from station.kinematics import se3
from station.logs import FloatArray, PoseLog

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# Smallest side of the scene [m]: the volume in which a gross outlier may lie.
LEAST_SCENE_M = 0.1
# Relative to the largest entry: rounding in whatever made the covariance.
SYMMETRIC_WITHIN = 1e-6
# Relative poses that are looked at at once, some 0.5 kB each.
POSES_AT_ONCE = 50_000
# Rows of covariances that are checked at once.
ROWS_AT_ONCE = 1000


@dataclass(frozen=True, eq=False)
class Bodies:
    """Poses of K bodies at T times.

    Attributes:
        names: K.
        T_ref_body: (T, K, 4, 4), identity where not seen.
        seen: (T, K).
        oriented: (T, K) seen with orientation.
        covariance: (T, K, 6, 6) finite; None where it is unknown and has to be estimated for each pair.
        noisy: (K,) False for a reference frame, which is known exactly.
        least_scale: least factor of the given covariances.
        scene_m3: volume of the scene.
    """

    names: tuple[str, ...]
    T_ref_body: FloatArray
    seen: BoolArray
    oriented: BoolArray
    covariance: FloatArray | None
    noisy: BoolArray
    least_scale: float
    scene_m3: float


def bodies_of_log(log: PoseLog) -> Bodies:
    """Each part a body of its own. Covariances are used if every seen part has a finite one for its position.

    Raises:
        InvalidData: for a covariance that is none, and for a position that was not observed.
    """
    seen = np.array(log.seen)
    poses = np.where(seen[..., None, None], log.T_ref_part, np.eye(4))
    oriented, covariance = seen.copy(), None
    if log.covariance is not None:
        _check_positions(log, seen)
        oriented &= np.all(np.isfinite(np.diagonal(log.covariance, axis1=-2, axis2=-1)[..., 3:]), axis=-1)
        if np.all(np.isfinite(log.covariance[seen][:, :3, :3])):
            covariance = _finite_covariance(log.covariance, seen, oriented)
            _check_covariance(log, covariance)
        else:  # rotation flags can be told apart even where no size is: infinite is not observed, NaN is unknown
            oriented = seen & ~np.any(np.isinf(np.diagonal(log.covariance, axis1=-2, axis2=-1)[..., 3:]), axis=-1)
    noisy = np.ones(len(log.parts), dtype=bool)
    return Bodies(log.parts, poses, seen, oriented, covariance, noisy, LEAST_GIVEN_SCALE, _scene(poses, seen))


def _check_positions(log: PoseLog, seen: BoolArray) -> None:
    """Raise InvalidData for an infinite variance of a position: a part without one was not seen."""
    if log.covariance is None:
        return
    lost = seen & np.any(np.isinf(np.diagonal(log.covariance, axis1=-2, axis2=-1)[..., :3]), axis=-1)
    if np.any(lost):
        row, part = np.argwhere(lost)[0]
        raise InvalidData(
            f"'{log.parts[part]}' in row {row}: its position has an infinite variance; want a finite one, or a NaN pose"
            " if the part was not seen; only orientations may be unobserved"
        )


def _check_covariance(log: PoseLog, covariance: FloatArray) -> None:
    """Raise InvalidData for a covariance that is no positive definite matrix."""
    largest = np.abs(covariance).max(initial=0.0)
    for row in range(0, len(covariance), ROWS_AT_ONCE):  # memory asks for this loop
        some = covariance[row : row + ROWS_AT_ONCE]
        swapped = np.swapaxes(some, -1, -2)
        good = np.abs(some - swapped).max(axis=(-2, -1), initial=0.0) <= SYMMETRIC_WITHIN * largest
        try:
            np.linalg.cholesky(0.5 * (some + swapped))
        except np.linalg.LinAlgError:
            good &= np.linalg.eigvalsh(0.5 * (some + swapped))[..., 0] > 0
        if not np.all(good):
            at, part = np.argwhere(~good)[0]
            raise InvalidData(
                f"the covariance of '{log.parts[part]}' in row {row + at} is not symmetric and positive definite; "
                "give one that is, or none at all: the noise is then estimated"
            )


def with_reference(bodies: Bodies, reference: str) -> Bodies:
    """The bodies with the reference frame before them: a static one, identity, without noise."""
    T = len(bodies.seen)
    first = np.ones((T, 1), dtype=bool)
    covariance = bodies.covariance
    return replace(
        bodies,
        names=(reference, *bodies.names),
        T_ref_body=np.concatenate([se3.identity(T, 1), bodies.T_ref_body], axis=1),
        seen=np.concatenate([first, bodies.seen], axis=1),
        oriented=np.concatenate([first, bodies.oriented], axis=1),
        covariance=None if covariance is None else np.concatenate([np.zeros((T, 1, 6, 6)), covariance], axis=1),
        noisy=np.concatenate([[False], bodies.noisy]),
    )


def _finite_covariance(covariance: FloatArray, seen: BoolArray, oriented: BoolArray) -> FloatArray:
    """Identity where unseen, and in the rotation block where there is no orientation."""
    full = covariance.copy()
    full[~seen] = np.eye(6)
    flat = seen & ~oriented
    if flat.any():
        positions = full[flat, :3, :3]
        full[flat] = np.eye(6)
        full[flat, :3, :3] = positions
    return full


def _scene(poses: FloatArray, seen: BoolArray) -> float:
    """Volume [m^3] of a cube as large as the scene is long."""
    p = poses[seen][:, :3, 3]
    if not len(p):
        return LEAST_SCENE_M**3
    return float(max(np.max(p.max(axis=0) - p.min(axis=0)), LEAST_SCENE_M)) ** 3


def oriented_pairs(bodies: Bodies, pairs: IntArray) -> IntArray:
    """Pairs (P, 2), turned where only the second has orientations: the parent of a pair needs them."""
    frames = bodies.oriented.sum(axis=0)
    swap = (frames[pairs[:, 0]] == 0) & (frames[pairs[:, 1]] > 0)
    return np.where(swap[:, None], pairs[:, ::-1], pairs)


def counted_tracks(bodies: Bodies, pairs: IntArray, *, at_most: int | None = None) -> PairTracks:
    """Tracks of pairs (P, 2) as `pair_tracks` makes them, of frames at rest as many as of those in motion.

    Args:
        bodies: where the poses are.
        pairs: (P, 2).
        at_most: frames to keep of each pair, spread evenly over those that count; None for all, of which those that
            don't count are taken for unseen.
    """
    counted = _counted(bodies, pairs)
    rows = np.arange(len(bodies.seen))[None] if at_most is None else _spread_rows(counted, at_most)
    tracks = pair_tracks(bodies, pairs, rows=rows)
    kept = np.take_along_axis(counted, np.broadcast_to(rows, tracks.seen.shape), axis=-1)
    return replace(tracks, seen=tracks.seen & kept, oriented=tracks.oriented & kept)


def _counted(bodies: Bodies, pairs: IntArray) -> BoolArray:
    """(P, T) frames that count of pairs (P, 2)."""
    rows = np.arange(len(bodies.seen))[None]
    at_once = max(POSES_AT_ONCE // max(len(bodies.seen), 1), 1)
    some = [pairs[first : first + at_once] for first in range(0, max(len(pairs), 1), at_once)]  # memory asks for pieces
    return np.concatenate([frames_to_count(*_relative_poses(bodies, piece, rows)) for piece in some])


def _relative_poses(bodies: Bodies, pairs: IntArray, rows: IntArray) -> tuple[FloatArray, BoolArray]:
    """T_a_b (P, N, 4, 4) of pairs (P, 2) in some rows (P or 1, N), identity where not seen, and where they were."""
    a, b = pairs[:, :1], pairs[:, 1:]
    seen = bodies.oriented[rows, a] & bodies.seen[rows, b]
    T_a_b = se3.inverse(bodies.T_ref_body[rows, a]) @ bodies.T_ref_body[rows, b]
    return np.where(seen[..., None, None], T_a_b, np.eye(4)), seen


def pair_tracks(bodies: Bodies, pairs: IntArray, *, rows: IntArray | None = None) -> PairTracks:
    """Relative poses of pairs (P, 2) of bodies, parent first, with their noise.

    Args:
        bodies: where the poses are.
        pairs: (P, 2).
        rows: (P, N) frames to keep; None for all.
    """
    a, b = pairs[:, :1], pairs[:, 1:]
    rows = np.arange(len(bodies.seen))[None] if rows is None else rows
    T_a_b, seen = _relative_poses(bodies, pairs, rows)
    oriented = seen & bodies.oriented[rows, b]
    if bodies.covariance is None:
        noise = unknown_noise(T_a_b, bodies.noisy[a[:, 0]], bodies.noisy[b[:, 0]])
    else:
        noise = given_noise(T_a_b, bodies.covariance[rows, a], bodies.covariance[rows, b], bodies.least_scale)
    return PairTracks(T_a_b, seen, oriented, noise, np.full(len(pairs), bodies.scene_m3))


def _spread_rows(counted: BoolArray, at_most: int) -> IntArray:
    """(P, N) rows of frames, N <= at_most, spread evenly over those that count for each pair (P, T), in order.

    A pair of which fewer count is filled up with others.
    """
    count = counted.sum(axis=-1)
    N = int(min(at_most, max(count.max(initial=0), 1)))
    order = np.argsort(~counted, axis=-1, kind="stable")  # counted frames first, each kind in order of time
    position = np.where(count[:, None] > N, (np.arange(N) * count[:, None]) // N, np.arange(N))
    return np.sort(np.take_along_axis(order, position, axis=-1), axis=-1)


def scaled_by_part(bodies: Bodies, variances: FloatArray) -> Bodies:
    """The bodies with the covariances that a first look at the data found.

    Args:
        bodies: one for each part.
        variances: (K, 1) factors of given covariances, or (K, 2) variances of position [m^2] and orientation [rad^2].
    """
    if bodies.covariance is not None:
        factors = np.where(bodies.noisy, variances[:, 0], 0.0)
        covariance = bodies.covariance * factors[:, None, None]
    else:
        diagonal = np.where(bodies.noisy[:, None], np.repeat(variances, 3, axis=-1), 0.0)
        covariance = np.broadcast_to(diagonal[:, None, :] * np.eye(6), (*bodies.seen.shape, 6, 6))
    return replace(bodies, covariance=covariance, least_scale=LEAST_ESTIMATED_SCALE)


@dataclass(frozen=True, eq=False)
class Group:
    """Parts (indices) that are one body, and their mounts T_body_part (M, 4, 4); the first one's is the identity."""

    members: tuple[int, ...]
    mounts: FloatArray
