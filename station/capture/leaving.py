"""At the end of every capture the arm is brought into the state that the rig declares, whatever led there."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from station.capture.approach import approach
from station.capture.crew import Crew
from station.capture.pausing import heed_pause
from station.capture.states import State
from station.logs import FloatArray
from station.motion import JointLimits


def leave(crew: Crew, joints: Sequence[JointLimits], park: FloatArray, *, failed: bool, stopped: bool) -> None:
    """Leave the arm as `[safety] at_exit` says: each step is tried, the first failure is raised when all have been.

    A pause holds the arm on its way, too; nothing else that people ask is heeded any more. An arm whose motion ended
    early first stays where it is, so that it doesn't run on to its last goal.

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
        crew.situation.step = f"arm NOT left as declared ({at_exit}): {failures[0]}"
        crew.states.to(State.FAULT)
        raise failures[0]
    say_left(crew, at_exit)


def say_left(crew: Crew, how: str) -> None:
    """Nothing more is asked of the servos: say how the arm was left."""
    crew.situation.step = f"arm left: {how}"
    crew.states.to(State.IDLE)
    crew.journal.info(crew.situation.step)


def _park(crew: Crew, joints: Sequence[JointLimits], park: FloatArray) -> None:
    crew.situation.step = "parking"
    approach(crew, joints, park, heed=lambda: heed_pause(crew, holds=True))


def _tried(crew: Crew, step: Callable[[], None]) -> Exception | None:
    try:
        step()
    except Exception as error:
        crew.journal.error(error, "leaving the arm")
        return error
    return None
