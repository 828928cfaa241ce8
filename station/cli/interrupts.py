"""What signals ask of a running capture: Ctrl-C pauses, again stops; SIGTERM and a lost terminal stop."""

from __future__ import annotations

import signal
from types import FrameType
from typing import Any

from station.capture.control import Control, Wish
from station.capture.states import State

SIGNAL_CODE = 128
# Until another is entered nothing moves, and a signal ends the command at once.
STILL = frozenset({State.IDLE, State.CHECKING})


class Interrupts:
    """Has signals ask a capture to pause or stop, inside a `with` block. They only set flags: the servo loop does it.

    Ctrl-C, where a person can be asked, holds the arm where it is whenever it moves, also on its way to be left;
    pressed again it stops the capture. Elsewhere it stops at once, and so do SIGTERM and SIGHUP (the terminal is gone).
    Ctrl-Z pauses: a program that is suspended watches over no arm. Nothing skips how the arm is to be left.

    Args:
        asks: whether a person can be asked.
        by_hand: whether people move what is captured: Ctrl-C is then its normal end.

    Attributes:
        code: the exit code of the signal that stopped the capture; None without one.
        stopping: whether the capture was stopped.
    """

    def __init__(self, control: Control, *, asks: bool, by_hand: bool) -> None:
        self._control, self._asks, self._by_hand = control, asks, by_hand
        self._moves = False
        self._before: dict[signal.Signals, Any] = {}
        self.code: int | None = None
        self.stopping = False

    def entered(self, state: State) -> None:
        """The capture is in this state now."""
        self._moves = self._moves or self._by_hand or state not in STILL

    def stop(self) -> None:
        """Stop as a person's second Ctrl-C does."""
        self._stop(signal.SIGINT)

    def __enter__(self) -> Interrupts:
        wanted = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup
            wanted.append(signal.SIGHUP)
        if self._asks:
            wanted.append(signal.SIGTSTP)
        for number in wanted:
            self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGTSTP:
            self._control.pause()
        elif not self._moves:
            raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(SIGNAL_CODE + number)
        elif number == signal.SIGINT and self._asks and not self._by_hand and self._control.wish is not Wish.PAUSE:
            self._control.pause()
        else:
            self._stop(number)

    def _stop(self, number: int) -> None:
        self._control.stop()
        if not self.stopping and not (self._by_hand and number == signal.SIGINT):
            self.code = SIGNAL_CODE + number
        self.stopping = True
