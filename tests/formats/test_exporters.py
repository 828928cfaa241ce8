"""Every exporter of the registry, each read back by a program that we did not write: a new one needs a reader here."""

from __future__ import annotations

import builtins
import csv
import io
import json
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from yourdfpy import URDF

from calibration.intrinsics import CameraModel
from station.errors import InvalidData, StationError
from station.formats.exporters import EXPORTERS, WHAT, Exportable, exporter_named, exporter_of_file, files_of
from station.formats.read import read_pose_log
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.logs import JointLog, PoseLog
from station.perception.observations import ObservationLog

CAMERA = CameraModel(
    (640, 480), np.array([[600.1, 0, 320], [0, 601.2, 240], [0, 0, 1]]), np.array([0.1, -0.2, 0, 0, 0])
)
TREE = KinematicTree(
    root="base",
    parts=("base", "door", "lid"),
    rigid_groups=(),
    trees=(("base", "door", "lid"),),
    joints=(
        Joint(
            name="hinge",
            type="revolute",
            parent="base",
            child="door",
            axis_parent=np.array([0, 0, 1.0]),
            point_parent_m=np.zeros(3),
            T_parent_child_zero=se3.translation([0.2, 0, 0]),
        ),
        Joint(
            name="slide",
            type="prismatic",
            parent="base",
            child="lid",
            axis_parent=np.array([1.0, 0, 0]),
            point_parent_m=None,
            T_parent_child_zero=se3.translation([0, 0.1, 0]),
        ),
    ),
)
JPEGS = ((0, b"\xff\xd8first"), (40_000_000, b"\xff\xd8second"))


def pose_log(frames: int, seed: int, *, covariance: bool = True) -> PoseLog:
    """Parts with gaps at uneven times."""
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(rng.uniform(0.01, 1.0, frames))
    T = se3.exp(rng.normal(size=(frames, 2, 6)))
    T[rng.random((frames, 2)) < 0.3] = np.nan
    A = rng.normal(size=(frames, 2, 6, 6))
    return PoseLog(t_s, "camera", ("door", "lid"), T, A @ np.swapaxes(A, -1, -2) if covariance else None)


def joint_log(frames: int, seed: int, *, std: bool) -> JointLog:
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(frames, 2)) * 10
    q[rng.random((frames, 2)) < 0.3] = np.nan
    return JointLog(np.arange(frames) / 7, ("hinge", "slide"), q, ("rad", "m"), np.abs(q) if std else None)


def observations(frames: int, seed: int) -> ObservationLog:
    rng = np.random.default_rng(seed)
    frame = np.sort(rng.choice(np.arange(frames), size=rng.integers(0, frames + 1), replace=False))
    count = len(frame)
    return ObservationLog(
        t_s=np.arange(frames) / 3,
        frame=frame,
        marker_id=rng.integers(0, 50, count),
        corners_px=rng.normal(size=(count, 4, 2)) * 100,
        corner_covariance_px2=np.full((count, 4, 2, 2), np.nan),
        T_cam_marker=se3.exp(rng.normal(size=(count, 2, 6))),
        rms_px=rng.random((count, 2)),
    )


def everything(frames: int, seed: int) -> Exportable:
    return Exportable(
        poses=pose_log(frames, seed),
        states=joint_log(frames, seed, std=True),
        commands=joint_log(frames, seed + 1, std=False),
        readings=joint_log(frames, seed + 2, std=False),
        tree=TREE,
        observations=observations(frames, seed),
        camera=CAMERA,
        images=lambda: iter(JPEGS),
    )


def written(source: Exportable, format_: str, what: tuple[str, ...] = ()) -> dict[str, bytes]:
    """The contents of the files by name."""
    contents: dict[str, bytes] = {}
    for name, write in files_of(source, exporter_named(format_), what, several=True).items():
        file = io.BytesIO()
        write(file)
        contents[name] = file.getvalue()
    return contents


# --- Readers: the standard library's csv, evo, pyarrow, yourdfpy, mcap, OpenCV, PyYAML -------------------------------


def rows_of(content: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(content.decode())))


def number(cell: str | float | None) -> float:
    return np.nan if cell in ("", None) else float(cell)


def check_states(log: JointLog, rows: list[Mapping[str, Any]]) -> None:
    np.testing.assert_array_equal([number(row["t_s"]) for row in rows], log.t_s)
    for j, joint in enumerate(log.joints):
        np.testing.assert_array_equal([number(row[joint]) for row in rows], log.q[:, j])
        if log.std is not None:
            np.testing.assert_array_equal([number(row[f"{joint}_std"]) for row in rows], log.std[:, j])


def check_poses(log: PoseLog, rows: list[Mapping[str, Any]]) -> None:
    frames, parts = np.nonzero(log.seen)
    assert [row["part"] for row in rows] == [log.parts[k] for k in parts]
    np.testing.assert_array_equal([number(row["t_s"]) for row in rows], log.t_s[frames])
    xyz = np.array([[number(row[c]) for c in ("x_m", "y_m", "z_m")] for row in rows]).reshape(-1, 3)
    wxyz = np.array([[number(row[c]) for c in ("qw", "qx", "qy", "qz")] for row in rows]).reshape(-1, 4)
    np.testing.assert_allclose(se3.from_xyz_wxyz(xyz, wxyz), log.T_ref_part[frames, parts], atol=1e-12)


def check_csv(source: Exportable, files: dict[str, bytes]) -> None:
    assert set(files) == {"poses.csv", "joint_states.csv", "commands.csv", "readings.csv", "observations.csv"}
    check_poses(source.poses, rows_of(files["poses.csv"]))
    check_states(source.states, rows_of(files["joint_states.csv"]))
    check_states(source.commands, rows_of(files["commands.csv"]))
    check_states(source.readings, rows_of(files["readings.csv"]))
    rows, log = rows_of(files["observations.csv"]), source.observations
    assert [int(row["marker"]) for row in rows] == log.marker_id.tolist()
    corners = [[float(row[f"{axis}{n}_px"]) for n in (1, 2, 3, 4) for axis in "uv"] for row in rows]
    np.testing.assert_array_equal(np.reshape(corners, (-1, 4, 2)), log.corners_px)


def check_tum(source: Exportable, files: dict[str, bytes]) -> None:
    evo = pytest.importorskip("evo.tools.file_interface", reason="evo isn't installed (the extra test has it)")
    log = source.poses
    assert set(files) == {f"{part}.tum" for part in log.parts}
    for k, part in enumerate(log.parts):
        seen = log.seen[:, k]
        if not seen.any():  # evo reads no empty trajectory
            continue
        read = evo.read_tum_trajectory_file(io.StringIO(files[f"{part}.tum"].decode()))
        np.testing.assert_array_equal(read.timestamps, log.t_s[seen])
        np.testing.assert_allclose(read.poses_se3, log.T_ref_part[seen, k], atol=1e-12)


def check_parquet(source: Exportable, files: dict[str, bytes]) -> None:
    tables = {name: pq.read_table(io.BytesIO(content)) for name, content in files.items()}
    assert set(tables) == {f"{n}.parquet" for n in ("poses", "joint_states", "commands", "readings", "observations")}
    poses = tables["poses.parquet"]
    check_poses(source.poses, poses.to_pylist())
    seen = source.poses.covariance[source.poses.seen]
    np.testing.assert_array_equal(np.reshape(poses["covariance"].to_pylist(), (-1, 6, 6)), seen)
    assert poses.schema.metadata[b"reference"] == b"camera"
    check_states(source.states, tables["joint_states.parquet"].to_pylist())
    assert tables["joint_states.parquet"].schema.metadata[b"unit:slide"] == b"m"
    check_states(source.commands, tables["commands.parquet"].to_pylist())
    check_states(source.readings, tables["readings.parquet"].to_pylist())
    seen, log = tables["observations.parquet"], source.observations
    np.testing.assert_array_equal(seen["marker_id"], log.marker_id)
    np.testing.assert_array_equal(np.reshape(seen["T_cam_marker"].to_pylist(), (-1, 2, 4, 4)), log.T_cam_marker)
    assert all(value is None for row in seen["corner_covariance_px2"].to_pylist() for value in row)  # unknown


def check_urdf(source: Exportable, files: dict[str, bytes]) -> None:
    robot = URDF.load(io.BytesIO(files["kinematics.urdf"]), build_collision_scene_graph=False)
    robot.update_cfg({"hinge": 0.5, "slide": 0.1})
    truth = source.tree.forward({"hinge": np.array(0.5), "slide": np.array(0.1)})
    for part in source.tree.parts:
        np.testing.assert_allclose(robot.get_transform(part, "base"), truth[part], atol=1e-12)


def check_json(source: Exportable, files: dict[str, bytes]) -> None:
    document = json.loads(files["kinematics.json"])
    assert document["schema"] == "kinematics/1" and [joint["name"] for joint in document["joints"]] == [
        "hinge",
        "slide",
    ]


def check_mcap(source: Exportable, files: dict[str, bytes]) -> None:
    reader = pytest.importorskip("mcap.reader", reason="mcap isn't installed (the extra mcap has it)")
    read = reader.make_reader(io.BytesIO(files["session.mcap"]))
    by_topic: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    schemas: dict[str, str] = {}
    for schema, channel, message in read.iter_messages():
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        schemas[channel.topic] = schema.name
        assert json.loads(schema.data)["title"] == schema.name
        by_topic.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
    assert schemas["/tf"] == "foxglove.FrameTransforms" and schemas["/camera/image"] == "foxglove.CompressedImage"
    check_transforms(source.poses, by_topic["/tf"])
    for topic, log in (("detected", source.states), ("commanded", source.commands), ("measured", source.readings)):
        messages = by_topic[f"/joints/{topic}"]
        rows = [{joint["name"]: joint["position"] for joint in message["joints"]} for _, message in messages]
        want = [{n: q for n, q in zip(log.joints, row, strict=True) if np.isfinite(q)} for row in log.q.tolist()]
        assert rows == want
        np.testing.assert_allclose([t_ns for t_ns, _ in messages], 1e9 * log.t_s, atol=0.5)
    ((_, calibration),) = by_topic["/camera/calibration"]
    assert calibration["K"] == CAMERA.matrix.ravel().tolist() and calibration["D"] == CAMERA.distortion.tolist()
    assert [t_ns for t_ns, _ in by_topic["/camera/image"]] == [t_ns for t_ns, _ in JPEGS]
    assert {attachment.name for attachment in read.iter_attachments()} == {"kinematics.urdf", "kinematics.json"}


def check_transforms(log: PoseLog, messages: list[tuple[int, dict[str, Any]]]) -> None:
    assert len(messages) == len(log.t_s)
    for row, (t_ns, message) in enumerate(messages):
        assert t_ns == round(log.t_s[row] * 1e9)
        assert [t["child_frame_id"] for t in message["transforms"]] == [
            log.parts[k] for k in np.flatnonzero(log.seen[row])
        ]
        for transform in message["transforms"]:
            assert transform["parent_frame_id"] == "camera"
            xyz = np.array([transform["translation"][axis] for axis in "xyz"])
            wxyz = np.array([transform["rotation"][axis] for axis in "wxyz"])
            truth = log.T_ref_part[row, log.parts.index(transform["child_frame_id"])]
            np.testing.assert_allclose(se3.from_xyz_wxyz(xyz, wxyz), truth, atol=1e-12)


def check_toml(source: Exportable, files: dict[str, bytes]) -> None:
    assert tomllib.loads(files["camera.toml"].decode())["matrix"] == source.camera.matrix.tolist()


def check_opencv(source: Exportable, files: dict[str, bytes]) -> None:
    text = files["camera.yaml"].decode()
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    np.testing.assert_array_equal(storage.getNode("camera_matrix").mat(), source.camera.matrix)
    storage.release()


def check_ros(source: Exportable, files: dict[str, bytes]) -> None:
    document = yaml.safe_load(files["camera_info.yaml"])
    assert document["camera_matrix"]["data"] == source.camera.matrix.ravel().tolist()
    assert (document["image_width"], document["distortion_model"]) == (640, "plumb_bob")


Check = Callable[[Exportable, dict[str, bytes]], None]
READERS: dict[str, Check] = {
    "csv": check_csv,
    "tum": check_tum,
    "parquet": check_parquet,
    "urdf": check_urdf,
    "json": check_json,
    "mcap": check_mcap,
    "toml": check_toml,
    "opencv": check_opencv,
    "ros": check_ros,
}


@pytest.mark.parametrize("format_", [exporter.format for exporter in EXPORTERS])
@given(frames=st.integers(1, 12), seed=st.integers(0, 10**6))
@settings(max_examples=15)
def test_another_program_reads_every_format_back(format_: str, frames: int, seed: int) -> None:
    source = everything(frames, seed)
    READERS[format_](source, written(source, format_))


@pytest.mark.parametrize("exporter", EXPORTERS, ids=lambda exporter: exporter.format)
def test_every_kind_can_be_written_alone(exporter: Any) -> None:
    assert set(exporter.what) <= set(WHAT)
    for kind in exporter.what:
        assert all(written(everything(5, 0), exporter.format, (kind,)).values())


def test_every_kind_has_a_format() -> None:
    assert {kind for exporter in EXPORTERS for kind in exporter.what} == set(WHAT)


def test_what_is_missing_or_unknown_is_told_with_the_choices() -> None:
    source = Exportable(poses=pose_log(3, 0))
    for format_, what, message in (
        ("csv", ("states",), "the input has no states; it has poses"),
        ("urdf", (), "urdf holds tree; the input has poses"),
        ("urdf", ("poses",), "urdf can't hold poses; it holds tree"),
        ("csv", ("angles",), "nothing is called 'angles'; choose of poses, states"),
    ):
        with pytest.raises(InvalidData, match=message):
            files_of(source, exporter_named(format_), what, several=True)
    with pytest.raises(InvalidData, match="no format 'bag'; choose one of csv, tum, parquet"):
        exporter_named("bag")
    with pytest.raises(
        InvalidData, match=r"'x\.yaml' may be one of several formats: say which with --format opencv or"
    ):
        exporter_of_file("x.yaml")
    with pytest.raises(InvalidData, match=r"'x.bag' ends in no known format's way \(.csv, .tum, .parquet"):
        exporter_of_file("x.bag")


def test_one_file_alone_is_of_the_first_kind() -> None:
    files = files_of(everything(3, 0), exporter_named("csv"), (), several=False)
    assert list(files) == ["poses.csv"]
    files = files_of(Exportable(tree=TREE, states=joint_log(3, 0, std=True)), exporter_named("csv"), (), several=False)
    assert list(files) == ["joint_states.csv"]


def test_tum_files_are_read_again_as_a_folder(tmp_path: Path) -> None:
    source = Exportable(poses=pose_log(40, 3, covariance=False))
    for name, content in written(source, "tum").items():
        (tmp_path / name).write_bytes(content)
    again = read_pose_log(tmp_path)
    assert again.parts == source.poses.parts
    at_all = source.poses.seen.any(axis=1)
    np.testing.assert_array_equal(again.t_s, source.poses.t_s[at_all])
    np.testing.assert_allclose(again.T_ref_part, source.poses.T_ref_part[at_all], atol=1e-12)


def test_a_position_without_rotation_is_no_trajectory_of_tum() -> None:
    log = pose_log(5, 0)
    covariance = np.array(log.covariance)
    covariance[:, 1, 3:, 3:] = np.diag([np.inf] * 3)
    source = Exportable(poses=PoseLog(log.t_s, log.reference, log.parts, log.T_ref_part, covariance))
    with pytest.raises(InvalidData, match="the rotations of 'lid' were not observed"):
        written(source, "tum")


def test_mcap_refuses_times_before_zero() -> None:
    pytest.importorskip("mcap", reason="mcap isn't installed (the extra mcap has it)")
    log = pose_log(3, 0)
    early = Exportable(poses=PoseLog(log.t_s - 10, log.reference, log.parts, log.T_ref_part))
    with pytest.raises(InvalidData, match="MCAP has none before 0"):
        written(early, "mcap")


def test_mcap_without_its_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without_mcap(name: str, *rest: Any) -> Any:
        if name.split(".")[0] == "mcap":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_mcap)
    with pytest.raises(StationError, match=r"needs the package mcap.*\n.*capture-fit-station\[mcap\]"):
        written(everything(2, 0), "mcap")
