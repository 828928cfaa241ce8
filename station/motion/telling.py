"""A plan in a few lines: given targets leg by leg, whatever was made of shares, curves and recordings step by step."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

from station.motion.plan import Plan
from station.motion.segment import Segment
from station.motion.steps import MotionStep


@dataclass(frozen=True, slots=True)
class ToldLegs:
    """A line: the step it belongs to, when it starts, how long it moves and rests in all, and what moves where."""

    step: int
    t_start_s: float
    move_s: float
    hold_s: float
    text: str


def told_legs(plan: Plan) -> list[ToldLegs]:
    """The lines of a plan, in the order of time."""
    lines: list[ToldLegs] = []
    for number, group in groupby(plan.segments, key=lambda leg: leg.step):
        step, legs = plan.motion.steps[number - 1], list(group)
        if isinstance(step, MotionStep):
            lines += [ToldLegs(number, leg.t_start_s, leg.move_s, leg.hold_s, _targets(plan, leg)) for leg in legs]
            continue
        move_s, hold_s = sum(leg.move_s for leg in legs), sum(leg.hold_s for leg in legs)
        count = f" ({len(legs)} legs)" if len(legs) > 1 else ""
        lines.append(ToldLegs(number, legs[0].t_start_s, move_s, hold_s, f"{step.text(plan.joints)}{count}"))
    return lines


def _targets(plan: Plan, leg: Segment) -> str:
    """Where the joints that move go, whole numbers without a decimal."""
    return ", ".join(
        f"{joint.name} to {joint.text(float(there)).replace('.0 ', ' ')}"
        for joint, here, there in zip(plan.joints, leg.q_from, leg.q_to, strict=True)
        if here != there
    )
