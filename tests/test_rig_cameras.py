"""`[camera]` of a rig: what reaches the camera, what is recorded of it, and the rolling shutter's two readout times."""

from __future__ import annotations

import socket
import threading
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from drivers.camera import Controls
from drivers.clock import VirtualClock
from drivers.errors import NoCamera
from station.doctor.checkup import examine
from station.doctor.finding import Verdict
from station.emulated_arm import EmulatedArm
from station.errors import InvalidFile
from station.formats.rig import RigTable, load_calibration, parse_rig
from station.rig import load_rig, open_rig, real_camera, rendered_camera
from station.rig_reading import packaged
from station.stage import SHUTTER_BANDS, Stage
from tests.drivers.ip_camera import HEAD, IpCamera, jpeg, part
from tests.drivers.videos import write_images

DEMO = packaged("rigs", "demo").read_text(encoding="utf-8")
MS = 1_000_000


def demo(*, camera: str = "", simulated: str = "") -> RigTable:
    """The demo rig with lines added to `[camera]` and `[simulation.camera]`."""
    text = DEMO.replace("latency_s = 0.016\n", f"latency_s = 0.016\n{camera}\n")
    return parse_rig(text.replace("exposure_s = 0.008\n", f"exposure_s = 0.008\n{simulated}\n"), "demo")


def stage_of(rig: RigTable) -> Stage:
    assert rig.simulation is not None
    return Stage(rig, rig.simulation, load_calibration(rig, Path(), "demo"), seed=0)


def test_what_is_to_be_locked_is_read():
    rig = demo(camera='pixel_format = "MJPG"\nexposure_ms = 8\nfocus = 30\ngain = 10\nwhite_balance_k = 5000')
    assert rig.camera.controls() == Controls("MJPG", 8.0, 30.0, 10.0, 5000.0)
    assert demo().camera.controls() == Controls() and demo().camera.stall_s == 2.0


@pytest.mark.parametrize("line", ['pixel_format = "MJPEG"', "exposure_ms = 0", "stall_s = 0", "focus = -1", "iris = 1"])
def test_what_no_camera_can_be_told_is_refused(line: str):
    with pytest.raises(InvalidFile, match=f"camera, {line.split()[0]}: "):
        demo(camera=line)


def test_the_rigs_camera_may_be_a_folder_of_pictures(tmp_path: Path):
    folder = write_images(tmp_path / "shots", ["1.png", "2.png"])
    text = DEMO.replace('source = "rendered"', f'source = "{folder}"').replace("[640, 480]", "[64, 48]")
    camera = real_camera(parse_rig(text, "demo"), clock := VirtualClock())
    camera.start()
    stamps = [frame.t_ns for frame in (camera.read(clock.now_ns() + 10**9) for _ in range(2)) if frame]
    assert stamps == [0, round(1e9 / 30)]  # the rig's rate, as pictures have none
    camera.close()


def test_an_address_is_recorded_and_told_without_its_password(tmp_path: Path):
    path = tmp_path / "arm.toml"
    path.write_text(DEMO.replace('source = "rendered"', 'source = "http://me:mine@127.0.0.1:9/video"'))
    rig = load_rig(str(path))
    assert rig.table.camera.source == "http://me:mine@127.0.0.1:9/video"
    assert 'source = "http://127.0.0.1:9/video"' in rig.text and "mine" not in rig.text
    with pytest.raises(NoCamera, match=r"http://127.0.0.1:9/video': it can't be reached") as error, open_rig(rig):
        pass
    assert "mine" not in str(error.value)


def test_the_readout_time_of_the_rig_goes_before_the_calibrations():
    calibrated = "[camera.calibration]\nreadout_s = 0.01\n"
    assert load_calibration(demo(), Path(), "demo").readout_s is None
    assert load_calibration(demo(camera="readout_s = 0.02"), Path(), "demo").readout_s == 0.02
    rig = parse_rig(DEMO.replace("[camera.calibration]\n", calibrated), "demo")
    assert load_calibration(rig, Path(), "demo").readout_s == 0.01


def test_the_true_readout_time_may_be_another_than_the_rig_says():
    assert stage_of(demo()).knots_s.tolist() == [0.0]
    assert stage_of(demo(camera="readout_s = 0.02")).readout_s == 0.02
    rolling = stage_of(demo(camera="readout_s = 0.02", simulated="readout_s = 0.024"))
    np.testing.assert_allclose(rolling.knots_s, np.linspace(-0.012, 0.012, SHUTTER_BANDS + 1))
    assert stage_of(demo(camera="readout_s = 0.02", simulated="readout_s = 0.0")).knots_s.tolist() == [0.0]


class NotedArm:
    """Stands still, and notes the times for which it is asked."""

    def __init__(self) -> None:
        self.asked_ns: list[int] = []

    def joint_states(self, t_ns: int) -> np.ndarray:
        self.asked_ns.append(t_ns)
        return np.zeros(4)


def test_each_row_sees_the_arm_at_its_own_time_and_the_frame_comes_after_the_last():
    rig = demo(simulated="readout_s = 0.02")
    assert rig.simulation is not None
    arm, clock = NotedArm(), VirtualClock()
    camera = rendered_camera(rig, rig.simulation.camera, stage_of(rig), cast(EmulatedArm, arm), clock, realtime=False)
    camera.start()
    frame = camera.read(10**9)
    # 8 ms of exposure and 20 ms of readout from the start on, then 12 ms of latency.
    assert frame is not None and frame.t_ns == 40 * MS
    blur_ms, rows_ms = np.array([-2.0, 2.0]), np.linspace(-10, 10, SHUTTER_BANDS + 1)
    np.testing.assert_allclose(np.array(arm.asked_ns) / MS, 14 + np.add.outer(blur_ms, rows_ms).ravel(), atol=1e-5)
    assert max(arm.asked_ns) < clock.now_ns()


def test_a_moving_arm_leans_under_a_rolling_shutter():
    """The same instant of the same motion with and without it: only what moves differs, and by what it moves."""
    rigs = [demo(), demo(simulated="readout_s = 0.02")]
    global_, rolling = (stage_of(rig) for rig in rigs)

    def states(stage: Stage, rad_s: float) -> np.ndarray:
        return (stage.knots_s[None, :, None] * rad_s) * np.array([1.0, 0, 0, 0])

    still = [stage.render(states(stage, 0.0), 0) for stage in (global_, rolling)]
    np.testing.assert_array_equal(*still)
    moved = [stage.render(states(stage, 3.0), 0).astype(int) for stage in (global_, rolling)]
    assert np.mean(np.abs(moved[0] - moved[1]) > 30) > 0.001


def test_the_doctor_examines_an_ip_camera(tmp_path: Path):
    def script(connection: socket.socket, leave: threading.Event) -> None:
        connection.sendall(HEAD)
        for k in range(10_000):
            connection.sendall(part(jpeg(k)))
            if leave.wait(1 / 40):
                return

    with IpCamera(script) as server:
        text = DEMO.replace('source = "rendered"', f'source = "{server.address}"').replace("[640, 480]", "[64, 48]")
        path = tmp_path / "arm.toml"
        path.write_text(text)
        found = {f.check: f for f in examine(str(path), folder=tmp_path).findings if f.where == "camera"}
    assert found["opens"].found == "64x48 px"
    assert found["stamps"].values["stamps"] == "at arrival, before decoding"
    assert found["exposure"].verdict is Verdict.WARNING and "camera's own settings" in found["exposure"].mend
    assert found["frame rate"].values["dropped"] == 0 and "fresh frames" not in found
