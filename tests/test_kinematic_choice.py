"""A fitted tree puts ambiguous poses on their side: parts seen nearly from the front, that hang from others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from station import commands
from station.fit.learner import learn
from station.formats.camera import format_camera
from station.formats.markers import format_markers
from station.kinematic_choice import choose_by_tree
from station.kinematics import se3
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray
from station.perception.markers import Marker, MarkerTable
from station.perception.observations import MARKER_SHAPES, FrameMarkers, ObservationLog
from station.recording import RecordingWriter
from station.tracking import TrackedParts, track_parts
from tests.made_sessions import describe
from tests.test_tracking import AHEAD, CAMERA, DICTIONARY, FACING, SIZE_M, flips, watch

FRAMES = 240
# A base seen from the side, and a lid on it, seen nearly from the front, which turns in its own plane.
TABLE = MarkerTable(DICTIONARY, (Marker(1, "lid", SIZE_M), Marker(2, "base", SIZE_M)))


def swinging_lid(lean_deg: float = 9.0) -> FloatArray:
    """(F, 2, 4, 4) poses of lid and base in the camera; the lid turns to and fro by 80 deg."""
    swing = np.deg2rad(40) * np.sin(np.arange(FRAMES) / 20)
    zero = np.zeros(FRAMES)
    leaning = se3.pose(se3.exp_so3(np.array([np.deg2rad(lean_deg), 0, 0])) @ FACING, AHEAD)
    lid = leaning @ se3.exp(np.stack([zero] * 5 + [swing], axis=-1))
    base = leaning @ se3.pose(se3.exp_so3(np.array([0.7, 0.3, 0.0])), np.array([0.1, 0.0, -0.02]))
    return np.stack([lid, np.broadcast_to(base, lid.shape)], axis=1)


@pytest.fixture(scope="module")
def tracked() -> TrackedParts:
    return track_parts(watch(swinging_lid(), TABLE, sigma_px=0.3), TABLE, CAMERA)


@pytest.fixture(scope="module")
def tree(tracked: TrackedParts) -> KinematicTree:
    return learn(tracked.poses).tree


def test_the_tree_is_found_although_some_poses_are_on_the_wrong_side(tree: KinematicTree) -> None:
    assert [joint.type for joint in tree.joints] == ["revolute"]


def test_what_corners_and_time_leave_open_the_tree_decides(tracked: TrackedParts, tree: KinematicTree) -> None:
    truth = swinging_lid()[:, 0]
    before, after = tracked.choice, choose_by_tree(tracked, tree)
    wrong = [flips(tracked.hypotheses, choice.chosen[:, 0], truth) for choice in (before, after)]
    assert wrong[0] >= 10
    assert wrong[1] <= wrong[0] // 5
    assert after.ambiguous.sum() < before.ambiguous.sum() / 2


def test_refitted_with_those_the_axis_is_at_least_as_good(tracked: TrackedParts, tree: KinematicTree) -> None:
    again = learn(replace(tracked, choice=choose_by_tree(tracked, tree)).poses).tree
    lid, base = swinging_lid()[0]

    def off_deg(found: KinematicTree) -> float:
        joint = found.joints[0]
        assert joint.axis_parent is not None
        axis_cam = (base if joint.parent == "base" else lid)[:3, :3] @ joint.axis_parent
        return float(np.rad2deg(np.arccos(min(1.0, abs(axis_cam @ lid[:3, 2])))))

    assert off_deg(again) < max(off_deg(tree), 0.5)


def test_sure_poses_stay_as_they_are(tracked: TrackedParts, tree: KinematicTree) -> None:
    sure = ~tracked.choice.ambiguous
    after = choose_by_tree(tracked, tree)
    np.testing.assert_array_equal(after.chosen[sure], tracked.choice.chosen[sure])
    np.testing.assert_array_equal(after.probability[sure], tracked.choice.probability[sure])


def test_a_second_marker_on_the_same_body_decides_too(tree: KinematicTree) -> None:
    lid, base = np.moveaxis(swinging_lid(), 1, 0)
    turned = lid @ se3.pose(se3.exp_so3(np.array([0.0, 0.8, 0.0])), np.array([0.07, 0.0, -0.03]))
    table = MarkerTable(DICTIONARY, (*TABLE.markers, Marker(3, "lid_b", SIZE_M)))
    tracked = track_parts(watch(np.stack([lid, base, turned], axis=1), table, sigma_px=0.3), table, CAMERA)
    grouped = replace(tree, parts=table.parts, rigid_groups=(("lid", "lid_b"),))
    after = choose_by_tree(tracked, grouped)
    assert flips(tracked.hypotheses, tracked.choice.chosen[:, 0], lid) >= 10
    assert flips(tracked.hypotheses, after.chosen[:, 0], lid) <= 2


def recorded(folder: Path, observations: ObservationLog) -> Path:
    """A session of these observations, with black pictures."""
    told = describe(
        camera=format_camera(CAMERA), markers=format_markers(TABLE), joints=(), units=(), rig=None, motion=None
    )
    with RecordingWriter(folder, told, start_ns=0) as writer:
        for frame, t_s in enumerate(observations.t_s):
            rows = observations.frame == frame
            markers = FrameMarkers(**{name: getattr(observations, name)[rows] for name in MARKER_SHAPES})
            writer.log_frame(frame, round(t_s * 1e9) + 1, np.zeros((48, 64, 3), dtype=np.uint8), markers)
        writer.close("complete", {})
    return folder


def test_fitting_a_session_says_how_many_poses_its_tree_turned_over(tmp_path: Path) -> None:
    session = recorded(tmp_path / "lid", watch(swinging_lid(), TABLE, sigma_px=0.3))
    result = commands.fit(session)
    assert any("were turned over to agree with the tree" in notice for notice in result.notices)
    assert [joint.type for joint in result.fit.tree.joints] == ["revolute"]
    sure = recorded(tmp_path / "sure", watch(swinging_lid(40.0), TABLE, sigma_px=0.1))
    assert not commands.fit(sure).notices
