"""Pause, go on, stop: what people ask of a capture, seen to in the servo loop."""

from __future__ import annotations

import time
from collections.abc import Callable

from station.capture.control import StopAsked, Wish
from station.capture.crew import TURN_NS, Crew
from station.capture.states import State

# Of real time: how often who watches is told of a pause while a virtual clock stands still.
LOOK_S = 0.2


def heed(crew: Crew, *, holds: bool, read: Callable[[], object] | None = None) -> bool:
    """See to what is asked for, each turn; returns whether there was a pause.

    Nothing is recorded during a pause. The servos are read on, which is what watches over them and keeps their bus
    watchdogs quiet. On a virtual clock the simulated world stands still with the clock.

    Args:
        holds: whether the arm is to hold itself, at once; it is limp if not.
        read: watches the servos each turn of a pause; `crew.read` if None.

    Raises:
        StopAsked: somebody asked for the end.
    """
    paused = heed_pause(crew, holds=holds, read=read)
    if crew.control.wish is Wish.STOP:
        raise StopAsked
    return paused


def heed_pause(crew: Crew, *, holds: bool, read: Callable[[], object] | None = None) -> bool:
    """Pause if that is asked for; returns whether it was."""
    if crew.control.wish is not Wish.PAUSE:
        return False
    crew.frames.close()
    before = crew.states.state
    if holds:
        hold(crew)
    crew.tally.add("pauses")
    crew.states.to(State.PAUSED)
    since_s = time.monotonic()
    while (
        crew.control.wait_while_paused(LOOK_S) if crew.rig.virtual else _next_turn(crew, read or crew.read)
    ) is Wish.PAUSE:
        crew.tell()
    crew.journal.info(f"paused for {time.monotonic() - since_s:.1f} s")
    crew.states.to(before)
    return True


def hold(crew: Crew) -> None:
    """Have the arm stay where it is, at once."""
    crew.rig.arm.stop()
    crew.situation.goal = crew.read().q


def _next_turn(crew: Crew, read: Callable[[], object]) -> Wish:
    """Watch the servos for a turn of a pause."""
    crew.clock.sleep_until_ns(crew.clock.now_ns() + TURN_NS)
    read()
    if not crew.leaving:
        crew.check()
    return crew.control.wish
