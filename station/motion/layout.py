"""Lays motions out in time for the joints of an arm, and checks all of what comes out against their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from station.errors import InvalidData, LimitExceeded
from station.logs import check_slugs, frozen_floats
from station.motion.limits import LIMIT_SLACK, JointLimits
from station.motion.plan import Motion, Plan, timed
from station.motion.segment import Segment
from station.motion.step import Step

LONGEST_S = 24 * 3600.0


def plan_motion(motion: Motion, joints: Sequence[JointLimits]) -> Plan:
    """Lay out a motion in time, from the park pose, and check all of it.

    A leg lasts until its slowest joint would arrive, then rests for its hold_s.

    Raises:
        InvalidData: a motion without steps, one that moves a joint that isn't there, or lasts longer than a day.
        LimitExceeded: a joint would leave its limits, or exceed its greatest speed or acceleration; with step and time.
    """
    check_slugs([joint.name for joint in joints], "joint")
    if not motion.steps:
        raise InvalidData(f"motion '{motion.name}' has no step; add a [[step]] with move = {{ joint = degrees }}")
    legs: list[Segment] = []
    q, t_s = frozen_floats([joint.park for joint in joints]), 0.0
    for number, step in enumerate(motion.steps, start=1):
        where = f"motion '{motion.name}', step {number}"
        try:
            laid = [replace(leg, step=number) for leg in step.legs(q, joints, motion.mode)]
        except (InvalidData, LimitExceeded) as error:
            at = f" (t = {t_s:.1f} s)" if isinstance(error, LimitExceeded) else ""
            raise type(error)(f"{where}{at}: {error}") from error
        laid = list(timed(laid, t_s))
        for leg in laid:
            _check_leg(leg, step, f"{where} (t = {leg.t_start_s:.1f} s)", joints)
        legs += laid
        q, t_s = (laid[-1].q_to, laid[-1].t_end_s) if laid else (q, t_s)
        if not t_s <= LONGEST_S:
            raise InvalidData(f"{where}: the motion lasts {t_s / 3600:.3g} h by then; {LONGEST_S / 3600:.0f} h at most")
    return Plan(motion, tuple(joints), tuple(legs))


def extended(plan: Plan, steps: Sequence[Step]) -> Plan:
    """The same motion with further steps after its last one: the legs that it has stay as they are."""
    return plan_motion(replace(plan.motion, steps=(*plan.motion.steps, *steps)), plan.joints)


def _check_leg(leg: Segment, step: Step, where: str, joints: Sequence[JointLimits]) -> None:
    """Raise LimitExceeded for a target, or what a curve reaches on its way, beyond a joint's limits."""
    curve = leg.curve
    low, high = (leg.q_to, leg.q_to) if curve is None else (curve.lowest(), curve.highest())
    for j, joint in enumerate(joints):
        far = low[j] if low[j] < joint.lower - joint.slack else high[j]
        if not joint.lower - joint.slack <= far <= joint.upper + joint.slack:
            raise LimitExceeded(
                f"{where}: {joint.name} would go to {joint.text(float(far))}; "
                f"its limits are {joint.text(joint.lower)} to {joint.text(joint.upper)}\n"
                f"{step.remedy}, or {joint.key('limits')} of {joint.name} in the rig"
            )
        if curve is None:
            continue  # made to keep to speeds and accelerations
        most = np.inf if joint.max_acceleration is None else joint.max_acceleration
        for value, limit, each, what in (
            (curve.fastest()[j], joint.max_speed, "/s", "speed"),
            (curve.hardest()[j], most, "/s2", "acceleration"),
        ):
            if value > limit * (1 + LIMIT_SLACK):
                raise LimitExceeded(
                    f"{where}: {joint.name} would reach {joint.text(float(value))}{each}; "
                    f"its greatest {what} is {joint.text(limit)}{each}\n{step.remedy}"
                )
