"""Whatever the arm, motions of every kind keep to its limits and speeds, and go from rest to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station.errors import InvalidData, LimitExceeded
from station.formats.motion import parse_motion
from station.formats.motion_text import format_motion
from station.logs import FloatArray
from station.motion import (
    SLOW,
    Combined,
    EachJoint,
    Explore,
    JointLimits,
    Motion,
    MotionStep,
    Plan,
    Reach,
    Replay,
    Sinusoids,
    SinusoidsInReach,
    Step,
    Wave,
    extended,
    plan_motion,
)
from tests.motion_rigs import arms

FINE_S = 1e-3
PAN = JointLimits("pan", -1.5, 1.5, 1.0, park=0.5)
TILT = JointLimits("tilt", -1.0, 2.0, 1.0)
LIFT = JointLimits("lift", 0.0, 0.3, 0.1, park=0.1, unit="m")


@st.composite
def reaches(draw: st.DrawFn) -> Reach:
    share = draw(st.floats(0.05, 1.0))
    return draw(st.sampled_from((Reach(share), Reach(share, {"rad": 9.0, "m": 9.0}), Reach(share, skip=("gripper",)))))


@st.composite
def steps(draw: st.DrawFn) -> Step:
    """Any kind that suits any arm."""
    reach, hold_s, repeat = draw(reaches()), draw(st.sampled_from((0.0, 0.3))), draw(st.integers(1, 2))
    return draw(
        st.sampled_from(
            (
                EachJoint(reach, hold_s=hold_s, repeat=repeat),
                Combined(reach, hold_s=hold_s, repeat=repeat),
                Explore(reach, poses=draw(st.integers(1, 9)), seed=draw(st.integers(0, 99)), hold_s=hold_s),
                SinusoidsInReach(reach, cycles=draw(st.integers(1, 3)), hold_s=hold_s, repeat=repeat),
            )
        )
    )


def fine(plan: Plan) -> tuple[FloatArray, FloatArray]:
    """Times a millisecond apart, of at most two minutes in all, and what is commanded then."""
    t_s = np.arange(-0.1, min(plan.duration_s, 120.0) + 0.1, FINE_S)
    return t_s, plan.commanded(t_s)


@settings(max_examples=60)
@given(arms(), st.lists(steps(), min_size=1, max_size=2))
def test_any_motion_stays_within_limits_speeds_and_accelerations(
    joints: tuple[JointLimits, ...], chosen: list[Step]
) -> None:
    plan = plan_motion(Motion("any", tuple(chosen), "stream"), joints)
    _, q = fine(plan)
    # A thousandth of the range for what millisecond differences of accelerations round.
    for j, joint in enumerate(joints):
        assert joint.lower - joint.slack <= q[:, j].min() and q[:, j].max() <= joint.upper + joint.slack
        speed = np.abs(np.diff(q[:, j])) / FINE_S
        assert speed.max() <= min(joint.max_speed, SLOW[joint.unit]) * (1 + 1e-6)
        if joint.max_acceleration is not None:
            acceleration = np.abs(np.diff(q[:, j], 2)) / FINE_S**2
            assert acceleration.max() <= joint.max_acceleration * (1 + 1e-3) + 1e-6


@settings(max_examples=40)
@given(arms(), steps())
def test_any_motion_starts_and_ends_at_rest_in_the_park_pose(joints: tuple[JointLimits, ...], step: Step) -> None:
    plan = plan_motion(Motion("any", (step,), "stream"), joints)
    end_s = plan.duration_s
    for at_s in (0.0, end_s):
        np.testing.assert_allclose(plan.commanded(at_s), plan.park, atol=1e-9)
    slow = np.abs(plan.commanded([FINE_S, end_s - FINE_S]) - plan.park) / FINE_S
    assert np.all(slow <= 0.01 * np.array([SLOW[joint.unit] for joint in joints]))


@settings(max_examples=40)
@given(arms(accelerations=False), steps())
def test_a_motion_is_one_way_without_gaps_whose_legs_agree_with_what_is_commanded(
    joints: tuple[JointLimits, ...], step: Step
) -> None:
    plan = plan_motion(Motion("any", (step,), "stream"), joints)
    for leg, following in zip(plan.segments, plan.segments[1:], strict=False):
        assert leg.t_end_s == pytest.approx(following.t_start_s)
        np.testing.assert_array_equal(leg.q_to, following.q_from)
    for leg in plan.segments:
        assert leg.t_end_s - leg.t_start_s <= 60 or leg.curve is None
        np.testing.assert_allclose(plan.commanded(leg.t_start_s), leg.q_from, atol=1e-9)
        np.testing.assert_allclose(plan.commanded(leg.t_end_s - leg.hold_s), leg.q_to, atol=1e-9)
    times = plan.command_times_s()
    assert np.all(np.diff(times) > 0)
    np.testing.assert_allclose(plan.commanded(times[-1]), plan.segments[-1].q_to, atol=1e-9)


@given(arms(), steps(), st.booleans())
@settings(max_examples=60)
def test_a_motion_reads_back_from_its_text(joints: tuple[JointLimits, ...], step: Step, given_speeds: bool) -> None:
    if given_speeds and not isinstance(step, MotionStep | Sinusoids | Replay):
        step = replace(step, speeds={j.unit: min(k.max_speed for k in joints if k.unit == j.unit) for j in joints})
    motion = Motion('any, and "quoted"', (step, MotionStep({joints[0].name: joints[0].upper})), "stream", 60.0)
    text = format_motion(motion, joints)
    plan, back = plan_motion(motion, joints), plan_motion(parse_motion(text, "back.toml", joints), joints)
    t_s = np.arange(0.0, plan.duration_s, 0.37)
    np.testing.assert_allclose(back.commanded(t_s), plan.commanded(t_s), atol=1e-9)
    assert format_motion(parse_motion(text, "back.toml", joints), joints) == text


def test_each_joint_goes_alone_to_shares_of_its_room_and_back():
    plan = plan_motion(Motion("m", (EachJoint(Reach(0.5, skip=("gripper",))),), "stream"), (PAN, LIFT))
    moved = [np.flatnonzero(leg.q_from != leg.q_to).tolist() for leg in plan.segments]
    assert moved == [[0], [0], [0], [1], [1], [1]]
    # Pan has 1.0 above its park pose and 2.0 below, which is cut to 35 deg; the lift 0.2 and 0.1.
    assert [leg.q_to[0] for leg in plan.segments[:3]] == pytest.approx([1.0, 0.5 - np.radians(35), 0.5])
    assert [leg.q_to[1] for leg in plan.segments[3:]] == pytest.approx([0.18, 0.05, 0.1])


def correlations(plan: Plan, q: FloatArray) -> FloatArray:
    """(J, J) without the diagonal."""
    found = np.corrcoef(q, rowvar=False)
    return found - np.diag(np.diag(found))


@pytest.mark.parametrize("count", range(2, 9))
def test_combined_poses_are_uncorrelated_between_any_two_joints(count: int):
    joints = tuple(JointLimits(f"j{k}", -1.0 - 0.1 * k, 1.0, 1.0) for k in range(count))
    plan = plan_motion(Motion("m", (Combined(),), "stream"), joints)
    goals = np.array([leg.q_to for leg in plan.segments[:-1]])
    assert np.abs(correlations(plan, goals)).max() < 1e-9
    on_the_way = fine(plan)[1]
    assert np.abs(correlations(plan, on_the_way)).max() < 0.5


@pytest.mark.parametrize("count", range(2, 9))
def test_sinusoids_in_reach_are_uncorrelated_at_full_amplitude(count: int):
    joints = tuple(JointLimits(f"j{k}", -1.0 - 0.1 * k, 1.0, 1.0) for k in range(count))
    step = SinusoidsInReach()
    plan = plan_motion(Motion("m", (step,), "stream"), joints)
    sinusoids = step.sinusoids(plan.park, joints)
    start_s = next(leg.t_start_s for leg in plan.segments if leg.curve is not None) + (sinusoids.ramp_s or 0.0)
    full_s = sinusoids.duration_s - 2 * (sinusoids.ramp_s or 0.0)
    q = plan.commanded(start_s + full_s * np.arange(4000) / 4000)
    assert np.abs(correlations(plan, q)).max() < 1e-6


def test_sinusoids_are_their_formula_between_the_ramps_and_reach_amplitude_times_omega():
    waves = {"pan": Wave(0.4, 0.25, np.radians(30), 0.2), "lift": Wave(0.05, 0.2)}
    plan = plan_motion(Motion("m", (Sinusoids(waves, 20.0, 3.0),), "stream"), (PAN, LIFT))
    start_s = plan.segments[1].t_start_s
    t = np.linspace(3.0, 17.0, 200)
    q = plan.commanded(start_s + t)
    np.testing.assert_allclose(q[:, 0], 0.2 + 0.4 * np.sin(2 * np.pi * 0.25 * t + np.radians(30)), atol=1e-12)
    np.testing.assert_allclose(q[:, 1], 0.1 + 0.05 * np.sin(2 * np.pi * 0.2 * t), atol=1e-12)
    fast = np.abs(np.diff(fine(plan)[1], axis=0)).max(axis=0) / FINE_S
    np.testing.assert_allclose(fast, [0.4 * 2 * np.pi * 0.25, 0.05 * 2 * np.pi * 0.2], rtol=1e-4)


@given(st.floats(0.5, 5.0), st.floats(0.05, 2.0), st.floats(0.0, 2 * np.pi))
def test_no_ramp_of_half_a_period_or_more_makes_a_sinusoid_faster(ramps: float, hz: float, phase: float) -> None:
    ramp_s = ramps / hz
    joint = JointLimits("pan", -1.0, 1.0, 0.3 * 2 * np.pi * hz)
    step = Sinusoids({"pan": Wave(0.3, hz, phase)}, 2 * ramp_s + 1.3 / hz, ramp_s)
    plan = plan_motion(Motion("m", (step,), "stream"), (joint,))
    curve = plan.segments[0].curve
    assert curve is not None
    t_s = np.linspace(0.0, plan.duration_s, 20_000)
    q, dt_s = plan.commanded(t_s)[:, 0], t_s[1]
    assert np.abs(np.diff(q)).max() / dt_s <= curve.fastest()[0] * (1 + 1e-9)
    assert np.abs(np.diff(q, 2)).max() / dt_s**2 <= curve.hardest()[0] * (1 + 1e-3)


def test_explorations_are_the_same_for_a_seed_and_cover_each_joint_evenly():
    reach = Reach(1.0, {"rad": 9.0, "m": 9.0})

    def goals(seed: int) -> FloatArray:
        plan = plan_motion(Motion("m", (Explore(reach, poses=10, seed=seed),), "stream"), (PAN, LIFT))
        return np.array([leg.q_to for leg in plan.segments[:-1]])

    np.testing.assert_array_equal(goals(3), goals(3))
    assert np.all(goals(3) != goals(4))
    tenths = np.floor(10 * (goals(3)[:, 0] - PAN.lower) / (PAN.upper - PAN.lower))
    assert sorted(tenths) == list(range(10))


def test_a_leg_that_begins_again_in_the_middle_of_a_curve_gets_under_way_smoothly():
    plan = plan_motion(Motion("m", (EachJoint(), SinusoidsInReach()), "stream"), (PAN, TILT))
    cut = [k for k, leg in enumerate(plan.segments) if leg.curve is not None][2]
    again, starts_s = plan.restarted(cut), plan.segments[cut].t_start_s
    assert len(again.segments) == len(plan.segments) and again.segments[cut].t_start_s == starts_s
    before_s = np.linspace(0.0, starts_s, 300)
    np.testing.assert_array_equal(again.commanded(before_s), plan.commanded(before_s))
    late_s = again.duration_s - plan.duration_s
    assert 0 < late_s < 0.5
    later_s = np.linspace(starts_s + 1.0, again.duration_s, 500)
    np.testing.assert_allclose(again.commanded(later_s), plan.commanded(later_s - late_s), atol=1e-12)
    speeds = np.abs(np.diff(again.commanded(starts_s + np.arange(0.0, 2.0, FINE_S)), axis=0)) / FINE_S
    assert np.all(speeds[0] < 1e-3) and speeds.max() <= SLOW["rad"] * (1 + 1e-6)
    assert plan.restarted(2) is plan and again.restarted(cut) is again
    with pytest.raises(InvalidData, match="has no leg 99"):
        plan.restarted(99)


def test_an_extended_motion_keeps_the_legs_that_it_has():
    plan = plan_motion(Motion("m", (EachJoint(),), "stream"), (PAN, TILT))
    longer = extended(plan, [EachJoint(Reach(joints=("tilt",)))])
    assert len(longer.segments) == len(plan.segments) + 3
    t_s = np.linspace(0.0, plan.duration_s, 300)
    np.testing.assert_array_equal(longer.commanded(t_s), plan.commanded(t_s))


def test_what_goes_too_far_or_too_fast_is_refused_with_step_joint_and_remedy():
    def plan(*chosen: Step, mode: str = "stream") -> None:
        plan_motion(Motion("m", chosen, "stream" if mode == "stream" else "step"), (PAN, TILT, LIFT))

    ok = EachJoint()
    with pytest.raises(LimitExceeded, match=r"step 2 .*: pan would go to 91\.7 deg.* to 85\.9 deg\nlower its"):
        plan(ok, Sinusoids({"pan": Wave(1.1, 0.1)}, 30.0))
    with pytest.raises(LimitExceeded, match=r"step 1 .*: tilt would reach 60\.0 deg/s; its greatest speed is 57\.3"):
        plan(Sinusoids({"tilt": Wave(np.radians(60) / 2 / np.pi, 1.0)}, 30.0))
    with pytest.raises(LimitExceeded, match=r"step 1 .*: lift would move at 200\.0 mm/s; its greatest"):
        plan(EachJoint(speeds={"m": 0.2}))
    with pytest.raises(InvalidData, match=r"step 1: no joint 'knee'; the rig has pan, tilt, lift"):
        plan(EachJoint(Reach(joints=("knee",))))
    with pytest.raises(InvalidData, match=r"step 1: no joint is left to move"):
        plan(Combined(Reach(skip=("pan", "tilt", "lift"))))
    with pytest.raises(InvalidData, match=r"step 1: poses = 3 don't tell 3 joints apart; want 5 or more"):
        plan(Combined(poses=3))
    with pytest.raises(InvalidData, match=r"step 1: sinusoids are streamed"):
        plan(SinusoidsInReach(), mode="step")
    with pytest.raises(InvalidData, match=r"step 1: ramp_s = 1 .*want 5 s at least"):
        plan(Sinusoids({"pan": Wave(0.1, 0.1)}, 30.0, 1.0))
    with pytest.raises(InvalidData, match=r"step 1: the motion lasts .* h by then; 24 h at most"):
        plan(EachJoint(hold_s=40_000.0))


def test_a_sinusoid_that_shakes_a_joint_too_hard_is_refused_though_it_is_slow_enough():
    wave = Sinusoids({"pan": Wave(0.05, 2.0)}, 4.0)  # 0.63 rad/s, 7.9 rad/s2 at its ends
    motion = Motion("shaking", (wave,), "stream")
    plan_motion(motion, (replace(PAN, max_acceleration=20.0),))
    with pytest.raises(LimitExceeded, match=r"pan would reach .*/s2; its greatest acceleration is 286\.5 deg/s2"):
        plan_motion(motion, (replace(PAN, max_acceleration=5.0),))
