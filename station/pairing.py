"""Which fitted joint follows which commanded one, and by how much two clocks differ; `station.compare` builds on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.signal import correlate

from calibration.lag import (
    MAX_COARSE_POINTS,
    MIN_FRAMES,
    Sampler,
    combined_lag,
    estimate_slope,
    held,
    held_smooth,
    interpolated,
    known_rows,
    period,
)
from station.errors import InvalidData
from station.logs import FloatArray, JointLog

# A reference that ranges over less than this has not moved: neither correlation nor lag nor gain means anything.
MIN_TRAVEL = {"rad": float(np.radians(0.5)), "m": 5e-4}
# A servo that holds still reads back a few counts to either side (0.3 deg each on AX), or gives a little under load.
REST_TRAVEL = {"rad": float(np.radians(2.0)), "m": 2e-3}
# Dimensionless, see `_agreement`. Two unrelated signals of one spread have about 0.3; a gain of 0.5 has 0.67.
MIN_AGREEMENT = 0.4
# Half width, in frames, of the window under which steps are looked at when a lag is estimated.
SMOOTHING_FRAMES = 4
# Seconds to either side in which a lag is looked for on one clock: a servo's read-back is current.
MEASURED_LAG_SPAN_S = 1.0
# The part of the shorter log that two logs on different clocks must have in common.
MIN_OVERLAP = 0.3


@dataclass(frozen=True, eq=False)
class Reference:
    """A commanded joint at any time: `primary` is the read-back where there is any, else the command."""

    name: str
    unit: str
    commanded: Sampler
    commanded_smooth: Sampler
    measured: Sampler
    primary: Sampler
    span_s: tuple[float, float]
    has_readback: bool

    def delayed(self, lag_s: float) -> Reference:
        """The same, later."""

        def later(sampler: Sampler) -> Sampler:
            return lambda at_s: sampler(at_s - lag_s)

        start_s, end_s = self.span_s
        samplers = map(later, (self.commanded, self.commanded_smooth, self.measured, self.primary))
        span_s = (start_s + lag_s, end_s + lag_s)
        return Reference(self.name, self.unit, *samplers, span_s=span_s, has_readback=self.has_readback)


@dataclass(frozen=True)
class Pair:
    """A fitted joint that follows a commanded one, turned by `sign`."""

    fitted: str
    reference: Reference
    sign: int


def references_of(commanded: JointLog | None, measured: JointLog | None, period_s: float) -> list[Reference]:
    """All joints that are commanded or measured; `period_s` is that of the frames."""
    logs = [log for log in (commanded, measured) if log is not None]
    names = dict.fromkeys(name for log in logs for name in log.joints)
    return [_reference(name, commanded, measured, period_s) for name in names]


def _reference(name: str, commanded: JointLog | None, measured: JointLog | None, period_s: float) -> Reference:
    def column(log: JointLog | None) -> tuple[FloatArray, FloatArray]:
        return known_rows(log.t_s, log.state(name)) if log and name in log.joints else (np.zeros(0), np.zeros(0))

    units = {log.units[log.joints.index(name)] for log in (commanded, measured) if log and name in log.joints}
    if len(units) > 1:
        raise InvalidData(
            f"joint '{name}' is commanded in one unit and read back in another: {', '.join(sorted(units))}"
        )
    command, readback = column(commanded), column(measured)
    has_readback = len(readback[0]) > 1
    primary = readback if has_readback else command
    hold_s = float(np.median(np.diff(primary[0]))) if len(primary[0]) > 1 else 0.0
    span_s = (float(primary[0][0]), float(primary[0][-1]) + hold_s) if len(primary[0]) else (0.0, 0.0)
    samplers = (held(*command), held_smooth(*command, SMOOTHING_FRAMES * period_s), interpolated(*readback))
    first = samplers[2] if has_readback else samplers[0]
    return Reference(name, units.pop(), *samplers, primary=first, span_s=span_s, has_readback=has_readback)


def _agreement(y: FloatArray, x: FloatArray, unit: str) -> tuple[float, int]:
    """How much two states agree after sign and offset, and that sign.

    `1 - mean|y - s x| / (mean|x| + mean|y|)`, each term about its median: 1 for equal motions, about 0.3 for unrelated
    ones. Unlike a correlation it tells joints that move together by different amounts apart, and a few wild frames
    don't sway it. 0 where the reference did not move or too few frames have both.
    """
    both = np.isfinite(y) & np.isfinite(x)
    if np.count_nonzero(both) < MIN_FRAMES or np.ptp(x[both]) < MIN_TRAVEL[unit]:
        return 0.0, 1
    scale = _spread(x[both]) + _spread(y[both])
    scores = {sign: 1.0 - _spread(y[both] - sign * x[both]) / scale for sign in (1, -1)}
    sign = max(scores, key=lambda sign: scores[sign])
    return scores[sign], sign


def _spread(values: FloatArray) -> float:
    return float(np.mean(np.abs(values - np.median(values))))


def match_joints(detected: JointLog, references: Sequence[Reference]) -> list[Pair]:
    """One to one, of the same unit, the greatest sum of agreements; in the references' order."""
    score = np.zeros((len(references), len(detected.joints)))
    sign = np.ones(score.shape, dtype=int)
    for row, reference in enumerate(references):
        x = reference.primary(detected.t_s)
        for column, unit in enumerate(detected.units):
            if unit == reference.unit:
                score[row, column], sign[row, column] = _agreement(detected.q[:, column], x, unit)
    score = np.where(score >= MIN_AGREEMENT, score, 0.0)
    rows, columns = linear_sum_assignment(score, maximize=True)
    return [
        Pair(detected.joints[column], references[row], int(sign[row, column]))
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        if score[row, column] > 0
    ]


def estimate_clock_lag(detected: JointLog, references: Sequence[Reference]) -> tuple[float, float | None] | None:
    """One lag over all joints [s] and its standard deviation; None if no joint agrees.

    Coarsely by correlation over the whole overlap, then finely joint by joint.
    """
    step_s = max(period(detected.t_s), max(_length(r.span_s) for r in references) / MAX_COARSE_POINTS)
    coarse_s = _coarse_clock_lag(detected, references, step_s)
    if coarse_s is None:
        return None
    pairs = match_joints(detected, [reference.delayed(coarse_s) for reference in references])
    span_s = max(MEASURED_LAG_SPAN_S, 4 * step_s)
    slopes = [
        estimate_slope(detected.t_s, pair.sign * detected.state(pair.fitted), pair.reference.primary, span_s=span_s)
        for pair in pairs
    ]
    fine = combined_lag(slopes)
    return (coarse_s, None) if fine is None else (coarse_s + fine[0], fine[1])


def _length(span_s: tuple[float, float]) -> float:
    return span_s[1] - span_s[0]


def _coarse_clock_lag(detected: JointLog, references: Sequence[Reference], step_s: float) -> float | None:
    """The shift of greatest likelihood: sum over the best pairs of `-n log(1 - r^2)`, n the frames in common."""
    t_s = np.arange(detected.t_s[0], detected.t_s[-1] + step_s, step_s)
    start_s = min(reference.span_s[0] for reference in references)
    at_s = np.arange(start_s, max(reference.span_s[1] for reference in references) + step_s, step_s)
    pairs: list[list[FloatArray]] = []
    for reference in references:
        x = reference.primary(at_s)
        same = (unit == reference.unit for unit in detected.units)
        seen = (interpolated(detected.t_s, q)(t_s) for q in detected.q.T)
        zeros = np.zeros(len(t_s) + len(at_s) - 1)
        pairs.append([_shift_scores(y, x) if ok else zeros for y, ok in zip(seen, same, strict=True)])
    score = np.array(pairs)
    # A loop over shifts: each is an assignment of its own.
    total = np.array([s[linear_sum_assignment(s, maximize=True)].sum() for s in np.moveaxis(score, -1, 0)])
    if total.max() <= 0:
        return None
    return float(t_s[0] - at_s[0] + (int(np.argmax(total)) - (len(at_s) - 1)) * step_s)


def _shift_scores(y: FloatArray, x: FloatArray) -> FloatArray:
    """`-n log(1 - r^2)` of y[i] against x[i - k], k from -(len(x) - 1) to len(y) - 1; 0 for too few in common."""
    moments = [correlate(a, b, mode="full", method="fft") for a, b in _powers(y, x)]
    n, sum_y, sum_x, sum_yy, sum_xx, sum_yx = moments
    enough = n > max(MIN_FRAMES, MIN_OVERLAP * min(np.isfinite(y).sum(), np.isfinite(x).sum()))
    n = np.maximum(n, 1.0)
    var_y, var_x = sum_yy - sum_y**2 / n, sum_xx - sum_x**2 / n
    moved = (var_y > 1e-3 * sum_yy.max()) & (var_x > 1e-3 * sum_xx.max())
    r2 = (sum_yx - sum_y * sum_x / n) ** 2 / np.where(moved, var_y * var_x, 1.0)
    return np.where(enough & moved, -n * np.log1p(-np.clip(r2, 0.0, 1 - 1e-4)), 0.0)


def _powers(y: FloatArray, x: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    in_y, in_x = np.isfinite(y).astype(float), np.isfinite(x).astype(float)
    y, x = np.where(in_y > 0, y - np.nanmean(y), 0.0), np.where(in_x > 0, x - np.nanmean(x), 0.0)
    return [(in_y, in_x), (y, in_x), (in_y, x), (y**2, in_x), (in_y, x**2), (y, x)]


def moved(reference: Reference, commanded: JointLog | None, measured: JointLog | None) -> bool:
    """Whether a joint was told to move, or moved by more than one that holds still."""

    def travel(log: JointLog | None) -> float:
        states = log.state(reference.name) if log is not None and reference.name in log.joints else np.zeros(0)
        known = states[np.isfinite(states)]
        return float(np.ptp(known)) if len(known) else 0.0

    return travel(commanded) >= MIN_TRAVEL[reference.unit] or travel(measured) >= REST_TRAVEL[reference.unit]
