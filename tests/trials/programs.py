"""Captures as programs of their own: started, watched by what they write down, stopped or killed from outside."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PATIENCE_S = 60.0
LOOK_S = 0.005

# All joints move at once and from the first second on; it ends away from the park pose, so that there is a way to park.
MOTION = """
schema = "motion/1"
name = "trial"
[[step]]
move = { base_pan = 30, shoulder = 20, elbow = -30, wrist = 40 }
speed_deg_s = 40
hold_s = 0.2
[[step]]
move = { base_pan = -20, shoulder = -10, elbow = 0, wrist = -20 }
speed_deg_s = 40
hold_s = 0.2
[[step]]
move = { base_pan = 15, shoulder = 10, elbow = -20, wrist = 20 }
speed_deg_s = 40
hold_s = 0.2
"""


@dataclass(frozen=True)
class Line:
    """One line of the ledger; times in ns of the machine's monotonic clock."""

    told_ns: int
    stamp_ns: int
    word: str
    text: str


def read_ledger(path: Path) -> list[Line]:
    """The whole lines of a ledger; none where it doesn't exist."""
    if not path.exists():
        return []
    whole = path.read_text(encoding="utf-8").rpartition("\n")[0]
    rows = (row.split(" ", 3) for row in whole.splitlines())
    return [Line(int(told), int(stamp), word, text) for told, stamp, word, text in rows]


@dataclass(frozen=True)
class Program:
    """A capture that runs: the program, its session's folder and its ledger."""

    process: subprocess.Popen[str]
    session: Path
    ledger: Path

    def lines(self) -> list[Line]:
        """What it has written down so far."""
        return read_ledger(self.ledger)

    def wait_for(self, condition: Callable[[], bool], what: str) -> None:
        """Return when the condition holds; raises AssertionError if the program ends before, or takes too long."""
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert self.process.poll() is None, f"it ended before {what}: {self.process.communicate()[1]}"
            assert time.monotonic() < deadline_s, f"no {what} in {PATIENCE_S} s"
            time.sleep(LOOK_S)

    def wait_for_frames(self, count: int) -> None:
        """Return when so many frames have been handed to the recording."""
        self.wait_for(lambda: sum(line.word == "frame" for line in self.lines()) >= count, f"{count} frames")

    def wait_for_motion(self, seconds: float) -> None:
        """Return when frames of so much time have been handed to the recording."""

        def span_s() -> float:
            stamps = [line.stamp_ns for line in self.lines() if line.word == "frame"]
            return (max(stamps) - min(stamps)) * 1e-9 if stamps else 0.0

        self.wait_for(lambda: span_s() >= seconds, f"{seconds} s of frames")

    def kill(self) -> int:
        """Kill it as `kill -9` does; the monotonic time at which that was, ns."""
        self.process.send_signal(signal.SIGKILL)
        killed_ns = time.monotonic_ns()
        self.process.wait(PATIENCE_S)
        return killed_ns

    def stop(self, number: signal.Signals) -> tuple[int, str]:
        """Send a signal and wait for the end; exit code and what it said on standard error."""
        self.process.send_signal(number)
        return self.end()

    def end(self, patience_s: float = PATIENCE_S) -> tuple[int, str]:
        """Wait for the end; exit code and what it said on standard error."""
        _, said = self.process.communicate(timeout=patience_s)
        return self.process.returncode, said


@contextmanager
def program(
    folder: Path,
    *arguments: str,
    session: Path | None = None,
    breaks: str = "",
    variables: Mapping[str, str] | None = None,
) -> Iterator[Program]:
    """Run `station ARGUMENTS` with its ledger in `folder`/ledger; killed at the end if it still runs.

    `breaks` names what shall fail in it, of tests/trials/told.py; `variables` are added to its environment.
    """
    ledger = folder / "ledger"
    with subprocess.Popen(
        [sys.executable, "-m", "tests.trials.told", str(ledger), breaks, *arguments],
        env={**environment(folder), **(variables or {})},
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield Program(process, session or folder / "session", ledger)
        finally:
            process.kill()


def environment(folder: Path) -> dict[str, str]:
    """The environment of a program whose temporary files are in `folder`."""
    return {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(folder)}


def capture_arguments(
    folder: Path, *more: str, rig: str = "demo", motion: str = MOTION, session: Path | None = None
) -> Sequence[str]:
    """`station capture` of the trial's motion in real time, into `folder`/session if no other is named."""
    (folder / "motion.toml").write_text(motion, encoding="utf-8")
    out = str(session or folder / "session")
    return ("capture", rig, str(folder / "motion.toml"), "--out", out, "--realtime", *more)
