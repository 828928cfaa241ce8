"""One joint at a time: the motion stays within every packaged rig's limits, and its stretches are found again."""

from __future__ import annotations

import numpy as np
import pytest

from station.calibrating.lone_motion import lone_sweeps, swinging_motion
from station.errors import StationError
from station.formats.motion import parse_motion
from station.logs import JointLog
from station.motion import JointLimits, plan_motion
from station.perception.observations import ObservationLog
from station.rig_reading import packaged_names, read_rig


@pytest.mark.parametrize("name", packaged_names("rigs"))
def test_every_packaged_rig_swings_its_revolute_joints_alone_and_slowly(name: str):
    limits = read_rig(name)[0].limits()
    plan = plan_motion(parse_motion(swinging_motion(limits), "swings", limits), limits)
    for segment in plan.segments:
        (moved,) = np.flatnonzero(segment.q_from != segment.q_to)
        assert limits[moved].unit == "rad" and segment.speed[moved] <= np.radians(45.001)
        assert abs(segment.q_to[moved] - limits[moved].park) <= np.radians(15.001)
    swung = {int(np.flatnonzero(s.q_from != s.q_to)[0]) for s in plan.segments}
    assert len(swung) == sum(joint.unit == "rad" for joint in limits)
    assert plan.duration_s < 40


LIFT = JointLimits("lift", -0.02, 0.02, 1.0)
PAN = JointLimits("pan", -1.0, 1.0, 1.0)
DRAWER = JointLimits("drawer", 0.0, 0.1, 0.05, park=0.0, unit="m")


def test_only_what_is_asked_for_swings_and_what_cannot_is_said():
    assert "pan" in swinging_motion([PAN, LIFT]) and "lift" not in swinging_motion([PAN, LIFT])
    drawer = swinging_motion([PAN, DRAWER], ["drawer"])
    assert "speed_mm_s" in drawer and "pan" not in drawer
    parse_motion(drawer, "swings", [PAN, DRAWER])
    with pytest.raises(StationError, match="no joint 'elbow'; the rig has pan, lift"):
        swinging_motion([PAN, LIFT], ["elbow"])
    with pytest.raises(StationError, match="no joint can swing by 8 deg"):
        swinging_motion([LIFT])


def watched(t_s: np.ndarray, markers: int = 2) -> ObservationLog:
    """Markers 0, 1, ... in every frame, all corners at (100, 100) px."""
    count = len(t_s) * markers
    return ObservationLog(
        t_s=t_s,
        frame=np.repeat(np.arange(len(t_s)), markers),
        marker_id=np.tile(np.arange(markers), len(t_s)),
        corners_px=np.full((count, 4, 2), 100.0),
        corner_covariance_px2=np.full((count, 4, 2, 2), np.nan),
        T_cam_marker=np.full((count, 2, 4, 4), np.nan),
        rms_px=np.full((count, 2), np.nan),
    )


def test_stretches_in_which_one_joint_moves_are_found_and_shared_motion_is_left_out():
    t_s = np.arange(0, 12, 0.02)
    pan = np.radians(np.interp(t_s, [1, 2, 3, 8, 9, 10], [0, 30, 0, 0, 20, 0]))
    lift = np.radians(np.interp(t_s, [5, 6, 7, 8, 9, 10], [0, 20, 0, 0, 20, 0]))
    flicker = np.radians(0.3) * (np.arange(len(t_s)) % 2)
    log = JointLog(t_s, ("pan", "lift", "still"), np.stack([pan, lift, flicker], axis=1), ("rad", "rad", "rad"))
    sweeps = lone_sweeps(log, watched(t_s[::2]), readout_s=0.02, height_px=480)
    assert [sweep.joint for sweep in sweeps] == ["pan", "lift"]
    assert sweeps[0].readback_t_s[0] == 0 and 4.8 < sweeps[0].readback_t_s[-1] < 5.1
    assert 2.9 < sweeps[1].readback_t_s[0] < 3.2 and 7.8 < sweeps[1].readback_t_s[-1] < 8.1
    # 100 px is 140 rows above the middle: seen 5.8 ms earlier
    assert sweeps[1].t_s[0, 0] - t_s[::2][np.searchsorted(t_s[::2], sweeps[1].readback_t_s[0] - 0.5)] == pytest.approx(
        -140 / 480 * 0.02
    )


def test_without_readings_or_markers_there_are_no_stretches():
    t_s = np.arange(0, 4, 0.02)
    nothing = JointLog(np.zeros(0), ("pan",), np.zeros((0, 1)), ("rad",))
    assert lone_sweeps(nothing, watched(t_s), readout_s=0.0, height_px=480) == []
    moved = JointLog(t_s, ("pan",), np.sin(t_s)[:, None], ("rad",))
    assert lone_sweeps(moved, watched(t_s, markers=0), readout_s=0.0, height_px=480) == []
