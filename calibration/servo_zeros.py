"""The servos' zeros from a reference pose: counts read while the arm is held where its joints' angles are known."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import CalibrationError

FloatArray = NDArray[np.float64]

# rad of a servo. A person's hand keeps an arm still to less; more between readings means that it moved.
STILL_RAD = float(np.radians(1.5))
# Counts. The least that a sensor's reading is uncertain by: half a count to either side, evenly.
ROUNDING_COUNTS = 1 / np.sqrt(12)
FEWEST_READINGS = 3


@dataclass(frozen=True)
class ReferenceServo:
    """A servo of a joint as the rig has it.

    Attributes:
        sign: +1 if the joint's state grows with the count, else -1.
        ratio: turn of the servo for one unit of the joint, rad/rad or rad/m.
        zero: the rig's present zero count.
        first, last: the counts that it can be sent to; None where its mode sets no bounds.
        turn: counts of one turn, in a mode that counts further ones and forgets them when it is switched off.
        shares_zero: whether it takes its leader's goals count by count, and so its zero.
    """

    id: int
    sign: int
    ratio: float
    rad_per_count: float
    zero: int
    first: int | None = None
    last: int | None = None
    turn: int | None = None
    shares_zero: bool = False


@dataclass(frozen=True)
class ReferenceJoint:
    """A joint, where it is held, and its servos, the leading one first; rad, or m where `unit` says so."""

    name: str
    state: float
    lower: float
    upper: float
    unit: str
    servos: tuple[ReferenceServo, ...]

    def text(self, state: float) -> str:
        """A state as people write it."""
        return f"{np.degrees(state):.1f} deg" if self.unit == "rad" else f"{1e3 * state:.1f} mm"


@dataclass(frozen=True)
class ServoZero:
    """The zero of one servo.

    Attributes:
        zero: the count at which the joint is at zero.
        std: of the joint's state that this leaves [rad or m]: spread of the readings, a count's rounding, that of zero.
        moved: by how much the joint's state reads otherwise than with the rig's present zero.
        spread_counts: from the least to the greatest reading.
        problems: why this zero can't be used, in words.
        warnings: what is doubtful, in words.
    """

    servo_id: int
    joint: str
    zero: int
    std: float
    moved: float
    spread_counts: int
    problems: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def find_zeros(
    joints: Sequence[ReferenceJoint], counts: Mapping[int, ArrayLike], *, disagreement_rad: float
) -> tuple[ServoZero, ...]:
    """Zeros of all servos from the counts (N,) that each read, N times, while the arm was held in the reference pose.

    `zero = mean count - sign ratio state / rad_per_count`, to a whole count.

    Args:
        disagreement_rad: ganged servos that differ by more from what the rig has are worth a word.

    Raises:
        CalibrationError: too few readings, or a servo that moved while it was read.
    """
    return tuple(
        _zero(joint, servo, np.asarray(counts[servo.id], dtype=np.float64), counts, disagreement_rad)
        for joint in joints
        for servo in joint.servos
    )


def _zero(
    joint: ReferenceJoint,
    servo: ReferenceServo,
    read: FloatArray,
    counts: Mapping[int, ArrayLike],
    disagreement_rad: float,
) -> ServoZero:
    _check_still(joint, servo, read)
    leader = joint.servos[0]
    own = _exact_zero(joint, servo, read)
    led = _exact_zero(joint, leader, np.asarray(counts[leader.id], dtype=np.float64))
    exact = led if servo.shares_zero else own
    zero = int(np.floor(exact + 0.5))
    per_count = servo.rad_per_count / servo.ratio
    rounding = np.hypot(ROUNDING_COUNTS, exact - zero)
    std = per_count * float(np.hypot(rounding, np.std(read, ddof=1) / np.sqrt(len(read))))
    return ServoZero(
        servo.id,
        joint.name,
        zero,
        std,
        moved=servo.sign * (servo.zero - zero) * per_count,
        spread_counts=int(np.ptp(read)),
        problems=tuple(_problems(joint, servo, zero, read)),
        warnings=tuple(_ganging(joint, servo, (own, led), disagreement_rad)),
    )


def _exact_zero(joint: ReferenceJoint, servo: ReferenceServo, read: FloatArray) -> float:
    return float(np.mean(read)) - servo.sign * servo.ratio * joint.state / servo.rad_per_count


def _check_still(joint: ReferenceJoint, servo: ReferenceServo, read: FloatArray) -> None:
    who = f"servo {servo.id} ({joint.name})"
    if read.ndim != 1 or len(read) < FEWEST_READINGS:
        raise CalibrationError(f"{who}: have readings of shape {read.shape}; want {FEWEST_READINGS} or more in a row")
    spread_rad = float(np.ptp(read)) * servo.rad_per_count
    if spread_rad > STILL_RAD:
        raise CalibrationError(
            f"{who} moved by {np.ptp(read):.0f} counts ({np.degrees(spread_rad):.1f} deg) while it was read\n"
            "hold the arm still in the reference pose, or let it rest against something, and try again"
        )


def _problems(joint: ReferenceJoint, servo: ReferenceServo, zero: int, read: FloatArray) -> Iterator[str]:
    who = f"servo {servo.id} ({joint.name})"
    if servo.turn is not None and not 0 <= np.mean(read) < servo.turn:
        yield (
            f"{who} counts whole turns and stands at {np.mean(read):.0f}, outside its first one; it forgets them "
            "when it is switched off: do that, and calibrate again"
        )
        return
    if zero < 0:
        yield f"{who}: its zero would be count {zero}, below 0; turn its horn by a spline, or take another pose as zero"
        return
    if servo.first is None or servo.last is None:
        return
    ends = sorted(zero + servo.sign * servo.ratio * q / servo.rad_per_count for q in (joint.lower, joint.upper))
    if ends[0] < servo.first - 0.5 or ends[1] > servo.last + 0.5:
        reach = sorted(servo.sign * (c - zero) * servo.rad_per_count / servo.ratio for c in (servo.first, servo.last))
        yield (
            f"{who} would have to go from count {ends[0]:.0f} to {ends[1]:.0f}, it goes from {servo.first} to "
            f"{servo.last}: turn its horn, or narrow the joint's limits to "
            f"{joint.text(reach[0])} to {joint.text(reach[1])}"
        )


def _ganging(
    joint: ReferenceJoint, servo: ReferenceServo, zeros: tuple[float, float], disagreement_rad: float
) -> Iterator[str]:
    """What two servos of one joint say of each other."""
    leader = joint.servos[0]
    if servo is leader:
        return
    own, led = zeros
    if servo.shares_zero:
        apart_rad = abs(own - led) * servo.rad_per_count
        if apart_rad > disagreement_rad:
            yield (
                f"servo {servo.id} ({joint.name}) stands {own - led:+.0f} counts ({np.degrees(apart_rad):.1f} deg) off "
                f"servo {leader.id}, whose goals it takes: they fight; set its horn anew, or its homing offset"
            )
        return
    mine = servo.sign * (servo.zero - own) * servo.rad_per_count
    its = leader.sign * (leader.zero - led) * leader.rad_per_count
    if abs(mine - its) > disagreement_rad:
        yield (
            f"servos {leader.id} and {servo.id} ({joint.name}) move by {np.degrees(its):.1f} and "
            f"{np.degrees(mine):.1f} deg against the rig's zeros: if those were good once, a horn has slipped, "
            "or a sign is wrong"
        )
