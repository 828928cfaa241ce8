"""Rigs: what is read, what is refused, and what the emulated and rendered ones really do."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.intrinsics import CameraModel
from drivers.errors import NoCamera, NoPort
from station.drawn import facing, look_at
from station.errors import InvalidData, InvalidFile, LimitExceeded
from station.formats.rig import load_calibration, parse_rig
from station.mechanism import mechanism
from station.motion import Motion, Sinusoids, Wave, plan_motion
from station.rig import load_rig, open_rig
from station.rig_reading import joint_configs, packaged, packaged_names
from station.stage import Stage

DEMO = packaged("rigs", "demo").read_text(encoding="utf-8")


JOINTS_OF_PACKAGED_RIGS = {
    "crustcrawler_ax18a": 5,
    "demo": 4,
    "koch_v1_1": 6,
    "openmanipulator_x": 5,
    "vx300s": 7,
    "wx250s": 7,
}


def test_packaged_rigs_are_read_with_their_calibration():
    assert packaged_names("rigs") == list(JOINTS_OF_PACKAGED_RIGS)
    for name, joints in JOINTS_OF_PACKAGED_RIGS.items():
        rig = load_rig(name)
        assert list(rig.camera_model.size_px) == rig.table.camera.size_px
        assert len(rig.table.joint) == joints


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("baud = 1000000", "baut = 1000000", r"bus, baut: unknown key; known here: port, baud, protocol"),
        ("baud = 1000000", 'baud = "fast"', r"bus, baud: .*valid integer; have 'fast'"),
        ("protocol = 1.0", "protocol = 3.0", r"want 1.0 or 2.0; have 3.0"),
        ("rig/1", "rig/7", r"has schema 'rig/7'; this station reads 'rig/1'"),
        ("id = 2\n", "id = 1\n", r"each servo id may stand once"),
        ('ganging = "software"', "", r"joint 2: a joint with several servos needs ganging"),
        ("limits_deg = [-60, 60]", "limits_deg = [60, -60]", r"joint 2: want limits_deg = \[lower, upper\]"),
        ('part = "base_b"', 'part = "base"', r"base"),
        ("DICT_4X4_50", "DICT_3X3", r"no marker dictionary 'DICT_3X3'"),
        ('name = "wrist"\nparent', 'name = "wrist_roll"\nparent', r"must place each joint once"),
        ('body = "hand"', 'body = "foot"', r"no simulated body 'foot'"),
        ("[safety]", "[savety]", r"savety: unknown key"),
    ],
)
def test_a_wrong_rig_is_refused_with_the_key(old: str, new: str, said: str):
    assert old in DEMO
    with pytest.raises(InvalidFile, match=said) as error:
        parse_rig(DEMO.replace(old, new), "my.toml")
    assert str(error.value).startswith("my.toml") and len(str(error.value).splitlines()) <= 5


def test_a_joint_may_have_a_greatest_acceleration_that_streamed_motions_keep_to():
    def limited(key: str) -> str:
        assert DEMO.count("limits_deg = [-60, 60]") == 1
        return DEMO.replace("limits_deg = [-60, 60]", f"limits_deg = [-60, 60]\n{key} = 40")

    joints = parse_rig(limited("max_acceleration_deg_s2"), "my.toml").limits()
    have = [joint.max_acceleration for joint in joints]
    assert have == [None, pytest.approx(np.radians(40)), None, None]
    shaken = Sinusoids({"shoulder": Wave(np.radians(5), 0.5)}, 8.0)  # 49 deg/s2 without its ramps
    with pytest.raises(LimitExceeded, match=r"shoulder would reach .* its greatest acceleration is 40\.0 deg/s2"):
        plan_motion(Motion("m", (shaken,), "stream"), joints)
    with pytest.raises(InvalidFile, match="joint 2: want limits_deg and max_speed_deg_s"):
        parse_rig(limited("max_acceleration_mm_s2"), "my.toml")


def test_a_missing_or_misfit_calibration_is_said_before_anything_opens(tmp_path: Path):
    head, tail = DEMO.split("[camera.calibration]")
    without = head + tail[tail.index("# 2-inch") :]
    with pytest.raises(InvalidFile, match="no calibration of its camera"):
        load_calibration(parse_rig(without, "my.toml"), tmp_path, "my.toml")
    elsewhere = without.replace("latency_s", 'calibration = "gone.toml"\nlatency_s', 1)
    with pytest.raises(InvalidFile, match=r"no calibration '.*gone\.toml'"):
        load_calibration(parse_rig(elsewhere, "my.toml"), tmp_path, "my.toml")
    larger = DEMO.replace("size_px = [640, 480]", "size_px = [1280, 720]", 1)
    with pytest.raises(InvalidFile, match="calibration is for frames of 640 x 480 px"):
        load_calibration(parse_rig(larger, "my.toml"), tmp_path, "my.toml")


def changed(tmp_path: Path, old: str, new: str) -> str:
    path = tmp_path / "rig.toml"
    path.write_text(DEMO.replace(old, new), encoding="utf-8")
    return str(path)


def test_a_port_or_a_camera_that_is_not_there_is_said(tmp_path: Path):
    absent = load_rig(changed(tmp_path, 'port = "emulated"', 'port = "/dev/ttyNOWHERE"\n'))
    with pytest.raises(InvalidData, match="can't see a real arm"), open_rig(absent):
        pass
    no_port = DEMO.replace('port = "emulated"', 'port = "/dev/ttyNOWHERE"').replace('"rendered"', "97")
    (tmp_path / "rig.toml").write_text(no_port, encoding="utf-8")
    with pytest.raises(NoPort, match="ttyNOWHERE"), open_rig(load_rig(str(tmp_path / "rig.toml"))):
        pass
    blind = load_rig(changed(tmp_path, '"rendered"', "97"))
    with pytest.raises(NoCamera, match="97"), open_rig(blind):
        pass
    with open_rig(blind, simulate=True) as rig:
        assert rig.virtual and rig.seed == 0


def test_a_rig_without_simulation_cannot_be_simulated(tmp_path: Path):
    real = DEMO[: DEMO.index("# Drawn with all joints")].replace('"emulated"', '"/dev/x"').replace('"rendered"', "0")
    (tmp_path / "rig.toml").write_text(real, encoding="utf-8")
    with (
        pytest.raises(InvalidData, match=r"no \[simulation\]"),
        open_rig(load_rig(str(tmp_path / "rig.toml")), simulate=True),
    ):
        pass


def test_the_camera_looks_where_it_is_told_and_plates_face_outward():
    T_world_camera = look_at(np.array([0.0, -1.0, 1.0]), np.zeros(3))
    target_camera = np.linalg.inv(T_world_camera) @ [0, 0, 0, 1]
    np.testing.assert_allclose(target_camera[:3], [0, 0, np.sqrt(2)], atol=1e-12)
    assert T_world_camera[2, 1] < 0  # the image's down is the world's down
    T = facing(np.array([1.0, 2.0, 3.0]), [0, -2, 0], [0, 0, 1])
    np.testing.assert_allclose(T[:3, :3], np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), atol=1e-12)


def test_the_mechanism_turns_about_its_drawn_axes():
    rig = parse_rig(DEMO, "demo")
    assert rig.simulation is not None
    tree = mechanism(rig.simulation)
    poses = tree.forward({"base_pan": np.radians(90), "shoulder": 0.0, "elbow": 0.0, "wrist": 0.0})
    np.testing.assert_allclose(poses["hand"] @ [0.2, 0, 0.28, 1], [0, 0.2, 0.28, 1], atol=1e-12)


def corners_seen(image: np.ndarray) -> dict[int, np.ndarray]:
    """OpenCV's own corners of the markers in a picture."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    return {int(i): c.reshape(4, 2) for i, c in zip(np.ravel(ids), corners, strict=True)}


def projected(stage: Stage, camera_model: CameraModel, q_rad: np.ndarray, body: int) -> dict[int, np.ndarray]:
    """Where cv2.projectPoints puts the corners of a body's plates."""
    T_camera_body = stage.T_camera_bodies(q_rad)[body]
    corners = {}
    for plate in (plate for plate in stage.plates if plate.body == body):
        h = plate.size_m / 2
        T = T_camera_body @ plate.T_body_marker
        square = np.array([[-h, h, 0], [h, h, 0], [h, -h, 0], [-h, -h, 0]])
        points, _ = cv2.projectPoints(
            square, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], camera_model.matrix, camera_model.distortion
        )
        corners[plate.marker_id] = points.reshape(4, 2)
    return corners


def test_the_picture_shows_the_arms_actual_angles_in_the_middle_of_the_exposure():
    """OpenCV's corners are where cv2.projectPoints puts them for the shafts' true angles then, not for the goals."""
    rig_file = load_rig("demo")
    simulation = rig_file.table.simulation
    assert simulation is not None
    with open_rig(rig_file, seed=3) as rig:
        rig.arm.connect()
        rig.arm.set_speeds(np.full(4, np.radians(20.0)))
        rig.arm.torque_on()
        rig.arm.command(np.radians([20.0, 10.0, -20.0, 20.0]))
        readings = [rig.arm.read()]
        while readings[-1].t_ns < 400_000_000:
            readings.append(rig.arm.read())
        frame = rig.camera.read(2**62)
        while frame is not None and frame.t_ns < 250_000_000:
            frame = rig.camera.read(2**62)
    assert frame is not None
    stage = Stage(rig_file.table, simulation, rig_file.camera_model, seed=3)
    t_mid_ns = frame.t_ns - (simulation.camera.latency_s + simulation.camera.exposure_s / 2) * 1e9
    q = [np.interp(t_mid_ns, [r.t_ns for r in readings], [r.q[j] for r in readings]) for j in range(4)]
    assert np.radians(1) < q[0] < np.radians(10)  # on its way
    truth = projected(stage, rig_file.camera_model, np.array(q), body=3)
    seen = corners_seen(frame.image)
    for marker_id in set(truth) & set(seen):
        # SUBPIX sees the square 0.4 px small; a count of the servo is 0.3 deg, 1 px at 0.2 m from the axis.
        np.testing.assert_allclose(seen[marker_id], truth[marker_id], atol=2.0)
    assert set(truth) & set(seen)


def test_a_model_of_two_firmwares_is_that_of_the_bus():
    for protocol, name in ((1.0, "MX-28"), (2.0, "MX-28(2.0)")):
        table = parse_rig(
            DEMO.replace('"AX-18A"', '"MX-28"').replace("protocol = 1.0", f"protocol = {protocol}"), "my.toml"
        )
        assert {servo.model for joint in joint_configs(table) for servo in joint.servos} == {name}


def test_a_model_that_does_not_speak_the_protocol_is_said(tmp_path: Path):
    with pytest.raises(InvalidFile, match=r"rig\.toml: AX-18A speaks protocol 1\.0, not 2\.0"):
        load_rig(changed(tmp_path, "protocol = 1.0", "protocol = 2.0"))


def test_a_servo_model_that_is_not_known_is_said_when_the_rig_is_read(tmp_path: Path):
    with pytest.raises(InvalidFile, match=r"rig\.toml: no servo model 'AX-99'; have AX-12A"):
        load_rig(changed(tmp_path, '"AX-18A"', '"AX-99"'))
