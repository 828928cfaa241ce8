"""The arm over the emulated bus: joints in radians, limits before anything is sent, errors that name the joint."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers.arm import Arm
from drivers.clock import VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.emulator import EmulatedBus, EmulatedServo
from drivers.emulator.bus import AlterReply
from drivers.errors import ArmFault, BusLost, DriverError, NoReply, ServoFault, WrongModel
from drivers.joints import JointConfig, ServoConfig
from drivers.packets import FrameReader, Instruction
from drivers.servo_models import load_model

S = 1_000_000_000
BOTH = pytest.mark.parametrize(("model", "protocol"), [("AX-18A", 1.0), ("XM430-W350", 2.0)])


def paper_joints(model: str) -> tuple[JointConfig, ...]:
    """Base, a shoulder and an elbow on two mirrored servos each, a wrist."""
    zero = load_model(model).zero_count

    def joint(name: str, *servos: ServoConfig) -> JointConfig:
        return JointConfig(name, servos, -1.5, 1.5, 1.6)

    return (
        joint("base", ServoConfig(1, model)),
        joint(
            "shoulder", ServoConfig(2, model, zero + 20), ServoConfig(3, model, zero - 11, sign=-1, ganging="software")
        ),
        joint("elbow", ServoConfig(4, model), ServoConfig(5, model, sign=-1, ganging="software")),
        joint("wrist", ServoConfig(6, model, sign=-1)),
    )


@dataclass
class Bench:
    arm: Arm
    bus: DynamixelBus
    emulated: EmulatedBus
    clock: VirtualClock
    servos: dict[int, EmulatedServo]

    def pass_s(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + int(seconds * S))

    def talk_s(self, seconds: float) -> None:
        """Let time pass with a read every half second, as a station does: the servos' watchdogs hear it."""
        for _ in range(round(2 * seconds)):
            self.pass_s(0.5)
            self.arm.read()


@contextmanager
def bench(
    model: str = "AX-18A",
    protocol: float = 1.0,
    *,
    joints: Sequence[JointConfig] | None = None,
    counts: dict[int, int] | None = None,
    present: Iterable[int] = range(1, 7),
    timeout_s: float = 5.0,
    alter_reply: AlterReply | None = None,
) -> Iterator[Bench]:
    joints = joints or paper_joints(model)
    zeros = {servo.id: servo.zero for joint in joints for servo in joint.servos}
    servos = {
        id: EmulatedServo(id, model, initial_count=(zeros | (counts or {})).get(id), protocol=protocol)
        for id in present
    }
    clock = VirtualClock()
    with (
        EmulatedBus(list(servos.values()), baud=1_000_000, clock=clock, alter_reply=alter_reply) as emulated,
        DynamixelBus(emulated.path, baud=1_000_000, protocol=protocol, clock=clock, reply_timeout_s=timeout_s) as bus,
    ):
        yield Bench(Arm(bus, joints, clock), bus, emulated, clock, servos)


def ready(b: Bench, joints: int = 4) -> Arm:
    b.arm.connect()
    b.arm.set_speeds([1.0] * joints)
    b.arm.torque_on()
    return b.arm


@BOTH
def test_joints_go_where_they_are_sent(model: str, protocol: float) -> None:
    with bench(model, protocol) as b:
        arm = ready(b)
        assert arm.names == ("base", "shoulder", "elbow", "wrist")
        goal = [1.0, -0.7, 0.4, 1.4]
        stamp_ns = arm.command(goal)
        assert np.abs(arm.read().q).max() < 0.02  # it takes time
        assert stamp_ns < b.clock.now_ns()
        b.talk_s(3)
        reading = arm.read()
        count = load_model(model).rad_per_count
        np.testing.assert_allclose(reading.q, goal, atol=count / 2 + 1e-12)
        shafts = [b.emulated.shaft_rad(id, b.clock.now_ns()) for id in range(1, 7)]
        # sign * (shaft - shaft at zero), the mirrored ones against the others; half a count
        np.testing.assert_allclose(
            shafts, [1.0, -0.7 + 20 * count, 0.7 - 11 * count, 0.4, -0.4, -1.4], atol=count / 2 + 1e-12
        )
        assert not any(arm.bus_errors.values())


@BOTH
def test_ganged_servos_move_as_one(model: str, protocol: float) -> None:
    with bench(model, protocol) as b:
        arm = ready(b)
        arm.command([0.0, 1.0, -1.0, 0.0])
        arm.read()
        start_ns = b.clock.now_ns()
        b.pass_s(2)
        count = load_model(model).rad_per_count
        for t_ns in range(start_ns, start_ns + 2 * S, S // 50):
            left, right = (b.emulated.shaft_rad(id, t_ns) for id in (2, 3))
            # zeros at +20 and -11 counts; each goal is rounded to a count
            assert left + right == pytest.approx(9 * count, abs=count + 1e-9)


@BOTH
def test_a_reading_is_stamped(model: str, protocol: float) -> None:
    with bench(model, protocol) as b:
        arm = ready(b)
        before_ns = b.clock.now_ns()
        reading = arm.read()
        assert before_ns <= reading.t_request_ns < reading.t_ns < reading.t_reply_ns == b.clock.now_ns()
        assert np.all((reading.t_request_ns < reading.t_joint_ns) & (reading.t_joint_ns < reading.t_reply_ns))
        assert reading.q.flags.writeable is False


@BOTH
def test_no_joint_is_faster_than_its_limit(model: str, protocol: float) -> None:
    with bench(model, protocol) as b:
        b.arm.connect()
        b.arm.set_speeds([0.5, 1.0, 1.5, 1.6])
        b.arm.torque_on()
        b.arm.command([1.4, 1.4, 1.4, 1.4])
        b.arm.read()
        start_ns = b.clock.now_ns()
        b.pass_s(2)
        for id, limit in ((1, 0.5), (2, 1.0), (3, 1.0), (4, 1.5), (6, 1.6)):
            shaft = np.array([b.emulated.shaft_rad(id, start_ns + k * S // 100) for k in range(100)])
            fastest = np.abs(np.diff(shaft)).max() * 100
            # at most the limit (1e-6: rounding), and no less than a unit under it
            assert limit - load_model(model).speed_unit_rad_s - 1e-6 <= fastest <= limit + 1e-6


def test_a_speed_register_is_never_set_to_0() -> None:
    with bench() as b:
        b.arm.connect()
        unit = load_model("AX-18A").speed_unit_rad_s
        b.arm.set_speeds([unit, 1.999 * unit, 2 * unit, 1.6])
        assert [b.bus.read(id, "moving_speed") for id in (1, 2, 4)] == [1, 1, 2]
        for speeds, message in (
            ([0.9 * unit, 1, 1, 1], "'base'.*slower than AX-18A can go"),
            ([1, 0.0, 1, 1], "'shoulder': speed 0"),
            ([1, 1, 1.7, 1], "'elbow': speed 1.7 rad/s; its limit is 1.6"),
            ([1, 1, 1, math.nan], "'wrist'"),
            ([1, 1], "shape"),
        ):
            with pytest.raises(ArmFault, match=message):
                b.arm.set_speeds(speeds)
        assert [b.bus.read(id, "moving_speed") for id in (1, 2, 4)] == [1, 1, 2]


def test_x_servos_get_a_moderate_acceleration() -> None:
    with bench("XM430-W350", 2.0) as b:
        b.arm.connect()
        b.arm.set_speeds([1.0] * 4)
        unit = load_model("XM430-W350").acceleration_unit_rad_s2
        assert unit is not None
        assert 0 < b.bus.read(1, "profile_acceleration") * unit <= 10.0
        assert b.bus.read(1, "profile_velocity") == math.floor(1.0 / (0.229 * 2 * math.pi / 60))


@BOTH
def test_torque_on_moves_nothing(model: str, protocol: float) -> None:
    joints = paper_joints(model)
    counts = {1: 400, 2: 530, 3: 490, 4: 600} if protocol == 1.0 else {1: 1800, 2: 2200, 3: 1905}
    if protocol == 1.0:
        counts[5] = 1024 - 600
    with bench(model, protocol, joints=joints, counts=counts) as b:
        b.arm.connect()
        before = b.arm.read().q
        b.bus.write(1, "goal_position", 300)  # left behind by another program
        b.arm.torque_on()
        assert all(servo.get("torque_enable") for servo in b.servos.values())
        b.talk_s(2)
        np.testing.assert_array_equal(b.arm.read().q, before)
        # and even without set_speeds it is limited, to the joints' own speeds
        register = load_model(model).speed_register
        assert all(0 < b.bus.read(id, register) * load_model(model).speed_unit_rad_s <= 1.6 for id in b.servos)
        b.arm.torque_off()
        assert not any(servo.get("torque_enable") for servo in b.servos.values())


@BOTH
def test_a_command_outside_the_limits_sends_nothing(model: str, protocol: float) -> None:
    with bench(model, protocol) as b:
        arm = ready(b)
        before_ns, goals = b.clock.now_ns(), [servo.get("goal_position") for servo in b.servos.values()]
        for q, message in (
            ([0, 0, 1.51, 0], r"'elbow': commanded to 86.52 deg; its limits are -85.94 deg to 85.94 deg"),
            ([0, 0, 0, math.nan], "'wrist'"),
            ([0, 0, 0], "shape"),
        ):
            with pytest.raises(ArmFault, match=message):
                arm.command(q)
        assert b.clock.now_ns() == before_ns
        assert [servo.get("goal_position") for servo in b.servos.values()] == goals
        arm.command([1.5, -1.5, 1.5, -1.5])  # the limits themselves are inside
        arm.read()


def test_nothing_is_commanded_before_connect_and_torque() -> None:
    with bench() as b:
        for call in (lambda: b.arm.read(), lambda: b.arm.torque_on(), lambda: b.arm.set_speeds([1] * 4)):
            with pytest.raises(ArmFault, match="connect"):
                call()
        b.arm.connect()
        with pytest.raises(ArmFault, match="torque is off"):
            b.arm.command([0.0] * 4)


@BOTH
def test_a_servo_of_another_model_is_found_before_any_write(model: str, protocol: float) -> None:
    other = {"AX-18A": "AX-12A", "XM430-W350": "XL430-W250"}[model]
    joints = list(paper_joints(model))
    joints[2] = replace(joints[2], servos=(ServoConfig(4, model), ServoConfig(5, other, ganging="software")))
    sent = FrameReader(protocol)
    with bench(model, protocol, joints=joints) as b:
        written: list[bytes] = []
        write_port = b.bus._port.writePort
        b.bus._port.writePort = lambda packet: (written.append(bytes(packet)), write_port(packet))[1]  # type: ignore
        number = load_model(model).model_number
        with pytest.raises(WrongModel, match=rf"servo 5 \(elbow\).*model number {number}; {other} is") as caught:
            b.arm.connect()
        assert (caught.value.servo_id, caught.value.have) == (5, number)
        instructions = {frame.body[0] for frame in sent.feed(b"".join(written))}
        assert instructions <= {Instruction.PING, Instruction.READ}


def test_a_missing_servo_is_named_with_its_joint() -> None:
    with bench(present=(1, 2, 4, 5, 6), timeout_s=0.03) as b, pytest.raises(NoReply) as caught:
        b.arm.connect()
    assert str(caught.value).startswith("no reply from servo 3 (shoulder) on /")
    assert str(caught.value).endswith("at 1000000 baud, protocol 1.0; check power and cable, baud and id in rig.toml")


@BOTH
def test_an_alarm_is_a_fault_of_the_joint(model: str, protocol: float) -> None:
    with bench(model, protocol) as b:
        arm = ready(b)
        b.emulated.raise_alarm(5, "overload")
        with pytest.raises(ServoFault, match=r"servo 5 \(elbow\).*reports overload") as caught:
            arm.read()
        assert (caught.value.servo_id, caught.value.flags) == (5, ("overload",))
        arm.torque_off()  # an alarm doesn't keep the arm from being let go
        assert not any(servo.get("torque_enable") for servo in b.servos.values())
        with pytest.raises(ServoFault, match="elbow"):
            arm.connect()


def test_ganged_servos_that_disagree_are_a_fault() -> None:
    with bench(counts={2: 532, 3: 501 + 40}) as b:  # 40 counts: 11.7 deg
        b.arm.connect()
        with pytest.raises(ArmFault, match=r"'shoulder'.*servo 2 at 0.00 deg, servo 3 at -11.73 deg") as caught:
            b.arm.read()
        assert caught.value.joint == "shoulder"


def test_ganged_servos_that_disagree_get_no_torque() -> None:
    with bench(counts={2: 532, 3: 501 + 40}) as b:
        b.arm.connect()
        with pytest.raises(ArmFault, match="disagree"):
            b.arm.torque_on()
        assert not any(servo.get("torque_enable") for servo in b.servos.values())


def test_disagreement_is_of_the_shafts_and_not_of_the_geared_joint() -> None:
    def servo(id: int, zero: int) -> ServoConfig:
        return ServoConfig(id, "AX-18A", zero, ratio=4.0, ganging=None if id == 1 else "software")

    joint = JointConfig("slow", (servo(1, 512), servo(2, 500)), -0.3, 0.3, 0.3)
    for apart, fine in ((12, True), (12 + 20, False)):  # 20 counts: 5.9 deg of the shaft, 1.5 deg of the joint
        with bench(joints=[joint], present=(1, 2), counts={1: 512, 2: 500 + apart - 12}) as b:
            b.arm.connect()
            if fine:
                b.arm.read()
            else:
                with pytest.raises(ArmFault, match="disagree"):
                    b.arm.read()


def test_a_silent_servo_does_not_keep_the_others_from_being_stopped() -> None:
    mute = [False]

    def speak(servo_id: int, reply: bytes) -> Iterable[tuple[int, bytes]]:
        return () if mute[0] and servo_id == 1 else ((0, reply),)

    with bench(alter_reply=speak, timeout_s=0.1) as b:
        arm = ready(b)
        arm.command([0.5] * 4)
        arm.read()
        b.pass_s(0.2)
        mute[0] = True
        with pytest.raises(NoReply, match=r"servo 1 \(base\)"):
            arm.stop()
        for id in range(2, 7):
            here = b.servos[id].model.count(b.emulated.shaft_rad(id, b.clock.now_ns()))
            assert abs(b.servos[id].get("goal_position") - here) <= 12  # it was moving: 1 rad/s, some ms ago


@pytest.mark.parametrize(("model", "protocol"), [("AX-18A", 1.0), ("MX-28", 1.0)])
def test_torque_lost_by_a_shutdown_is_given_back_when_it_is_switched_on(model: str, protocol: float) -> None:
    with bench(model, protocol) as b:
        arm = ready(b)
        b.servos[1].set("torque_limit", 0)  # what a shutdown leaves
        arm.torque_off()
        arm.torque_on()
        assert b.servos[1].get("torque_limit") == b.servos[1].get("max_torque") > 0
        arm.command([0.5] * 4)
        b.talk_s(2)
        assert arm.read().q[0] == pytest.approx(0.5, abs=0.01)


def followers(ganging: str, *, sign: int = 1, reversed: bool | None = None) -> tuple[JointConfig, ...]:
    leader = ServoConfig(1, "XM540-W270")
    follower = ServoConfig(2, "XM540-W270", sign=sign, ganging=ganging, reversed=reversed)  # type: ignore[arg-type]
    return (JointConfig("lift", (leader, follower), -1.0, 1.0, 1.0),)


def test_a_follower_by_secondary_id_takes_its_leaders_goals_and_has_its_speed() -> None:
    with bench("XM540-W270", 2.0, joints=followers("secondary_id", reversed=True), present=(1, 2)) as b:
        b.servos[2].set("secondary_id", 1)
        b.servos[2].set("drive_mode", 1)
        arm = ready(b, joints=1)
        assert b.servos[1].get("profile_velocity") == b.servos[2].get("profile_velocity") > 0
        arm.command([0.5])
        b.talk_s(2)
        assert arm.read().q == pytest.approx([0.5], abs=0.002)
        left, right = (b.emulated.shaft_rad(id, b.clock.now_ns()) for id in (1, 2))
        assert left == pytest.approx(-right, abs=0.002)  # they face each other


def test_a_follower_by_secondary_id_that_does_not_take_the_speed_is_found() -> None:
    with bench("XM540-W270", 2.0, joints=followers("secondary_id"), present=(1, 2)) as b:
        b.servos[2].set("secondary_id", 1)
        write, speed = b.servos[2].write, b.servos[2].model.registers["profile_velocity"]

        def ignore(address: int, data: bytes, t_ns: int, **how: bool) -> None:
            if address != speed.address:
                write(address, data, t_ns, **how)

        b.servos[2].write = ignore  # type: ignore[method-assign]
        b.arm.connect()
        with pytest.raises(ServoFault, match=r"servo 2 \(lift\): wrote 41 to 'profile_velocity', it reads 0"):
            b.arm.set_speeds([1.0])


def test_a_follower_by_sync_cable_is_sent_no_goal() -> None:
    with bench("XM540-W270", 2.0, joints=followers("sync_cable", sign=-1), present=(1, 2)) as b:
        b.servos[2].set("drive_mode", 2)
        b.servos[2].follow(b.servos[1], twisted=True)
        goal = b.servos[2].get("goal_position")
        arm = ready(b, joints=1)
        arm.command([0.5])
        b.talk_s(2)
        assert arm.read().q == pytest.approx([0.5], abs=0.002)
        assert b.servos[2].get("goal_position") == goal
        arm.stop()
        assert b.servos[2].get("goal_position") == goal


@pytest.mark.parametrize(
    ("joints", "secondary_id", "drive_mode", "said"),
    [
        (followers("secondary_id"), 255, 0, "has secondary id 255; to follow servo 1 it must be 1"),
        (followers("secondary_id", reversed=True), 1, 0, "reverse bit of its drive mode off; the rig wants it on"),
        (followers("secondary_id", reversed=False), 1, 1, "reverse bit of its drive mode on; the rig wants it off"),
        (followers("software", sign=-1), 1, 0, "takes the goals of servo 1 by its secondary id"),
        (followers("sync_cable", sign=-1), 255, 0, "isn't set to follow by its sync cable; set bit 1"),
    ],
)
def test_a_follower_that_is_set_up_otherwise_is_told(
    joints: tuple[JointConfig, ...], secondary_id: int, drive_mode: int, said: str
) -> None:
    with bench("XM540-W270", 2.0, joints=joints, present=(1, 2)) as b:
        b.servos[2].set("secondary_id", secondary_id)
        b.servos[2].set("drive_mode", drive_mode)
        with pytest.raises(ServoFault, match=said):
            b.arm.connect()


def test_the_servos_own_limits_count_in_position_mode_alone() -> None:
    for mode, fine in ((3, False), (4, True), (5, True)):
        with bench("XM430-W350", 2.0) as b:
            b.servos[1].set("operating_mode", mode)
            b.servos[1].set("min_position_limit", 2000)
            if fine:
                b.arm.connect()
            else:
                with pytest.raises(ArmFault, match="goes from count 2000"):
                    b.arm.connect()


def test_settings_that_cannot_work_are_told_at_connect() -> None:
    def connect(model: str, protocol: float, register: str, value: int) -> str:
        with bench(model, protocol, timeout_s=0.1) as b:
            b.servos[4].set(register, value)
            with pytest.raises(DriverError) as caught:
                b.arm.connect()
            return str(caught.value)

    assert "servo 4 (elbow)" in (text := connect("AX-18A", 1.0, "status_return_level", 1))
    assert "its status return level is 1, set it to 2" in text
    assert "is in velocity mode" in connect("XM430-W350", 2.0, "operating_mode", 1)
    assert "time-based profile" in connect("XM430-W350", 2.0, "drive_mode", 4)
    assert "limits are 219 to 805" in connect("AX-18A", 1.0, "cw_angle_limit", 300)
    assert "answers pings, but no reads" in connect("XM430-W350", 2.0, "status_return_level", 0)


def test_a_servo_that_ignores_a_write_is_found_by_reading_back() -> None:
    with bench() as b:
        b.arm.connect()
        write = b.servos[6].write

        def ignore(address: int, data: bytes, t_ns: int, **how: bool) -> None:
            if address != b.servos[6].model.registers["torque_enable"].address:
                write(address, data, t_ns, **how)

        b.servos[6].write = ignore  # type: ignore[method-assign]
        with pytest.raises(ServoFault, match=r"servo 6 \(wrist\): wrote 1 to 'torque_enable', it reads 0"):
            b.arm.torque_on()
        assert not any(servo.get("torque_enable") for servo in b.servos.values())  # all are let go again


def test_a_lost_bus_is_told_by_every_call() -> None:
    with bench() as b:
        arm = ready(b)
        b.emulated.close()
        for call in (arm.read, lambda: arm.command([0.0] * 4), arm.torque_off):
            with pytest.raises(BusLost):
                call()


def test_wrong_configurations_say_so() -> None:
    servo = ServoConfig(1, "AX-18A")
    for make, message in (
        (lambda: JointConfig("a", (), -1, 1, 1), "no servo"),
        (lambda: JointConfig("a", (ServoConfig(1, "AX-18A", sign=2),), -1, 1, 1), "sign"),
        (lambda: JointConfig("a", (servo,), 1, -1, 1), "no range"),
        (lambda: JointConfig("a", (servo,), -1, 1, 0), "positive"),
    ):
        with pytest.raises(DriverError, match=message):
            make()
    clock = VirtualClock()
    bus = DynamixelBus("/dev/null", baud=1_000_000, protocol=2.0, clock=clock)
    with pytest.raises(DriverError, match=r"AX-18A doesn't speak 2\.0"):
        Arm(bus, [JointConfig("a", (servo,), -1, 1, 1)], clock)
    with pytest.raises(DriverError, match="a servo appears twice"):
        Arm(bus, [JointConfig(name, (servo,), -1, 1, 1) for name in "ab"], clock)


@BOTH
def test_two_runs_of_a_motion_are_the_same(model: str, protocol: float) -> None:
    def run() -> list[object]:
        seen: list[object] = []
        with bench(model, protocol) as b:
            arm = ready(b)
            for k in range(40):
                seen.append(arm.command([0.03 * k, 0.5, -0.02 * k, 1.0 if k % 20 < 10 else -1.0]))
                reading = arm.read()
                seen.append((reading.t_request_ns, reading.t_reply_ns, reading.q.tobytes()))
                b.pass_s(0.02)
            arm.torque_off()
            seen.append(b.clock.now_ns())
        return seen

    assert run() == run()
