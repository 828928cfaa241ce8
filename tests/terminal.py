"""A real terminal (a pty) with a program in its foreground: what is on its screen, keys, and the program's end."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import termios
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import pyte

CTRL_C, CTRL_Z = "\x03", "\x1a"
PATIENCE_S = 60.0
# The program opens its terminal as a session's leader, which makes it the session's own: Ctrl-C is then a signal to it.
TAKES_TERMINAL = (
    "import os, sys; os.open(os.ttyname(0), os.O_RDWR); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
)


class Terminal:
    """A program on a terminal of its own.

    Args:
        arguments: of the Python interpreter.
        size: rows and columns.
    """

    def __init__(self, arguments: Sequence[str], *, size: tuple[int, int] = (24, 80)) -> None:
        self._screen = pyte.Screen(size[1], size[0])
        self._seen: str | None = None  # what is on the screen, until more comes
        self._stream = pyte.ByteStream(self._screen)
        self._fd, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", *size, 0, 0))
        environment = {**os.environ, "TERM": "xterm-256color", "PYTHONPATH": str(Path(__file__).parents[1])}
        for name in ("COLUMNS", "LINES", "NO_COLOR"):
            environment.pop(name, None)
        self.program = subprocess.Popen(
            [sys.executable, "-c", TAKES_TERMINAL, *arguments],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
            env=environment,
        )
        self._theirs: int | None = theirs
        self.shown = ""  # all that came, as it came

    def __enter__(self) -> Terminal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.program.poll() is None:
            self.program.kill()
        self.program.wait()
        self.hang_up()

    def hang_up(self) -> None:
        """Take the terminal away, as when a window is closed or a connection breaks."""
        for fd in (self._fd, self._theirs):
            if fd is not None and fd >= 0:
                os.close(fd)
        self._fd, self._theirs = -1, None

    @property
    def modes(self) -> int:
        """The local modes of the terminal, such as termios.ECHO."""
        return termios.tcgetattr(self._fd)[3]

    def screen(self) -> str:
        """What is on the screen now."""
        while select.select([self._fd], [], [], 0)[0]:
            came = os.read(self._fd, 65536)
            self.shown += came.decode("utf-8", "replace")
            self._stream.feed(came)
            self._seen = None
        if self._seen is None:  # looked at a hundred times a second, and drawn five times
            self._seen = "\n".join(line.rstrip() for line in self._screen.display).rstrip()
        return self._seen

    def press(self, keys: str) -> None:
        """Press keys."""
        os.write(self._fd, keys.encode())

    def wait_for(self, text: str) -> str:
        """Wait until the screen shows a text; returns the screen."""
        self.wait_until(lambda: text in self.screen())
        return self.screen()

    def wait_until(self, done: Callable[[], bool]) -> None:
        """Wait for something, reading what the program writes."""
        deadline = time.monotonic() + PATIENCE_S
        while not done():
            ended = self.program.poll() is not None
            self.screen()
            assert not ended or done(), self.screen()
            assert time.monotonic() < deadline, self.screen()
            time.sleep(0.01)

    def end(self) -> int:
        """The exit code of the program, once it has ended."""
        self.wait_until(lambda: self.program.poll() is not None)
        self.screen()
        assert self.program.returncode is not None
        return self.program.returncode
