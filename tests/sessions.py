"""Short sessions for the tests, captured with the packaged demo rig."""

from __future__ import annotations

import shutil
import tempfile
from functools import cache
from pathlib import Path

from station.capture.counts import CaptureCounts
from station.commands import capturing
from station.rig_reading import packaged

# Two joints move by enough to be found; two seconds and a half.
SHORT = """
schema = "motion/1"
name = "short"
[[step]]
move = { base_pan = 30, elbow = -30 }
speed_deg_s = 50
hold_s = 0.2
[[step]]
move = { base_pan = -10, elbow = 0, shoulder = 25, wrist = 40 }
speed_deg_s = 50
hold_s = 0.2
[[step]]
move = { base_pan = 0, shoulder = 0, wrist = 0 }
speed_deg_s = 50
hold_s = 0.1
"""


def slower_rig(name: str, folder: Path, fps: int = 10) -> str:
    """A packaged rig whose camera takes fewer pictures, each at one instant, in `folder`; returns its path.

    For claims about what moves: drawing a picture and looking for its markers takes most of a capture's time.
    """
    text = packaged("rigs", name).read_text(encoding="utf-8")
    assert "fps = 30\n" in text and "blur_instants = 2\n" in text
    path = folder / f"{name}.toml"
    slower = text.replace("fps = 30\n", f"fps = {fps}\n").replace("blur_instants = 2\n", "blur_instants = 1\n")
    path.write_text(slower, encoding="utf-8")
    return str(path)


def write_motion(folder: Path, text: str = SHORT) -> str:
    """A motion file in `folder`; returns its path."""
    path = folder / "motion.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def capture_short(folder: Path, *, seed: int = 0, rig: str = "demo") -> tuple[Path, CaptureCounts]:
    """A short session in `folder`/session, and its counts."""
    out = folder / "session"
    return out, capturing.capture(rig, write_motion(folder), out, seed=seed)


def copy_of_short(folder: Path) -> Path:
    """A short session in `folder`/session, for claims about what is made of it: it is captured once for all tests of
    a program."""
    return Path(shutil.copytree(Path(_captured_once().name) / "session", folder / "session"))


@cache
def _captured_once() -> tempfile.TemporaryDirectory[str]:
    folder = tempfile.TemporaryDirectory(prefix="short-session-")
    capture_short(Path(folder.name))
    return folder
