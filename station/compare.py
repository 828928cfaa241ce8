"""Detected joint states against commanded and measured ones: pairing, sign, offset, errors, lag and gain.

Three logs meet here, SI inside (rad, m, s):

- detected: fitted joints at camera frames; sign and zero are the fit's own, NaN where a joint was not seen;
- commanded: a row a command; each value holds until the next (zero-order hold, unknown before the first);
- measured: the servos' read-back, interpolated linearly between its own stamps, never across a gap.

A fitted joint becomes a commanded one by `joint = sign * fitted + offset`, sign in {+1, -1}, and one lag serves the
whole session: a frame stamped t shows the arm as it was at t - lag, so that is when commands and read-back are looked
up. On one clock it is the camera's lag behind the read-back, from all joints together, applied where it is sure
(`station.session_lag`); on two clocks it is the difference between them. Each joint's own lag and its gain are
estimated in the stamps as given and reported, never applied. One offset serves a joint: the one against the read-back
where there is any, else against the command, so the errors are those of the columns of comparison.csv; what the errors
would be without the lag is reported beside them.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calibration.lag import Sampler, Slope, estimate_slope, period
from station.callable_module import CallableModule
from station.errors import InvalidData
from station.kinematics.joints import JOINT_TYPES
from station.logs import FloatArray, JointLog, frozen_floats
from station.pairing import Pair, estimate_clock_lag, match_joints, moved, references_of
from station.session_lag import UNKNOWN, SessionLag, estimate_session_lag, readback_slopes

UNIT_SCALE = {"rad": 180.0 / np.pi, "m": 1e3}
UNIT_NAME = {"rad": "deg", "m": "mm"}
# Joint types where nobody tells them.
TYPE_OF_UNIT = {"rad": "revolute", "m": "prismatic"}

# Farther than this many robust standard deviations from the usual difference, a servo is on its way to a command.
ARRIVED_SIGMAS = 3.0
# Seconds to either side in which a lag behind a command is looked for: half the time that the servo needs for it.
COMMANDED_LAG_SPAN_S = 5.0


@dataclass(frozen=True)
class Agreement:
    """How well a detected joint agrees with one reference (its command or its read-back).

    Attributes:
        lag_s: by how much the detected state trails the reference [s], in the stamps as given, none applied yet; NaN if
            undefined.
        lag_std_s: its standard deviation [s], correlated residuals accounted for; None if undefined. Against step
            commands it is mostly how differently long the steps take: one lag is not the whole story there.
        gain: slope b of `detected(t) = b reference(t - lag) + a` by ordinary least squares; NaN if undefined.
        offset: `joint = sign * fitted + offset`, rad or m.
        rmse: root mean square of detected - reference [rad or m], after sign, offset and the session's lag; so are the
            next two.
        mae: mean absolute error.
        max: greatest absolute error.
        frames: number of frames with both.
        gain_std: standard deviation of the gain; None if undefined.
        rmse_before_lag: the same as `rmse` without the session's lag, with the offset that is best without it; NaN
            where no frame has both.
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
    rmse_before_lag: float = np.nan


@dataclass(frozen=True, eq=False)
class JointComparison:
    """One matched joint at the frames of the detection.

    Attributes:
        joint: its name in the commands (or in the read-back).
        fitted_joint: its name in the fit.
        type: of the fitted joint, "revolute", "prismatic", ...
        unit: "rad" or "m", of all the states here.
        sign: +1 or -1, `joint = sign * fitted + offset`.
        t_s: (T,) the frames' stamps as given.
        commanded: (T,) at t_s less the applied lag; NaN where unknown.
        measured: (T,) at t_s less the applied lag; NaN where unknown.
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
        lag: the one lag of the session, and whether it was applied; that between the clocks where there are two.
    """

    joints: tuple[JointComparison, ...]
    unmatched_fitted: tuple[str, ...] = ()
    unmatched_commanded: tuple[str, ...] = ()
    clock_lag_s: float | None = None
    clock_lag_std_s: float | None = None
    at_rest: tuple[str, ...] = ()
    lag: SessionLag = UNKNOWN


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
    and offset (`station.pairing`), against the read-back where there is any. Offset by least squares, against commands
    alone over the frames where the servo had arrived. Errors are after sign, offset and the session's one lag where it
    is sure; never after gain.

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
    references = references_of(commanded, measured, period(detected.t_s))
    usable = [reference for reference in references if reference.span_s[1] > reference.span_s[0]]
    told = _with_one_state(detected, types)
    clock = None if same_clock or not usable or not told.joints else estimate_clock_lag(told, usable)
    clock_lag_s = 0.0 if clock is None else clock[0]
    pairs = match_joints(told, [reference.delayed(clock_lag_s) for reference in references])
    slopes = readback_slopes(detected, pairs)
    lag = estimate_session_lag(list(slopes.values())) if clock is None else SessionLag(*clock)
    fitted, followed = {pair.fitted for pair in pairs}, {pair.reference.name for pair in pairs}
    unfollowed = [reference for reference in references if reference.name not in followed]
    at_rest = tuple(reference.name for reference in unfollowed if not moved(reference, commanded, measured))
    return Comparison(
        tuple(
            _joint_comparison(pair, detected, types[pair.fitted], lag, clock_lag_s, slopes.get(pair.reference.name))
            for pair in pairs
        ),
        tuple(name for name in detected.joints if name not in fitted),
        tuple(reference.name for reference in unfollowed if reference.name not in at_rest),
        *(clock or (None, None)),
        at_rest=at_rest,
        lag=lag,
    )


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


def _joint_comparison(
    pair: Pair, detected: JointLog, type_name: str, lag: SessionLag, clock_lag_s: float, behind_readback: Slope | None
) -> JointComparison:
    """`pair.reference` is on the detection's clock already, delayed by `clock_lag_s`; the camera's lag is not in it."""
    t_s, given = detected.t_s, pair.reference
    reference = given.delayed(lag.applied_s - clock_lag_s)
    signed = pair.sign * detected.state(pair.fitted)
    offset, offset_before = (_offset(each.primary(t_s) - signed, each.has_readback) for each in (reference, given))
    std = np.full(len(t_s), np.nan) if detected.std is None else detected.std[:, detected.joints.index(pair.fitted)]

    def against(sampler: Sampler, before: Sampler, slope: Slope) -> Agreement | None:
        shifted = replace(slope, lag_s=slope.lag_s + clock_lag_s)
        rmse_before = _rms(signed + offset_before - before(t_s))
        return _agreement(signed + offset - sampler(t_s), shifted, offset, rmse_before)

    behind_command = estimate_slope(t_s, signed, given.commanded_smooth, span_s=COMMANDED_LAG_SPAN_S)

    return JointComparison(
        joint=given.name,
        fitted_joint=pair.fitted,
        type=type_name,
        unit=given.unit,
        sign=pair.sign,
        t_s=t_s,
        commanded=reference.commanded(t_s),
        measured=reference.measured(t_s),
        detected=signed + offset,
        detected_std=std,
        against_commanded=against(reference.commanded, given.commanded, behind_command),
        against_measured=behind_readback and against(reference.measured, given.measured, behind_readback),
    )


def _offset(difference: FloatArray, has_readback: bool) -> float:
    """Least squares; against commands alone over the frames where the servo had arrived, not over its ramps.

    Those are the ones within `ARRIVED_SIGMAS` robust standard deviations (1.4826 MAD) of the median.
    """
    known = difference[np.isfinite(difference)]
    if has_readback:
        return float(np.mean(known))
    apart = np.abs(known - np.median(known))
    return float(np.mean(known[apart <= ARRIVED_SIGMAS * 1.4826 * np.median(apart)]))


def _agreement(error: FloatArray, slope: Slope, offset: float, rmse_before_lag: float) -> Agreement | None:
    """From the errors (T,), NaN where one of both is unknown; None where no frame has both."""
    known = error[np.isfinite(error)]
    if not len(known):
        return None
    return Agreement(
        lag_s=slope.lag_s,
        lag_std_s=slope.lag_std_s,
        gain=slope.gain,
        gain_std=slope.gain_std,
        offset=offset,
        rmse=_rms(known),
        mae=float(np.mean(np.abs(known))),
        max=float(np.max(np.abs(known))),
        frames=len(known),
        rmse_before_lag=rmse_before_lag,
    )


def _rms(error: FloatArray) -> float:
    known = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


sys.modules[__name__].__class__ = CallableModule
