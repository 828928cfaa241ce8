"""Where joints will be: a servo runs at its limit to a step's target, and follows a stream."""

from __future__ import annotations

import numpy as np
import pytest

from station.foresight.expectation import expected_states
from station.motion import JointLimits, Motion, MotionStep, plan_motion
from tests.foresight.scenes import plan


def test_a_step_is_gone_at_its_speed_and_then_rests():
    planned = plan(1.0, -1.0, speed=2.0, hold_s=0.5)
    t_s = np.array([0.0, 0.25, 0.5, 0.9, 1.5, 2.0, 2.4])
    # 0.5 s to get there, 0.5 s of rest, 1 s for the way back.
    assert expected_states(planned, t_s)[:, 0] == pytest.approx([0.0, 0.5, 1.0, 1.0, 0.0, -1.0, -1.0])


def test_each_joint_of_a_step_arrives_by_its_own_speed():
    limits = [JointLimits("slow", -9, 9, 0.1), JointLimits("quick", -9, 9, 0.3)]  # under the default speed
    planned = plan_motion(Motion("two", (MotionStep({"slow": 0.2, "quick": -0.3}),)), limits)
    assert planned.duration_s == pytest.approx(2.0)
    assert expected_states(planned, np.array([0.5, 1.0, 2.0])) == pytest.approx(
        np.array([[0.05, -0.15], [0.1, -0.3], [0.2, -0.3]])
    )


def test_at_the_end_of_each_leg_the_plans_own_target_is_reached():
    planned = plan(1.0, -0.3, 0.7, speed=1.3)
    ends_s = np.array([segment.t_start_s + segment.move_s for segment in planned.segments])
    assert expected_states(planned, ends_s) == pytest.approx(np.stack([s.q_to for s in planned.segments]))


def test_a_stream_is_where_it_is_commanded():
    planned = plan(1.0, -1.0, mode="stream")
    t_s = np.linspace(0, planned.duration_s, 50)
    assert np.array_equal(expected_states(planned, t_s), planned.commanded(t_s))


def test_before_the_motion_the_arm_is_parked():
    assert expected_states(plan(1.0), np.array([-0.1]))[0, 0] == 0.0
