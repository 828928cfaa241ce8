"""The viewer's layout is kept in the recording, and the viewer shows a session whole, on this machine only."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from station.errors import InvalidFile, StationError
from station.logs import JointLog
from station.recording import Recording, RecordingWriter, append_detected
from station.view import (
    Viewer,
    open_viewer,
    screenshot,
    session_blueprint,
    session_files,
    viewer_command,
    viewer_environment,
)
from tests.made_sessions import JOINTS, START_NS, describe, log_frame, make_frames, make_session


def fitted_session(folder: Path, count: int = 8) -> Path:
    """A session with the layout in it, and states as a fit writes them beside it."""
    with RecordingWriter(folder, describe(), start_ns=START_NS, blueprint=session_blueprint(JOINTS)) as writer:
        for frame in make_frames(count):
            log_frame(writer, frame)
        writer.close("complete")
    t_s = Recording.load(folder).observations.t_s
    append_detected(folder, JointLog(t_s, JOINTS, np.outer(t_s, (1, 2, 3)), ("rad", "rad", "m")))
    return folder


def test_the_layout_is_kept_in_the_recording(tmp_path: Path) -> None:
    folder = fitted_session(tmp_path / "s")
    assert len(RrdReader(folder / "recording.rrd").blueprints()) == 1
    assert Recording.load(folder).frames == 8


@pytest.mark.parametrize("joints", [(), ("lid",), JOINTS])
def test_there_is_a_layout_for_any_joints(tmp_path: Path, joints: tuple[str, ...]) -> None:
    session_blueprint(joints).save("station", tmp_path / "layout.rbl")
    assert (tmp_path / "layout.rbl").stat().st_size > 0


def test_a_session_is_shown_with_its_fit(tmp_path: Path) -> None:
    folder = make_session(tmp_path / "s", make_frames(1))
    assert session_files(folder) == [folder / "recording.rrd"]
    (folder / "fit").mkdir()
    (folder / "fit" / "fit.rrd").write_bytes(b"")
    assert session_files(folder) == [folder / "recording.rrd", folder / "fit" / "fit.rrd"]
    assert session_files(folder / "recording.rrd") == [folder / "recording.rrd"]
    with pytest.raises(InvalidFile, match=r"recording\.rrd is missing"):
        session_files(tmp_path)


def test_without_a_screen_there_is_a_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_session(tmp_path / "s", make_frames(1))
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(StationError, match="no screen"):
        open_viewer(folder)


def test_the_viewer_sends_no_usage_data(tmp_path: Path) -> None:
    command = [*viewer_command(), "analytics", "config"]
    said = subprocess.run(command, env=viewer_environment(tmp_path), capture_output=True, check=True, timeout=30)
    assert json.loads(said.stdout)["analytics_enabled"] is False


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], Path]:
    """What the views report as wrong, and the picture; skips where the viewer can't draw, which it learns only then."""
    folder = tmp_path_factory.mktemp("viewer")
    png = folder / "picture.png"
    try:
        return screenshot(fitted_session(folder / "s"), png, 0.2, size_px=(1200, 800)), png
    except StationError as error:
        if "Vulkan" in str(error):
            pytest.skip(str(error).splitlines()[0])
        raise


@pytest.mark.vulkan
def test_a_picture_shows_all_views_without_an_error(picture: tuple[list[str], Path]) -> None:
    reports, png = picture
    assert reports == []
    image = cv2.imread(str(png))
    assert image is not None
    assert image.shape == (800, 1200, 3)
    # Quarters: space, image, joints, log; an empty view is one grey level but for its title.
    for quarter in (image[40:400, :600], image[40:400, 600:], image[440:760, :600], image[440:760, 800:]):
        assert quarter.std() > 3.0


@pytest.mark.vulkan
@pytest.mark.usefixtures("picture")
def test_the_viewer_listens_on_this_machine_only() -> None:
    with Viewer([], headless=True) as viewer:
        rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        inodes = {link.readlink().name for link in Path(f"/proc/{viewer.pid}/fd").iterdir() if link.is_symlink()}
        own = {row[1] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in inodes}
    assert own == {f"0100007F:{viewer.port:04X}"}
