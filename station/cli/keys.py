"""Keys that a person presses while a capture runs, read one by one and not echoed into the dashboard."""

from __future__ import annotations

import os
import select
import sys
import termios
import time


def somebody_there() -> bool:
    """Whether a person can be shown something and can answer: a terminal on both ends, this program in its foreground.

    A program in the background that touches its terminal's settings is stopped by the terminal.
    """
    try:
        return sys.stdin.isatty() and sys.stderr.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):  # closed, or no terminal of ours
        return False


class Keys:
    """The keys of standard input, a terminal, inside a `with` block. Ctrl-C and Ctrl-Z stay signals."""

    def __init__(self) -> None:
        self._fd = sys.stdin.fileno()

    def __enter__(self) -> Keys:
        self._before = termios.tcgetattr(self._fd)
        keywise = termios.tcgetattr(self._fd)
        keywise[3] &= ~(termios.ICANON | termios.ECHO)
        keywise[6][termios.VMIN] = keywise[6][termios.VTIME] = 0  # Ctrl-C takes back what was pressed, also from a read
        termios.tcsetattr(self._fd, termios.TCSANOW, keywise)
        return self

    def __exit__(self, *_: object) -> None:
        try:
            termios.tcsetattr(self._fd, termios.TCSANOW, self._before)
        except termios.error:
            return  # the terminal is gone

    def forget(self) -> None:
        """Drop what was pressed so far: it answers nothing that is asked from now on."""
        termios.tcflush(self._fd, termios.TCIFLUSH)

    def wait(self, timeout_s: float) -> str:
        """What is pressed within this time; "" if nothing is, or the terminal is gone."""
        if not select.select([self._fd], [], [], timeout_s)[0]:
            return ""
        try:
            pressed = os.read(self._fd, 64)
        except OSError:
            pressed = b""
        if not pressed:
            time.sleep(timeout_s)  # at its end a terminal is always ready
        return pressed.decode("ascii", "replace")
