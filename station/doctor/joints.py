"""Check of the joints: they stand where they can, and servos that turn one joint agree on where that is."""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.joints import JointConfig, ServoConfig
from station.doctor.finding import Finding, Value, Verdict


def check_joint(
    joint: JointConfig,
    counts: Mapping[int, int],
    servo_limits: Mapping[int, tuple[int, int]],
    *,
    disagreement_rad: float,
) -> list[Finding]:
    """Where a joint's servos stand.

    Args:
        counts: position count of each of its servos, by id, as far as they could be asked.
        servo_limits: their own position limits, counts, as far as they could be asked.
    """
    asked = [servo for servo in joint.servos if servo.id in counts]
    if not asked:
        return []
    angles = {servo.id: servo.q(counts[servo.id]) for servo in asked}
    findings = [_check_place(joint, angles, [s for s in asked if _outside(counts[s.id], servo_limits.get(s.id))])]
    if len(angles) > 1:
        findings.append(_check_agreement(joint, angles, disagreement_rad))
    return findings


def _outside(count: int, limits: tuple[int, int] | None) -> bool:
    return limits is not None and not limits[0] <= count <= limits[1]


def _check_place(joint: JointConfig, angles: Mapping[int, float], outside: list[ServoConfig]) -> Finding:
    where = f"joint {joint.name}"
    q = sum(angles.values()) / len(angles)
    unit, each = ("deg", math.degrees(1.0)) if joint.unit == "rad" else ("mm", 1e3)
    values: dict[str, Value] = {
        f"q_{unit}": q * each,
        f"lower_{unit}": joint.lower * each,
        f"upper_{unit}": joint.upper * each,
    }
    said = joint.text(q)
    if outside:
        found = f"{said}: servo {outside[0].id} is outside its own position limits"
        mend = "move the joint inside by hand with torque off; else its zero is lost: check 'zero' in the rig"
        return Finding(where, "position", Verdict.BLOCKS, found, mend, values)
    if not joint.lower <= q <= joint.upper:
        found = f"{said}, the rig's limits are {joint.text(joint.lower)} to {joint.text(joint.upper)}"
        mend = "move the joint inside by hand; if it looks inside, correct 'zero' or 'sign' in the rig"
        return Finding(where, "position", Verdict.WARNING, found, mend, values)
    return Finding(where, "position", Verdict.OK, said, values=values, brief=f"at {said}")


def _check_agreement(joint: JointConfig, angles: Mapping[int, float], disagreement_rad: float) -> Finding:
    where = f"joint {joint.name}"
    spread_rad = (max(angles.values()) - min(angles.values())) * joint.servos[0].ratio  # of the shafts
    limit_deg = math.degrees(disagreement_rad)
    values: dict[str, Value] = {"disagreement_deg": math.degrees(spread_rad), "limit_deg": limit_deg}
    each = ", ".join(f"servo {servo_id} at {joint.text(q)}" for servo_id, q in angles.items())
    if spread_rad <= disagreement_rad:
        return Finding(where, "ganged servos", Verdict.OK, f"they agree: {each}", values=values)
    mend = "torque would make them fight: check 'sign' and 'zero' of both in the rig, and the horns"
    return Finding(where, "ganged servos", Verdict.BLOCKS, f"{each} (limit {limit_deg:g} deg)", mend, values)
