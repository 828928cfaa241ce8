"""`station export`: which file is written where, and what is said when it can't be."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import station as api
from station.fit.learner import learn
from station.fit_files import write_fit
from station.formats.camera_files import read_camera
from station.formats.poses_csv import format_poses_csv
from station.formats.read import read_pose_log
from station.kinematics import se3
from station.logs import PoseLog
from station.recording import Recording, RecordingWriter
from tests.made_sessions import CAMERA, START_NS, describe, log_frame, make_frames

FRAMES = 8


def door_log() -> PoseLog:
    rng = np.random.default_rng(0)
    swing = se3.rotation_z(np.linspace(0, np.pi / 3, 60))
    T = se3.translation([0.3, 0.1, 1.0]) @ swing @ se3.translation([0.4, 0.0, 0.0])
    T = T @ se3.exp(rng.normal(size=(60, 6)) * ([0.001] * 3 + [0.01] * 3))
    return PoseLog(np.arange(60) / 30, "world", ("door",), T[:, None])


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a session of an arm, a log of poses, its fit, and a camera."""
    folder = tmp_path_factory.mktemp("inputs")
    with RecordingWriter(folder / "session", describe(rig=None), start_ns=START_NS) as writer:
        for frame in make_frames(FRAMES):
            unknown = np.full_like(frame.markers.corner_covariance_px2, np.nan)
            log_frame(writer, replace(frame, markers=replace(frame.markers, corner_covariance_px2=unknown)))
        writer.close("complete")
    (folder / "poses.csv").write_text(format_poses_csv(door_log()), "utf-8")
    write_fit(learn(door_log()), folder / "fit")
    (folder / "camera.toml").write_text(CAMERA, "utf-8")
    return folder


def is_one_clear_error(err: str) -> bool:
    return err.startswith("error: ") and len(err.splitlines()) <= 5 and "Traceback" not in err


@pytest.mark.parametrize(
    ("source", "out", "options", "files"),
    [
        ("poses.csv", "p.parquet", (), ["p.parquet"]),
        ("poses.csv", "door.txt", (), ["door.txt"]),
        ("poses.csv", "folder", ("--format", "tum"), ["folder/door.tum"]),
        ("poses.csv", "p.mcap", (), ["p.mcap"]),
        ("fit", "tree.urdf", (), ["tree.urdf"]),
        ("fit", "states.csv", (), ["states.csv"]),
        ("fit", "states.parquet", ("--what", "states"), ["states.parquet"]),
        ("fit/kinematics.json", "tree.urdf", (), ["tree.urdf"]),
        ("fit/kinematics.urdf", "tree.json", (), ["tree.json"]),
        ("camera.toml", "c.yaml", ("--format", "ros"), ["c.yaml"]),
        ("camera.toml", "c.yml", ("--format", "opencv"), ["c.yml"]),
        ("session", "c.toml", (), ["c.toml"]),
        ("session", "s.mcap", (), ["s.mcap"]),
        ("session/recording.rrd", "corners.csv", ("--what", "observations"), ["corners.csv"]),
        (
            "session",
            "all",
            ("--format", "csv"),
            ["all/commands.csv", "all/observations.csv", "all/poses.csv", "all/readings.csv"],
        ),
        ("session", "two", ("--format", "parquet", "--what", "poses", "--what", "readings"), None),
    ],
)
def test_an_ending_or_a_format_says_what_is_written(
    station, inputs: Path, tmp_path: Path, source: str, out: str, options: tuple[str, ...], files: list[str] | None
) -> None:
    code, printed, err = station("export", inputs / source, "--out", tmp_path / out, *options, "--json")
    assert code == 0, err
    there = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    assert there == (files or ["two/poses.parquet", "two/readings.parquet"])
    assert sorted(json.loads(printed)["files"]) == [str(tmp_path / name) for name in there]
    assert all((tmp_path / name).stat().st_size for name in there)


def test_what_is_exported_is_what_there_was(station, inputs: Path, tmp_path: Path) -> None:
    assert station("export", inputs / "poses.csv", "--out", tmp_path / "door.tum")[0] == 0
    again = read_pose_log(tmp_path / "door.tum")
    np.testing.assert_array_equal(again.t_s, door_log().t_s)
    np.testing.assert_allclose(again.T_ref_part, door_log().T_ref_part, atol=1e-12)
    assert station("export", inputs / "camera.toml", "--out", tmp_path / "c.yaml", "--format", "ros")[0] == 0
    np.testing.assert_array_equal(read_camera(tmp_path / "c.yaml").matrix, read_camera(inputs / "camera.toml").matrix)
    assert station("export", inputs / "session", "--out", tmp_path / "c", "--format", "csv")[0] == 0
    commanded = api.read_commands(tmp_path / "c" / "commands.csv", {"elbow": "m"})
    recorded = Recording.load(inputs / "session").commanded
    np.testing.assert_array_equal(commanded.t_s, recorded.t_s)
    np.testing.assert_array_equal(commanded.q, recorded.q)


def test_python_calls_do_the_same(inputs: Path, tmp_path: Path) -> None:
    assert api.export(inputs / "fit", tmp_path / "tree.urdf") == (tmp_path / "tree.urdf",)
    assert api.read_camera(inputs / "camera.toml").size_px == (64, 48)


@pytest.mark.parametrize(
    ("source", "out", "options", "message"),
    [
        ("nowhere", "x.csv", (), "no input"),
        ("poses.csv", "x", (), "is a folder: say with --format what to write there"),
        ("poses.csv", "x.bag", (), "ends in no known format's way"),
        ("poses.csv", "x.urdf", (), "urdf holds tree; the input has poses"),
        ("poses.csv", "x.csv", ("--what", "states"), "the input has no states; it has poses"),
        ("poses.csv", "x.csv", ("--format", "bag"), "no format 'bag'; choose one of csv"),
        ("camera.toml", "x.yaml", (), "say which with --format opencv or --format ros"),
        ("session", "x.tum", (), "makes 3 files of this kind: base.tum, link1.tum, link2.tum"),
        ("session", "x.csv", ("--what", "poses", "--what", "readings"), "makes 2 files"),
        ("session", "x.json", (), "json holds tree; the input has poses"),
    ],
)
def test_what_cannot_be_exported_is_one_clear_error_and_leaves_nothing(
    station, inputs: Path, tmp_path: Path, source: str, out: str, options: tuple[str, ...], message: str
) -> None:
    code, _, err = station("export", inputs / source, "--out", tmp_path / out, *options)
    assert code == 1 and is_one_clear_error(err) and message in err, err
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_is_kept_unless_forced(station, inputs: Path, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("mine", "utf-8")
    code, _, err = station("export", inputs / "poses.csv", "--out", tmp_path / "p.csv")
    assert code == 1 and is_one_clear_error(err) and "--force" in err
    code, _, err = station("export", inputs / "poses.csv", "--out", tmp_path, "--format", "tum")
    assert code == 1 and is_one_clear_error(err) and "isn't empty" in err
    assert (tmp_path / "p.csv").read_text("utf-8") == "mine"
    assert station("export", inputs / "poses.csv", "--out", tmp_path / "p.csv", "--force")[0] == 0
    assert read_pose_log(tmp_path / "p.csv").parts == ("door",)


def test_a_failure_while_writing_leaves_what_was_there(station, inputs: Path, tmp_path: Path) -> None:
    early = door_log()
    (tmp_path / "early.csv").write_text(
        format_poses_csv(PoseLog(early.t_s - 5, early.reference, early.parts, early.T_ref_part)), "utf-8"
    )
    (tmp_path / "x.mcap").write_text("old", "utf-8")
    code, _, err = station("export", tmp_path / "early.csv", "--out", tmp_path / "x.mcap", "--force")
    assert code == 1 and is_one_clear_error(err) and "MCAP has none before 0" in err
    assert (tmp_path / "x.mcap").read_text("utf-8") == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["early.csv", "x.mcap"]


def test_a_place_that_cannot_be_written_is_one_clear_error(station, inputs: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", "utf-8")
    code, _, err = station("export", inputs / "poses.csv", "--out", tmp_path / "file" / "p.csv")
    assert code == 1 and is_one_clear_error(err) and "can't write into" in err
