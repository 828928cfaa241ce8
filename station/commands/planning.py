"""Plans of motions: laid out and checked against the rig before anything moves."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from station.motion import Plan, plan_motion, told_legs

if TYPE_CHECKING:
    from station.rig import RigFile


def plan(rig: str, motion: str) -> Plan:
    """Lay out a motion on a rig (names of packaged ones, or paths) and check all of it against the rig's limits."""
    from station.rig import load_rig

    return planned_motion(load_rig(rig), motion)[0]


def plan_rows(planned: Plan) -> list[list[str]]:
    """A table of a plan, its header first: the legs of given targets, a row for each other step."""
    rows = [["step", "at [s]", "move [s]", "hold [s]", "what moves"]]
    for told in told_legs(planned):
        rows.append([str(told.step), f"{told.t_start_s:.2f}", f"{told.move_s:.2f}", f"{told.hold_s:.2f}", told.text])
    return rows


def plan_document(planned: Plan) -> dict[str, object]:
    """A plan as JSON: duration and legs, in s, rad and m."""
    legs = [
        {
            "step": leg.step,
            "kind": planned.motion.steps[leg.step - 1].kind,
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
    from station.commands.motion_sources import read_motion
    from station.rig_reading import check_arm

    check_arm(rig.table, rig.name)
    joints = rig.table.limits()
    read, text = read_motion(motion, joints)
    return plan_motion(read, joints), text


def room_remarks(rig: RigFile, planned: Plan, folder: Path, frames: str) -> tuple[str, ...]:
    """What to warn of where the folder's disk has no room for the motion; `frames` as for a capture."""
    from station.recording.sizes import expected_rates, room_warning

    warning = room_warning(folder, expected_rates(rig.table, frames), planned.duration_s)
    return () if warning is None else (warning,)
