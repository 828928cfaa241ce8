"""At the end of every capture the arm is brought into the state that the rig declares, whatever led there."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers.errors import BusLost, DriverError, NoReply
from station.capture.approach import approach
from station.capture.crew import NS_PER_S, Crew
from station.capture.pausing import heed_pause
from station.capture.states import State
from station.logs import FloatArray
from station.motion import JointLimits

# A bus that was lost on the way is looked for this often.
RECONNECT_EVERY_S = 0.2


def leave(
    crew: Crew,
    joints: Sequence[JointLimits],
    park: FloatArray,
    *,
    failure: BaseException | None,
    finished: bool,
) -> None:
    """Leave the arm as `[safety] at_exit` says: each step is tried, the first failure is raised when all have been.

    A pause holds the arm on its way, too; nothing else that people ask is heeded any more. An arm whose motion ended
    early first stays where it is, so that it doesn't run on to its last goal.

    Where the bus is lost meanwhile it is waited for as the rig says, unless it was what ended the capture: that has
    waited. An arm that was out of reach isn't parked any more, but released or held as declared.

    Args:
        failure: what ended the capture; a signal is no fault.
        finished: the motion was made to its end.
    """
    arm, safety = crew.rig.arm, crew.rig.table.safety
    crew.leaving = True
    steps: list[tuple[Callable[[], None], bool]] = []  # and whether it is tried again after the bus was away
    if not finished and safety.at_exit != "release":
        steps.append((arm.stop, True))
    if safety.at_exit == "park-then-release":
        steps.append((lambda: _park(crew, joints, park), False))
    steps.append((arm.leave_holding if safety.at_exit == "hold" else arm.torque_off, True))
    patience_s = 0.0 if isinstance(failure, BusLost) else safety.reconnect_s
    crew.situation.step = f"leaving the arm: {safety.at_exit}"
    if isinstance(failure, Exception):
        crew.states.to(State.FAULT)
    crew.states.to(State.PARKING)
    tried = [_tried(crew, step, patience_s, again) for step, again in steps]
    failures = [error for error in tried if error is not None]
    crew.situation.goal = None
    if failures:
        crew.situation.step = f"arm NOT left as declared ({safety.at_exit}): {failures[0]}"
        crew.states.to(State.FAULT)
        raise failures[0]
    _say_left(crew, safety.at_exit)


def leave_alone(crew: Crew, how: str, failure: BaseException | None) -> None:
    """End the capture of an arm of which nothing was asked: only say how it is left.

    Args:
        failure: as of `leave`.
    """
    if isinstance(failure, Exception):
        crew.states.to(State.FAULT)
    if crew.has_arm:
        _say_left(crew, how)
    else:
        crew.states.to(State.IDLE)


def _say_left(crew: Crew, how: str) -> None:
    crew.situation.step = f"arm left: {how}"
    crew.states.to(State.IDLE)
    crew.journal.info(crew.situation.step)


def _park(crew: Crew, joints: Sequence[JointLimits], park: FloatArray) -> None:
    approach(crew, joints, park, heed=lambda: heed_pause(crew, holds=True))


def _tried(crew: Crew, step: Callable[[], None], patience_s: float, again: bool) -> Exception | None:
    """What a step failed with."""
    try:
        try:
            step()
        except BusLost as lost:
            if not _is_back(crew, patience_s) or not again:
                raise
            crew.journal.warn(f"{lost}; it is back")
            step()
    except Exception as error:
        crew.journal.error(error, "leaving the arm")
        return error
    return None


def _is_back(crew: Crew, patience_s: float) -> bool:
    """Whether something answers on the bus again in time."""
    until_ns = crew.clock.now_ns() + int(patience_s * NS_PER_S)
    while True:
        try:
            crew.rig.arm.connect()
            return True
        except (BusLost, NoReply):
            if crew.clock.now_ns() >= until_ns:
                return False
            crew.clock.sleep_until_ns(crew.clock.now_ns() + int(RECONNECT_EVERY_S * NS_PER_S))
        except DriverError:  # a servo has an alarm, it may be: it can be told to let go all the same
            return True
