"""What the doctor finds on made faults: in servos, port, camera, disk; and what it mends, by name only."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from drivers.camera import Frame
from drivers.clock import Clock, VirtualClock
from drivers.emulator import EmulatedBus, EmulatedServo
from drivers.emulator.bus import AlterReply
from drivers.errors import NoCamera
from drivers.rendered_camera import RenderedCamera
from drivers.serial_ports import User
from station.doctor.bus import BusReport, Wire, examine_bus
from station.doctor.camera import check_locks, check_stamps, watch_camera
from station.doctor.checkup import examine
from station.doctor.disk import check_disk
from station.doctor.finding import Finding, Verdict, blocks, mends, summary_rows
from station.doctor.fixes import FIXES
from station.doctor.port import UDEV_RULE, System, check_port
from station.errors import StationError
from station.formats.rig import RigTable, parse_rig
from station.recording.sizes import ExpectedRates
from station.rig_reading import packaged, packaged_names

LATENCY_S = 0.03  # replies are waited for four times as long
RIG = """
schema = "rig/1"
[bus]
port = "{port}"
protocol = {protocol}
[[joint]]
name = "pan"
limits_deg = [-60, 60]
max_speed_deg_s = 60
[[joint.servo]]
id = 1
model = "{model}"
[[joint]]
name = "lift"
limits_deg = [-60, 60]
max_speed_deg_s = 60
[[joint.servo]]
id = 2
model = "{model}"
[[joint.servo]]
id = 3
model = "{model}"
sign = -1
ganging = "software"
[camera]
source = 0
size_px = [640, 480]
fps = 30
[markers]
dictionary = "DICT_4X4_50"
marker = [{{ id = 0, part = "base", size_mm = 50.8 }}]
"""
AX, X = ("AX-18A", 1.0), ("XM430-W350", 2.0)
BOTH = pytest.mark.parametrize(("model", "protocol"), [AX, X])


class Bench:
    """An emulated bus with the servos of RIG, and the doctor's look at it."""

    def __init__(self, bus: EmulatedBus, servos: dict[int, EmulatedServo], table: RigTable, clock: Clock) -> None:
        self.servos, self.bus = servos, bus
        self._table, self._clock = table, clock

    def examine(self, *fixes: str) -> BusReport:
        wire = Wire(self.bus.path, self._clock, LATENCY_S, 0.2)
        return examine_bus(wire, self._table, "arm.toml", fixes)


@contextmanager
def bench(
    model: str,
    protocol: float,
    *,
    ids: Iterable[int] = (1, 2, 3),
    models: dict[int, str] | None = None,
    counts: dict[int, int] | None = None,
    alter_reply: AlterReply | None = None,
    **physical: float,
) -> Iterator[Bench]:
    clock = VirtualClock()
    servos = {
        id: EmulatedServo(id, (models or {}).get(id, model), initial_count=(counts or {}).get(id), **physical)
        for id in ids
    }
    bus = EmulatedBus([*servos.values()], baud=1_000_000, clock=clock, alter_reply=alter_reply)
    for servo in servos.values():
        servo.set("return_delay_time", 0)
    with bus:
        table = parse_rig(RIG.format(port=bus.path, protocol=protocol, model=model), "arm.toml")
        yield Bench(bus, servos, table, clock)


def faults(report: BusReport) -> set[tuple[str, str, str]]:
    """(where, check, verdict) of all that isn't well."""
    return {(f.where, f.check, f.verdict.value) for f in report.findings if f.verdict is not Verdict.OK}


def find(findings: Iterable[Finding], where: str, check: str) -> Finding:
    (finding,) = (f for f in findings if f.where == where and f.check == check)
    return finding


OTHERS = [("MX-106", 1.0), ("MX-28(2.0)", 2.0), ("XL-320", 2.0), ("XL430-W250", 2.0), ("XC330-M181", 2.0)]


@pytest.mark.parametrize(("model", "protocol"), [AX, X, *OTHERS])
def test_a_sound_arm_has_no_fault(model: str, protocol: float):
    with bench(model, protocol) as arm:
        report = arm.examine()
    assert faults(report) == set() and not report.changes
    places = [finding.where for finding in report.findings]
    assert list(dict.fromkeys(places)) == [
        "servo 1 (pan)",
        "servo 2 (lift)",
        "servo 3 (lift)",
        "joint pan",
        "joint lift",
    ]
    voltage = find(report.findings, "servo 1 (pan)", "voltage")
    assert voltage.values["voltage_v"] == arm.servos[1].voltage_v and voltage.brief.endswith(" V")


def set_baud(arm: Bench) -> None:
    servo = arm.servos[2]
    servo.set("baud_rate", next(code for code, baud in servo.model.baud_codes.items() if baud == 57_600))


FAULTS: list[tuple[str, Callable[[Bench], object], set[tuple[str, str, str]]]] = [
    ("another baud", set_baud, {("servo 2 (lift)", "answers", "blocks")}),
    (
        "status level 0",
        lambda arm: arm.servos[2].set("status_return_level", 0),
        {("servo 2 (lift)", "status return level", "blocks")},
    ),
    (
        "status level 1",
        lambda arm: arm.servos[2].set("status_return_level", 1),
        {("servo 2 (lift)", "status return level", "blocks")},
    ),
    (
        "return delay",
        lambda arm: arm.servos[2].set("return_delay_time", 250),
        {("servo 2 (lift)", "return delay", "warning")},
    ),
    ("alarm", lambda arm: arm.bus.raise_alarm(2, "overload"), {("servo 2 (lift)", "alarms", "blocks")}),
]


@BOTH
@pytest.mark.parametrize(("name", "spoil", "expected"), FAULTS, ids=[fault[0] for fault in FAULTS])
def test_one_bad_servo_is_told_and_hides_no_other(
    model: str, protocol: float, name: str, spoil: Callable[[Bench], object], expected: set[tuple[str, str, str]]
):
    with bench(model, protocol) as arm:
        spoil(arm)
        report = arm.examine()
    told = faults(report)
    if name == "status level 0" and protocol == 1.0:  # there it doesn't even tell its model
        told.remove(("servo 2 (lift)", "model", "warning"))
    assert told == expected
    assert all(finding.mend for finding in report.findings if finding.verdict is not Verdict.OK)
    assert find(report.findings, "servo 3 (lift)", "voltage").verdict is Verdict.OK


def test_a_check_that_fails_leaves_the_others_to_be_done():
    """Servo 2 keeps silent when asked for registers of four bytes: its position and the limits of it."""

    def mute(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        return [] if servo_id == 2 and len(reply) == 15 else [(0, reply)]

    with bench(*X, alter_reply=mute) as arm:
        report = arm.examine()
    assert faults(report) == {("servo 2 (lift)", "position limits", "blocks"), ("joint lift", "position", "blocks")}
    for check in ("voltage", "alarms", "follows"):
        assert find(report.findings, "servo 2 (lift)", check).verdict is Verdict.OK


@BOTH
def test_a_servo_with_another_id_is_missing(model: str, protocol: float):
    with bench(model, protocol, ids=(1, 2, 9)) as arm:
        report = arm.examine()
    assert faults(report) == {("servo 3 (lift)", "answers", "blocks")}
    assert "station scan --rig arm.toml" in find(report.findings, "servo 3 (lift)", "answers").mend


@pytest.mark.parametrize(("model", "protocol", "other"), [(*AX, "AX-12A"), (*X, "XM430-W210")])
def test_another_model_is_told_by_name(model: str, protocol: float, other: str):
    with bench(model, protocol, models={2: other}) as arm:
        report = arm.examine()
    finding = find(report.findings, "servo 2 (lift)", "model")
    assert finding.verdict is Verdict.BLOCKS and other in finding.found and model in finding.found
    assert find(report.findings, "servo 2 (lift)", "temperature").verdict is Verdict.OK


@BOTH
def test_alarms_are_decoded(model: str, protocol: float):
    with bench(model, protocol) as arm:
        arm.bus.raise_alarm(1, "overheating")
        finding = find(arm.examine().findings, "servo 1 (pan)", "alarms")
    assert finding.found == "overheating" and finding.values["alarms"] == ["overheating"]
    assert ("reboot" in finding.mend) == (protocol == 2.0)


def test_modes_that_take_no_positions_block():
    with bench(*X) as arm:
        arm.servos[1].set("operating_mode", 1)
        arm.servos[2].set("drive_mode", 4)
        told = faults(arm.examine())
    assert told == {("servo 1 (pan)", "operating mode", "blocks"), ("servo 2 (lift)", "drive mode", "blocks")}
    with bench(*AX) as arm:
        for name in ("cw_angle_limit", "ccw_angle_limit"):
            arm.servos[1].set(name, 0)
        told = faults(arm.examine())
    assert ("servo 1 (pan)", "operating mode", "blocks") in told


def test_a_follower_by_secondary_id_that_the_rig_does_not_know_is_told():
    with bench(*X) as arm:
        arm.servos[3].set("secondary_id", 2)
        assert ("servo 3 (lift)", "follows", "blocks") in faults(arm.examine())


@BOTH
def test_limits_of_the_servo_inside_the_rigs_block(model: str, protocol: float):
    with bench(model, protocol) as arm:
        servo = arm.servos[1]
        servo.set(servo.model.position_limit_registers[1], servo.model.count(math.radians(30)))
        report = arm.examine()
    assert faults(report) == {("servo 1 (pan)", "position limits", "blocks")}


@BOTH
def test_a_joint_outside_its_limits_is_a_warning_and_outside_the_servos_own_blocks(model: str, protocol: float):
    count = EmulatedServo(1, model).model.count(math.radians(80))
    with bench(model, protocol, counts={1: count}) as arm:
        assert faults(arm.examine()) == {("joint pan", "position", "warning")}
        servo = arm.servos[1]
        servo.set(servo.model.position_limit_registers[1], servo.model.count(math.radians(70)))
        report = arm.examine()
    assert faults(report) == {("joint pan", "position", "blocks")}
    assert find(report.findings, "joint pan", "position").values["q_deg"] == pytest.approx(80, abs=0.2)  # a count


@BOTH
def test_ganged_servos_that_stand_apart_block(model: str, protocol: float):
    table = EmulatedServo(1, model).model
    counts = {2: table.count(math.radians(20)), 3: table.count(math.radians(-12))}
    with bench(model, protocol, counts=counts) as arm:
        report = arm.examine()
    assert faults(report) == {("joint lift", "ganged servos", "blocks")}
    spread = find(report.findings, "joint lift", "ganged servos").values["disagreement_deg"]
    assert spread == pytest.approx(8, abs=0.4)  # a count of each


@BOTH
def test_supply_and_temperature_are_held_against_the_servos_limits(model: str, protocol: float):
    with bench(model, protocol, voltage_v=19.0, temperature_c=90.0) as arm:
        report = arm.examine()
    assert ("servo 1 (pan)", "voltage", "blocks") in faults(report)
    assert ("servo 3 (lift)", "temperature", "blocks") in faults(report)


def test_ids_that_two_servos_share_block():
    def twice(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        return [(0, reply)] * (1 + (servo_id == 1))

    with bench(*AX, alter_reply=twice) as arm:
        assert ("servo 1 (pan)", "alone with its id", "blocks") in faults(arm.examine())


def registers(arm: Bench) -> dict[tuple[int, str], int]:
    return {
        (id, name): servo.get(name)
        for id, servo in arm.servos.items()
        for name, register in servo.model.registers.items()
        if register.writable
    }


def spoil_all(arm: Bench) -> None:
    for servo in arm.servos.values():
        servo.set("return_delay_time", 250)
    arm.servos[1].set("status_return_level", 0)
    arm.servos[2].set("status_return_level", 1)
    if "drive_mode" in arm.servos[1].model.registers:
        arm.servos[3].set("drive_mode", 5)
        arm.servos[3].set("operating_mode", 1)


@BOTH
def test_nothing_is_written_that_was_not_asked_for(model: str, protocol: float):
    with bench(model, protocol) as arm:
        spoil_all(arm)
        before = registers(arm)
        arm.examine()
        assert registers(arm) == before
        arm.examine("return-delay")  # the servo at level 0 can't be asked, and is left alone
        changed = {key for key, value in registers(arm).items() if value != before[key]}
    assert changed == {(2, "return_delay_time"), (3, "return_delay_time")}


@BOTH
def test_all_that_software_can_mend_is_mended_on_request(model: str, protocol: float):
    with bench(model, protocol) as arm:
        spoil_all(arm)
        report = arm.examine(*FIXES)
        assert faults(report) == set()
        assert all(change.done for change in report.changes)
        after = registers(arm)
        again = arm.examine(*FIXES)
    assert not again.changes
    assert all(after[id, "return_delay_time"] == 0 and after[id, "status_return_level"] == 2 for id in (1, 2, 3))
    if protocol == 2.0:
        assert after[3, "drive_mode"] == 1  # the other flag is as it was
        assert after[3, "operating_mode"] == 3


@BOTH
@pytest.mark.parametrize("fix", ["return-delay", "status-level"])
def test_a_servo_under_torque_is_not_written_to(model: str, protocol: float, fix: str):
    with bench(model, protocol) as arm:
        arm.servos[2].set("return_delay_time", 250)
        arm.servos[2].set("status_return_level", 1)
        arm.servos[2].set("torque_enable", 1)
        before = registers(arm)
        (change,) = arm.examine(fix).changes
        assert registers(arm) == before
    assert not change.done and "torque is on" in change.said


@pytest.mark.parametrize(("model", "protocol", "other"), [(*AX, "AX-12A"), (*X, "XM430-W210")])
def test_a_servo_of_another_model_is_not_written_to(model: str, protocol: float, other: str):
    with bench(model, protocol, models={2: other}) as arm:
        arm.servos[2].set("return_delay_time", 250)
        arm.servos[2].set("status_return_level", 1)
        changes = arm.examine("return-delay", "status-level").changes
        assert arm.servos[2].get("return_delay_time") == 250 and arm.servos[2].get("status_return_level") == 1
    assert [change.done for change in changes] == [False, False]


def test_a_locked_eeprom_is_said_to_be():
    with bench(*AX) as arm:
        arm.servos[1].set("return_delay_time", 250)
        arm.servos[1].set("lock", 1)
        (change,) = arm.examine("return-delay").changes
    assert not change.done and "locked" in change.said


def test_an_unknown_fix_lists_those_that_there_are():
    with pytest.raises(StationError, match="no fix 'everything'") as error:
        examine("demo", fixes=["everything"])
    assert all(name in str(error.value) for name in FIXES)


NOBODY = User("nobody", 65534, frozenset({65534}))
ME = User.of_this_program()


def made_system(folder: Path, latency: str | None = None) -> tuple[str, System]:
    """A port ttyUSB0 in a made /dev, with made /proc and /sys."""
    for name in ("dev", "proc", "sys"):
        (folder / name).mkdir()
    port = folder / "dev" / "ttyUSB0"
    port.touch(mode=0o660)
    if latency is not None:
        device = folder / "sys" / "bus" / "usb-serial" / "devices" / "ttyUSB0"
        device.mkdir(parents=True)
        (device / "latency_timer").write_text(latency)
    return str(port), System(folder / "dev", folder / "proc", folder / "sys")


def test_a_port_that_is_not_there_lists_those_that_are(tmp_path: Path):
    port, system = made_system(tmp_path)
    (finding,) = check_port("/dev/gone", ME, system)
    assert finding.verdict is Verdict.BLOCKS and port in finding.mend


def test_a_user_outside_the_ports_group_is_told_how_to_join(tmp_path: Path):
    port, system = made_system(tmp_path)
    finding = find(check_port(port, NOBODY, system), "port", "permission")
    assert finding.verdict is Verdict.BLOCKS and "usermod -aG" in finding.mend and "nobody" in finding.mend
    assert not blocks(check_port(port, ME, system))


def test_the_holder_of_a_port_is_named(tmp_path: Path):
    port, system = made_system(tmp_path)
    holder = system.proc / "4711"
    (holder / "fd").mkdir(parents=True)
    (holder / "fd" / "3").symlink_to(port)
    (holder / "cmdline").write_bytes(b"/usr/bin/python3\0run.py\0")
    (holder / "comm").write_text("python3\n")
    finding = find(check_port(port, ME, system), "port", "held by")
    assert finding.verdict is Verdict.BLOCKS and "4711" in finding.found and "run.py" in finding.mend


@pytest.mark.parametrize(("latency", "verdict"), [("16\n", Verdict.WARNING), ("1\n", Verdict.OK), (None, Verdict.OK)])
def test_a_slow_latency_timer_comes_with_the_rule_that_mends_it(tmp_path: Path, latency: str | None, verdict: Verdict):
    port, system = made_system(tmp_path, latency)
    finding = find(check_port(port, ME, system), "port", "latency timer")
    assert finding.verdict is verdict
    assert (UDEV_RULE in finding.mend) == (verdict is Verdict.WARNING)


def black(clock: Clock, fps: float) -> RenderedCamera:
    def render(t_ns: int, index: int) -> np.ndarray:
        return np.zeros((48, 64, 3), np.uint8)

    return RenderedCamera(
        render, size_px=(64, 48), fps=fps, exposure_s=0.005, latency_s=0.01, clock=clock, realtime=False
    )


def test_the_frame_rate_is_measured():
    clock = VirtualClock()
    watched = watch_camera(black(clock, 30.0), clock, fps=30.0)
    rate = find(watched.findings, "camera", "frame rate")
    assert rate.verdict is Verdict.OK and rate.values["rate_hz"] == pytest.approx(30.0)
    assert watched.image is not None
    slow = find(watch_camera(black(clock, 15.0), clock, fps=30.0).findings, "camera", "frame rate")
    assert slow.verdict is Verdict.WARNING and slow.values["rate_hz"] == pytest.approx(15.0) and slow.mend


class Broken:
    """A camera that can't be opened, or gives no frame."""

    size_px, fps, dropped, stale = (64, 48), 30.0, 0, 0
    settings = MappingProxyType({})

    def __init__(self, clock: Clock, *, opens: bool) -> None:
        self._clock, self._opens = clock, opens

    def start(self) -> None:
        if not self._opens:
            raise NoCamera("camera 0: there is no /dev/video0")

    def read(self, until_ns: int) -> Frame | None:
        self._clock.sleep_until_ns(until_ns)
        return None

    def close(self) -> None:
        pass


@pytest.mark.parametrize(("opens", "check"), [(False, "opens"), (True, "frame rate")])
def test_a_camera_that_gives_nothing_blocks(opens: bool, check: str):
    clock = VirtualClock()
    watched = watch_camera(Broken(clock, opens=opens), clock, fps=30.0)
    finding = find(watched.findings, "camera", check)
    assert finding.verdict is Verdict.BLOCKS and finding.mend and watched.image is None


def test_an_exposure_that_varies_comes_with_the_command_that_locks_it():
    (finding,) = check_locks({"exposure_locked": True, "exposure_ms": 8.0}, 2)
    assert finding.verdict is Verdict.OK and finding.found == "exposure locked at 8 ms"
    for settings in ({"exposure_locked": False}, {}):
        (finding,) = check_locks(settings, 2)
        assert finding.verdict is Verdict.WARNING and "v4l2-ctl -d /dev/video2 -c auto_exposure=1" in finding.mend
        assert "exposure_ms = 8 under [camera]" in finding.mend
    (finding,) = check_locks({}, "http://camera/video")
    assert "v4l2" not in finding.mend


def test_a_focus_that_moves_is_told():
    for locked, verdict in ((True, Verdict.OK), (False, Verdict.WARNING)):
        _, focus = check_locks({"exposure_locked": True, "focus_locked": locked}, 2)
        assert (focus.check, focus.verdict) == ("focus", verdict)


class Frozen(Broken):
    """A camera that gave the same picture five times beside its ten frames, two of them without a driver's stamp."""

    stale = 5
    given = 0

    def read(self, until_ns: int) -> Frame | None:
        t_ns = self._clock.now_ns() + 33_000_000
        self._clock.sleep_until_ns(t_ns)
        self.given += 1
        kind = "arrival" if self.given in (3, 7) else "driver"
        return Frame(self.given, t_ns, np.zeros((48, 64, 3), np.uint8), kind) if self.given <= 10 else None


def test_stale_frames_and_what_stamps_the_others_are_told():
    clock = VirtualClock()
    watched = watch_camera(Frozen(clock, opens=True), clock, fps=30.0)
    fresh = find(watched.findings, "camera", "fresh frames")
    assert fresh.verdict is Verdict.WARNING and fresh.values == {"stale": 5} and fresh.mend
    assert watched.stamps == {"driver": 8, "arrival": 2}
    mixed = check_stamps(watched.stamps, 0.03)
    assert mixed.verdict is Verdict.WARNING and "8 by the camera's driver, 2 at arrival" in mixed.found


def test_a_rig_without_a_latency_is_told():
    assert check_stamps({"arrival": 60}, 0.03).verdict is Verdict.OK
    assert check_stamps({"driver": 60}, 0.0).verdict is Verdict.WARNING


@pytest.mark.parametrize(
    ("free_minutes", "verdict"), [(0.5, Verdict.BLOCKS), (5.0, Verdict.WARNING), (500.0, Verdict.OK)]
)
def test_the_disk_is_held_against_a_minute_of_capture(tmp_path: Path, free_minutes: float, verdict: Verdict):
    rates = ExpectedRates(fps=30.0, image_bytes=80e3, markers=12, joints=4, servos=6)
    minute_bytes = check_disk(tmp_path, 0, rates).values["minute_bytes"]
    assert isinstance(minute_bytes, int) and minute_bytes > 60 * 30 * 80e3
    assert check_disk(tmp_path, round(free_minutes * minute_bytes), rates).verdict is verdict


@pytest.mark.parametrize("rig", packaged_names("rigs"))
def test_packaged_rigs_pass_on_emulated_bus_and_rendered_camera(rig: str):
    checkup = examine(rig)
    assert checkup.passed
    assert find(checkup.findings, "camera", "frame rate").values["rate_hz"] == pytest.approx(30.0)
    assert {"port", "camera", "calibration", "disk"} <= {finding.where for finding in checkup.findings}


def test_all_is_examined_though_port_camera_and_calibration_are_wrong(tmp_path: Path):
    text = packaged("rigs", "demo").read_text(encoding="utf-8")
    text = text.replace('"emulated"', '"/dev/gone"').replace('"rendered"', '"/dev/video77"')
    path = tmp_path / "arm.toml"
    path.write_text(text.replace("size_px = [640, 480]\nfps", "size_px = [320, 240]\nfps"), encoding="utf-8")
    checkup = examine(str(path), folder=tmp_path)
    blocked = {finding.where for finding in checkup.findings if finding.verdict is Verdict.BLOCKS}
    assert blocked == {"port", "servos", "camera", "calibration"} and not checkup.passed
    simulated = examine(str(path), folder=tmp_path, simulate=True)
    blocked = {finding.where for finding in simulated.findings if finding.verdict is Verdict.BLOCKS}
    assert blocked == {"calibration", "camera"}  # which can't be rendered without one


def test_a_bus_that_another_program_uses_is_not_disturbed(tmp_path: Path):
    asked: list[int] = []

    def note(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        asked.append(servo_id)
        return [(0, reply)]

    _, system = made_system(tmp_path)
    with bench(*AX, alter_reply=note) as arm:
        path = tmp_path / "arm.toml"
        path.write_text(RIG.format(port=arm.bus.path, protocol=1.0, model="AX-18A"), encoding="utf-8")
        holder = system.proc / "4711"
        (holder / "fd").mkdir(parents=True)
        (holder / "fd" / "3").symlink_to(Path(arm.bus.path).resolve())
        (holder / "cmdline").write_bytes(b"other\0")
        (holder / "comm").write_text("other\n")
        checkup = examine(str(path), folder=tmp_path, system=system)
    assert not asked and not checkup.passed
    assert find(checkup.findings, "servos", "answer").verdict is Verdict.BLOCKS


def finding(where: str, verdict: Verdict, mend: str = "", brief: str = "") -> Finding:
    return Finding(where, "look", verdict, "this", mend, brief=brief)


def test_what_is_well_takes_a_row_a_place_and_what_is_not_a_row_each():
    rows = summary_rows(
        [finding("a", Verdict.OK, brief="12 V"), finding("a", Verdict.OK), finding("a", Verdict.BLOCKS)]
    )
    assert rows == [
        ["where", "verdict", "found"],
        ["a", "ok", "12 V, 1 more check passed"],
        ["a", "blocks", "look: this"],
    ]


def test_a_long_finding_is_cut_to_the_table_and_whole_in_json():
    long = Finding("servo 12 (shoulder)", "look", Verdict.WARNING, "x" * 200)
    _, row = summary_rows([long])
    assert sum(map(len, row)) <= 100 - 8 and row[2].endswith("x…")
    assert long.as_dict()["found"] == "x" * 200


def test_mends_are_said_once_what_blocks_first():
    findings = [finding(name, Verdict.WARNING, "oil") for name in "abcd"] + [finding("e", Verdict.BLOCKS, "glue")]
    assert mends(findings) == ["e: glue", "a, b and 2 more: oil"]
