"""Which camera a source gets, and that secrets are taken out of addresses."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.addresses import without_secrets
from drivers.camera import Camera, Controls
from drivers.camera_sources import is_stored, open_camera
from drivers.clock import MonotonicClock
from drivers.errors import CameraLost, NoCamera, SettingRefused
from drivers.live_camera import LiveCamera
from drivers.stored_camera import StoredCamera
from tests.drivers.ip_camera import HEAD, IpCamera, jpeg, part, sends
from tests.drivers.videos import SIZE, write_images, write_video


def opened(source: int | str, controls: Controls | None = None) -> Camera:
    return open_camera(source, size_px=None, fps=None, clock=MonotonicClock(), controls=controls)


def test_files_and_folders_are_stored_frames(tmp_path: Path) -> None:
    video = write_video(tmp_path / "v.avi")
    folder = write_images(tmp_path / "shots", ["1.png"])
    for path in (video, folder):
        assert is_stored(str(path))
        camera = opened(str(path))
        assert isinstance(camera, StoredCamera)
        camera.start()
        assert camera.size_px == SIZE
        camera.close()


@pytest.mark.parametrize("source", [97, "97", "/dev/video97"])
def test_indices_and_devices_are_webcams(source: int | str) -> None:
    camera = opened(source)
    assert isinstance(camera, LiveCamera) and not is_stored(source)
    with pytest.raises(NoCamera, match=r"/dev/video97"):
        camera.start()


def test_a_file_that_is_named_like_an_index_is_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_images(tmp_path / "7", ["1.png"])
    assert isinstance(opened("7"), StoredCamera)


def test_http_is_read_without_opencv() -> None:
    with IpCamera(sends(HEAD, part(jpeg(1)))) as server:
        camera = opened(server.address)
        camera.start()
        assert camera.settings["backend"] == "HTTP" and camera.size_px == SIZE
        camera.close()


def test_what_is_nothing_is_told_with_what_there_is() -> None:
    with pytest.raises(NoCamera, match=r"there is no no_such\.mp4; this machine has .*; give one of these, a video"):
        opened("no_such.mp4")


@pytest.mark.parametrize("source", ["http://camera/video", "rtsp://camera/video", "shots/"])
def test_only_cameras_of_this_machine_take_settings(source: str) -> None:
    with pytest.raises(SettingRefused, match=r"exposure_ms, gain: only a camera of this machine"):
        opened(source, Controls(exposure_ms=8, gain=1))


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("http://user:pass@host:81/a?b=c", "http://host:81/a?b=c"),
        ("rtsp://user:p@ss@host/a", "rtsp://host/a"),
        ("https://user@host", "https://host"),
        ('source = "http://u:p@h/x"  # at home@lab', 'source = "http://h/x"  # at home@lab'),
        ("http://h/x?channel=1&User=me&PWD=mine&token=z", "http://h/x?channel=1&User=...&PWD=...&token=..."),
        ("http://h/x?fps=30", "http://h/x?fps=30"),
        ("http://h/at@home?to=me@home", "http://h/at@home?to=me@home"),
    ],
)
def test_user_names_passwords_and_tokens_are_taken_out(text: str, seen: str) -> None:
    assert without_secrets(text) == seen


def test_other_addresses_go_through_opencv_with_our_own_time_limits(tmp_path: Path) -> None:
    """As a stand-in for rtsp://, which nothing here serves: the same back end, the same parameters."""
    path = write_video(tmp_path / "v.avi", frames=5)
    camera = opened(f"file://{path}")
    assert isinstance(camera, LiveCamera)
    camera.start()
    assert (camera.settings["backend"], camera.size_px) == ("FFMPEG", SIZE)
    levels: list[int] = []
    with pytest.raises(CameraLost, match=r"the stream ended"):
        while frame := camera.read(10**18):
            levels.append(round(frame.image.mean() / 10))
    assert levels == [0, 1, 2, 3, 4]
    camera.close()


def test_an_address_that_nobody_serves_is_no_camera_and_no_chatter(capfd: pytest.CaptureFixture[str]) -> None:
    camera = opened("rtsp://me:mine@127.0.0.1:9/video")
    with pytest.raises(NoCamera, match=r"camera 'rtsp://127.0.0.1:9/video' can't be opened"):
        camera.start()
    assert capfd.readouterr() == ("", "")
