"""Rigs of drawn objects: the same mechanism, limits within a servo's turn, markers that are seen; what is refused."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from station.builder.draft import Draft, blank
from station.builder.edits import add_part, set_limits, set_type
from station.builder.marking import add_marker, set_block
from station.builder.placing import set_axis, set_zero
from station.builder.rig_text import Table, servo_tables, written
from station.builder.rig_truth import tracked_tree
from station.builder.rigs import DrawnRig, to_rig, write_rig
from station.errors import InvalidData, InvalidFile
from station.formats.rig import RigTable, parse_rig
from station.hand_motion import free_joints, hand_motion
from station.kinematics import se3
from station.mechanism import mechanism
from station.rig_reading import joint_configs
from tests.drawn_objects import drawer_cabinet, swivel_chair

# Metres: a rig's lengths are written to a thousandth of a millimetre.
WRITTEN = 5e-6


def askew() -> Draft:
    """A chair on a tilted column, a lamp that is fixed to its back and turns there."""
    draft = set_zero(swivel_chair(), "column", (0.05, -0.02, 0.2), (0.1, -0.2, 0.3))
    draft = add_part(draft, "bracket", "back", "rigid")
    draft = set_zero(draft, "bracket", (0.1, 0.0, 0.3), (0.4, 0.1, -0.2))
    draft = set_axis(add_part(draft, "lamp", "bracket"), "lamp_joint", (1, 1, 0), (0.02, 0, 0.1))
    return set_limits(draft, "lamp_joint", 0.1, 0.9)


# What a rig has beside its joints, as short as may be.
REST = (
    Table("camera", {"source": 0, "size_px": [640, 480], "fps": 30}),
    Table("markers", {"dictionary": "DICT_4X4_50", "marker": [{"id": 0, "part": "seat", "size_mm": 50.0}]}),
)


def rig_of(draft: Draft, *, servos: bool = True) -> RigTable:
    return parse_rig(to_rig(draft, servos=servos).text, "rig.toml")


@cache
def rig_as_drawn(draw: Callable[[], Draft], *, servos: bool = True) -> DrawnRig:
    """Of a draft that is taken as it is: many claims are about the same, and placing its markers takes a second."""
    return to_rig(draw(), servos=servos)


@pytest.mark.parametrize("draw", [swivel_chair, drawer_cabinet, askew])
def test_the_simulation_moves_as_the_drawn_tree(draw):
    draft = draw()
    simulation = parse_rig(rig_as_drawn(draw).text, "rig.toml").simulation
    assert simulation is not None
    true = mechanism(simulation)
    rng = np.random.default_rng(0)
    zero = draft.tree.forward(np.zeros(len(draft.tree.columns)))
    for _ in range(5):
        q = {joint.name: rng.uniform(*joint.limits) for joint in draft.tree.movable}
        poses, drawn = true.forward(q), draft.tree.forward(q)
        for body in true.bodies:
            np.testing.assert_allclose(poses[body] @ zero[body], drawn[body], atol=WRITTEN)


def test_markers_and_boxes_are_where_they_were_drawn():
    draft = add_marker(askew(), "bracket", 0.06)
    rig = to_rig(draft)
    simulation = parse_rig(rig.text, "rig.toml").simulation
    assert simulation is not None
    zero = draft.tree.forward(np.zeros(len(draft.tree.columns)))
    plate = next(plate for plate in simulation.plate if plate.id == 0)
    T = zero["bracket"] @ draft.marker(0).mount
    assert plate.body == "back"
    np.testing.assert_allclose(np.array(plate.position_mm) / 1e3, T[:3, 3], atol=WRITTEN)
    np.testing.assert_allclose(plate.normal, T[:3, 2], atol=1e-5)
    seat = [box for box in simulation.box if box.body == "seat"]
    np.testing.assert_allclose(seat[0].size_mm, (420, 420, 60), atol=1e-3)
    np.testing.assert_allclose(np.array(seat[0].position_mm) / 1e3, zero["seat"][:3, 3], atol=WRITTEN)


def test_limits_are_taken_over_and_lie_within_a_turn_of_the_servo():
    draft = set_limits(swivel_chair(), "swivel", -np.pi, np.pi)
    draft = set_limits(draft, "height", 0.1, 0.25)
    table = rig_of(draft)
    for limits, servo, joint in zip(table.limits(), joint_configs(table), draft.tree.movable, strict=True):
        np.testing.assert_allclose((limits.lower, limits.upper), joint.limits, atol=1e-7)
        assert limits.lower <= limits.park <= limits.upper
        counts = [servo.servos[0].count(q) for q in (joint.limits[0], joint.limits[1], limits.park)]
        assert min(counts) >= 0 and max(counts) < 4096


@pytest.mark.parametrize(("low", "high"), [(0.0, 1e-8), (-600.0, 600.0), (1.0, 2.0), (-2.0, -1.0)])
def test_limits_of_any_size_lie_within_a_turn_of_the_servo(low: float, high: float):
    joints = set_limits(swivel_chair(), "swivel", low, high).tree.movable
    text = written([Table("", {"schema": "rig/1"}), *servo_tables(joints), *REST])
    servo = joint_configs(parse_rig(text.replace('"emulated"', '"/dev/ttyUSB0"'), "rig.toml"))[1].servos[0]
    counts = [servo.count(q) for q in (low, high, 0.0)]
    assert min(counts) >= 0 and max(counts) < 4096


def test_a_rig_without_servos_is_moved_by_hand_within_the_drawn_limits():
    draft = set_limits(set_limits(drawer_cabinet(), "upper_joint", -0.03, 0.0), "door_joint", 0.4, 0.5)
    table = rig_of(draft, servos=False)
    assert not table.joint and table.simulation is not None
    limits = free_joints(table.simulation.units(), table.simulation.hand_limits())
    hand = hand_motion(limits, None)
    q = np.array([hand.states(t) for t in np.linspace(0, hand.duration_s, 400)])
    names = [limit.name for limit in limits]
    for name, low, high in (("upper_joint", -0.03, 0.0), ("door_joint", 0.4, 0.5)):
        states = q[:, names.index(name)]
        assert low - 1e-7 <= states.min() < states.max() <= high + 1e-7  # written to millionths of a degree
        assert states.max() - states.min() > 0.5 * (high - low)


@pytest.mark.parametrize("draw", [swivel_chair, drawer_cabinet])
def test_every_part_of_a_drawn_object_is_seen_in_most_poses(draw):
    rig = rig_as_drawn(draw)
    assert rig.remarks == ()
    assert min(rig.view.seen_share.values()) > 0.6
    assert len(rig.draft.markers) == 2 * len(rig.draft.parts)


def test_a_part_that_is_shut_away_is_told_of():
    draft = set_block(add_part(blank("safe"), "lid"), "base", (0.5, 0.5, 0.5), (0.0, 0.0, 0.25))
    draft = set_zero(draft, "lid", (0.0, 0.0, 0.25), (0, 0, 0))
    hidden = se3.translation([0.0, 0.0, 0.0])
    draft = set_block(draft, "lid", (0.05, 0.05, 0.05))
    for _ in range(2):
        draft = add_marker(draft, "lid", 0.04, T_part_marker=hidden)
    assert any("'lid' is seen in 0 % of the poses" in remark for remark in to_rig(draft).remarks)


def test_each_marker_is_a_part_of_its_own_under_a_name_that_is_free():
    draft = add_part(swivel_chair(), "seat_b", "base", "rigid")
    names = [marker.part for marker in rig_of(draft).markers.marker]
    assert len(set(names)) == len(names)
    assert {"seat", "seat_b"} <= set(names)


def test_the_tree_that_a_fit_should_find_moves_the_markers_as_the_draft_does():
    draft = rig_as_drawn(askew).draft
    tree = tracked_tree(draft)
    rng = np.random.default_rng(1)
    q = {joint.name: rng.uniform(*joint.limits) for joint in draft.tree.movable}
    found, poses = tree.forward(q), draft.tree.forward(q)
    markers = {marker.part: marker for marker in reversed(draft.markers)}
    T_root_first = poses["base"] @ markers["base"].mount
    for part in ("column", "seat", "back", "lamp"):
        want = se3.inverse(T_root_first) @ poses[part] @ markers[part].mount
        np.testing.assert_allclose(found[part], want, atol=1e-12)


@pytest.mark.parametrize(
    ("draft", "said"),
    [
        (set_type(swivel_chair(), "recline", "screw"), "joint 'recline' is screw; a rig's"),
        (set_type(swivel_chair(), "recline", "spherical"), "joint 'recline' is spherical"),
        (add_part(blank(), "lid", type="rigid"), "nothing moves"),
        (blank(), "nothing moves"),
    ],
)
def test_what_can_be_no_rig_is_refused(draft: Draft, said: str):
    with pytest.raises(InvalidData, match=said):
        to_rig(draft)


def test_a_rig_is_written_once_and_only_for_a_tree_that_is_there(tmp_path: Path):
    out = tmp_path / "lamp.toml"
    write_rig("lamp", out)
    assert parse_rig(out.read_text(encoding="utf-8"), "lamp.toml").name == "lamp"
    with pytest.raises(InvalidData, match="is there already"):
        write_rig("lamp", out)
    with pytest.raises(InvalidData, match=r"want one that ends in .toml"):
        write_rig("lamp", tmp_path / "lamp.json")
    with pytest.raises(InvalidFile, match="no tree"):
        write_rig("sofa", tmp_path / "sofa.toml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("limits_mm = [0.0, 200.0]", "limits_mm = [200.0, 0.0]", r"want limits_mm = \[lower, upper\]"),
        ("limits_mm = [0.0, 200.0]", "limits_deg = [0.0, 200.0]", "a prismatic joint has limits_mm, not limits_deg"),
        ("axis = [0.0, -1.0, 0.0]", "axis = [0.0, 0.0, 0.0]", "the axis has no direction"),
    ],
)
def test_simulated_joints_that_can_not_be_are_refused(old: str, new: str, said: str):
    text = rig_as_drawn(drawer_cabinet, servos=False).text
    assert old in text
    with pytest.raises(InvalidFile, match=said):
        parse_rig(text.replace(old, new), "rig.toml")
