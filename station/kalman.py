"""A Kalman smoother of poses on SE(3): forward filter and Rauch-Tung-Striebel pass back, for all parts at once.

The model: the twist of a part, in its own frame, changes by white noise; q_translation (m^2/s^3) and q_rotation
(rad^2/s^3) say how much. States are a pose T and a twist v, errors [xi, dv] (12) with T exp(xi); between frames
T -> T exp(v dt), xi -> Ad(exp(-v dt)) xi + Jr(v dt) dt dv. Source: T. Barfoot, State Estimation for Robotics, chapters
3 and 8; its mean accelerations are zero here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData
from station.kinematics import se3
from station.logs import FloatArray, PoseLog

# Before anything was seen: a part is within a metre, at any angle, and moves no faster than by hand.
START_SIGMA = np.array([1.0] * 3 + [np.pi] * 3 + [1.0] * 3 + [10.0] * 3)
# A measurement further than this from its prediction, in squared standard deviations of 6 (chance: 1 in 10 000), counts
# less, such that it is just as far: an outlier doesn't drag the poses around it along.
LARGEST_SQUARED = 27.9
# A direction that is less certain than this share of START_SIGMA was not observed.
UNOBSERVED_SHARE = 0.5
# The logarithms (base 10) of the noises that are tried, and the finer steps around the likeliest.
COARSE = np.arange(-6.0, 3.0)
FINE = np.arange(-1, 2) / 3.0
# A covariance's share of its diagonal that keeps it invertible.
JITTER = 1e-12


@dataclass(frozen=True, eq=False)
class _State:
    """Poses (..., 4, 4), twists (..., 6) and covariances (..., 12, 12) of B parts, at one frame or at all."""

    T: FloatArray
    v: FloatArray
    P: FloatArray

    def __getitem__(self, at: int | NDArray[np.intp]) -> _State:
        return _State(self.T[at], self.v[at], self.P[at])

    def replaced(self, rows: NDArray[np.intp], by: _State) -> _State:
        """Another state for some of the parts."""
        T, v, P = self.T.copy(), self.v.copy(), self.P.copy()
        T[rows], v[rows], P[rows] = by.T, by.v, by.P
        return _State(T, v, P)

    @staticmethod
    def stacked(states: list[_State]) -> _State:
        """One for all frames."""
        return _State(np.stack([s.T for s in states]), np.stack([s.v for s in states]), np.stack([s.P for s in states]))


@dataclass(frozen=True, eq=False)
class _Filtered:
    """States of all frames after their measurements and before them.

    Attributes:
        F: (T, B, 12, 12) takes errors to each frame from the one before.
        log_likelihood: (B,) of all measurements but the first.
    """

    after: _State
    before: _State
    F: FloatArray
    log_likelihood: FloatArray


def _noise(q: FloatArray, dt_s: float) -> FloatArray:
    """(B, 12, 12) covariance of white accelerations of densities q (B, 2) over a time."""
    each = np.repeat(q, 3, axis=1)
    Q = np.zeros((len(q), 12, 12))
    i = np.arange(6)
    Q[:, i, i] = each * dt_s**3 / 3
    Q[:, i, i + 6] = Q[:, i + 6, i] = each * dt_s**2 / 2
    Q[:, i + 6, i + 6] = each * dt_s
    return Q


def _predicted(state: _State, q: FloatArray, dt_s: float) -> tuple[_State, FloatArray]:
    """The state a time later, and how errors get there (B, 12, 12)."""
    step = se3.exp(state.v * dt_s)
    F = np.broadcast_to(np.eye(12), state.P.shape).copy()
    F[:, :6, :6] = se3.adjoint(se3.inverse(step))
    F[:, :6, 6:] = se3.right_jacobian(state.v * dt_s) * dt_s
    return _State(state.T @ step, state.v, F @ state.P @ np.swapaxes(F, -1, -2) + _noise(q, dt_s)), F


def _information(covariance: FloatArray) -> FloatArray:
    """Inverses (..., 6, 6): no information of what has infinite variance."""
    known = np.isfinite(np.diagonal(covariance, axis1=-2, axis2=-1))
    both = known[..., :, None] & known[..., None, :]
    regular = np.where(both, covariance, np.eye(6))
    return np.where(both, np.linalg.inv(regular), 0.0)


def _updated(state: _State, measured: FloatArray, information: FloatArray) -> tuple[_State, FloatArray]:
    """The state with a measurement (B, 4, 4), and the log densities (B,) of the measurements."""
    error = se3.log(se3.inverse(state.T) @ measured)
    P = state.P[:, :6, :6]
    squared = _squared(error, _weight(P, information))
    less = np.minimum(LARGEST_SQUARED / np.maximum(squared, LARGEST_SQUARED), 1.0)
    information = information * less[:, None, None]
    weight = _weight(P, information)
    gain = state.P[:, :, :6] @ weight
    change = (gain @ error[..., None])[..., 0]
    left = state.P - gain @ state.P[:, :6, :]
    observed = np.count_nonzero(np.diagonal(information, axis1=-2, axis2=-1), axis=-1)
    spread = np.linalg.slogdet(np.eye(6) + P @ information)[1]
    log_density = -0.5 * (_squared(error, weight) + spread - observed * np.log(less))
    moved = _State(state.T @ se3.exp(change[:, :6]), state.v + change[:, 6:], 0.5 * (left + np.swapaxes(left, -1, -2)))
    return moved, log_density


def _weight(P: FloatArray, information: FloatArray) -> FloatArray:
    """(P + R)^-1 = L (1 + P L)^-1 with L = R^-1, which may be singular."""
    return information @ np.linalg.inv(np.eye(6) + P @ information)


def _squared(error: FloatArray, weight: FloatArray) -> FloatArray:
    return np.einsum("bi,bij,bj->b", error, weight, error)


def _filter(t_s: FloatArray, T_meas: FloatArray, information: FloatArray, q: FloatArray) -> _Filtered:
    """Forward over the frames; T_meas (F, B, 4, 4) NaN where unseen, information (F, B, 6, 6), q (B, 2)."""
    seen = ~np.isnan(T_meas[..., 0, 0])
    first = np.argmax(seen, axis=0)
    start = np.broadcast_to(np.diag(START_SIGMA**2), (len(q), 12, 12))
    state = _State(T_meas[first, np.arange(len(q))], np.zeros((len(q), 6)), start)
    before, after, moves = list[_State](), list[_State](), list[FloatArray]()
    total = np.zeros(len(q))
    for n in range(len(t_s)):  # a frame needs the last
        moving = np.flatnonzero(n > first)
        F = np.broadcast_to(np.eye(12), start.shape).copy()
        if moving.size:
            there, F[moving] = _predicted(state[moving], q[moving], float(t_s[n] - t_s[n - 1]))
            state = state.replaced(moving, there)
        before.append(state)
        rows = np.flatnonzero(seen[n])
        if rows.size:
            there, log_density = _updated(state[rows], T_meas[n, rows], information[n, rows])
            state = state.replaced(rows, there)
            total[rows] += np.where(n > first[rows], log_density, 0.0)
        after.append(state)
        moves.append(F)
    return _Filtered(_State.stacked(after), _State.stacked(before), np.stack(moves), total)


def _smoothed(found: _Filtered) -> tuple[FloatArray, FloatArray]:
    """Poses (F, B, 4, 4) and covariances (F, B, 6, 6) given all frames."""
    state = found.after[-1]
    states = [state]
    for n in range(len(found.F) - 2, -1, -1):  # and back
        here, ahead = found.after[n], found.before[n + 1]
        jitter = JITTER * np.diagonal(ahead.P, axis1=-2, axis2=-1)[:, :, None] * np.eye(12)
        solved = np.asarray(np.linalg.solve(ahead.P + jitter, found.F[n + 1] @ here.P), dtype=np.float64)
        A = np.swapaxes(solved, -1, -2)
        error = np.concatenate([se3.log(se3.inverse(ahead.T) @ state.T), state.v - ahead.v], axis=-1)
        change = (A @ error[..., None])[..., 0]
        left = here.P + A @ (state.P - ahead.P) @ np.swapaxes(A, -1, -2)
        state = _State(here.T @ se3.exp(change[:, :6]), here.v + change[:, 6:], left)
        states.append(state)
    together = _State.stacked(states[::-1])
    return together.T, together.P[:, :, :6, :6]


def estimate_noise(log: PoseLog) -> FloatArray:
    """Likeliest noises (K, 2) [m^2/s^3, rad^2/s^3] of the parts' twists, to a factor of about two.

    A coarse grid for both together, then a finer one for each.
    """
    tried = _likeliest(log, np.broadcast_to(COARSE[:, None, None], (len(COARSE), len(log.parts), 2)))
    for column in (0, 1):
        for steps in (9 * FINE, 3 * FINE, FINE):
            shift = np.zeros((len(steps), 1, 2))
            shift[:, 0, column] = steps
            tried = _likeliest(log, tried + shift)
    return 10.0**tried


def _likeliest(log: PoseLog, exponents: FloatArray) -> FloatArray:
    """Of (G, K, 2) exponents the likeliest (K, 2) for each part; all are filtered at once."""
    count = len(exponents)
    T, information = np.tile(log.T_ref_part, (1, count, 1, 1)), np.tile(_informations(log), (1, count, 1, 1))
    found = _filter(log.t_s, T, information, 10.0 ** exponents.reshape(-1, 2))
    best = np.argmax(found.log_likelihood.reshape(count, -1), axis=0)
    return exponents[best, np.arange(exponents.shape[1])]


def _informations(log: PoseLog) -> FloatArray:
    """(F, K, 6, 6) inverse covariances; zero where nothing was seen."""
    covariance = np.full((*log.seen.shape, 6, 6), np.nan) if log.covariance is None else log.covariance
    seen = log.seen[..., None, None]
    return np.where(seen, _information(np.where(seen, covariance, np.eye(6))), 0.0)


def kalman_smooth(log: PoseLog, *, noise: FloatArray | None = None, fill_s: float = 0.0) -> PoseLog:
    """The poses of a log given all frames, with their covariances; unseen stays unseen but for short gaps, if asked.

    The result's errors are correlated from frame to frame, more so the less a part's motion changes: who takes them
    for independent, as fits do, trusts them too much.

    Args:
        log: with covariances; what has infinite variance isn't used.
        noise: (K, 2) densities [m^2/s^3, rad^2/s^3] of the twists' white accelerations; the likeliest if None.
        fill_s: gaps in which a part was unseen for no longer than this get poses, too; they are as uncertain as the
            model says.

    Raises:
        InvalidData: if the log states no covariance of some pose.
    """
    seen = log.seen
    if log.covariance is None or np.any(np.isnan(log.covariance[seen])):
        raise InvalidData(
            "the log has poses of unknown covariance, without which a Kalman smoother can't weigh them; "
            "want one for each (std_m and std_rad in poses.csv), or smooth by lowpass"
        )
    if not seen.any():
        return log
    noise = estimate_noise(log) if noise is None else np.asarray(noise, dtype=np.float64)
    known = np.flatnonzero(seen.any(axis=0))
    T, P = _smoothed(_filter(log.t_s, log.T_ref_part[:, known], _informations(log)[:, known], noise[known]))
    told = np.zeros(seen.shape, dtype=bool)
    told[:, known] = seen[:, known] | _in_short_gaps(log.t_s, seen[:, known], fill_s)
    poses, covariance = np.full(log.T_ref_part.shape, np.nan), np.full(log.covariance.shape, np.nan)
    poses[:, known], covariance[:, known] = T, _with_unobserved(P, log.covariance[:, known])
    poses[..., :3, :3] = se3.project_to_so3(np.where(told[..., None, None], poses[..., :3, :3], np.eye(3)))
    poses[~told], covariance[~told] = np.nan, np.nan
    return PoseLog(log.t_s, log.reference, log.parts, poses, covariance)


def _in_short_gaps(t_s: FloatArray, seen: NDArray[np.bool_], longest_s: float) -> NDArray[np.bool_]:
    """(F, K) frames between two sightings that are no further apart than a frame more than `longest_s`."""
    F = len(t_s)
    rows = np.arange(F)[:, None]
    last = np.maximum.accumulate(np.where(seen, rows, -1), axis=0)
    following = np.minimum.accumulate(np.where(seen, rows, F)[::-1], axis=0)[::-1]
    inside = ~seen & (last >= 0) & (following < F)
    first_unseen = t_s[np.clip(last + 1, 0, F - 1)]
    last_unseen = t_s[np.clip(following - 1, 0, F - 1)]
    return inside & (last_unseen - first_unseen <= longest_s) & (longest_s > 0)


def _with_unobserved(P: FloatArray, measured: FloatArray) -> FloatArray:
    """Covariances with infinite variance where START_SIGMA is nearly all that is known.

    So too where no measurement (F, K, 6, 6) of a part ever told: that a part's twist hardly changes in its own frame
    would tell of its orientation by its path alone, which is the model's word, not the camera's.
    """
    variance = np.diagonal(P, axis1=-2, axis2=-1)
    never = ~np.any(np.isfinite(np.diagonal(measured, axis1=-2, axis2=-1)), axis=0)
    open_ = (variance > (UNOBSERVED_SHARE * START_SIGMA[:6]) ** 2) | never
    covariance = np.where(open_[..., :, None] | open_[..., None, :], 0.0, P)
    i = np.arange(6)
    covariance[..., i, i] = np.where(open_, np.inf, variance)
    return covariance
