"""station calibrate camera, from folders, videos and a live camera."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.boards import CharucoBoard
from calibration.view_selection import WAYS, ViewSelector
from station.calibrating.waved_board import OPTICS
from station.cli.camera import wizard_lines
from station.commands import cameras
from station.formats.board import format_board
from station.formats.camera import parse_camera
from tests.board_sets import BOARD, good_poses, rendered

COUNT = 11


@pytest.fixture(scope="module")
def images() -> list[np.ndarray]:
    return rendered(OPTICS, good_poses(OPTICS, np.random.default_rng(3), COUNT), 3)


@pytest.fixture
def folder(images, tmp_path: Path) -> Path:
    (tmp_path / "images").mkdir()
    for k, image in enumerate(images):
        cv2.imwrite(str(tmp_path / "images" / f"shot_{k}.png"), image)
    return tmp_path / "images"


def test_a_folder_of_images_gives_a_camera_and_the_same_again_from_the_stored_views(
    station, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    arguments = ["--board", BOARD.spec, "--measured-mm", "100.0x100.0", "--out", "camera"]
    code, out, err = station("calibrate", "camera", folder, *arguments)
    assert code == 0 and "camera.toml: good" in out and "in views left out" in out
    first = (tmp_path / "camera" / "camera.toml").read_text("utf-8")
    camera = parse_camera(first, "camera.toml")
    assert abs(camera.matrix[0, 0] - 610.0) < 3 * camera.matrix_std[0, 0] < 2.0
    assert len(list((tmp_path / "camera" / "views").glob("*.png"))) == COUNT
    again = err.rstrip().splitlines()[-1].removeprefix("again from the stored views: station ").split()
    code, out, _ = station(*again, "--json")
    assert code == 0 and json.loads(out)["verdict"]["grade"] == "good"
    second = (tmp_path / "camera" / "camera.toml").read_text("utf-8")
    assert [line for line in second.splitlines() if not line.startswith("when")] == [
        line for line in first.splitlines() if not line.startswith("when")
    ]
    assert len(list((tmp_path / "camera" / "views").glob("*.png"))) == COUNT


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ([], 1, "no board: want --board"),
        (["--board", BOARD.spec], 1, "measure both 100 mm rulers"),
        (["--board", BOARD.spec, "--measured-mm", "9.96"], 1, "measures 9.96 mm; want 90 to 110 mm"),
        (["--board", BOARD.spec, "--measured-mm", "long"], 1, "want millimetres across x down"),
        (["--board", "nowhere.toml", "--measured-mm", "100"], 1, "no board 'nowhere.toml'"),
        (["--board", "charuco:what", "--measured-mm", "100"], 1, "is no board"),
        (["--board", BOARD.spec, "--measured-mm", "100", "--size", "1280x720"], 1, "the camera is set to 1280x720 px"),
        (["--board", BOARD.spec, "--measured-mm", "100", "--size", "large"], 2, "such as 1280x720"),
        (["--board", replace(BOARD, columns=6).spec, "--measured-mm", "100"], 1, "on a board of 7 squares across"),
    ],
)  # fmt: skip
def test_what_cannot_be_calibrated_is_one_clear_error_and_leaves_nothing(
    station, folder: Path, tmp_path: Path, monkeypatch, arguments, code, message
):
    monkeypatch.chdir(tmp_path)
    for path in sorted(folder.iterdir())[4:]:
        path.unlink()
    got, out, err = station("calibrate", "camera", folder, "--out", "camera", *arguments)
    assert got == code and message in err and not out
    assert len(err.splitlines()) <= 5 or code == 2
    assert not (tmp_path / "camera").exists()


def test_sources_that_are_none_are_errors(station, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    board = ["--board", BOARD.spec, "--measured-mm", "100", "--out", "camera"]
    (tmp_path / "empty").mkdir()
    (tmp_path / "mixed").mkdir()
    for k, size in enumerate(((640, 480), (320, 240))):
        cv2.imwrite(str(tmp_path / "mixed" / f"{k}.png"), np.zeros((size[1], size[0]), np.uint8))
    (tmp_path / "torn.mp4").write_bytes(b"no video")
    for source, message in (
        ("empty", "has no images"),
        ("mixed", "one size"),
        ("torn.mp4", "no video that OpenCV reads"),
        ("nowhere.mp4", "nowhere.mp4"),
    ):
        code, _, err = station("calibrate", "camera", source, *board)
        assert code == 1 and message in err, err
    code, _, err = station("calibrate", "camera", *board)
    assert code == 1 and "no source" in err
    code, _, err = station("calibrate", "camera", "--rig", "demo", *board)
    assert code == 1 and "sees the arm, no board" in err


def test_a_bad_set_is_exit_code_1_and_says_why(station, folder: Path, tmp_path: Path):
    for path in sorted(folder.iterdir())[4:]:
        path.unlink()
    code, out, _ = station(
        "calibrate", "camera", folder, "--board", BOARD.spec, "--measured-mm", "100", "--out", tmp_path / "c"
    )
    assert code == 1 and "camera.toml: bad" in out and "only 4 views" in out and "take 15" in out


def test_the_measured_length_is_kept_beside_the_views(images, folder: Path, tmp_path: Path):
    board = cameras.require_measured(cameras.read_board(BOARD.spec, None), (99.0, 100.0))
    done = cameras.calibrate_camera(str(folder), board, tmp_path / "camera")
    kept = cameras.read_board(None, str(tmp_path / "camera" / "views"))
    assert kept.measured and kept.board == BOARD.measured((99.0, 100.0))
    # A sheet that is drawn true and said to be 1 % narrow is a camera that sees 1 % more across.
    assert done.calibration.camera.matrix[0, 0] / done.calibration.camera.matrix[1, 1] != pytest.approx(
        610 / 609, abs=1e-3
    )


def test_views_are_chosen_from_a_video(images, tmp_path: Path):
    path = tmp_path / "board.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 30.0, (640, 480))
    for image in images:
        for _ in range(6):  # the board rests for 0.2 s
            video.write(image)
    video.release()
    seen: list[cameras.Progress] = []
    done = cameras.calibrate_camera(str(path), BOARD, tmp_path / "camera", on_look=seen.append)
    assert COUNT - 2 <= len(done.calibration.shots) <= COUNT  # two of the poses are much alike
    assert len(seen) == 6 * COUNT
    assert seen[-1].frames == 6 * COUNT
    said = {progress.look.why for progress in seen}
    assert "hold it still" in said and "view 1" in said and any(why.startswith("too much like view") for why in said)


def test_a_live_camera_is_watched_until_somebody_has_had_enough(tmp_path: Path):
    lines: list[list[str]] = []

    def on_look(progress: cameras.Progress) -> None:
        lines.append(wizard_lines(progress))

    def stop() -> bool:
        return sum(each[-1] == "TAKEN" for each in lines) >= 4

    board = cameras.read_board(None, "rendered")
    assert board.measured
    out = tmp_path / "camera"
    done = cameras.calibrate_camera("rendered", board.board, out, on_look=on_look, stop=stop)
    assert [shot.name for shot in done.calibration.shots] == [path.name for path in sorted((out / "views").iterdir())]
    assert done.calibration.verdict.grade.word == "bad"  # of four views
    assert all(len(line) <= 80 for each in lines for line in each)
    assert any("hold it still" in line for each in lines for line in each)
    assert lines[-1][0].startswith("4 views") and any(line.startswith("next: ") for line in lines[-1])


def test_the_wizard_asks_for_what_is_missing(images):
    selector = ViewSelector(BOARD, every=True)
    assert selector.advice().startswith("hold the board before the camera")
    selector.look(images[0], "0.png")
    first = selector.shots[0].quality
    advice = selector.advice()
    assert any(way in advice for way in WAYS) and "30 to 40 deg" in advice
    # Not the way in which the first view is tilted already.
    leaning = max(WAYS, key=lambda way: float(np.array(WAYS[way]) @ first.facing))
    assert leaning not in advice
    for k, image in enumerate(images[1:], start=1):
        selector.look(image, f"{k}.png")
    assert len(selector.shots) == COUNT and not selector.complete


def test_a_board_file_with_its_rulers_measured_needs_no_option(station, folder: Path, tmp_path: Path):
    path = tmp_path / "board.toml"
    path.write_text(format_board(BOARD.measured((100.0, 100.0)), measured=True), encoding="utf-8")
    for image in sorted(folder.iterdir())[8:]:
        image.unlink()
    code, out, _ = station("calibrate", "camera", folder, "--board", path, "--out", tmp_path / "c", "--json")
    assert code in (0, 1) and json.loads(out)["views_used"] == 8
    assert isinstance(cameras.read_board(str(path), None).board, CharucoBoard)


def test_a_blurred_view_is_not_taken_after_a_sharp_one(images):
    selector = ViewSelector(BOARD, wait_for_rest=False)
    assert selector.look(images[0], "0.png").taken
    blurred = cv2.GaussianBlur(images[8], (0, 0), 1.6)
    look = selector.look(blurred, "1.png")
    assert not look.taken and look.why.startswith("blurred")
    assert selector.look(images[8], "1.png").taken
