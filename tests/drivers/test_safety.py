"""When an arm is stopped: each limit on both sides, what passes, and what is told once or again."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from drivers.errors import SafetyStop
from drivers.joints import JointConfig, ServoConfig
from drivers.safety import PERSISTENCE_S, SafetyLimits, ServoRange, ServoState, Watch

S = 1_000_000_000
JOINTS = (
    JointConfig("pan", (ServoConfig(1, "AX-18A"),), -1.0, 1.0, 1.0),
    JointConfig("lift", (ServoConfig(2, "AX-18A"), ServoConfig(3, "AX-18A", ganging="software")), -1.0, 1.0, 1.0),
)
OWN = dict.fromkeys((1, 2, 3), ServoRange(max_temperature_c=75.0, min_voltage_v=9.0, max_voltage_v=12.0))
FINE = ServoState(count=512, speed_rad_s=0.0, load=0.1, voltage_v=11.0, temperature_c=40.0)


def watch(**limits: float) -> Watch:
    return Watch(JOINTS, SafetyLimits(**limits), OWN)


def look(
    watch: Watch,
    t_s: float,
    *,
    q: tuple[float, float] = (0.0, 0.0),
    goals: tuple[float, float] | None = (0.0, 0.0),
    **third: float,
) -> None:
    """A reading in which servo 3 differs from the others."""
    watch.check(round(t_s * S), {1: FINE, 2: FINE, 3: replace(FINE, **third)}, q, goals)


def lasting(watch: Watch, **third: float) -> str:
    """What the watch says of a state that lasts."""
    look(watch, 0.0, **third)
    with pytest.raises(SafetyStop) as caught:
        look(watch, PERSISTENCE_S, **third)
    assert caught.value.joint == "lift"
    return str(caught.value)


def test_a_servo_is_stopped_five_degrees_before_it_stops_itself() -> None:
    look(watch(), 0.0, temperature_c=70.0)
    with pytest.raises(SafetyStop, match=r"servo 3 \(lift\) is at 71 degC; the limit is 70 degC") as caught:
        look(watch(), 0.0, temperature_c=71.0)
    assert caught.value.what == "temperature"
    look(watch(max_temperature_c=80.0), 0.0, temperature_c=80.0)
    with pytest.raises(SafetyStop, match="the limit is 50 degC"):
        look(watch(max_temperature_c=50.0), 0.0, temperature_c=51.0)


def test_a_voltage_must_stay_wrong_to_count() -> None:
    assert "gets 8.9 V; wants 9.0 to 12.0 V" in lasting(watch(), voltage_v=8.9)
    assert "gets 12.1 V" in lasting(watch(), voltage_v=12.1)
    assert "wants 10.5 to 12.0 V" in lasting(watch(min_voltage_v=10.5), voltage_v=10.2)
    dips = watch()
    for k in range(20):  # a dip each time a motor starts
        look(dips, 0.2 * k, voltage_v=8.0 if k % 2 else 11.0)


def test_a_load_counts_where_the_rig_limits_it() -> None:
    limited = watch(max_load=0.6)
    assert "bears 70 % of its greatest load; the limit is 60 %" in lasting(limited, load=-0.7)
    assert "bears" in lasting(limited, load=-0.7)  # and again
    free = watch(stall_s=0.0)
    for k in range(20):
        look(free, 0.2 * k, load=1.0)


def test_a_joint_that_pushes_and_does_not_move_is_stalled() -> None:
    still = watch(stall_s=1.0, stall_load=0.5)
    goals = (0.0, 0.5)
    for k in range(10):
        look(still, 0.1 * k, goals=goals, load=0.8)
    with pytest.raises(SafetyStop, match=r"joint 'lift' is stalled at 0.00 deg, 28.65 deg from its goal") as caught:
        look(still, 1.0, goals=goals, load=0.8)
    assert (caught.value.what, caught.value.joint) == ("stall", "lift")


@pytest.mark.parametrize(
    ("speed_rad_s", "goal", "load"),
    [
        (0.1, 0.5, 0.8),  # slow, but it gets there
        (0.0, 0.5, 0.3),  # no load: it hasn't set out
        (0.0, math.radians(1.5), 0.9),  # near: a load that is held
    ],
    ids=["moves", "no load", "holds"],
)
def test_what_is_no_stall(speed_rad_s: float, goal: float, load: float) -> None:
    fine = watch(stall_s=1.0)
    for k in range(60):
        look(fine, 0.1 * k, q=(0.0, speed_rad_s * 0.1 * k), goals=(0.0, max(goal, speed_rad_s * 0.1 * k)), load=load)
    for k in range(60):  # nothing is commanded
        look(fine, 6.0 + 0.1 * k, goals=None, load=1.0)


def test_a_temperature_is_told_once_so_that_the_arm_can_be_parked() -> None:
    hot = watch()
    with pytest.raises(SafetyStop):
        look(hot, 0.0, temperature_c=74.0)
    look(hot, 0.1, temperature_c=74.0)
