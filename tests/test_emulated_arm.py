"""A rig's servos on the emulated bus: built as the rig says, with the load, play and faults of its simulation."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.dynamixel import DynamixelBus
from drivers.errors import DriverError, NoReply
from station.emulated_arm import EmulatedArm
from station.errors import InvalidFile
from station.formats.rig import RigTable, parse_rig
from station.rig import load_rig, open_rig
from station.rig_reading import packaged

DEMO = packaged("rigs", "demo").read_text(encoding="utf-8")
MANIPULATOR = packaged("rigs", "openmanipulator_x").read_text(encoding="utf-8")
S = 1_000_000_000


def with_simulation(text: str, lines: str) -> RigTable:
    return parse_rig(text.replace("[simulation]\n", f"[simulation]\n{lines}\n", 1), "my.toml")


@contextmanager
def arm_and_bus(
    table: RigTable, *, timeout_s: float = 0.5, **settings: object
) -> Iterator[tuple[EmulatedArm, DynamixelBus, VirtualClock]]:
    clock = VirtualClock()
    with (
        EmulatedArm(table, table.simulation, clock, **settings) as arm,  # type: ignore[arg-type]
        DynamixelBus(
            arm.path, baud=table.bus.baud, protocol=table.bus.protocol, clock=clock, reply_timeout_s=timeout_s
        ) as bus,
    ):
        yield arm, bus, clock


def test_faults_of_the_simulation_befall_the_arm() -> None:
    with arm_and_bus(with_simulation(DEMO, 'faults = ["mute:3@2+1"]')) as (_, bus, clock):
        bus.ping(3)
        clock.sleep_until_ns(2 * S)
        bus.ping(2)
        with pytest.raises(NoReply):
            bus.ping(3)
        clock.sleep_until_ns(3 * S)
        bus.ping(3)


def test_the_sessions_seed_decides_about_the_faults() -> None:
    table = with_simulation(DEMO, 'faults = ["temperature:1%0.5=70"]')

    def heated(seed: int | None) -> bool:
        with arm_and_bus(table, seed=seed) as (_, bus, _):
            return bus.read(1, "present_temperature") > 60

    drawn = [heated(seed) for seed in range(10)]
    assert 0 < sum(drawn) < 10 and drawn == [heated(seed) for seed in range(10)]
    assert heated(None) == heated(0)  # the rig's own


def test_a_fault_that_can_not_be_read_is_refused_with_the_rig() -> None:
    with pytest.raises(InvalidFile, match=r"simulation, faults: .*no fault kind 'mte'; there are mute"):
        with_simulation(DEMO, 'faults = ["mte"]')
    table = with_simulation(DEMO, 'faults = ["mute:77"]')
    with pytest.raises(DriverError, match="no servo 77 on this bus; it has 1, 2, 3"):
        EmulatedArm(table, table.simulation, VirtualClock())


def test_an_open_rig_has_its_faults(tmp_path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(DEMO.replace("[simulation]\n", '[simulation]\nfaults = ["mute:6"]\n', 1), encoding="utf-8")
    with pytest.raises(NoReply, match=r"servo 6 \(wrist\)"), open_rig(load_rig(str(path))) as rig:
        rig.arm.connect()


def test_without_mass_an_arm_carries_no_load() -> None:
    table = parse_rig(MANIPULATOR, "my.toml")
    with arm_and_bus(table) as (arm, bus, clock):
        bus.write(12, "torque_enable", 1)
        clock.sleep_until_ns(S)
        assert bus.read(12, "present_current") == 0
        np.testing.assert_allclose(arm.joint_states(clock.now_ns()), 0.0, atol=1e-12)


def heavy(mass_kg: float) -> RigTable:
    """The manipulator with a mass on its gripper, 130 mm in front of joint 4's axis, 278 mm in front of joint 2's."""
    old = 'child = "gripper"\n'
    assert old in MANIPULATOR
    return parse_rig(MANIPULATOR.replace(old, f"{old}mass_kg = {mass_kg}\ncentre_mm = [290, 0, 205]\n"), "my.toml")


def test_a_weight_makes_the_arm_sag_and_its_servos_pull() -> None:
    with arm_and_bus(heavy(0.2), timeout_s=10.0) as (arm, bus, clock):
        for id in (11, 12, 13, 14):
            bus.write(id, "goal_position", bus.read(id, "present_position"))
            bus.write(id, "torque_enable", 1)
        clock.sleep_until_ns(2 * S)
        amperes = {id: abs(bus.read(id, "present_current")) for id in (11, 12, 13, 14)}
        sag = arm.joint_states(clock.now_ns())
    # joint 1 turns about the vertical; the farther joint 2 carries more than joints 3 and 4 (levers 278, 254, 130 mm)
    assert amperes[11] == 0 < amperes[14] < amperes[13] < amperes[12]
    assert amperes[12] / amperes[14] == pytest.approx(278 / 130, rel=0.15)  # counts of 2.69 mA, of some 70
    assert sag[0] == pytest.approx(0.0, abs=1e-9) and np.all(sag[1:4] > 0)  # +y turns x down


def test_mass_and_centre_come_together() -> None:
    with pytest.raises(InvalidFile, match="want mass_kg and centre_mm, or neither"):
        parse_rig(MANIPULATOR.replace('child = "gripper"\n', 'child = "gripper"\nmass_kg = 0.1\n'), "my.toml")


def test_backlash_leaves_a_shaft_where_it_comes_from() -> None:
    def reached(lines: str) -> list[float]:
        found = []
        with arm_and_bus(with_simulation(DEMO, lines)) as (arm, bus, clock):
            bus.write(1, "torque_enable", 1)
            for count in (700, 512, 300, 512):
                bus.write(1, "goal_position", count)
                bus.ping(1)
                clock.sleep_until_ns(clock.now_ns() + 3 * S)
                found.append(np.degrees(arm.joint_states(clock.now_ns())[0]))
        return found

    _, from_above, _, from_below = reached("backlash_deg = 1.0")
    assert from_above - from_below == pytest.approx(1.0, abs=0.35)  # a count is 0.29 deg
    _, from_above, _, from_below = reached("")
    assert from_above == from_below


def ganged(second: str) -> RigTable:
    text = MANIPULATOR.replace('id = 11\nmodel = "XM430-W350"\n', f'id = 1\nmodel = "XM540-W270"\n{second}', 1)
    return parse_rig(text, "my.toml")


@pytest.mark.parametrize(
    ("second", "reversed"),
    [
        ('[[joint.servo]]\nid = 2\nmodel = "XM540-W270"\nganging = "secondary_id"\n', False),
        ('[[joint.servo]]\nid = 2\nmodel = "XM540-W270"\nganging = "secondary_id"\nreversed = true\n', True),
        ('[[joint.servo]]\nid = 2\nmodel = "XM540-W270"\nsign = -1\nganging = "sync_cable"\n', False),
        ('[[joint.servo]]\nid = 2\nmodel = "XM540-W270"\nsign = -1\nganging = "software"\n', False),
    ],
)
def test_ganged_servos_are_built_as_the_rig_says_and_turn_the_joint_together(second: str, reversed: bool) -> None:
    table = ganged(second)
    with arm_and_bus(table) as (arm, bus, clock):
        start = {id: arm.shaft_rad(id, 0) for id in (1, 2)}
        assert bus.read(2, "drive_mode") & 1 == reversed
        for id in (1, 2) if "sync_cable" not in second else (1,):
            bus.write(id, "torque_enable", 1)
        bus.write(1, "goal_position", 2348)
        if "software" in second:
            bus.write(2, "goal_position", 1748)
        bus.ping(1)
        clock.sleep_until_ns(3 * S)
        turned = {id: arm.shaft_rad(id, clock.now_ns()) - start[id] for id in (1, 2)}
        assert turned[1] == pytest.approx(300 * 2 * np.pi / 4096, abs=1e-3)
        mirrored = reversed or "sign = -1" in second
        assert turned[2] == pytest.approx(-turned[1] if mirrored else turned[1], abs=1e-3)
        assert arm.joint_states(clock.now_ns())[0] == pytest.approx(turned[1], abs=1e-3)
