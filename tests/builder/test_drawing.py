"""What is drawn of a draft: beams that meet in the joints at every state, axes, arcs, rails and pointers in place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from station.builder.draft import Draft, blank
from station.builder.drawing import joint_glyph, part_blocks, sliders
from station.builder.edits import add_part, set_limits, set_type
from station.builder.placing import set_axis, set_zero
from tests.drawn_objects import swivel_chair


def ends_of_beams(draft: Draft, part: str, T_root_part: np.ndarray) -> np.ndarray:
    """(N, 3) both ends of the part's boxes along their z, in the root's frame."""
    ends = [
        (T_root_part @ block.T_part_block @ [0, 0, sign * block.size_m[2] / 2, 1])[:3]
        for block in part_blocks(draft, part)[1:]
        for sign in (-1, 1)
    ]
    return np.array(ends)


@pytest.mark.parametrize("type", ["revolute", "spherical", "rigid"])
@pytest.mark.parametrize("q", [-0.6, 0.0, 0.9])
def test_beams_of_parent_and_child_meet_in_the_joint_at_every_state(type: str, q: float):
    draft = set_zero(add_part(blank(), "arm"), "arm", (0.3, 0.1, 0.4), (0.2, 0.5, -0.3))
    draft = set_axis(set_limits(draft, "arm_joint", -1.0, 1.0), "arm_joint", (0.2, 1, 0), (0.2, 0, 0.1))
    draft = set_type(draft, "arm_joint", type)
    states = dict.fromkeys(draft.tree.columns, q)
    poses = draft.poses(states)
    parent, child = (ends_of_beams(draft, part, poses[part]) for part in ("base", "arm"))
    # A rigid child's block is at the end of the parent's beam: it has none of its own.
    child = poses["arm"][None, :3, 3] if type == "rigid" else child
    assert np.linalg.norm(parent[:, None] - child[None], axis=-1).min() < 1e-9  # m


@pytest.mark.parametrize("q", [0.05, 0.1, 0.3])
def test_the_beams_of_a_slide_overlap_over_all_its_travel(q: float):
    draft = set_zero(add_part(blank(), "drawer", type="prismatic"), "drawer", (0.3, 0.1, 0.4), (0.2, 0.5, -0.3))
    draft = set_limits(set_axis(draft, "drawer_joint", (0, 1, 1)), "drawer_joint", 0.05, 0.3)
    poses = draft.poses({"drawer_joint": q})
    start = draft.poses({"drawer_joint": 0.05})["drawer"][:3, 3]
    ends = ends_of_beams(draft, "drawer", poses["drawer"])
    assert np.linalg.norm(ends_of_beams(draft, "base", poses["base"]) - start, axis=-1).min() < 1e-9
    axis = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    along = (start - ends[0]) @ axis
    assert -1e-9 <= along <= np.linalg.norm(ends[1] - ends[0]) + 1e-9
    assert np.linalg.norm(np.cross(axis, start - ends[0])) < 1e-9


def test_a_part_with_a_box_of_its_own_is_drawn_as_that_alone():
    assert [len(part_blocks(swivel_chair(), part)) for part in swivel_chair().parts] == [1, 1, 1, 1]


def test_axis_arc_and_pointer_are_where_the_joint_is():
    draft = swivel_chair()
    states = {"height": 0.04, "swivel": 0.5, "recline": 0.2}
    poses = draft.poses(states)
    glyph = joint_glyph(draft, "recline", states)
    lines = {line.what: line.points_m for line in glyph.lines}
    point = (poses["seat"] @ [0.0, 0.2, 0.05, 1])[:3]
    axis = poses["seat"][:3, 0]
    np.testing.assert_allclose(lines["axis"].mean(axis=0), point, atol=1e-12)
    np.testing.assert_allclose(np.cross(axis, lines["axis"][1] - lines["axis"][0]), 0, atol=1e-12)
    np.testing.assert_allclose((lines["limits"] - point) @ axis, 0, atol=1e-12)
    # The pointer turns with the part: by the state from where it points at 0.
    at_zero = {line.what: line for line in joint_glyph(draft, "recline", {**states, "recline": 0.0}).lines}["state"]
    a, b = (points[1] - points[0] for points in (at_zero.points_m, lines["state"]))
    assert np.arctan2(np.cross(a, b) @ axis, a @ b) == pytest.approx(0.2)


def test_a_rail_is_as_long_as_the_travel_and_the_pointer_stands_on_the_part():
    draft = swivel_chair()
    lines = {
        line.what: line.points_m for line in joint_glyph(draft, "height", draft.usual_states() | {"height": 0.07}).lines
    }
    assert np.linalg.norm(lines["limits"][1] - lines["limits"][0]) == pytest.approx(0.12)
    np.testing.assert_allclose(lines["state"].mean(axis=0), (0, 0, 0.27), atol=1e-12)


def test_given_poses_draw_the_same():
    draft = swivel_chair()
    states = draft.usual_states()
    given = joint_glyph(draft, "swivel", states, draft.poses(states))
    for old, new in zip(joint_glyph(draft, "swivel", states).lines, given.lines, strict=True):
        np.testing.assert_array_equal(old.points_m, new.points_m)


def test_sliders_are_in_degrees_and_millimetres():
    shown = {slider.label: (slider.low, slider.high) for slider in sliders(swivel_chair())}
    assert shown == {"height [mm]": (0.0, 120.0), "swivel [deg]": (-80.0, 80.0), "recline [deg]": (-30.0, 20.0)}
    ball = replace(swivel_chair(), tree=set_type(swivel_chair(), "recline", "spherical").tree)
    assert [slider.column for slider in sliders(ball)][2:] == ["recline_x", "recline_y", "recline_z"]
