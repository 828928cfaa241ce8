"""Plans of motions: laid out and checked against the rig before anything moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from station.formats.motion import parse_motion
from station.formats.text import read_text
from station.motion import JointLimits, Plan, plan_motion

if TYPE_CHECKING:
    from station.rig import RigFile


def plan(rig: str, motion: str) -> Plan:
    """Lay out a motion on a rig (names of packaged ones, or paths) and check all of it against the rig's limits."""
    from station.rig import load_rig

    return planned_motion(load_rig(rig), motion)[0]


def plan_rows(planned: Plan) -> list[list[str]]:
    """A table of a plan's legs, its header first."""
    rows = [["step", "at [s]", "move [s]", "hold [s]", "what moves"]]
    for leg in planned.segments:
        moves = [
            f"{joint.name} to {joint.text(there).replace('.0 ', ' ')}"
            for joint, here, there in zip(planned.joints, leg.q_from, leg.q_to, strict=True)
            if here != there
        ]
        rows.append([str(leg.step), f"{leg.t_start_s:.2f}", f"{leg.move_s:.2f}", f"{leg.hold_s:.2f}", ", ".join(moves)])
    return rows


def plan_document(planned: Plan) -> dict[str, object]:
    """A plan as JSON: duration and legs, in s, rad and m."""
    legs = [
        {
            "step": leg.step,
            "start_s": leg.t_start_s,
            "move_s": leg.move_s,
            "hold_s": leg.hold_s,
            "from": dict(zip([joint.name for joint in planned.joints], leg.q_from.tolist(), strict=True)),
            "to": dict(zip([joint.name for joint in planned.joints], leg.q_to.tolist(), strict=True)),
        }
        for leg in planned.segments
    ]
    units = {joint.name: joint.unit for joint in planned.joints}
    return {"motion": planned.motion.name, "duration_s": planned.duration_s, "units": units, "legs": legs}


def planned_motion(rig: RigFile, motion: str) -> tuple[Plan, str]:
    """A motion laid out on a rig, and its text for the session's copy."""
    from station.rig_reading import check_arm, packaged, packaged_names

    check_arm(rig.table, rig.name)
    path = packaged("motions", motion)
    text = read_text(path, "motion", f"packaged ones are {', '.join(packaged_names('motions'))}")
    joints: tuple[JointLimits, ...] = rig.table.limits()
    return plan_motion(parse_motion(text, str(path), joints), joints), text
