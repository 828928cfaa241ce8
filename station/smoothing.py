"""Smoothers of pose logs, by name: the paper's low-pass filter (IV-B) with zero phase, and a Kalman smoother on SE(3).

Any smoothing correlates the noise of neighbouring frames; `--method station` doesn't smooth unless it is asked to. The
low-pass states no covariance, the Kalman smoother does.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from station.errors import InvalidData
from station.kalman import kalman_smooth
from station.kinematics import se3
from station.logs import FloatArray, PoseLog

# The paper doesn't state its filter; a Butterworth of second order, run forward and back.
ORDER = 2
# sosfiltfilt pads its input at each end: a run of fewer frames than this can't be filtered and stays as it is.
SHORTEST_RUN = 3 * (2 * (ORDER // 2) + 1) + 1


def smooth(log: PoseLog, cutoff_hz: float) -> PoseLog:
    """The poses of a log without what changes faster than `cutoff_hz`; unseen stays unseen, without covariance.

    Each run of frames in which a part was seen is filtered by itself, entry by entry of the pose matrices; the
    rotations are then the nearest ones (good while a part turns much less than half a turn within 1 / cutoff_hz).
    Times count as evenly spaced by their median step.

    Raises:
        InvalidData: if the cut-off is not between zero and half the frame rate.
    """
    if len(log.t_s) < SHORTEST_RUN:
        return PoseLog(log.t_s, log.reference, log.parts, log.T_ref_part)
    nyquist_hz = 0.5 / float(np.median(np.diff(log.t_s)))
    if not 0 < cutoff_hz < nyquist_hz:
        raise InvalidData(f"cut-off is {cutoff_hz:g} Hz; want above 0 and below half the frame rate, {nyquist_hz:g} Hz")
    sections = butter(ORDER, cutoff_hz / nyquist_hz, output="sos")
    T = np.array(log.T_ref_part)
    for k in range(len(log.parts)):  # runs differ from part to part in number and length
        for run in _runs(log.seen[:, k]):
            if len(run) >= SHORTEST_RUN:
                T[run, k] = _smooth_run(T[run, k], sections)
    return PoseLog(log.t_s, log.reference, log.parts, T)


def _runs(seen: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """The rows of each unbroken run of seen frames."""
    rows = np.flatnonzero(seen)
    return np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if rows.size else []


def _smooth_run(T: FloatArray, sections: FloatArray) -> FloatArray:
    filtered = sosfiltfilt(sections, T[:, :3], axis=0)
    return se3.pose(se3.project_to_so3(filtered[:, :, :3]), filtered[:, :, 3])


Smoother = Callable[[PoseLog], PoseLog]


def _low_pass(value: float | None) -> Smoother:
    if value is None:
        raise InvalidData("smoother 'lowpass' needs its cut-off in Hz; want lowpass:HZ, such as lowpass:5")
    return partial(smooth, cutoff_hz=value)


def _kalman(value: float | None) -> Smoother:
    return partial(kalman_smooth, fill_s=value or 0.0)


# What makes a smoother of its one number, or of none.
SMOOTHERS: dict[str, Callable[[float | None], Smoother]] = {"lowpass": _low_pass, "kalman": _kalman}


def smoother(text: str) -> Smoother:
    """The smoother that a text asks for: `lowpass:HZ` (its cut-off), `kalman`, or `kalman:S` (fills gaps up to S s).

    Raises:
        InvalidData: for another name, or what is no number of zero or more.
    """
    name, _, number = text.partition(":")
    if name not in SMOOTHERS:
        raise InvalidData(f"no smoother '{name}'; want lowpass:HZ, kalman, or kalman:S (fills gaps up to S seconds)")
    try:
        value = float(number) if number else None
    except ValueError:
        value = -1.0
    if value is not None and not (0 <= value < np.inf):
        raise InvalidData(f"smoother '{text}': want a number of zero or more after the colon, such as {name}:5")
    return SMOOTHERS[name](value)
