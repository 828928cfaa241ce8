"""What every test is held to (no thread, file descriptor or listening port stays behind), and the command line."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

# Tests run side by side and fill the cores by themselves: threads of matrix products, and of pictures, would only wait
# for each other, which made some take up to four times the processor's time. Set before NumPy and OpenCV come, and for
# programs that tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")

import hypothesis
import pytest

# A shell that runs the tests in the background has them ignore SIGINT, nohup SIGHUP; some of them send these.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
# No deadline for an example: machines differ, and a timing is no test.
hypothesis.settings.register_profile("station", deadline=None)
hypothesis.settings.load_profile("station")
# Threads and files that end a moment after the test may do so for this long.
GRACE_S = 2.0
# Files that libraries open once for the whole process.
LASTING = ("/dev/urandom", "/dev/null", ".ttf")  # matplotlib keeps its fonts open


def open_files() -> dict[int, str]:
    """What each file descriptor of this process points to; a listening port is one of them, as a socket."""
    files: dict[int, str] = {}
    for name in os.listdir("/proc/self/fd"):  # noqa: PTH208 (a path object for each would be slower)
        try:
            files[int(name)] = str(Path(f"/proc/self/fd/{name}").readlink())
        except OSError:
            continue  # the descriptor of the listing itself
    return files


def left_behind(threads: set[threading.Thread], files: dict[int, str]) -> list[str]:
    """Threads and files that are there now and weren't before."""
    new_threads = [f"thread '{t.name}'" for t in threading.enumerate() if t not in threads and t.is_alive()]
    new_files = [
        f"file {fd} -> {target}"
        for fd, target in open_files().items()
        if files.get(fd) != target and not target.endswith(LASTING)
    ]
    return new_threads + new_files


@pytest.fixture(autouse=True)
def leaves_nothing_behind(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that leaves a thread, a file descriptor or a port behind."""
    if not Path("/proc/self/fd").is_dir():
        yield
        return
    threads, files = set(threading.enumerate()), open_files()
    yield
    deadline = time.monotonic() + GRACE_S
    while (left := left_behind(threads, files)) and time.monotonic() < deadline:
        gc.collect()
        time.sleep(0.02)
    if left:
        pytest.fail(f"{request.node.name} left behind: {'; '.join(left)}")


@pytest.fixture
def station(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """Runs the command line; returns its exit code, standard output and standard error."""

    def call(*arguments: object) -> tuple[int, str, str]:
        from station import cli

        before = signal.getsignal(signal.SIGTERM)
        monkeypatch.setattr(sys, "argv", ["station", *map(str, arguments)])
        try:
            with pytest.raises(SystemExit) as end:
                cli.main()
        finally:
            signal.signal(signal.SIGTERM, before)
        printed = capsys.readouterr()
        return int(end.value.code or 0), printed.out, printed.err

    return call
