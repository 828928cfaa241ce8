"""Whether an exposure is locked is only told of cameras."""

from pathlib import Path

from drivers.exposure import read_exposure_lock


def test_what_is_no_camera_does_not_tell(tmp_path: Path):
    video = tmp_path / "video.avi"
    video.touch()
    assert read_exposure_lock(str(video)) is None
    assert read_exposure_lock("http://example.org/stream") is None
    assert read_exposure_lock("/dev/video77") is None
    assert read_exposure_lock(77) is None
