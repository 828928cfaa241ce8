"""Shows a capture while it runs and hears what the person wants of it, in a thread of its own.

On a terminal that is the dashboard; elsewhere, as in a log, a line at each change of state and each warning.
"""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.capture.control import Control, Wish
from station.cli.dashboard import Dashboard, duration
from station.cli.interrupts import Interrupts
from station.cli.keys import Keys, somebody_there
from station.cli.show import say_next

if TYPE_CHECKING:
    from rich.live import Live

    from station.capture.snapshot import Snapshot
    from station.commands.live import LiveServer

# Between two pictures of the dashboard, s; between two looks at the disk.
TICK_S = 0.2
DISK_EVERY_S = 2.0
# A terminal that takes nothing more (Ctrl-S) doesn't hold up the end for longer than this, s.
END_S = 2.0

PAUSED = "paused: the arm holds where it is. Enter: on from the last checkpoint. s, or Ctrl-C again: stop and park."
STOPPING = "stopping: the arm is left as the rig declares. Ctrl-C holds it on its way."
HELD = "held on its way. Enter, or Ctrl-C again: the arm is left as the rig declares."


class Attendant:
    """One capture's face on the terminal. `watch` and `control` are what it gives the capture.

    Args:
        out: the session's folder, whose disk is looked at.
        by_hand: whether people move what is captured.
        foot: a line for the dashboard's end, such as where the live view is.
    """

    def __init__(self, out: Path, *, by_hand: bool, foot: str = "") -> None:
        self.control = Control()
        self._asks = somebody_there()
        self.interrupts = Interrupts(self.control, asks=self._asks, by_hand=by_hand)
        self._hint = "Ctrl-C ends the recording" if by_hand else "Ctrl-C pauses" if self._asks else "Ctrl-C stops"
        self._foot = foot
        self._disk = Disk(out)
        self._last: Snapshot | None = None
        self._lines: deque[str] = deque()
        self._first, self._ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="terminal", daemon=True)

    @property
    def last(self) -> Snapshot | None:
        """The last snapshot that came."""
        return self._last

    def settings(self) -> dict[str, Any]:
        """The settings of a capture that this attends."""
        return {"control": self.control, "watch": self.watch}

    def watch(self, snapshot: Snapshot) -> None:
        """Take a snapshot; from the capture's own thread, so this returns at once."""
        before, self._last = self._last, snapshot
        if before is None or (before.state, before.said) != (snapshot.state, snapshot.said):
            self._lines.append(_line(snapshot, before))
        self.interrupts.entered(snapshot.state)
        self._first.set()

    def __enter__(self) -> Attendant:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._first.set()
        self._thread.join(END_S)

    def _run(self) -> None:
        """Wait for the first snapshot: until then others may have something to ask."""
        self._first.wait()
        try:
            if sys.stderr.isatty():
                self._show_dashboard()
            else:
                self._print_lines()
        except OSError:
            return  # nobody looks any more; the capture isn't concerned

    def _print_lines(self) -> None:
        while not self._ended.wait(TICK_S) or self._lines:
            while self._lines:
                print(self._lines.popleft(), file=sys.stderr, flush=True)

    def _show_dashboard(self) -> None:
        from rich.console import Console
        from rich.live import Live

        live = Live(console=Console(stderr=True), auto_refresh=False, redirect_stdout=False, vertical_overflow="crop")
        with ExitStack() as stack:
            keys = stack.enter_context(Keys()) if self._asks else None
            stack.enter_context(live)
            while not self._ended.is_set():
                self._draw(live)
                self._listen(keys)
            self._draw(live)

    def _draw(self, live: Live) -> None:
        if (snapshot := self._last) is None:
            return
        ends = self._ended.is_set() or self.control.wish is Wish.STOP
        foot = "   ".join(filter(None, ("" if ends else self._hint, self._foot)))
        live.update(Dashboard(snapshot, self._disk.text(snapshot.bytes_per_s), self._asked(), foot), refresh=True)

    def _asked(self) -> str:
        wish = self.control.wish
        if wish is Wish.PAUSE:
            return HELD if self.interrupts.stopping else PAUSED
        return STOPPING if wish is Wish.STOP and not self._ended.is_set() else ""

    def _listen(self, keys: Keys | None) -> None:
        """Until the next picture: hear the answer where there is a question."""
        if keys is None:
            self._ended.wait(TICK_S)
            return
        asked = self.control.wish is Wish.PAUSE
        pressed = keys.wait(TICK_S)
        if not asked:
            return  # pressed before the question: answers nothing
        if "s" in pressed.lower():
            self.interrupts.stop()
        elif "\n" in pressed or "\r" in pressed:
            self.control.resume()


class Disk:
    """What is left on a session's disk, in words; looked at now and then."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._looked_s = -DISK_EVERY_S
        self._text = ""

    def text(self, bytes_per_s: float | None = None) -> str:
        """Such as "70.7 GB left, 38 h"; the time is at so many bytes a second."""
        if (now_s := time.monotonic()) - self._looked_s >= DISK_EVERY_S:
            self._looked_s = now_s
            try:
                free = shutil.disk_usage(self._folder).free
            except OSError:
                return self._text  # the folder isn't there yet, or its disk is gone
            self._text = f"{free / 1e9:.1f} GB left" + (f", {_long(free / bytes_per_s)}" if bytes_per_s else "")
        return self._text


def _long(lasts_s: float) -> str:
    """Roughly: 38 h, 45 min."""
    return f"{lasts_s / 3600:.0f} h" if lasts_s >= 7200 else f"{lasts_s / 60:.0f} min"


def _line(now: Snapshot, before: Snapshot | None) -> str:
    """A change, as a line of a log."""
    told = f"{duration(now.t_s):>7}  {now.state}"
    if before is None or before.state != now.state:
        told += f": {now.step}" if now.step else ""
    if now.said and (before is None or before.said != now.said):
        told += f": {' '.join(now.said.split())}"
    return told


@contextmanager
def attended(
    out: Path, live: LiveServer | None = None, *, by_hand: bool = False, fits: bool = False
) -> Iterator[Attendant]:
    """Show the capture that the block runs, have signals steer it, and say after any end what there is.

    Exits as the signal says that ended it early.

    Args:
        fits: whether the command itself fits what is complete.
    """
    foot = "" if live is None else f"live view {live.address}"
    attendant = Attendant(out, by_hand=by_hand, foot=foot)
    try:
        with attendant, attendant.interrupts:
            yield attendant
    finally:
        if attendant.last is not None:
            say_next(*left(out, attendant.last, fits=fits))
    if attendant.interrupts.code is not None:
        raise SystemExit(attendant.interrupts.code)


def left(out: Path, last: Snapshot, *, fits: bool = False) -> list[str]:
    """What a capture left, after any end: what is in the folder, how the arm is, what can be done next."""
    from station.errors import StationError
    from station.session import MOTION_FILE, read_status

    try:
        status = read_status(out)
    except StationError:
        return []
    arm = f"; {last.step}" if last.step.startswith("arm") else ""
    if status.state == "complete":
        lines = [f"{out} is complete: {status.counts.get('frames', 0)} frames{arm}"]
        return lines if fits else [*lines, f"fit it        station fit {out}"]
    lines = [f"stopped; what was recorded is in {out}: {status.counts.get('frames', 0)} frames{arm}"]
    lines.append(f"fit it        station fit {out}")
    if (out / MOTION_FILE).exists():
        lines.append(f"go on         station capture --resume {out}")
    return lines
