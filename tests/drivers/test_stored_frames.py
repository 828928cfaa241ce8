"""Stored frames: real video files and image folders, whole and damaged."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.errors import CameraError, DamagedFrames, NoCamera, NoFrames, WrongSize
from drivers.stored_frames import StoredFrame, decode_image, natural_order, open_stored_frames
from tests.drivers.videos import FRAMES, SIZE, flat, textured, write_images, write_video

# Grey levels. Lossy codecs at OpenCV's default quality keep a flat image within this.
LOSSY_GREY = 5
# s. Matroska's own resolution.
STAMP_S = 0.0006


def read_until_broken(path: Path) -> tuple[list[StoredFrame], CameraError]:
    frames: list[StoredFrame] = []
    with pytest.raises(CameraError) as error:
        frames.extend(iter_into(frames, path))
    return frames, error.value


def iter_into(frames: list[StoredFrame], path: Path) -> list[StoredFrame]:
    for frame in open_stored_frames(path):
        frames.append(frame)
    return []


@pytest.mark.parametrize(
    ("codec", "suffix", "grey"),
    [("MJPG", "avi", LOSSY_GREY), ("mp4v", "mp4", LOSSY_GREY), ("FFV1", "mkv", 0), ("FFV1", "avi", 0)],
)
def test_a_video_is_read_whole_with_its_own_stamps(tmp_path: Path, codec: str, suffix: str, grey: int) -> None:
    video = open_stored_frames(write_video(tmp_path / f"v.{suffix}", fps=30.0, codec=codec))
    assert (video.size_px, video.fps, video.count) == (SIZE, 30.0, FRAMES)
    for _ in range(2):  # each time from the start
        frames = list(video)
        assert [frame.index for frame in frames] == list(range(FRAMES))
        np.testing.assert_allclose([frame.t_s for frame in frames], np.arange(FRAMES) / 30, atol=STAMP_S)
        for k, frame in enumerate(frames):
            assert frame.image.dtype == np.uint8
            np.testing.assert_allclose(frame.image.astype(int), flat(k).astype(int), atol=grey)


def test_a_reader_that_leaves_early_leaves_nothing_open(tmp_path: Path) -> None:
    for frame in open_stored_frames(write_video(tmp_path / "v.avi")):
        if frame.index == 3:
            break


def test_a_lossless_video_is_given_bit_by_bit(tmp_path: Path) -> None:
    path = write_video(tmp_path / "v.mkv", codec="FFV1", picture=textured)
    for frame in open_stored_frames(path):
        np.testing.assert_array_equal(frame.image, textured(frame.index))


def test_a_bare_stream_has_no_stamps_but_those_one_gives_it(tmp_path: Path) -> None:
    path = tmp_path / "bare.mjpeg"
    path.write_bytes(b"".join(cv2.imencode(".jpg", flat(k))[1].tobytes() for k in range(5)))
    unknown, known = open_stored_frames(path), open_stored_frames(path, fps=10.0)
    assert (unknown.fps, unknown.count) == (None, None)
    assert [frame.t_s for frame in unknown] == [None] * 5
    assert [frame.t_s for frame in known] == [0.0, 0.1, 0.2, 0.3, 0.4]


@pytest.mark.parametrize("part", [0.4, 0.9])
@pytest.mark.parametrize(("codec", "suffix"), [("MJPG", "avi"), ("FFV1", "mkv"), ("mp4v", "mkv")])
def test_a_video_cut_short_gives_its_frames_then_says_so(
    tmp_path: Path, codec: str, suffix: str, part: float, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write_video(tmp_path / f"v.{suffix}", codec=codec, picture=textured)
    data = path.read_bytes()
    path.write_bytes(data[: round(part * len(data))])
    frames, error = read_until_broken(path)
    assert isinstance(error, DamagedFrames) and error.frames == len(frames)
    assert FRAMES * part - 5 <= len(frames) < FRAMES
    assert f"{len(frames)} frames could be read" in str(error) and f"it has {FRAMES}" in str(error)
    assert [frame.index for frame in frames] == list(range(len(frames)))
    assert capfd.readouterr() == ("", "")


def test_a_video_that_turns_to_noise_gives_its_frames_then_says_so(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write_video(tmp_path / "v.avi", codec="FFV1", picture=textured)
    data = path.read_bytes()
    half = len(data) // 2
    path.write_bytes(data[:half] + np.random.default_rng(0).bytes(len(data) - half))
    frames, error = read_until_broken(path)
    assert isinstance(error, DamagedFrames) and error.frames == len(frames) > 5
    np.testing.assert_array_equal(frames[4].image, textured(4))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["no_such.mp4", "no_such_folder/"])
def test_what_is_missing_is_no_camera(tmp_path: Path, name: str) -> None:
    with pytest.raises(NoCamera, match=r"there is no .*no_such"):
        open_stored_frames(tmp_path / name)


@pytest.mark.parametrize(
    ("data", "says"),
    [(b"", "is an empty file"), (b"no video\n" * 100, "no video that OpenCV reads"), (bytes(5000), "no video that")],
)
def test_a_file_without_frames_says_which_and_no_chatter(
    tmp_path: Path, data: bytes, says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "v.mp4"
    path.write_bytes(data)
    with pytest.raises(NoFrames, match=rf"v\.mp4 .*{says}"):
        open_stored_frames(path)
    assert capfd.readouterr() == ("", "")


def test_a_video_whose_index_was_never_written_has_no_frames(tmp_path: Path) -> None:
    path = write_video(tmp_path / "v.mp4", codec="mp4v", picture=textured)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])  # an mp4 has its index at the end
    with pytest.raises(NoFrames, match="damaged or not wholly written"):
        open_stored_frames(path)


def test_images_come_in_the_order_a_person_would_count(tmp_path: Path) -> None:
    names = ["shot1.png", "shot2.png", "Shot10.PNG", "shot11.jpg", "shot100.png"]
    folder = write_images(tmp_path / "shots", names)
    (folder / "notes.txt").write_text("no image")
    (folder / ".hidden.png").write_text("no image")
    frames = open_stored_frames(folder)
    assert (frames.count, frames.fps, frames.size_px) == (5, None, SIZE)
    assert [(frame.index, frame.t_s, round(frame.image.mean() / 10)) for frame in frames] == [
        (k, None, k) for k in range(5)
    ]
    assert [frame.t_s for frame in open_stored_frames(folder, fps=4.0)] == [0, 0.25, 0.5, 0.75, 1.0]


def test_natural_order_compares_numbers_and_letters() -> None:
    names = ["2", "10", "a1b2", "a1b10", "A2", "b"]
    assert sorted(reversed(names), key=natural_order) == names


def test_one_image_is_a_folder_of_one(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "shots", ["a.png"])
    assert [frame.index for frame in open_stored_frames(folder / "a.png")] == [0]


def test_a_folder_without_images_has_no_frames(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no image")
    with pytest.raises(NoFrames, match=r"no images in it; want files that end in \.png"):
        open_stored_frames(tmp_path)


def test_an_image_of_another_size_is_named(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "shots", ["1.png", "2.png", "3.png"])
    cv2.imwrite(str(folder / "2.png"), flat(0, (32, 24)))
    frames, error = read_until_broken(folder)
    assert [frame.index for frame in frames] == [0]
    assert isinstance(error, WrongSize)
    assert "2.png: frame 1 has 32x24 px; the first has 64x48" in str(error)


@pytest.mark.parametrize("data", [b"", b"\x89PNG no image"])
def test_a_damaged_image_is_named_and_what_was_before_it_is_kept(tmp_path: Path, data: bytes) -> None:
    folder = write_images(tmp_path / "shots", ["1.png", "2.png", "3.png"])
    (folder / "3.png").write_bytes(data)
    frames, error = read_until_broken(folder)
    assert len(frames) == 2
    assert isinstance(error, DamagedFrames) and error.frames == 2
    assert "3.png is no image that OpenCV reads; 2 of 3 were read before it" in str(error)


def test_a_picture_that_says_turn_me_is_left_as_the_sensor_took_it(tmp_path: Path) -> None:
    jpeg = cv2.imencode(".jpg", flat(3))[1].tobytes()
    # Exif 2.3, 4.6.2: one entry, Orientation (0x0112) = 6, a quarter turn.
    tiff = b"MM\x00*\x00\x00\x00\x08\x00\x01\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06\x00\x00\x00\x00\x00\x00"
    exif = b"Exif\x00\x00" + tiff
    turned = jpeg[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + jpeg[2:]
    (tmp_path / "turned.jpg").write_bytes(turned)
    assert cv2.imread(str(tmp_path / "turned.jpg")).shape == (64, 48, 3)  # OpenCV on its own turns it
    assert open_stored_frames(tmp_path).size_px == SIZE


def decoded(data: bytes) -> np.ndarray | None:
    return decode_image(np.frombuffer(data, dtype=np.uint8))


def test_a_picture_that_is_not_whole_is_none() -> None:
    whole = cv2.imencode(".jpg", flat(3))[1].tobytes()
    image = decoded(whole + b"\0\0\r\n")  # as some cameras fill up
    assert image is not None
    np.testing.assert_allclose(image, 30, atol=LOSSY_GREY)
    rich = cv2.imencode(".jpg", textured(0, (640, 480)))[1].tobytes()
    for data in (whole, rich):
        for end in np.linspace(0, len(data) - 1, 50).astype(int):
            assert decoded(data[:end]) is None
