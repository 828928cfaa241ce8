"""Zeros of servos from the counts that they read while the arm is held in a reference pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.errors import CalibrationError
from calibration.servo_zeros import ReferenceJoint, ReferenceServo, ServoZero, find_zeros

AX_RAD = float(np.radians(300 / 1023))
X_RAD = 2 * np.pi / 4096
AX = ReferenceServo(2, 1, 1.0, AX_RAD, 512, 0, 1023)
X = ReferenceServo(11, 1, 1.0, X_RAD, 2048, 0, 4095)


def joint(*servos: ReferenceServo, state: float = 0.0, limit: float = 1.0, unit: str = "rad") -> ReferenceJoint:
    return ReferenceJoint("lift", state, -limit, limit, unit, servos)


def zeros(reference: ReferenceJoint, *counts: int) -> list[ServoZero]:
    read = {servo.id: [count] * 5 for servo, count in zip(reference.servos, counts, strict=True)}
    return list(find_zeros([reference], read, disagreement_rad=np.radians(5)))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("gear", [1.0, 2.5])
def test_the_joint_is_where_it_was_held_by_the_zero_that_is_found(sign: int, gear: float):
    servo = replace(X, sign=sign, ratio=gear)
    held = np.radians(20.0)
    (found,) = zeros(joint(servo, state=held, limit=0.6), 2222)
    read_back = sign * (2222 - found.zero) * X_RAD / gear
    assert read_back == pytest.approx(held, abs=0.51 * X_RAD / gear)  # half a count
    assert found.moved == pytest.approx(read_back - sign * (2222 - 2048) * X_RAD / gear)
    assert not found.problems and not found.warnings


def test_the_standard_deviation_has_the_counts_rounding_and_the_readings_spread():
    (still,) = zeros(joint(AX), 520)
    assert still.std == pytest.approx(AX_RAD / np.sqrt(12)) and still.spread_counts == 0
    read = {2: [519, 521] * 10}
    (trembling,) = find_zeros([joint(AX)], read, disagreement_rad=0.1)
    assert trembling.zero == 520 and trembling.spread_counts == 2
    assert trembling.std == pytest.approx(AX_RAD * np.hypot(1 / np.sqrt(12), np.std(read[2], ddof=1) / np.sqrt(20)))


def test_rounding_and_noise_are_covered_by_what_is_stated():
    rng = np.random.default_rng(0)
    normalised = []
    for _ in range(400):
        true, held = rng.uniform(500, 540), rng.uniform(-0.3, 0.3)
        shaft = true + held / AX_RAD
        read = np.round(shaft + rng.normal(0, 0.4, 20)).astype(int)
        (found,) = find_zeros([joint(AX, state=held)], {2: read}, disagreement_rad=0.1)
        normalised.append((found.zero - true) * AX_RAD / found.std)
    assert 0.6 < np.sqrt(np.mean(np.square(normalised))) < 1.1  # the mean of trembling counts is better than one


def test_an_arm_that_moves_while_it_is_read_is_refused():
    with pytest.raises(CalibrationError, match=r"servo 2 \(lift\) moved by 6 counts \(1\.8 deg\)"):
        find_zeros([joint(AX)], {2: [512, 515, 518]}, disagreement_rad=0.1)
    with pytest.raises(CalibrationError, match="want 3 or more"):
        find_zeros([joint(AX)], {2: [512, 512]}, disagreement_rad=0.1)


def test_a_zero_too_near_to_the_end_of_the_range_is_a_problem_with_what_could_be_reached():
    (found,) = zeros(joint(AX, limit=np.radians(100)), 250)
    (problem,) = found.problems
    assert "from count -91 to 591, it goes from 0 to 1023" in problem and "-73.3 deg to 226.7 deg" in problem
    (mirrored,) = zeros(joint(replace(AX, sign=-1), limit=np.radians(100)), 250)
    assert "-226.7 deg to 73.3 deg" in mirrored.problems[0]
    assert not zeros(joint(AX, limit=np.radians(60)), 250)[0].problems


def test_a_zero_below_nothing_and_turns_that_are_forgotten_are_problems():
    free = replace(X, first=None, last=None, turn=4096)
    assert "below 0" in zeros(joint(free, state=1.0), 100)[0].problems[0]
    assert "outside its first one" in zeros(joint(free), 4500)[0].problems[0]
    assert "outside its first one" in zeros(joint(free), -3)[0].problems[0]
    assert not zeros(joint(free), 4000)[0].problems


def test_a_pair_of_which_one_horn_has_slipped_is_told():
    pair = joint(AX, replace(AX, id=3, sign=-1))
    assert not any(found.warnings for found in zeros(pair, 520, 504))  # both 2.3 deg on
    leader, follower = zeros(pair, 520, 520)
    assert not leader.warnings and not follower.warnings  # 4.7 deg apart: within what is allowed
    leader, follower = zeros(pair, 520, 534)
    assert not leader.warnings and "servos 2 and 3 (lift) move by -2.3 and 6.5 deg" in follower.warnings[0]


def test_a_follower_by_secondary_id_gets_its_leaders_zero_and_is_told_when_it_fights():
    pair = joint(X, replace(X, id=12, shares_zero=True))
    leader, follower = zeros(pair, 2060, 2063)
    assert (leader.zero, follower.zero) == (2060, 2060) and not follower.warnings
    _, off = zeros(pair, 2060, 2160)
    assert off.zero == 2060 and "stands +100 counts (8.8 deg) off servo 11" in off.warnings[0]


def test_a_prismatic_joint_is_held_in_metres():
    lead_m = 0.0747
    rack = replace(X, ratio=2 * np.pi / lead_m, sign=-1)
    (found,) = zeros(joint(rack, state=0.010, limit=0.019, unit="m"), 1551)
    assert found.zero == 1551 + round(0.010 * 4096 / lead_m)
    assert found.std == pytest.approx(lead_m / 4096 * np.hypot(1 / np.sqrt(12), 0.32), rel=0.1)
