"""What a page draws of a draft: boxes on parts, lines for joints, and sliders; plain values, in metres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from station.builder.draft import Block, Draft, limits_of
from station.builder.placing import Numbers, to_gizmo
from station.kinematics import se3
from station.kinematics.tree import Joint
from station.logs import FloatArray

# Okabe and Ito's colours, told apart by all eyes, black and yellow left out.
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8a8f98")
AXIS_COLOUR, LIMITS_COLOUR, STATE_COLOUR = "#d62728", "#7f7f7f", "#2ca02c"
# Metres: a part's own block, and how thick the beam to what hangs from it is.
HUB_M, BEAM_M = 0.06, 0.03
# Of the length of an axis: its arrow head, and the radius of the arc of limits.
HEAD_SHARE, ARC_SHARE = 0.15, 0.6
AXIS_M = 0.2
ARC_STEP_RAD = np.radians(5.0)
MOST_ARC_POINTS = 145
X, Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
# Steps of a slider from end to end; digits of its ends, so that 60 degrees are 60 and not 59.99999.
SLIDER_STEPS, SHOWN_DIGITS = 400, 6


@dataclass(frozen=True, eq=False, slots=True)
class Line:
    """A polyline.

    Attributes:
        what: "axis", "arrow", "limits", "state", or whose it is.
        points_m: (N, 3) in the root's frame.
        colour: "#rrggbb".
        width: in pixels.
    """

    what: str
    points_m: FloatArray
    colour: str
    width: float = 3.0


@dataclass(frozen=True, eq=False, slots=True)
class Glyph:
    """A joint as lines: its axis with an arrow, an arc or a rail for its limits, a pointer at its state."""

    joint: str
    lines: tuple[Line, ...]


@dataclass(frozen=True, slots=True)
class Slider:
    """One state for people to move.

    Attributes:
        column: of the states.
        joint: its name.
        label: for people, such as "seat_joint [deg]".
        unit: "deg" or "mm".
        low, high, step: in that unit.
        per_unit: SI units (rad or m) in one unit.
    """

    column: str
    joint: str
    label: str
    unit: str
    low: float
    high: float
    step: float
    per_unit: float


def part_colour(draft: Draft, part: str) -> str:
    """A part's usual colour: neighbours in the list differ."""
    return COLOURS[draft.parts.index(part) % len(COLOURS)]


def part_blocks(draft: Draft, part: str) -> tuple[Block, ...]:
    """The part's own boxes, in its frame; of one without any a small block, and beams to all joints that it is at.

    Parent's and child's beams meet in the joint at every state: a slide's child has a beam as long as its travel.
    """
    own = tuple(block for block in draft.blocks if block.part == part)
    if own:
        return own
    colour = part_colour(draft, part)
    hub = Block(part, np.eye(4), np.full(3, HUB_M), colour)
    ends = [_anchor(joint) for joint in draft.joints if joint.parent == part]
    above = draft.joint_above(part)
    if above is not None:
        ends.append(_child_anchor(above))
    beams = (_beam(part, end, colour) for end in ends if np.linalg.norm(end) > HUB_M)
    return (hub, *beams)


def part_poses(draft: Draft, states: Mapping[str, float]) -> dict[str, tuple[Numbers, Numbers]]:
    """Quaternion (w, x, y, z) and place [m] of each part in the root's frame."""
    return {part: to_gizmo(T) for part, T in draft.poses(states).items()}


def joint_glyph(
    draft: Draft, joint: str, states: Mapping[str, float], poses: Mapping[str, FloatArray] | None = None
) -> Glyph:
    """A joint as lines in the root's frame; a rigid one is a line to its child.

    Args:
        draft: of the joint.
        joint: its name.
        states: of every column.
        poses: `draft.poses(states)`, for who draws many joints; found here if None.

    Raises:
        InvalidData: for a joint that isn't there.
    """
    drawn = draft.joint(joint)
    poses = draft.poses(states) if poses is None else poses
    T_root_parent, p_child = poses[drawn.parent], poses[drawn.child][:3, 3]
    if drawn.axis_parent is None:
        start = drawn.point_parent_m if drawn.point_parent_m is not None else np.zeros(3)
        return Glyph(joint, (Line("axis", np.stack([_moved(T_root_parent, start), p_child]), AXIS_COLOUR),))
    return Glyph(joint, axis_lines(drawn, T_root_parent, states[joint], AXIS_COLOUR))


def axis_lines(joint: Joint, T_root_parent: FloatArray, q: float, colour: str) -> tuple[Line, ...]:
    """An axis with its arrow, limits and state in the root's frame; `q` [rad or m]."""
    T_root_axis = T_root_parent @ joint.geometry.T_parent_axis
    lines = [*arrow(T_root_axis, colour)]
    low, high = limits_of(joint)
    if joint.unit == "m":
        rail = [low * Z, high * Z]
        lines.append(Line("limits", _all_moved(T_root_axis, rail), LIMITS_COLOUR, 5.0))
        pointer = [q * Z - 0.1 * AXIS_M * X, q * Z + 0.1 * AXIS_M * X]
    else:
        lines.append(Line("limits", _all_moved(T_root_axis, _arc(low, high)), LIMITS_COLOUR, 2.0))
        pointer = [np.zeros(3), ARC_SHARE * AXIS_M * np.array([np.cos(q), np.sin(q), 0.0])]
    return (*lines, Line("state", _all_moved(T_root_axis, pointer), STATE_COLOUR))


def arrow(T_root_axis: FloatArray, colour: str, width: float = 4.0) -> tuple[Line, ...]:
    """An axis along z of a frame and its arrow head, in the root's frame."""
    head = AXIS_M * HEAD_SHARE
    tip = 0.5 * AXIS_M * Z
    barbs = [tip + head * (0.5 * X - Z), tip, tip - head * (0.5 * X + Z)]
    return (
        Line("axis", _all_moved(T_root_axis, [-tip, tip]), colour, width),
        Line("arrow", _all_moved(T_root_axis, barbs), colour, width),
    )


def sliders(draft: Draft) -> tuple[Slider, ...]:
    """A slider for each column of the draft's states."""
    return tuple(_slider(joint, column) for joint in draft.tree.movable for column in joint.columns)


def shown_unit(joint: Joint) -> tuple[str, float]:
    """What a joint's states are shown in, "deg" or "mm", and how many rad or m one of it is."""
    return ("mm", 1e-3) if joint.unit == "m" else ("deg", float(np.radians(1.0)))


def _slider(joint: Joint, column: str) -> Slider:
    unit, per_unit = shown_unit(joint)
    low, high = limits_of(joint)
    if joint.type == "spherical":
        low = -high  # of each entry of the rotation vector
    low, high = (round(limit / per_unit, SHOWN_DIGITS) for limit in (low, high))
    return Slider(column, joint.name, f"{column} [{unit}]", unit, low, high, (high - low) / SLIDER_STEPS, per_unit)


def bounds(draft: Draft, states: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
    """The least and the greatest coordinates (3,) [m] of a draft's boxes and joints, in its root's frame."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
    points: list[FloatArray] = []
    poses = draft.poses(states)
    for part in draft.parts:
        points.append(poses[part][None, :3, 3])
        for block in part_blocks(draft, part):
            T = poses[part] @ block.T_part_block
            points.append((corners * block.size_m) @ T[:3, :3].T + T[:3, 3])
    for joint in draft.joints:
        points += [line.points_m for line in joint_glyph(draft, joint.name, states, poses).lines]
    every = np.concatenate(points)
    return every.min(axis=0), every.max(axis=0)


def _anchor(joint: Joint) -> FloatArray:
    """(3,) in the parent's frame: the point of the axis nearest the child's zero place, of a slide its lower end."""
    zero = joint.T_parent_child_zero[:3, 3]
    if joint.point_parent_m is None:
        return zero if joint.axis_parent is None else zero + limits_of(joint)[0] * joint.axis_parent
    if joint.axis_parent is None:
        return joint.point_parent_m
    return joint.point_parent_m + (joint.axis_parent @ (zero - joint.point_parent_m)) * joint.axis_parent


def _child_anchor(joint: Joint) -> FloatArray:
    """(3,) the same in the child's frame; of a slide where it is at the upper end."""
    T_child_parent = se3.inverse(joint.T_parent_child_zero)
    if joint.point_parent_m is None and joint.axis_parent is not None:
        low, high = limits_of(joint)
        return (low - high) * (T_child_parent[:3, :3] @ joint.axis_parent)
    return _moved(T_child_parent, _anchor(joint))


def _beam(part: str, end: FloatArray, colour: str) -> Block:
    """From the part's origin to a point in its frame."""
    length = float(np.linalg.norm(end))
    T = se3.pose(se3.rotation_between(Z, end / length), 0.5 * end)
    return Block(part, T, np.array([BEAM_M, BEAM_M, length]), colour)


def _arc(low: float, high: float) -> list[FloatArray]:
    """Points on the arc from one angle to another, at most once around."""
    high = min(high, low + 2 * np.pi)
    count = int(np.clip(np.ceil((high - low) / ARC_STEP_RAD) + 1, 2, MOST_ARC_POINTS))
    angles = np.linspace(low, high, count)
    points = ARC_SHARE * AXIS_M * np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=-1)
    return [np.zeros(3), *points, np.zeros(3)]


def _moved(T: FloatArray, p: FloatArray) -> FloatArray:
    return T[:3, :3] @ p + T[:3, 3]


def _all_moved(T: FloatArray, points: Sequence[FloatArray]) -> FloatArray:
    return np.stack(points) @ T[:3, :3].T + T[:3, 3]
