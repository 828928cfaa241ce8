"""The viewer: opening it on a session, and pictures of it without a screen."""

from __future__ import annotations

import importlib.util
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from station.errors import InvalidFile, StationError
from station.recording import layout
from station.recording.blueprint import session_blueprint as session_blueprint
from station.recording.live import HOST, free_port
from station.session import FIT_FILE, FIT_FOLDER, RECORDING_FILE, recording_pieces

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

# What a slow machine without a graphics card needs to show a window, to load a session, to draw all of it, s.
START_S = 30.0
LOAD_S = 60.0
DRAW_S = 60.0
# Between two looks at the viewer, s: while it still loads, two pictures this far apart differ.
POLL_S = 0.7
CLOSE_S = 5.0


def session_files(session: Path) -> list[Path]:
    """The pieces of a session folder's recording, and its fit's where there is one; of an .rrd, itself.

    Raises:
        InvalidFile: there is no recording.
    """
    recording = session / RECORDING_FILE if session.is_dir() else session
    pieces = recording_pieces(session) if session.is_dir() else [session]
    if not any(piece.is_file() for piece in pieces):
        raise InvalidFile(f"{recording} is missing; a session folder has its recording there")
    fit = session / FIT_FOLDER / FIT_FILE
    return [path.resolve() for path in (*pieces, fit) if path.is_file()]


class Viewer:
    """A running viewer. It listens on 127.0.0.1 only, and sends no usage data.

    Args:
        arguments: files, or options of rerun's viewer.
        headless: draw without a window, for pictures.

    Raises:
        StationError: there is no screen, no graphics adapter, or the viewer doesn't start.
    """

    def __init__(self, arguments: Sequence[str], *, headless: bool = False) -> None:
        if not headless and sys.platform == "linux" and not any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY"))):
            raise StationError(
                "no screen to open the viewer on (DISPLAY isn't set)\n"
                "open it on a machine that has one; a capture is served for that with --headless"
            )
        self.port = free_port()
        self._home = tempfile.TemporaryDirectory(prefix="station-viewer-", ignore_cleanup_errors=True)
        self._output = Path(self._home.name) / "output.txt"
        options = ["--bind", HOST, "--port", str(self.port), *(["--headless"] if headless else [])]
        with self._output.open("wb") as output:
            self._process = subprocess.Popen(
                [*viewer_command(), *options, *arguments],
                env=viewer_environment(Path(self._home.name)),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C in the terminal is the station's, not the viewer's
            )
        self._await_start()

    @property
    def pid(self) -> int:
        """The viewer's process."""
        return self._process.pid

    def show(self, address: str) -> None:
        """Show what is served at an address, such as a live view.

        Raises:
            StationError: the viewer isn't there any more.
        """
        from rerun.experimental import ViewerClient

        try:
            ViewerClient.connect(f"rerun+http://{HOST}:{self.port}/proxy").open([address])
        except (ConnectionError, RuntimeError, TimeoutError) as error:
            raise StationError(self.ended() or str(error).splitlines()[0]) from error

    def leave(self) -> None:
        """Let the viewer run on, also after the end of this program."""
        self._process.returncode = self._process.poll() or 0  # nobody waits for it any more
        self._home.cleanup()

    def wait(self) -> None:
        """Return when the person has closed the viewer."""
        self._process.wait()
        self._home.cleanup()

    def close(self) -> None:
        """Close the viewer, if it is still there."""
        self._process.terminate()
        try:
            self._process.wait(CLOSE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self.wait()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def ended(self) -> str | None:
        """Why the viewer ended by itself; None while it runs."""
        try:
            self._process.wait(1.0)  # it may be about to end
        except subprocess.TimeoutExpired:
            return None
        return _reason(self._output.read_text(encoding="utf-8", errors="replace"))

    def _await_start(self) -> None:
        deadline = time.monotonic() + START_S
        while not _listens(self.port):
            if self._process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.05)
                continue
            reason = self.ended() or f"the viewer did not start within {START_S:g} s"
            self.close()
            raise StationError(reason)


def open_viewer(session: Path) -> Viewer:
    """Open the viewer on a session folder, with the fit beside it, or on an .rrd."""
    return Viewer([str(path) for path in session_files(session)])


def screenshot(session: Path, png: Path, t_s: float, *, size_px: tuple[int, int] = (1600, 1000)) -> list[str]:
    """Save a picture of the viewer on a session at `t_s`; returns what its views report as wrong.

    Needs a Vulkan adapter; a software one does (package mesa-vulkan-drivers).

    Raises:
        InvalidFile: there is no recording.
        StationError: there is no adapter, or the viewer doesn't finish.
    """
    files = [str(path) for path in session_files(session)]
    from rerun.experimental import ViewerClient

    with Viewer(["--window-size", "{}x{}".format(*size_px)], headless=True) as viewer:
        client = ViewerClient.connect(f"rerun+http://{HOST}:{viewer.port}/proxy")
        try:
            client.open(files)
            _await(lambda: _loaded(client), LOAD_S, "load the session")
            client.set_time(layout.ELAPSED, duration=t_s, play_state="paused")
            _save_when_still(client, png.resolve())
            state = client.get_state()
        except (ConnectionError, RuntimeError, TimeoutError) as error:
            reason = viewer.ended() or str(error).splitlines()[0]
            raise StationError(f"no picture of {session}: {reason}") from error
    return [f"{view.name}: {report.summary}" for view in state.views for report in view.reports]


def _loaded(client: ViewerClient) -> bool:
    state = client.get_state()
    return bool(state.recordings) and not state.loading


def _save_when_still(client: ViewerClient, png: Path) -> None:
    """Save the picture once it no longer changes: the viewer loads what it shows bit by bit."""
    before = b""

    def still() -> bool:
        nonlocal before
        client.save_screenshot(str(png))
        previous, before = before, png.read_bytes()
        return previous == before

    _await(still, DRAW_S, "draw the session")


def _await(done: Callable[[], bool], timeout_s: float, what: str) -> None:
    deadline = time.monotonic() + timeout_s
    while not done():
        if time.monotonic() > deadline:
            raise StationError(f"the viewer did not {what} within {timeout_s:g} s")
        time.sleep(POLL_S)


def viewer_command() -> list[str]:
    """The command of rerun's viewer itself rather than its Python launcher, so that stopping it stops the viewer."""
    spec = importlib.util.find_spec("rerun_cli")
    if spec is None or spec.origin is None:
        raise StationError("rerun's viewer is not installed; it comes with the package rerun-sdk")
    program = Path(spec.origin).with_name("rerun")
    return [str(program)] if program.is_file() else [sys.executable, "-m", "rerun_cli"]


def viewer_environment(home: Path) -> Mapping[str, str]:
    """The environment of a viewer that sends no usage data, whatever the person's own settings.

    rerun has no switch for that on its command line; it reads a file, which is made in the folder `home`.
    """
    settings = home / "rerun" / "analytics.json"
    settings.parent.mkdir(parents=True)
    content = {
        "analytics_enabled": False,
        "analytics_id": "off",
        "metadata": {},
        "config_file_path": str(settings),
        "data_dir_path": str(home / "rerun" / "analytics"),
    }
    settings.write_text(json.dumps(content), encoding="utf-8")
    return {**os.environ, "XDG_CONFIG_HOME": str(home), "XDG_DATA_HOME": str(home)}


def _reason(said: str) -> str:
    if "No graphics adapter" in said or "Failed to get render context" in said:
        return "the viewer finds no Vulkan adapter\na software one is in the package mesa-vulkan-drivers"
    lines = [line for line in said.splitlines() if line.strip()]
    return "\n".join(["the viewer ended", *(line[:200] for line in lines[-3:])])


def _listens(port: int) -> bool:
    try:
        socket.create_connection((HOST, port), timeout=1.0).close()
    except OSError:
        return False
    return True
