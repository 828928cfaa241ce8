"""Joints: counts and states with gears and racks, and followers that can't follow."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DriverError
from drivers.joints import JointConfig, ServoConfig


@given(
    model=st.sampled_from(["AX-18A", "XM430-W350", "XL-320"]),
    zero=st.integers(0, 1023),
    sign=st.sampled_from([-1, 1]),
    ratio=st.floats(0.05, 400.0),
    count=st.integers(-5000, 5000),
)
def test_a_count_comes_back_from_its_state(model: str, zero: int, sign: int, ratio: float, count: int) -> None:
    servo = ServoConfig(1, model, zero, sign, ratio)
    assert servo.count(servo.q(count)) == count


def test_a_gear_and_a_rack_are_what_they_say() -> None:
    geared = ServoConfig(1, "XM430-W350", ratio=3.0)  # three turns of the servo for one of the joint
    assert geared.count(math.radians(30.0)) == 2048 + 1024
    rack = ServoConfig(1, "XM430-W350", sign=-1, ratio=2 * math.pi / 0.040)  # 40 mm a turn
    assert rack.count(0.010) == 2048 - 1024
    assert rack.q(1024) == pytest.approx(0.010, abs=1e-15)


X, AX = ServoConfig(1, "XM430-W350"), ServoConfig(1, "AX-18A")


@pytest.mark.parametrize(
    ("leader", "follower", "said"),
    [
        (X, ServoConfig(2, "XM430-W350"), "a second servo needs ganging"),
        (AX, ServoConfig(2, "AX-18A", ganging="secondary_id"), "AX-18A has no secondary id"),
        (X, ServoConfig(2, "XL430-W250", ganging="secondary_id"), "of its leader's model, XM430-W350"),
        (X, ServoConfig(2, "XM430-W350", sign=-1, ganging="secondary_id"), "same zero, sign and gear"),
        (X, ServoConfig(2, "XM430-W350", zero_count=2050, ganging="secondary_id"), "same zero, sign and gear"),
        (X, ServoConfig(2, "XM430-W350", ganging="sync_cable"), "no socket for a sync cable"),
        (ServoConfig(1, "AX-18A", ganging="software"), AX, "its first servo leads"),
        (ServoConfig(1, "AX-18A", ratio=0.0), AX, "its ratio is positive"),
    ],
)
def test_followers_that_cannot_follow_are_refused(leader: ServoConfig, follower: ServoConfig, said: str) -> None:
    with pytest.raises(DriverError, match=said):
        JointConfig("lift", (leader, follower), -1.0, 1.0, 1.0)


def test_the_three_kinds_of_followers_are_taken() -> None:
    big = ServoConfig(1, "XM540-W270")
    for follower in (
        ServoConfig(2, "XM540-W270", sign=-1, ganging="software"),
        ServoConfig(2, "XM540-W270", ganging="secondary_id", reversed=True),
        ServoConfig(2, "XM540-W270", sign=-1, ganging="sync_cable"),
    ):
        assert JointConfig("lift", (big, follower), -1.0, 1.0, 1.0).servos[1].takes_goals == (
            follower.ganging == "software"
        )
