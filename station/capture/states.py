"""The states of a capture, and which may follow which: the one place where a capture changes its state."""

from __future__ import annotations

import threading
from collections.abc import Callable
from enum import StrEnum

from station.errors import StationError


class State(StrEnum):
    """What a capture is doing.

    IDLE: nothing is asked of the servos, before the start and after the end. CHECKING: servos and camera are looked at;
    nothing moves. MOVING: the arm goes to where the motion starts or the motion is under way, or people move the arm.
    HOLDING: it is held, and waits for a bus or a camera that went away. PAUSED: it is held because somebody asked for
    it. PARKING: it is brought into the state that the rig declares. FAULT: something failed.
    """

    IDLE = "idle"
    CHECKING = "checking"
    MOVING = "moving"
    HOLDING = "holding"
    PAUSED = "paused"
    PARKING = "parking"
    FAULT = "fault"


FOLLOWS: dict[State, frozenset[State]] = {
    State.IDLE: frozenset({State.CHECKING, State.FAULT}),
    State.CHECKING: frozenset({State.MOVING, State.PAUSED, State.PARKING, State.FAULT, State.IDLE}),
    State.MOVING: frozenset({State.HOLDING, State.PAUSED, State.PARKING, State.FAULT, State.IDLE}),
    State.HOLDING: frozenset({State.MOVING, State.PAUSED, State.PARKING, State.FAULT, State.IDLE}),
    State.PAUSED: frozenset({State.CHECKING, State.MOVING, State.HOLDING, State.PARKING, State.FAULT, State.IDLE}),
    State.PARKING: frozenset({State.PAUSED, State.IDLE, State.FAULT}),
    State.FAULT: frozenset({State.PARKING, State.IDLE}),
}


class StateMachine:
    """The state of one capture; safe to read from any thread, changed by one at a time.

    Args:
        entered: called with each new state, after the change.
    """

    def __init__(self, entered: Callable[[State], None]) -> None:
        self._state = State.IDLE
        self._entered = entered
        self._lock = threading.Lock()

    @property
    def state(self) -> State:
        """The present state."""
        with self._lock:
            return self._state

    def to(self, state: State) -> None:
        """Change to a state; to the present one is no change.

        Raises:
            StationError: a state that can't follow the present one: a fault of the program.
        """
        with self._lock:
            if state == self._state:
                return
            if state not in FOLLOWS[self._state]:
                may = ", ".join(sorted(FOLLOWS[self._state]))
                raise StationError(f"a capture that is {self._state} can't become {state}; it may become {may}")
            self._state = state
        self._entered(state)
