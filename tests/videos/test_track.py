"""Tracking a video on the command line: the session that comes of it, the tree in it, and what is said of bad input."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from station.commands.fitting import load_session
from station.errors import InvalidFile
from station.formats.camera import format_camera
from station.formats.camera_files import format_camera_opencv, format_camera_ros
from station.formats.exporters import EXPORTERS, WHAT
from station.formats.markers import format_markers
from station.kinematics import se3
from station.perception.markers import Marker, MarkerTable
from station.recording import Recording
from station.rig import load_rig
from station.session import read_status
from tests.videos.made_videos import (
    CAMERA,
    DRAWER_AXIS,
    FPS,
    HINGE_M,
    SIZE_M,
    Scene,
    cabinet,
    images,
    lamp,
    moving_plate,
    swing,
    tilt,
    times_s,
    write_camera,
    write_markers,
    write_video,
)

FRAMES = 90
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with cabinet.avi, camera.toml, markers.toml."""
    folder = tmp_path_factory.mktemp("cabinet")
    write_video(folder / "cabinet.avi", images(cabinet(), FRAMES, exposure_s=0.008, instants=3))
    write_camera(folder)
    write_markers(folder, cabinet().table)
    return folder


@pytest.fixture
def track(station: Run, filmed: Path, tmp_path: Path) -> Run:
    """Runs `station track` on the cabinet into tmp_path/s; keyword arguments replace video, camera and markers."""

    def run(*options: object, video: object = None, camera: object = None, markers: object = None):
        given = (video or filmed / "cabinet.avi", camera or filmed / "camera.toml", markers or filmed / "markers.toml")
        return station(
            "track", given[0], "--camera", given[1], "--markers", given[2], "--out", tmp_path / "s", *options
        )

    return run


def is_one_clear_error(err: str) -> bool:
    return err.startswith("error: ") and len(err.splitlines()) <= 5 and "Traceback" not in err


def joints_of(folder: Path) -> dict[str, dict]:
    tree = json.loads((folder / "fit" / "kinematics.json").read_text("utf-8"))
    return {f"{joint['parent']}__{joint['child']}": joint for joint in tree["joints"]}


# The stated deviation is of what differs from frame to frame. What all frames share, such as how a still marker's edges
# fall on the pixels, comes on top: 0.15 deg and 0.3 mm.
SHARED_DEG, SHARED_MM = 0.15, 0.3


def assert_axis(joint: dict, axis: np.ndarray, point_m: np.ndarray | None) -> None:
    """The axis and its point are the true ones, within four stated standard deviations and what frames share."""
    found = np.array(joint["axis_parent"])
    off_deg = np.degrees(np.arccos(min(abs(float(found @ axis)), 1.0)))
    assert off_deg < 4 * joint["std"]["axis_deg"] + SHARED_DEG
    if point_m is not None:
        across = np.eye(3) - np.outer(axis, axis)
        off_mm = 1e3 * np.linalg.norm(across @ (np.array(joint["point_parent_m"]) - point_m))
        assert off_mm < 4 * joint["std"]["point_mm"] + SHARED_MM


def test_a_cabinet_moved_by_hand_is_a_hinge_and_a_slide(track: Run, station: Run, tmp_path: Path) -> None:
    code, out, err = track()
    assert code == 0, err
    for part in ("cabinet", "door", "drawer"):
        assert part in out
    assert "90 of 90" in out and "none" in out and "warning" not in err and "station fit" in err
    code, out, err = station("fit", tmp_path / "s")
    assert code == 0, err
    joints = joints_of(tmp_path / "s")
    assert {name: joint["type"] for name, joint in joints.items()} == {
        "cabinet__door": "revolute",
        "cabinet__drawer": "prismatic",
    }
    assert_axis(joints["cabinet__door"], np.array([0.0, 1.0, 0.0]), HINGE_M)
    assert_axis(joints["cabinet__drawer"], DRAWER_AXIS, None)
    assert joints["cabinet__door"]["state"]["max"] == pytest.approx(np.radians(60), abs=np.radians(1))
    assert joints["cabinet__drawer"]["state"]["max"] == pytest.approx(0.12, abs=0.002)


def test_a_lamp_moved_by_hand_is_two_hinges(station: Run, tmp_path: Path) -> None:
    scene = lamp()
    video = write_video(tmp_path / "lamp.mp4", images(scene, FRAMES))
    camera, markers = write_camera(tmp_path), write_markers(tmp_path, scene.table)
    code, _, err = station("track", video, "--camera", camera, "--markers", markers, "--out", tmp_path / "s")
    assert code == 0, err
    assert station("fit", tmp_path / "s")[0] == 0
    joints = joints_of(tmp_path / "s")
    assert {name: joint["type"] for name, joint in joints.items()} == {
        "foot__arm": "revolute",
        "arm__shade": "revolute",
    }
    assert_axis(joints["foot__arm"], np.array([0, 0, 1.0]), np.array([0.06, 0.02, 0.01]))
    assert_axis(joints["arm__shade"], np.array([0, 0, 1.0]), np.array([0.05, 0.0, 0.01]))


def test_a_door_alone_is_a_hinge_on_the_camera(station: Run, tmp_path: Path) -> None:
    whole = cabinet()
    scene = Scene(MarkerTable(whole.table.dictionary, whole.table.markers[1:2]), (1,), whole.T_cam_body)
    video = write_video(tmp_path / "door.avi", images(scene, 60))
    camera, markers = write_camera(tmp_path), write_markers(tmp_path, scene.table)
    assert station("track", video, "--camera", camera, "--markers", markers, "--out", tmp_path / "s")[0] == 0
    assert station("fit", tmp_path / "s")[0] == 0
    assert {name: joint["type"] for name, joint in joints_of(tmp_path / "s").items()} == {"camera__door": "revolute"}


def test_the_session_is_whole_and_what_follows_takes_it(track: Run, station: Run, tmp_path: Path) -> None:
    folder = tmp_path / "s"
    code, out, _ = track("--json")
    result = json.loads(out)
    assert code == 0 and (result["frames"], result["dropped_frames"], result["warnings"]) == (FRAMES, 0, [])
    assert [row["seen"] for row in result["markers"]] == [FRAMES] * 3
    assert all(0 < row["tilt_deg"] < 60 and row["rms_px"] < 0.1 for row in result["markers"])
    status, recording = read_status(folder), Recording.load(folder)
    assert (status.state, status.counts["frames"]) == ("complete", FRAMES)
    assert recording.notices == () and recording.description.joints == ()
    np.testing.assert_allclose(recording.observations.t_s, times_s(FRAMES), atol=1e-3 / FPS)
    assert recording.frame_image(44).shape == (480, 640, 3)
    code, _, err = station("report", folder)
    assert code == 1 and is_one_clear_error(err) and "nothing was fitted there yet" in err
    assert station("fit", folder)[0] == 0
    code, out, err = station("report", folder)
    assert code == 0 and "revolute" in out and [path.name for path in (folder / "report").iterdir()] == ["report.html"]
    page = (folder / "report" / "report.html").read_text("utf-8")
    assert "When the parts were seen" in page and page.count("<svg") == 5
    code, _, err = station("compare", folder)
    assert code == 1 and "neither commands nor read-back" in err and "--commands FILE" in err
    rows = [f"{t + 5:.6f},{-np.radians(60) * swing(np.array(t), 3.0):.9f}" for t in times_s(FRAMES)]
    (tmp_path / "commands.csv").write_text("\n".join(["t_s,door", *rows]), "utf-8")
    code, out, err = station("compare", folder, "--commands", tmp_path / "commands.csv", "--json")
    assert code == 0, err
    (joint,) = json.loads(out)["joints"]
    assert (joint["joint"], joint["fitted_joint"]) == ("door", "cabinet__door")
    assert joint["commanded"]["lag_s"] == pytest.approx(-5, abs=0.05) and joint["commanded"]["rmse_deg"] < 1.0


def test_an_occupied_folder_is_kept_unless_forced(track: Run, tmp_path: Path) -> None:
    assert track("--no-frames")[0] == 0
    code, _, err = track()
    assert code == 1 and is_one_clear_error(err) and "isn't empty" in err
    assert track("--force", "--no-frames")[0] == 0


def test_images_can_be_left_out(track: Run, tmp_path: Path) -> None:
    assert track("--no-frames")[0] == 0
    recording = Recording.load(tmp_path / "s")
    assert recording.frames == FRAMES and list(recording.frame_jpegs()) == []
    with pytest.raises(InvalidFile, match="has no image of frame 3; its markers are there"):
        recording.frame_jpeg(3)


def test_images_are_kept_in_order(track: Run, tmp_path: Path) -> None:
    assert track()[0] == 0
    recording = Recording.load(tmp_path / "s")
    jpegs = list(recording.frame_jpegs())
    assert [t_ns for t_ns, _ in jpegs] == recording.frame_ns.tolist()
    assert jpegs[7][1] == recording.frame_jpeg(7)


def test_calibrations_of_opencv_ros_and_a_rig_serve(track: Run, tmp_path: Path) -> None:
    (tmp_path / "opencv.yaml").write_text(format_camera_opencv(CAMERA), "utf-8")
    (tmp_path / "ros.yml").write_text(format_camera_ros(CAMERA), "utf-8")
    for name in ("opencv.yaml", "ros.yml"):
        code, _, err = track("--force", "--no-frames", camera=tmp_path / name)
        assert code == 0, err
    calibration = load_rig("demo").camera_model
    code, _, err = track("--force", "--no-frames", camera="demo", markers="demo")
    assert code == 0 and calibration.size_px == CAMERA.size_px
    description = Recording.load(tmp_path / "s").description
    assert description.camera == format_camera(calibration) and description.rig is None
    assert description.markers == format_markers(load_rig("demo").table.marker_table())


# --- Stamps ----------------------------------------------------------------------------------------------------------


def write_stamps(folder: Path, stamps: dict[int, str]) -> Path:
    path = folder / "stamps.csv"
    path.write_text("frame,t_s\n" + "".join(f"{frame},{t}\n" for frame, t in stamps.items()), "utf-8")
    return path


def test_given_stamps_are_kept_to_the_last_digit(track: Run, station: Run, tmp_path: Path) -> None:
    stamps = {k: f"{1_700_000_000 + k / 29.97 + 0.001 * (k % 3):.6f}" for k in range(FRAMES)}
    code, _, err = track("--timestamps", write_stamps(tmp_path, stamps), "--no-frames")
    assert code == 0 and "warning" not in err
    assert station("fit", tmp_path / "s")[0] == 0
    rows = (tmp_path / "s" / "fit" / "joint_states.csv").read_text("utf-8").splitlines()[1:]
    assert [float(row.split(",")[0]) for row in rows] == [float(t) for t in stamps.values()]


def test_frames_without_a_stamp_are_left_out_and_counted(track: Run, tmp_path: Path) -> None:
    stamps = write_stamps(tmp_path, {k: f"{k / 10}" for k in range(10, 95, 2)})
    code, out, err = track("--timestamps", stamps, "--no-frames", "--json")
    result = json.loads(out)
    assert code == 0 and (result["frames"], result["dropped_frames"]) == (40, 50)
    assert "warning: 50 of 90 frames have no time stamp and were left out" in err
    assert "warning: 3 time stamps are of frames that the video doesn't have" in err
    recording = Recording.load(tmp_path / "s")
    np.testing.assert_array_equal(recording.frame_index, np.arange(10, 90, 2))
    np.testing.assert_array_equal(recording.observations.t_s, np.arange(10, 90, 2) / 10)


def test_stamps_of_no_frame_are_refused(track: Run, tmp_path: Path) -> None:
    code, _, err = track("--timestamps", write_stamps(tmp_path, {500: "1.0"}))
    assert code == 1 and is_one_clear_error(err) and "none of its 90 frames has a time stamp" in err
    assert not (tmp_path / "s").exists()


def test_images_need_a_rate_or_stamps(track: Run, tmp_path: Path) -> None:
    folder = write_video(tmp_path / "images", images(cabinet(), 12))
    code, _, err = track(video=folder)
    assert code == 1 and is_one_clear_error(err) and "--fps" in err and "--timestamps" in err
    assert track("--fps", 25, video=folder)[0] == 0
    np.testing.assert_allclose(Recording.load(tmp_path / "s").observations.t_s, np.arange(12) / 25, atol=1e-9)
    stamps = write_stamps(tmp_path, {k: str(k * k) for k in range(12)})
    assert track("--timestamps", stamps, "--force", video=folder)[0] == 0
    np.testing.assert_array_equal(Recording.load(tmp_path / "s").observations.t_s, np.arange(12.0) ** 2)


# --- What can't be right ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is an empty file; want a video"),
        (bytes(range(256)) * 400, "is no video that OpenCV reads"),
        (b"frame,t_s\n0,0\n" * 1000, "is no video that OpenCV reads"),
        (None, "there is no"),
    ],
    ids=["empty", "garbage", "text", "missing"],
)
def test_what_is_no_video_is_refused_and_makes_no_session(
    track: Run, tmp_path: Path, content: bytes | None, message: str
) -> None:
    if content is not None:
        (tmp_path / "v.mp4").write_bytes(content)
    code, _, err = track(video=tmp_path / "v.mp4")
    assert code == 1 and is_one_clear_error(err) and message in err and "v.mp4" in err
    assert not (tmp_path / "s").exists()


def test_a_folder_without_images_and_a_live_camera_are_refused(track: Run, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    code, _, err = track(video=tmp_path / "folder")
    assert code == 1 and is_one_clear_error(err) and "has no images in it" in err
    for live in ("http://10.0.0.7/video", "/dev/video0", "0"):
        code, _, err = track(video=live)
        assert code == 1 and is_one_clear_error(err) and "is a live camera" in err and "capture --hand" in err


def test_a_video_cut_short_is_an_error_that_keeps_the_frames_before(
    track: Run, station: Run, filmed: Path, tmp_path: Path
) -> None:
    whole = (filmed / "cabinet.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(whole[: len(whole) // 2])
    code, _, err = track(video=tmp_path / "cut.avi")
    assert code == 1 and is_one_clear_error(err) and "is damaged or cut short" in err and "station fit" in err
    assert read_status(tmp_path / "s").state == "interrupted"
    recording = Recording.load(tmp_path / "s")
    assert 35 <= recording.frames <= 50 and f"{recording.frames} frames could be read" in err
    assert len(list(recording.frame_jpegs())) == recording.frames
    assert station("fit", tmp_path / "s")[0] == 0
    assert joints_of(tmp_path / "s").keys() == {"cabinet__door", "cabinet__drawer"}


def test_an_mp4_that_was_not_finished_is_refused(track: Run, filmed: Path, tmp_path: Path) -> None:
    write_video(tmp_path / "v.mp4", images(cabinet(), 20))
    whole = (tmp_path / "v.mp4").read_bytes()
    (tmp_path / "v.mp4").write_bytes(whole[: len(whole) - 2000])  # its index is at its end
    code, _, err = track(video=tmp_path / "v.mp4")
    assert code == 1 and is_one_clear_error(err) and "not wholly written" in err
    assert not (tmp_path / "s").exists()


def test_an_image_of_another_size_ends_the_session_with_an_error(track: Run, tmp_path: Path) -> None:
    folder = write_video(tmp_path / "images", images(cabinet(), 12))
    cv2.imwrite(str(folder / "7.png"), np.zeros((100, 100, 3), np.uint8))
    code, _, err = track("--fps", 30, video=folder)
    assert code == 1 and is_one_clear_error(err) and "7.png: frame 7 has 100x100 px; the first has 640x480" in err
    assert Recording.load(tmp_path / "s").frames == 7


def test_another_size_than_the_calibrations_is_refused_and_may_be_scaled(
    track: Run, station: Run, tmp_path: Path
) -> None:
    half = [cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA) for image in images(cabinet(), 30, blur_px=0.3)]
    video = write_video(tmp_path / "half.avi", half)
    code, _, err = track(video=video)
    assert code == 1 and is_one_clear_error(err)
    assert "frames of 320 x 240 px, the calibration is for 640 x 480 px" in err and "--scale-camera" in err
    assert not (tmp_path / "s").exists()
    assert track("--scale-camera", video=video)[0] == 0
    found = load_session(tmp_path / "s").poses.T_ref_part
    off_m = np.abs(found - cabinet().truth(times_s(30)))[..., :3, 3]
    # Of 0.8 m, seen with markers of 19 px; the middle of the image instead of its scaled place would be 0.7 mm off.
    assert np.nanmedian(off_m[..., :2]) < 0.0015 and np.nanmedian(off_m[..., 2]) < 0.015
    square = write_video(tmp_path / "square.avi", [image[:, :240] for image in half])
    code, _, err = track("--scale-camera", "--force", video=square)
    assert code == 1 and "frames of 240 x 240 px" in err and "--scale-camera" not in err
    turned = write_video(tmp_path / "turned.avi", [np.ascontiguousarray(np.rot90(image)) for image in half])
    camera = write_camera(tmp_path, CAMERA.scaled_to((320, 240)))
    code, _, err = track("--force", video=turned, camera=camera)
    assert code == 1 and "turned by a quarter" in err


def test_a_wrong_dictionary_is_named(track: Run, filmed: Path, tmp_path: Path) -> None:
    table = MarkerTable("DICT_5X5_100", cabinet().table.markers)
    code, _, err = track(markers=write_markers(tmp_path, table))
    assert code == 1 and is_one_clear_error(err)
    assert "no markers of DICT_5X5_100, but markers 0, 1, 2 of DICT_4X4_50" in err
    assert 'dictionary = "DICT_4X4_50"' in err
    assert not (tmp_path / "s").exists()


def test_a_mirrored_video_is_said_to_be(track: Run, tmp_path: Path) -> None:
    mirrored = [np.ascontiguousarray(image[:, ::-1]) for image in images(cabinet(), 10)]
    code, _, err = track(video=write_video(tmp_path / "v.avi", mirrored))
    assert code == 1 and is_one_clear_error(err) and "the mirrored picture shows markers 0, 1, 2" in err


def test_a_video_without_markers_is_refused(track: Run, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (4, 480, 640, 3), dtype=np.uint8)
    code, _, err = track(video=write_video(tmp_path / "v.avi", list(noise)))
    assert code == 1 and is_one_clear_error(err) and "no markers in 4 frames" in err
    assert not (tmp_path / "s").exists()


def test_markers_of_another_table_are_listed(track: Run, tmp_path: Path) -> None:
    table = MarkerTable(cabinet().table.dictionary, (Marker(30, "shelf", SIZE_M),))
    code, _, err = track(markers=write_markers(tmp_path, table))
    assert code == 1 and is_one_clear_error(err) and "the video shows markers 0, 1, 2 of it" in err


def test_a_marker_never_seen_and_those_not_in_the_table_are_warned_of(track: Run, tmp_path: Path) -> None:
    table = MarkerTable(cabinet().table.dictionary, (*cabinet().table.markers[:2], Marker(30, "shelf", SIZE_M)))
    code, out, err = track(markers=write_markers(tmp_path, table))
    assert code == 0 and "0 of 90" in out
    assert "warning: marker 30 (shelf) was never seen" in err
    assert "warning: markers were seen that are not in the table: 2 (90 frames)" in err
    texts = [event.text for event in Recording.load(tmp_path / "s").events if event.level == "WARN"]
    assert any("marker 30" in text for text in texts)


# --- Sizes -----------------------------------------------------------------------------------------------------------

MOUNTS = (
    se3.translation([-0.06, 0.0, 0.0]),
    se3.pose(se3.exp_so3(np.array([0.0, 0.5, 0.0])), np.array([0.06, 0.02, 0])),
)


def bracket(sizes_m: tuple[float, float] = (SIZE_M, SIZE_M), *, known: bool = True) -> Scene:
    """A part with two markers whose mounts are known, or two parts."""

    def path(t_s: np.ndarray) -> np.ndarray:
        turn = np.radians(20 + 20 * np.sin(2 * t_s))[:, None] * np.array([0.6, 0.8, 0.0])
        return se3.pose(se3.exp_so3(turn) @ tilt(0, 0), np.array([0.0, 0.0, 0.6]))

    markers = tuple(
        Marker(k, "bracket" if known else f"bracket_{k}", size_m, mount if known else None)
        for k, (size_m, mount) in enumerate(zip(sizes_m, MOUNTS, strict=True))
    )
    return Scene(MarkerTable("DICT_4X4_50", markers), (0, 0), moving_plate(path).T_cam_body)


@pytest.mark.parametrize(
    ("said_m", "doubted"), [((SIZE_M, SIZE_M), []), ((SIZE_M, 0.04), [1]), ((0.04, 0.04), [0, 1]), ((0.051, 0.05), [])]
)
def test_a_wrong_size_shows_where_a_part_has_two_markers(
    track: Run, tmp_path: Path, said_m: tuple[float, float], doubted: list[int]
) -> None:
    video = write_video(tmp_path / "v.avi", images(bracket(), 45))
    code, _, err = track(video=video, markers=write_markers(tmp_path, bracket(said_m).table))
    assert code == 0
    said = [line for line in err.splitlines() if "wide" in line]
    assert [int(line.split("marker ")[1].split()[0]) for line in said] == doubted
    for line in said:
        looks_mm = float(line.split("looks ")[1].split()[0])
        assert looks_mm == pytest.approx(50, abs=1.0) and "the table says 40.0 mm" in line


def test_of_a_size_that_nothing_contradicts_nothing_is_said(track: Run, tmp_path: Path) -> None:
    scene = bracket((0.04, 0.04), known=False)
    plates = replace(scene, table=bracket((SIZE_M, SIZE_M)).table)
    video = write_video(tmp_path / "v.avi", images(plates, 30))
    code, _, err = track(video=video, markers=write_markers(tmp_path, scene.table))
    assert code == 0 and "warning" not in err


# --- The page about it ---


def test_the_commands_of_the_videos_page_work(
    station: Run, filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[2] / "docs" / "videos.md").read_text("utf-8")
    (markers,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "markers.toml").write_text(markers, "utf-8")
    (tmp_path / "phone.yaml").write_text(format_camera_opencv(CAMERA), "utf-8")
    shutil.copy(filmed / "camera.toml", tmp_path)
    shutil.copy(filmed / "cabinet.avi", tmp_path / "cupboard.mp4")  # what is in a file is told by its content
    monkeypatch.chdir(tmp_path)
    lines = [line for block in re.findall(r"```sh\n(.*?)```", page, re.DOTALL) for line in block.splitlines()]
    assert len(lines) == 10
    for line in lines:
        name, *arguments = shlex.split(line, comments=True)
        assert name == "station"
        if arguments[0] == "view":  # needs a screen
            continue
        code, out, err = station(*arguments)
        assert code == 0, err
        if arguments[0] == "track":
            (shown,) = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
            words = [[word for word in row.split() if not word[0].isdecimal()] for row in shown.splitlines()]
            assert words == [[word for word in row.split() if not word[0].isdecimal()] for row in out.splitlines()]


def test_the_formats_of_the_videos_page_are_those_there_are() -> None:
    page = (Path(__file__).parents[2] / "docs" / "videos.md").read_text("utf-8")
    table = page[page.index("| `--format` |") :].split("\n\n")[0]
    rows = [line.split("|") for line in table.splitlines()[2:]]
    shown = {
        name: set(re.findall(r"`(\w+)`", row[3])) & set(WHAT) for row in rows for name in re.findall(r"\w+", row[1])
    }
    assert shown.pop("parquet") == set()  # "as CSV"
    assert shown == {e.format: set(e.what) for e in EXPORTERS if e.format != "parquet"}
    assert {e.format: e.what for e in EXPORTERS}["parquet"] == {e.format: e.what for e in EXPORTERS}["csv"]


# --- Signals ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_leaves_an_interrupted_session_that_opens(
    station: Run, filmed: Path, tmp_path: Path, number: signal.Signals, code: int
) -> None:
    long = write_video(tmp_path / "long.avi", 40 * images(cabinet(), 15))
    camera, markers = filmed / "camera.toml", filmed / "markers.toml"
    arguments = ["track", long, "--camera", camera, "--markers", markers, "--out", tmp_path / "s"]
    program = [sys.executable, "-c", "from station.cli import main; main()", *map(str, arguments)]
    with subprocess.Popen(program, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as running:
        recording = tmp_path / "s" / "recording.rrd"
        deadline = time.monotonic() + 60
        while (not recording.exists() or recording.stat().st_size < 300_000) and time.monotonic() < deadline:
            time.sleep(0.02)
        running.send_signal(number)
        _, err = running.communicate(timeout=60)
    assert running.returncode == code and "Traceback" not in err and "station fit" in err
    assert read_status(tmp_path / "s").state == "interrupted"
    found = Recording.load(tmp_path / "s")
    assert 0 < found.frames < 600 and found.notices == ()
    assert station("fit", tmp_path / "s")[0] == 0
