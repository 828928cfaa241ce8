"""What people ask of a capture while it runs: pause, go on, stop."""

from __future__ import annotations

import threading
from enum import StrEnum


class Wish(StrEnum):
    """What is asked for at present."""

    RUN = "run"
    PAUSE = "pause"
    STOP = "stop"


class StopAsked(Exception):
    """Somebody asked for the end of a capture; never leaves the capture."""


class Control:
    """Wishes for a running capture, from any thread or a signal's handler; the servo loop looks at them each turn.

    A stop can't be taken back. After one, a pause holds the arm on its way to the state that it is to be left in.
    """

    def __init__(self) -> None:
        self._paused = self._stopped = False
        self._changed = threading.Condition(threading.RLock())  # a signal may interrupt its own thread in here

    @property
    def wish(self) -> Wish:
        """What is asked for at present."""
        with self._changed:
            return Wish.PAUSE if self._paused else Wish.STOP if self._stopped else Wish.RUN

    def pause(self) -> None:
        """Hold the arm where it is, until `resume` or `stop`."""
        self._ask(paused=True, stopped=False)

    def resume(self) -> None:
        """Go on from the last checkpoint."""
        self._ask(paused=False, stopped=False)

    def stop(self) -> None:
        """End the capture: bring the arm into the state that the rig declares, close the recording."""
        self._ask(paused=False, stopped=True)

    def wait_while_paused(self, timeout_s: float) -> Wish:
        """Wait until something else than a pause is asked for, or for so long; returns what is asked for then."""
        with self._changed:
            self._changed.wait_for(lambda: not self._paused, timeout_s)
            return self.wish

    def _ask(self, *, paused: bool, stopped: bool) -> None:
        with self._changed:
            self._paused, self._stopped = paused, self._stopped or stopped
            self._changed.notify_all()
