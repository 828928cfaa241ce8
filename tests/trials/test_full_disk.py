"""A disk that runs full during a capture: a real one, small and in memory."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.trials.bench import bench
from tests.trials.test_ends import ON_BOTH, check_left, check_session

# The description and the first second's frames have room; the motion's rest has not.
SIZE_MB = 6


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A file system of some megabytes; skips where none can be mounted."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SIZE_MB}m", "tmpfs", str(folder)]
    try:
        done = subprocess.run(mount, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        pytest.skip("there is no mount on this machine")
    if done.returncode:
        pytest.skip(f"no file system can be mounted here: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@ON_BOTH
def test_a_full_disk_ends_the_capture_and_what_was_written_is_read(tmp_path: Path, rig: str) -> None:
    with small_disk(tmp_path / "disk") as disk, bench(tmp_path, rig) as lab:
        with lab.capture(session=disk / "session") as running:
            code, said = running.end()
            assert code == 1 and "can't be written" in said and "MB are free" in said
            check_left(lab, "park-then-release")
            recording = check_session(running)
        assert recording.frames > 30
        assert any("cut" in notice or "closed" in notice for notice in recording.notices)
