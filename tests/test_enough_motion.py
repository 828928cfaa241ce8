"""What was seen of each joint's motion while capturing agrees with what the fit then makes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from station.commands import capturing, fitting
from station.enough_motion import MotionTally, Sides, further_steps, sides_of, with_enough
from station.fit_files import read_fit
from station.logs import FloatArray
from station.motion import EachJoint, Explore, JointLimits, Motion, plan_motion
from station.recording import Recording
from station.rig import load_rig
from tests.sessions import slower_rig

PAN = JointLimits("pan", -1.5, 1.5, 1.0)
LIFT = JointLimits("lift", 0.0, 0.3, 0.1, unit="m")
SIDES = {"pan": Sides(frozenset({"base"}), frozenset({"arm", "arm_b"})), "lift": Sides(frozenset({"arm"}), frozenset())}


def swung(tally: MotionTally, q: FloatArray, parts: set[str]) -> None:
    for row in q:
        tally.add(row, parts)


def sweep(pan_deg: float) -> FloatArray:
    return np.column_stack([np.radians(np.linspace(0.0, pan_deg, 30)), np.zeros(30)])


def test_only_motion_with_both_sides_in_view_counts():
    tally = MotionTally((PAN, LIFT), SIDES)
    swung(tally, sweep(60.0), {"base"})
    swung(tally, sweep(-60.0), {"arm", "arm_b"})
    assert tally.shares() == {"pan": 0.0, "lift": None}
    swung(tally, sweep(7.5), {"base", "arm_b"})
    assert tally.shares()["pan"] == pytest.approx(0.5)
    swung(tally, sweep(-7.5), {"base", "arm"})
    assert tally.shares()["pan"] == pytest.approx(1.0)


def test_without_geometry_any_two_parts_count_and_few_sightings_are_not_enough():
    tally = MotionTally((PAN, LIFT), None)
    swung(tally, sweep(60.0), {"base"})
    assert tally.shares() == {"pan": 0.0, "lift": 0.0}
    swung(tally, sweep(60.0)[::10], {"base", "arm"})
    assert tally.shares()["pan"] == pytest.approx(0.3)
    swung(tally, np.full((30, 2), np.nan), {"base", "arm"})
    assert tally.shares()["pan"] == pytest.approx(0.3)


def test_sides_are_the_nearest_bodies_with_markers_and_a_gripper_has_none():
    table = load_rig("wx250s").table
    sides = sides_of(table)
    assert sides is not None
    assert sides["elbow"] == Sides(frozenset({"upper_arm", "upper_arm_b"}), frozenset({"forearm", "forearm_b"}))
    assert sides["gripper"].child == frozenset()


def test_further_steps_move_what_lacks_alone_and_then_look_for_it_in_other_poses():
    shares = {"pan": 0.4, "lift": None}
    (alone,) = further_steps(shares, 0)
    assert isinstance(alone, EachJoint) and alone.reach.joints == ("pan",)
    (first,), (second,) = further_steps(shares, 1), further_steps(shares, 2)
    assert isinstance(first, Explore) and isinstance(second, Explore)
    assert first.seed != second.seed and first.reach.skip == ("lift",)
    assert further_steps({"pan": 1.0, "lift": None}, 0) == ()
    plan = plan_motion(Motion("m", (EachJoint(),), "stream"), (PAN, LIFT))
    longer = with_enough(plan, shares, 0)
    assert longer is not None and len(longer.segments) == len(plan.segments) + 3
    assert with_enough(plan, {"pan": 1.0}, 0) is None


def test_the_tally_of_a_session_is_the_travel_that_its_fit_finds(tmp_path: Path):
    head = 'schema = "motion/1"\nname = "m"\nmode = "stream"\n'
    text = head + "[[step]]\neach_joint = { at_most_deg = 9 }\nspeed_deg_s = 30\n"
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    capturing.capture(slower_rig("demo", tmp_path), str(tmp_path / "m.toml"), tmp_path / "s")
    fitting.fit(tmp_path / "s")
    recording, table = Recording.load(tmp_path / "s"), load_rig("demo").table
    tally = MotionTally(table.limits(), sides_of(table))
    part_of = {marker.id: marker.part for marker in table.marker_table().markers}
    log = recording.observations
    for row, t_s in enumerate(log.t_s):
        q = [np.interp(t_s, recording.measured.t_s, column) for column in recording.measured.q.T]
        tally.add(np.array(q), {part_of[n] for n in log.marker_id[log.frame == row].tolist()})
    found = {joint.name: joint for joint in read_fit(tmp_path / "s" / "fit").tree.joints}
    assert set(found) == set(tally.shares())
    for name, travel in zip((joint.name for joint in table.limits()), tally.travel, strict=True):
        joint = found[name]
        assert joint.state_max is not None and joint.state_min is not None
        # Noise adds a little at either end, and the lag of a frame behind the read-back.
        assert np.degrees(travel) == pytest.approx(np.degrees(joint.state_max - joint.state_min), abs=1.0)
