"""Plans against arithmetic done by hand."""

import numpy as np
import pytest

from station.errors import InvalidData, InvalidFile, LimitExceeded, StationError
from station.formats.motion import parse_motion
from station.motion import JointLimits, Motion, MotionStep, plan_motion

PAN = JointLimits("pan", -1.5, 1.5, 1.0, park=0.5)
LIFT = JointLimits("lift", 0.0, 0.3, 0.1, unit="m")


def test_a_step_lasts_until_its_slowest_joint_arrives_and_rests():
    plan = plan_motion(Motion("m", (MotionStep({"pan": 0.3, "lift": 0.2}, hold_s=0.25),)), (PAN, LIFT))
    (segment,) = plan.segments
    assert segment.move_s == pytest.approx(2.0)  # lift: 0.2 m at 0.1 m/s; pan needs 0.6 s
    assert plan.duration_s == pytest.approx(2.25)


def test_step_mode_commands_the_target_at_once_and_stream_mode_interpolates():
    steps = (MotionStep({"pan": -0.5}, speed=1.0, hold_s=1.0), MotionStep({"pan": 0.5}, speed=0.5))
    step = plan_motion(Motion("m", steps), (PAN,))
    np.testing.assert_allclose(step.commanded([-1.0, 0.0, 1.9, 2.0, 99.0])[:, 0], [0.5, -0.5, -0.5, 0.5, 0.5])
    np.testing.assert_allclose(step.command_times_s(), [0.0, 2.0])
    stream = plan_motion(Motion("m", steps, "stream", rate_hz=10.0), (PAN,))
    np.testing.assert_allclose(
        stream.commanded([0.0, 0.5, 1.5, 3.0, 9.0])[:, 0], [0.5, 0.0, -0.5, 0.0, 0.5], atol=1e-12
    )
    times = stream.command_times_s()
    assert np.all(np.diff(times) > 0) and times[-1] <= stream.duration_s
    np.testing.assert_allclose(stream.commanded(times[-1])[0], 0.5)


def test_repeat_goes_back_to_where_the_step_began():
    plan = plan_motion(Motion("m", (MotionStep({"pan": 1.0}, repeat=2), MotionStep({"pan": 0.0}))), (PAN,))
    assert [s.q_to[0] for s in plan.segments] == [1.0, 0.5, 1.0, 0.0]
    assert [s.q_from[0] for s in plan.segments] == [0.5, 1.0, 0.5, 1.0]
    for before, after in zip(plan.segments, plan.segments[1:], strict=False):
        assert before.t_end_s == pytest.approx(after.t_start_s)


def test_the_whole_motion_is_checked_against_angles_and_speeds():
    with pytest.raises(LimitExceeded, match=r"step 2 .*pan would go to 114\.6 deg.*-85\.9 deg to 85\.9 deg"):
        plan_motion(Motion("far", (MotionStep({"pan": 1.5}), MotionStep({"pan": 2.0}))), (PAN,))
    with pytest.raises(LimitExceeded, match=r"lift would move at 200\.0 mm/s"):
        plan_motion(Motion("fast", (MotionStep({"lift": 0.1}, speed=0.2),)), (LIFT,))
    with pytest.raises(InvalidData, match="no joint 'tilt'"):
        plan_motion(Motion("lost", (MotionStep({"tilt": 0.1}),)), (PAN,))
    with pytest.raises(InvalidData, match="no step"):
        plan_motion(Motion("empty", ()), (PAN,))


TEXT = 'schema = "motion/1"\nname = "m"\n[[step]]\nmove = { pan = 45 }\nspeed_deg_s = 20\nhold_s = 0.5\n'


def test_motion_toml_is_read_in_degrees():
    motion = parse_motion(TEXT, "m.toml", (PAN, LIFT))
    assert motion.steps == (MotionStep({"pan": np.pi / 4}, np.radians(20), 0.5),)
    lift = parse_motion(TEXT.replace("pan = 45", "lift = 45").replace("deg", "mm"), "m.toml", (PAN, LIFT))
    assert lift.steps[0].move == {"lift": 0.045} and lift.steps[0].speed == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("hold_s", "hold", r"step 1, hold: unknown key; known here: move, speed_deg_s"),
        ("hold_s = 0.5", 'hold_s = "long"', r"step 1, hold_s: .*valid number; have 'long'"),
        ("motion/1", "motion/9", r"has schema 'motion/9'; this station reads 'motion/1'"),
        ('schema = "motion/1"', "", "has no schema"),
        ("move = { pan = 45 }", "move = { knee = 45 }", "no joint 'knee'; the rig has pan, lift"),
        ("pan = 45", "lift = 45", "unit"),
        ('name = "m"', "", "name: missing"),
        ("[[step]]", "[[step]", "is no TOML"),
    ],
)
def test_bad_motion_files_are_refused_with_the_key(old: str, new: str, said: str):
    with pytest.raises(InvalidFile, match=said) as error:
        parse_motion(TEXT.replace(old, new), "m.toml", (PAN, LIFT))
    assert str(error.value).startswith("m.toml") and str(error.value).count("\n") < 5
    assert isinstance(error.value, StationError)
