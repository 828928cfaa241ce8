"""Edits of a draft: what each one does, and what is refused with the draft left as it was."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from station.builder.documents import to_text
from station.builder.draft import Draft, blank
from station.builder.edits import (
    add_part,
    delete_branch,
    delete_part,
    rename_joint,
    rename_part,
    set_limits,
    set_parent,
    set_pitch,
    set_root,
    set_type,
)
from station.builder.marking import add_marker, change_marker, delete_marker, place_marker, set_block
from station.builder.placing import (
    axis_gizmo,
    part_gizmo,
    place_axis,
    place_part,
    set_axis,
    set_zero,
    to_gizmo,
    zero_numbers,
)
from station.errors import InvalidData
from station.kinematics import se3

# Metres and dimensionless: rounding of a few products of matrices of lengths about 1 m.
ROUNDING = 1e-12


def chair() -> Draft:
    """base - column (prismatic) - seat (revolute) - back (revolute); placed askew so that frames differ."""
    draft = add_part(blank("chair"), "column", "base", "prismatic")
    draft = add_part(draft, "seat", "column", "revolute")
    draft = add_part(draft, "back", "seat", "revolute")
    draft = set_zero(draft, "seat", (0.1, -0.2, 0.3), (0.3, -0.2, 0.9))
    draft = set_axis(draft, "back_joint", (1.0, 2.0, 0.5), (0.1, 0.0, 0.2))
    return add_marker(draft, "back", 0.05)


STATES = {"column_joint": 0.07, "seat_joint": 0.4, "back_joint": -0.3}


def motions(draft: Draft, states: dict[str, float], *parts: str) -> list[np.ndarray]:
    poses = draft.poses(states)
    return [poses[part] for part in parts]


def test_a_new_part_hangs_where_it_is_asked_to_and_beside_its_siblings():
    draft = add_part(add_part(blank(), "left", "base"), "right", "base", "prismatic")
    assert draft.parts == ("base", "left", "right")
    assert [joint.name for joint in draft.joints] == ["left_joint", "right_joint"]
    places = [joint.T_parent_child_zero[:3, 3] for joint in draft.joints]
    assert np.linalg.norm(places[0] - places[1]) > 0.1


def test_many_parts_without_names_get_distinct_names_and_places():
    draft = blank()
    for _ in range(12):
        draft = add_part(draft)
    assert len(set(draft.parts)) == 13
    places = np.array([joint.T_parent_child_zero[:3, 3] for joint in draft.joints])
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1) + np.eye(12)
    assert apart.min() > 0.1


def test_a_part_keeps_its_joint_markers_and_boxes_under_another_name():
    draft = rename_part(set_block(chair(), "back", (0.4, 0.05, 0.5)), "back", "backrest")
    assert draft.joint_above("backrest").name == "backrest_joint"
    assert draft.markers[0].part == draft.blocks[0].part == "backrest"
    assert rename_part(draft, "base", "foot").tree.root == "foot"


def test_a_joint_that_was_named_keeps_its_name_when_its_part_is_renamed():
    draft = rename_part(rename_joint(chair(), "back_joint", "recline"), "back", "backrest")
    assert draft.joint_above("backrest").name == "recline"


def test_children_of_a_deleted_part_hang_on_its_parent_and_stay_where_they_are_at_zero():
    before = chair()
    after = delete_part(before, "seat")
    assert after.parts == ("base", "column", "back")
    assert after.joint_above("back").parent == "column"
    zeros = dict.fromkeys(STATES, 0.0)
    want = before.poses(zeros)["back"]
    have = after.poses({"column_joint": 0.0, "back_joint": 0.0})["back"]
    np.testing.assert_allclose(have, want, atol=ROUNDING)
    # The axis, too: the back turns about the same line.
    turned = before.poses({**zeros, "back_joint": 0.5})["back"]
    np.testing.assert_allclose(after.poses({"column_joint": 0.0, "back_joint": 0.5})["back"], turned, atol=ROUNDING)


def test_a_branch_goes_with_all_that_hangs_from_it():
    draft = delete_branch(chair(), "seat")
    assert draft.parts == ("base", "column") and draft.markers == ()


def test_a_part_on_another_parent_stays_where_it_is_at_zero():
    before = chair()
    after = set_parent(before, "back", "base")
    zeros = dict.fromkeys(STATES, 0.0)
    for states in (zeros, {**zeros, "back_joint": 0.7}):
        np.testing.assert_allclose(after.poses(states)["back"], before.poses(states)["back"], atol=ROUNDING)
    assert set_parent(before, "back", "seat") is before


def test_another_root_moves_all_parts_as_before():
    before, after = chair(), set_root(chair(), "seat")
    assert after.tree.root == "seat"
    old, new = before.poses(STATES), after.poses(STATES)
    for part in before.parts:
        np.testing.assert_allclose(new[part], se3.inverse(old["seat"]) @ old[part], atol=ROUNDING)


@pytest.mark.parametrize("type", ["rigid", "prismatic", "revolute", "screw", "spherical"])
def test_every_type_of_joint_can_be_chosen_and_left_again(type: str):
    draft = set_type(chair(), "back_joint", type)
    assert draft.joint("back_joint").type == type
    back = set_type(draft, "back_joint", "revolute").joint("back_joint")
    assert back.type == "revolute" and back.limits is not None
    np.testing.assert_array_equal(back.T_parent_child_zero, chair().joint("back_joint").T_parent_child_zero)


def test_an_axis_stays_when_a_hinge_becomes_a_slide_and_the_limits_change_with_the_unit():
    hinge = chair().joint("back_joint")
    slide = set_type(chair(), "back_joint", "prismatic").joint("back_joint")
    np.testing.assert_array_equal(slide.axis_parent, hinge.axis_parent)
    assert slide.limits != hinge.limits and slide.point_parent_m is None


def test_the_z_of_a_gizmo_becomes_the_axis_wherever_the_parents_are():
    draft = chair()
    T = se3.pose(se3.exp_so3([0.3, 1.1, -0.4]), [0.5, -0.1, 0.8])
    placed = place_axis(draft, "back_joint", *to_gizmo(T), STATES)
    joint, T_root_seat = placed.joint("back_joint"), draft.poses(STATES)["seat"]
    np.testing.assert_allclose(T_root_seat[:3, :3] @ joint.axis_parent, T[:3, 2], atol=ROUNDING)
    np.testing.assert_allclose((T_root_seat @ [*joint.point_parent_m, 1])[:3], T[:3, 3], atol=ROUNDING)
    np.testing.assert_array_equal(joint.T_parent_child_zero, draft.joint("back_joint").T_parent_child_zero)


def test_a_gizmo_that_is_let_go_where_it_was_changes_no_axis():
    draft = chair()
    for joint in draft.joints:
        same = place_axis(draft, joint.name, *axis_gizmo(draft, joint.name, STATES), STATES).joint(joint.name)
        np.testing.assert_allclose(same.axis_parent, joint.axis_parent, atol=ROUNDING)
        if joint.point_parent_m is not None:
            np.testing.assert_allclose(same.point_parent_m, joint.point_parent_m, atol=ROUNDING)


def test_a_part_goes_where_its_gizmo_is_with_its_joint_and_all_below_it():
    draft = chair()
    T = se3.pose(se3.exp_so3([0.3, 1.1, -0.4]), [0.5, -0.1, 0.8])
    placed = place_part(draft, "seat", *to_gizmo(T), STATES)
    before, after = draft.poses(STATES), placed.poses(STATES)
    np.testing.assert_allclose(after["seat"], T, atol=ROUNDING)
    np.testing.assert_allclose(
        se3.inverse(after["seat"]) @ after["back"], se3.inverse(before["seat"]) @ before["back"], atol=ROUNDING
    )
    # The axis of its joint is where it was in the part.
    in_part = [
        se3.inverse(poses["seat"]) @ poses["column"] @ drawn.joint("seat_joint").geometry.T_parent_axis
        for drawn, poses in ((draft, before), (placed, after))
    ]
    np.testing.assert_allclose(in_part[0][:3, 2:], in_part[1][:3, 2:], atol=ROUNDING)


def test_numbers_say_where_a_part_is_in_its_parent():
    xyz, rpy = (0.1, -0.2, 0.3), (0.3, -0.2, 0.9)
    np.testing.assert_allclose(zero_numbers(chair(), "seat"), (xyz, rpy), atol=ROUNDING)


def test_a_marker_on_another_part_stays_where_it_is_at_zero():
    draft = chair()
    moved = change_marker(draft, 0, part="base", new_id=7, size_m=0.03)
    want = draft.tree.forward(np.zeros(3))["back"] @ draft.marker(0).mount
    np.testing.assert_allclose(moved.marker(7).mount, want, atol=ROUNDING)
    assert (moved.marker(7).size_m, moved.marker(7).part) == (0.03, "base")


def test_a_marker_goes_where_its_gizmo_is():
    T = se3.pose(se3.exp_so3([0.3, 1.1, -0.4]), [0.5, -0.1, 0.8])
    placed = place_marker(chair(), 0, *to_gizmo(T), STATES)
    np.testing.assert_allclose(placed.poses(STATES)["back"] @ placed.marker(0).mount, T, atol=ROUNDING)


def test_single_markers_on_a_part_stand_beside_each_other():
    draft = add_marker(chair(), "back")
    apart = np.linalg.norm(draft.marker(0).mount[:3, 3] - draft.marker(1).mount[:3, 3])
    assert apart > 0.05
    assert delete_marker(draft, 0).markers[0].id == 1


def stiff(draft: Draft) -> Draft:
    return set_type(draft, "seat_joint", "rigid")


REFUSED: list[tuple[str, Callable[[Draft], Draft], str]] = [
    ("a cycle", lambda d: set_parent(d, "column", "back"), "that is a loop"),
    ("itself", lambda d: set_parent(d, "seat", "seat"), "can't hang from itself"),
    ("the root's parent", lambda d: set_parent(d, "base", "seat"), "'base' is the root"),
    ("no such parent", lambda d: set_parent(d, "seat", "sofa"), "there is no part 'sofa'; have base, column"),
    ("deleting the root", lambda d: delete_part(d, "base"), "make another part the root first"),
    ("deleting its branch", lambda d: delete_branch(d, "base"), "make another part the root first"),
    ("a name twice", lambda d: add_part(d, "seat"), "there is a part 'seat' already"),
    ("a new name twice", lambda d: rename_part(d, "back", "seat"), "there is a part 'seat' already"),
    ("a joint's name twice", lambda d: rename_joint(d, "back_joint", "seat_joint"), "a joint 'seat_joint' already"),
    ("no slug", lambda d: rename_part(d, "back", "Back Rest"), "such as 'back_rest'"),
    ("no letters", lambda d: add_part(d, "42"), "'42' is no name for a part"),
    ("an unknown type", lambda d: set_type(d, "seat_joint", "hinge"), "choose one of rigid, prismatic, revolute"),
    ("a type for a new part", lambda d: add_part(d, "arm", type="hinge"), "'hinge' is no type of joint"),
    ("an unknown joint", lambda d: set_type(d, "knee", "rigid"), "no joint 'knee'"),
    ("reversed limits", lambda d: set_limits(d, "seat_joint", 1.0, -1.0), "the lower limit is above the upper one"),
    ("no room", lambda d: set_limits(d, "seat_joint", 1.0, 1.0), "leaves no room"),
    ("no limits", lambda d: set_limits(d, "seat_joint", float("nan"), 1.0), "want two numbers"),
    ("limits beyond all", lambda d: set_limits(d, "seat_joint", 0.0, 1e9), "at most to either side"),
    (
        "limits of a rigid joint",
        lambda d: set_limits(set_type(d, "seat_joint", "rigid"), "seat_joint", 0, 1),
        "is rigid",
    ),
    ("a zero axis", lambda d: set_axis(d, "seat_joint", (0, 0, 0)), "the axis is zero and points nowhere"),
    ("an axis of no numbers", lambda d: set_axis(d, "seat_joint", (0, float("inf"), 0)), "want three numbers"),
    (
        "a point of no number",
        lambda d: set_axis(d, "seat_joint", (0, 0, 1), (0, float("nan"), 0)),
        "want three numbers",
    ),
    (
        "an axis of a rigid joint",
        lambda d: set_axis(set_type(d, "seat_joint", "rigid"), "seat_joint", (0, 0, 1)),
        "rigid",
    ),
    ("a pitch of a hinge", lambda d: set_pitch(d, "seat_joint", 0.1), "only a screw has a pitch"),
    ("moving the root", lambda d: set_zero(d, "base", (0, 0, 1), (0, 0, 0)), "'base' is the root"),
    ("a place of no number", lambda d: set_zero(d, "seat", (0, 0, float("nan")), (0, 0, 0)), "want three numbers"),
    ("a place too far away", lambda d: set_zero(d, "seat", (0, 0, 1e6), (0, 0, 0)), "up to 1000 m"),
    ("angles of no number", lambda d: set_zero(d, "seat", (0, 0, 0), (0, 0, float("nan"))), "roll, pitch, yaw"),
    ("a zero quaternion", lambda d: place_part(d, "seat", (0, 0, 0, 0), (0, 0, 0), STATES), "not all of them 0"),
    (
        "a marker's id twice",
        lambda d: add_marker(d, "seat", id=0),
        "marker 0 is on 'back' already",
    ),
    ("an id beyond", lambda d: add_marker(d, "seat", id=50), "its ids are 0 to 49"),
    ("a marker on nothing", lambda d: add_marker(d, "sofa"), "there is no part 'sofa'"),
    ("a marker of no size", lambda d: add_marker(d, "seat", 0.0), "want the side of its black square"),
    ("a mount that is none", lambda d: add_marker(d, "seat", T_part_marker=2 * np.eye(4)), "no rigid motion"),
    ("a marker that isn't there", lambda d: delete_marker(d, 5), "there is no marker 5; have 0"),
    ("a box without size", lambda d: set_block(d, "seat", (0.1, 0.0, 0.1)), "want three above 0"),
    ("a box in no colour", lambda d: set_block(d, "seat", (0.1, 0.1, 0.1), colour="red"), "one such as #8a8f98"),
]


@pytest.mark.parametrize(("edit", "said"), [case[1:] for case in REFUSED], ids=[case[0] for case in REFUSED])
def test_what_can_not_be_is_refused_in_words_and_the_draft_stays(edit: Callable[[Draft], Draft], said: str):
    draft = chair()
    before = to_text(draft)
    with pytest.raises(InvalidData, match=said.replace("(", r"\(")) as error:
        edit(draft)
    assert to_text(draft) == before
    assert "Traceback" not in str(error.value) and len(str(error.value).splitlines()) <= 3


def test_all_fifty_markers_are_given_and_then_no_more():
    draft = blank()
    for _ in range(50):
        draft = add_marker(draft, "base")
    with pytest.raises(InvalidData, match="all 50 markers of DICT_4X4_50 are in use"):
        add_marker(draft, "base")


def test_a_ball_turns_about_the_centre_that_its_gizmo_gave_it():
    draft = set_type(chair(), "back_joint", "spherical")
    states = {"column_joint": 0.0, "seat_joint": 0.0, "back_joint_x": 0.1, "back_joint_y": 0.0, "back_joint_z": 0.2}
    T = se3.translation([0.5, -0.1, 0.8])
    placed = place_axis(draft, "back_joint", *to_gizmo(T), states)
    np.testing.assert_allclose(axis_gizmo(placed, "back_joint", states)[1], T[:3, 3], atol=ROUNDING)
    assert part_gizmo(placed, "base", states) == ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
