"""Detected joint states against commanded and measured ones: pairing, sign, offset, errors, lag and gain.

Three logs meet here, SI inside (rad, m, s):

- detected: fitted joints at camera frames; sign and zero are the fit's own, NaN where a joint was not seen;
- commanded: a row a command; each value holds until the next (zero-order hold, unknown before the first);
- measured: the servos' read-back, interpolated linearly between neighbouring samples.

A fitted joint becomes a commanded one by `joint = sign * fitted + offset`, sign in {+1, -1}; that and nothing else is
done before the errors are taken. Lag and gain are estimated and reported, never applied, save for the one lag between
two clocks (`same_clock=False`). One offset serves a joint: the one against the read-back where there is any, else
against the command, so the errors are those of the columns of comparison.csv.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.signal import correlate

from station.callable_module import CallableModule
from station.errors import InvalidData
from station.kinematics.joints import JOINT_TYPES
from station.lag import (
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
from station.logs import FloatArray, JointLog, frozen_floats

UNIT_SCALE = {"rad": 180.0 / np.pi, "m": 1e3}
UNIT_NAME = {"rad": "deg", "m": "mm"}
# Joint types where nobody tells them.
TYPE_OF_UNIT = {"rad": "revolute", "m": "prismatic"}

# A reference that ranges over less than this has not moved: neither correlation nor lag nor gain means anything.
MIN_TRAVEL = {"rad": float(np.radians(0.5)), "m": 5e-4}
# A servo that holds still reads back a few counts to either side (0.3 deg each on AX), or gives a little under load.
REST_TRAVEL = {"rad": float(np.radians(2.0)), "m": 2e-3}
# Dimensionless, see `_agreement`. Two unrelated signals of one spread have about 0.3; a gain of 0.5 has 0.67.
MIN_AGREEMENT = 0.4
# Farther than this many robust standard deviations from the usual difference, a servo is on its way to a command.
ARRIVED_SIGMAS = 3.0
# Half width, in frames, of the window under which steps are looked at when a lag is estimated.
SMOOTHING_FRAMES = 4
# Seconds to either side in which a lag is looked for on one clock. A servo's read-back is current; a command
# is trailed by half the time that the servo needs for it.
MEASURED_LAG_SPAN_S = 1.0
COMMANDED_LAG_SPAN_S = 5.0
# The part of the shorter log that two logs on different clocks must have in common.
MIN_OVERLAP = 0.3


@dataclass(frozen=True)
class Agreement:
    """How well a detected joint agrees with one reference (its command or its read-back).

    Attributes:
        lag_s: by how much the detected state trails the reference [s], in the stamps as given; NaN if undefined.
        lag_std_s: its standard deviation [s], correlated residuals accounted for; None if undefined. Against step
            commands it is mostly how differently long the steps take: one lag is not the whole story there.
        gain: slope b of `detected(t) = b reference(t - lag) + a` by ordinary least squares; NaN if undefined.
        offset: `joint = sign * fitted + offset`, rad or m.
        rmse: root mean square of detected - reference [rad or m], after sign and offset only; so are the next two.
        mae: mean absolute error.
        max: greatest absolute error.
        frames: number of frames with both.
        gain_std: standard deviation of the gain; None if undefined.
    """

    lag_s: float
    lag_std_s: float | None
    gain: float
    offset: float
    rmse: float
    mae: float
    max: float
    frames: int
    gain_std: float | None = None


@dataclass(frozen=True, eq=False)
class JointComparison:
    """One matched joint at the frames of the detection.

    Attributes:
        joint: its name in the commands (or in the read-back).
        fitted_joint: its name in the fit.
        type: of the fitted joint, "revolute", "prismatic", ...
        unit: "rad" or "m", of all the states here.
        sign: +1 or -1, `joint = sign * fitted + offset`.
        t_s: (T,) the frames' stamps.
        commanded: (T,) NaN where unknown.
        measured: (T,) NaN where unknown.
        detected: (T,) in the joint's own sign and zero; NaN where not seen.
        detected_std: (T,) NaN where unknown.
        against_commanded: None without commands in common.
        against_measured: None without read-back in common.
    """

    joint: str
    fitted_joint: str
    type: str
    unit: str
    sign: int
    t_s: FloatArray
    commanded: FloatArray
    measured: FloatArray
    detected: FloatArray
    detected_std: FloatArray
    against_commanded: Agreement | None
    against_measured: Agreement | None

    def __post_init__(self) -> None:
        for name in ("t_s", "commanded", "measured", "detected", "detected_std"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name)))


@dataclass(frozen=True, eq=False)
class Comparison:
    """All matched joints, in the order of the commands, and what found no counterpart.

    Attributes:
        joints: the matched ones.
        unmatched_fitted: names of fitted joints that follow no commanded one.
        unmatched_commanded: names of joints that moved, or should have, and no fitted one follows.
        clock_lag_s: the lag applied to commands and read-back because they have another clock [s]; None on one clock.
        clock_lag_std_s: its standard deviation [s].
        at_rest: names of joints that were neither told to move nor moved (a gripper left alone): nothing is amiss.
    """

    joints: tuple[JointComparison, ...]
    unmatched_fitted: tuple[str, ...] = ()
    unmatched_commanded: tuple[str, ...] = ()
    clock_lag_s: float | None = None
    clock_lag_std_s: float | None = None
    at_rest: tuple[str, ...] = ()


# --- Which fitted joint is which commanded one -----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Reference:
    """A commanded joint at any time: `primary` is the read-back where there is any, else the command."""

    name: str
    unit: str
    commanded: Sampler
    commanded_smooth: Sampler
    measured: Sampler
    primary: Sampler
    span_s: tuple[float, float]

    def delayed(self, lag_s: float) -> _Reference:
        def later(sampler: Sampler) -> Sampler:
            return lambda at_s: sampler(at_s - lag_s)

        start_s, end_s = self.span_s
        samplers = map(later, (self.commanded, self.commanded_smooth, self.measured, self.primary))
        return _Reference(self.name, self.unit, *samplers, span_s=(start_s + lag_s, end_s + lag_s))


@dataclass(frozen=True)
class _Pair:
    fitted: str
    reference: _Reference
    sign: int


def _references(commanded: JointLog | None, measured: JointLog | None, period_s: float) -> list[_Reference]:
    logs = [log for log in (commanded, measured) if log is not None]
    names = dict.fromkeys(name for log in logs for name in log.joints)
    return [_reference(name, commanded, measured, period_s) for name in names]


def _reference(name: str, commanded: JointLog | None, measured: JointLog | None, period_s: float) -> _Reference:
    def column(log: JointLog | None) -> tuple[FloatArray, FloatArray]:
        return known_rows(log.t_s, log.state(name)) if log and name in log.joints else (np.zeros(0), np.zeros(0))

    units = {log.units[log.joints.index(name)] for log in (commanded, measured) if log and name in log.joints}
    if len(units) > 1:
        raise InvalidData(
            f"joint '{name}' is commanded in one unit and read back in another: {', '.join(sorted(units))}"
        )
    command, readback = column(commanded), column(measured)
    primary = readback if len(readback[0]) > 1 else command
    hold_s = float(np.median(np.diff(primary[0]))) if len(primary[0]) > 1 else 0.0
    span_s = (float(primary[0][0]), float(primary[0][-1]) + hold_s) if len(primary[0]) else (0.0, 0.0)
    samplers = (held(*command), held_smooth(*command, SMOOTHING_FRAMES * period_s), interpolated(*readback))
    return _Reference(name, units.pop(), *samplers, samplers[2] if primary is readback else samplers[0], span_s)


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


def _match(detected: JointLog, references: Sequence[_Reference]) -> list[_Pair]:
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
        _Pair(detected.joints[column], references[row], int(sign[row, column]))
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        if score[row, column] > 0
    ]


# --- Two clocks ------------------------------------------------------------------------------------------------------


def _clock_lag(detected: JointLog, references: Sequence[_Reference]) -> tuple[float, float | None] | None:
    """One lag over all joints [s] and its standard deviation; None if no joint agrees.

    Coarsely by correlation over the whole overlap, then finely joint by joint.
    """
    step_s = max(period(detected.t_s), max(_length(r.span_s) for r in references) / MAX_COARSE_POINTS)
    coarse_s = _coarse_clock_lag(detected, references, step_s)
    if coarse_s is None:
        return None
    pairs = _match(detected, [reference.delayed(coarse_s) for reference in references])
    span_s = max(MEASURED_LAG_SPAN_S, 4 * step_s)
    slopes = [
        estimate_slope(detected.t_s, pair.sign * detected.state(pair.fitted), pair.reference.primary, span_s=span_s)
        for pair in pairs
    ]
    fine = combined_lag(slopes)
    return (coarse_s, None) if fine is None else (coarse_s + fine[0], fine[1])


def _length(span_s: tuple[float, float]) -> float:
    return span_s[1] - span_s[0]


def _coarse_clock_lag(detected: JointLog, references: Sequence[_Reference], step_s: float) -> float | None:
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


# --- The comparison --------------------------------------------------------------------------------------------------


def compare(
    detected: JointLog,
    commanded: JointLog | None,
    measured: JointLog | None = None,
    *,
    types: Mapping[str, str] | None = None,
    same_clock: bool = True,
) -> Comparison:
    """Compare detected joint states with commands and read-back.

    Fitted joints are paired with commanded ones of the same unit, one to one, by the sum of their agreement after sign
    and offset (see `_agreement`), against the read-back where there is any. Offset by least squares, against commands
    alone over the frames where the servo had arrived. Errors are after sign and offset only; never after gain.

    Args:
        detected: fitted joints at T frames [rad or m], NaN where not seen; std optional. A fit's `states`.
        commanded: a row a command, held until the next; None if there is none.
        measured: the servos' read-back.
        types: joint type of each fitted joint, for the result; None: revolute for rad, prismatic for m.
        same_clock: whether all stamps come from one clock. If not, commands and read-back (on one other clock) are
            shifted by one common lag before the errors are taken; the lags reported are in the stamps as given.

    Raises:
        InvalidData: what is no JointLog; a fitted joint without a type; a joint commanded and read back in different
            units.

    A joint that did not move matches nothing, nor do the three states of a spherical one, which no command tells.
    Joints that always move in the very same way can't be told apart.
    """
    _check_kinds(detected=detected, commanded=commanded, measured=measured)
    if types is None:
        types = {name: TYPE_OF_UNIT[unit] for name, unit in zip(detected.joints, detected.units, strict=True)}
    missing = [name for name in detected.joints if name not in types]
    if missing:
        raise InvalidData(f"no joint type for {', '.join(missing)}; have {', '.join(types) or 'none'}")
    references = _references(commanded, measured, period(detected.t_s))
    usable = [reference for reference in references if _length(reference.span_s) > 0]
    told = _with_one_state(detected, types)
    clock = None if same_clock or not usable or not told.joints else _clock_lag(told, usable)
    lag_s = 0.0 if clock is None else clock[0]
    pairs = _match(told, [reference.delayed(lag_s) for reference in references])
    fitted, followed = {pair.fitted for pair in pairs}, {pair.reference.name for pair in pairs}
    unfollowed = [reference for reference in references if reference.name not in followed]
    at_rest = tuple(reference.name for reference in unfollowed if not _moved(reference, commanded, measured))
    return Comparison(
        tuple(_joint_comparison(pair, detected, types[pair.fitted], lag_s) for pair in pairs),
        tuple(name for name in detected.joints if name not in fitted),
        tuple(reference.name for reference in unfollowed if reference.name not in at_rest),
        *(clock or (None, None)),
        at_rest=at_rest,
    )


def _moved(reference: _Reference, commanded: JointLog | None, measured: JointLog | None) -> bool:
    """Whether a joint was told to move, or moved by more than one that holds still."""

    def travel(log: JointLog | None) -> float:
        states = log.state(reference.name) if log is not None and reference.name in log.joints else np.zeros(0)
        known = states[np.isfinite(states)]
        return float(np.ptp(known)) if len(known) else 0.0

    return travel(commanded) >= MIN_TRAVEL[reference.unit] or travel(measured) >= REST_TRAVEL[reference.unit]


def _with_one_state(detected: JointLog, types: Mapping[str, str]) -> JointLog:
    """The states of joints that have one."""
    several = {name for name, joint in JOINT_TYPES.items() if joint.states > 1}
    kept = [i for i, name in enumerate(detected.joints) if types[name] not in several]
    names, units = (tuple(names[i] for i in kept) for names in (detected.joints, detected.units))
    return JointLog(detected.t_s, names, detected.q[:, kept], units)


def _check_kinds(**logs: object) -> None:
    """Raise InvalidData for a log that is none, a whole fit for instance."""
    for name, log in logs.items():
        if not isinstance(log, JointLog) and (log is not None or name == "detected"):
            have = type(log).__name__
            raise InvalidData(f"compare wants a JointLog for '{name}'; have a {have}; a fit's is its `states`")


def _joint_comparison(pair: _Pair, detected: JointLog, type_name: str, clock_lag_s: float) -> JointComparison:
    """`pair.reference` is on the detection's clock already, delayed by `clock_lag_s`."""
    t_s, reference = detected.t_s, pair.reference
    signed = pair.sign * detected.state(pair.fitted)
    offset = _offset(reference.primary(t_s) - signed, has_readback=bool(np.any(np.isfinite(reference.measured(t_s)))))
    state = signed + offset
    std = np.full(len(t_s), np.nan) if detected.std is None else detected.std[:, detected.joints.index(pair.fitted)]
    against = partial(_against, t_s, state, offset=offset, clock_lag_s=clock_lag_s)
    return JointComparison(
        joint=reference.name,
        fitted_joint=pair.fitted,
        type=type_name,
        unit=reference.unit,
        sign=pair.sign,
        t_s=t_s,
        commanded=reference.commanded(t_s),
        measured=reference.measured(t_s),
        detected=state,
        detected_std=std,
        against_commanded=against(reference.commanded, reference.commanded_smooth, span_s=COMMANDED_LAG_SPAN_S),
        against_measured=against(reference.measured, reference.measured, span_s=MEASURED_LAG_SPAN_S),
    )


def _offset(difference: FloatArray, *, has_readback: bool) -> float:
    """Least squares; against commands alone over the frames where the servo had arrived, not over its ramps.

    Those are the ones within `ARRIVED_SIGMAS` robust standard deviations (1.4826 MAD) of the median.
    """
    known = difference[np.isfinite(difference)]
    if has_readback:
        return float(np.mean(known))
    apart = np.abs(known - np.median(known))
    return float(np.mean(known[apart <= ARRIVED_SIGMAS * 1.4826 * np.median(apart)]))


def _against(
    t_s: FloatArray,
    state: FloatArray,
    sampler: Sampler,
    smooth: Sampler,
    *,
    offset: float,
    clock_lag_s: float,
    span_s: float,
) -> Agreement | None:
    error = state - sampler(t_s)
    error = error[np.isfinite(error)]
    if not len(error):
        return None
    slope = estimate_slope(t_s, state, smooth, span_s=span_s)
    return Agreement(
        lag_s=slope.lag_s + clock_lag_s,
        lag_std_s=slope.lag_std_s,
        gain=slope.gain,
        gain_std=slope.gain_std,
        offset=offset,
        rmse=float(np.sqrt(np.mean(error**2))),
        mae=float(np.mean(np.abs(error))),
        max=float(np.max(np.abs(error))),
        frames=len(error),
    )


sys.modules[__name__].__class__ = CallableModule
