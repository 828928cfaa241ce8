"""Runs the command line and writes down, at once, all that it hands to the recording: what a kill can be held against.

Run: python -m tests.trials.told LEDGER BREAKS ARGUMENTS OF STATION. BREAKS is empty or names what fails after a while.
A line of the ledger is the time of the call and the stamp of what was handed over, both ns of the machine's monotonic
clock, and what it was. A line is written before the call: it survives a kill as soon as the operating system has it.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from typing import Any

from drivers.camera import Frame

PATIENCE_S = 0.5
WITHOUT_IMAGE = "without image"


def _what(word: str, *values: Any) -> str:
    """What else a line says: an event's text, and of a frame whose image had no room that it comes without."""
    if word == "event":
        return str(values[2]).replace("\n", " ")
    return WITHOUT_IMAGE if word == "frame" and values[2] is None else ""


def _telling(fd: int, word: str, original: Callable[..., Any], stamp: Callable[..., int]) -> Callable[..., Any]:
    """The method, which writes its line first."""

    def told(self: Any, *values: Any, **named: Any) -> Any:
        text = _what(word, *values)
        os.write(fd, f"{time.monotonic_ns()} {stamp(*values, **named)} {word} {text}\n".encode())
        return original(self, *values, **named)

    return told


def tell_all(fd: int) -> None:
    """Have every recording of this program write its lines to the descriptor."""
    from station.recording import RecordingWriter

    stamps: dict[str, tuple[str, Callable[..., int]]] = {
        "log_reading": ("reading", lambda t_ns, *_, **__: t_ns),
        "log_command": ("command", lambda t_ns, *_, **__: t_ns),
        "log_servos": ("servos", lambda t_ns, *_, **__: t_ns),
        "log_event": ("event", lambda t_ns, *_, **__: t_ns),
        "log_frame": ("frame", lambda index, t_ns, *_, **__: t_ns),
        "close": ("close", lambda *_, **__: 0),
    }
    _tell_frames(fd)
    for name, (word, stamp) in stamps.items():
        if hasattr(RecordingWriter, name):
            setattr(RecordingWriter, name, _telling(fd, word, getattr(RecordingWriter, name), stamp))


def _tell_frames(fd: int) -> None:
    """Have the rendered camera write a line for every frame that it gives away."""
    from drivers.rendered_camera import RenderedCamera

    read = RenderedCamera.read

    def told(self: RenderedCamera, until_ns: int) -> Frame | None:
        frame = read(self, until_ns)
        if frame is not None:
            os.write(fd, f"{time.monotonic_ns()} {frame.t_ns} taken \n".encode())
        return frame

    RenderedCamera.read = told


class Breaks(RuntimeError):
    """What nobody foresaw."""


def _break(owner: type, name: str, after: int) -> None:
    """Have a method fail from its so many-th call on."""
    original, calls = getattr(owner, name), 0

    def breaking(self: Any, *values: Any, **named: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > after:
            raise Breaks(f"{name} broke")
        return original(self, *values, **named)

    setattr(owner, name, breaking)


def break_one(what: str) -> None:
    """Have a part of the program fail when it has done some of its work."""
    if what == "detection":
        from station.perception.marker_tracker import MarkerTracker

        _break(MarkerTracker, "detect", 30)
    elif what == "recorder":
        from station.recording import RecordingWriter

        _break(RecordingWriter, "log_frame", 30)
    elif what == "servo loop":
        from station.recording import RecordingWriter

        _break(RecordingWriter, "log_reading", 50)


def be_patient() -> None:
    """Wait longer for servos than real ones need: on a busy machine emulated ones answer late."""
    from drivers import sdk_fence

    sdk_fence.REPLY_MARGIN_S = PATIENCE_S


def main() -> None:
    """Run the command line, told."""
    be_patient()
    tell_all(os.open(sys.argv.pop(1), os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644))
    break_one(sys.argv.pop(1))
    from station import cli

    cli.main()


if __name__ == "__main__":
    main()
