"""At the end of every capture the arm is brought into the state that the rig declares, whatever led there."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from station.capture.approach import approach
from station.capture.crew import Crew
from station.capture.states import State
from station.logs import FloatArray
from station.motion import JointLimits


def leave(crew: Crew, joints: Sequence[JointLimits], park: FloatArray, *, failed: bool, stopped: bool) -> None:
    """Leave the arm as `[safety] at_exit` says: each step is tried, the first failure is raised when all have been.

    Nobody's wish is heeded any more. An arm whose motion ended early first stays where it is, so that it doesn't run on
    to its last goal.

    Args:
        failed: after a failure.
        stopped: in mid-motion, after a failure or because somebody asked for it.
    """
    crew.leaving = True
    arm, at_exit = crew.rig.arm, crew.rig.table.safety.at_exit
    steps: list[Callable[[], None]] = []
    if stopped and at_exit != "release":
        steps.append(arm.stop)
    if at_exit == "park-then-release":
        steps.append(lambda: _park(crew, joints, park))
    steps.append(arm.leave_holding if at_exit == "hold" else arm.torque_off)
    if failed:
        crew.states.to(State.FAULT)
    crew.states.to(State.PARKING)
    failures = [failure for step in steps if (failure := _tried(crew, step)) is not None]
    crew.situation.goal = None
    if failures:
        crew.states.to(State.FAULT)
        raise failures[0]
    crew.states.to(State.IDLE)
    crew.journal.info(f"arm left: {at_exit}")


def _park(crew: Crew, joints: Sequence[JointLimits], park: FloatArray) -> None:
    crew.situation.step = "parking"
    approach(crew, joints, park, heed=lambda: False)


def _tried(crew: Crew, step: Callable[[], None]) -> Exception | None:
    try:
        step()
    except Exception as error:
        crew.journal.error(error, "leaving the arm")
        return error
    return None
