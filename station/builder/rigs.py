"""A draft as a rig: a rig.toml whose [simulation] is the drawn object, so that the rendered camera captures it.

With servos the rig has one emulated servo a joint, and `station run RIG explore` captures and fits it; without, it is
an object that is moved by hand, which a made hand moves (`station capture RIG --hand`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.intrinsics import CameraModel
from station.builder.draft import FARTHEST_DRAWN_M, Block, Draft
from station.builder.drawing import part_blocks
from station.builder.marking import mark_all
from station.builder.plates import margin_m
from station.builder.rig_text import (
    Table,
    camera_tables,
    hand_limits,
    markers_table,
    numbers,
    servo_tables,
    written,
)
from station.builder.rig_truth import bodies, tracked_names
from station.builder.sights import Viewpoint, best_viewpoint, reached_states, swept_points, usual_camera
from station.builder.stored import load_draft, write_text
from station.errors import InvalidData
from station.formats.rig import RIG_SCHEMA, parse_rig
from station.formats.urdf_links import roll_pitch_yaw
from station.kinematics import se3
from station.kinematics.tree import Joint
from station.logs import FloatArray

TYPES = ("rigid", "revolute", "prismatic")
MM = 1e3
# Below which a body is seen too seldom to be worth a capture.
OFTEN = 0.5
# A table beneath and a wall behind, so that the picture has a background as a lab has: half its width, of the camera's
# distance; how thick; and how far behind the object.
ROOM_SHARE, THICK_M, BEHIND_M = 1.5, 0.02, 0.25
TABLE_COLOUR, WALL_COLOUR = "#b59a78", "#c9cdd2"


@dataclass(frozen=True, eq=False)
class DrawnRig:
    """A rig made from a draft.

    Attributes:
        text: of rig.toml.
        draft: with the markers that the rig has.
        view: where its camera stands.
        remarks: what may go wrong in a capture, in words.
    """

    text: str
    draft: Draft
    view: Viewpoint
    remarks: tuple[str, ...]


def to_rig(draft: Draft, *, servos: bool = True, camera: CameraModel | None = None) -> DrawnRig:
    """A rig of a draft: all of it drawn in the root's frame, z up, with all joints at 0.

    Parts without a marker get two (`marking.mark_all`); each marker is tracked as a part of its own, and which of them
    are on one body is for the fit to find. The camera stands where it sees most while the joints move.

    Args:
        draft: of rigid, revolute and prismatic joints; at least one moves.
        servos: whether each joint has an emulated servo; without them the object is moved by hand.
        camera: the rendered one; a webcam of 640 x 480 px if None.

    Raises:
        InvalidData: for other types of joints, an object that can't move, more markers than the dictionary has.
    """
    _check(draft)
    camera = usual_camera() if camera is None else camera
    marked = mark_all(draft)
    view = best_viewpoint(marked, camera)
    text = written(_tables(marked, camera, view, servos=servos))
    parse_rig(text, draft.name)
    return DrawnRig(text, marked, view, _remarks(marked, view))


def write_rig(name_or_path: str | Path, out: Path, *, servos: bool = True) -> DrawnRig:
    """Write the rig.toml of a tree: a kinematics.json, a URDF, a fit's folder or a packaged example.

    Args:
        name_or_path: the tree.
        out: the file, which must not be there yet.
        servos: as for `to_rig`.

    Raises:
        StationError: for a tree that can't be read or can't be a rig, a file that is there or can't be written.
    """
    if out.suffix.lower() != ".toml":
        raise InvalidData(f"'{out.name}' is no name for a rig; want one that ends in .toml")
    if out.exists():
        raise InvalidData(f"{out} is there already; name another file, or delete it first")
    rig = to_rig(load_draft(name_or_path), servos=servos)
    write_text(out, rig.text)
    return rig


def _check(draft: Draft) -> None:
    for joint in draft.joints:
        if joint.type not in TYPES:
            raise InvalidData(
                f"joint '{joint.name}' is {joint.type}; a rig's [simulation] has {', '.join(TYPES)} joints: choose one"
            )
    if not draft.tree.movable:
        raise InvalidData(f"nothing moves in '{draft.name}'; a rig needs a revolute or prismatic joint at least")


def _tables(draft: Draft, camera: CameraModel, view: Viewpoint, *, servos: bool) -> Iterator[Table]:
    yield Table("", {"schema": RIG_SCHEMA, "name": draft.name})
    if servos:
        yield from servo_tables(draft.tree.movable)
    yield from camera_tables(camera)
    yield markers_table(draft.dictionary, draft.markers, tracked_names(draft))
    yield from _simulation(draft, view, servos=servos)


def _simulation(draft: Draft, view: Viewpoint, *, servos: bool) -> Iterator[Table]:
    """The truth: rigid joints folded into bodies, everything told in the root's frame with all joints at 0."""
    body_of = bodies(draft)
    poses = draft.tree.forward(np.zeros(len(draft.tree.columns)))
    yield Table("simulation", {"root": body_of[draft.tree.root], "seed": 0})
    place = {"position_mm": numbers(MM * view.position_m), "look_at_mm": numbers(MM * view.target_m)}
    yield Table(
        "simulation.camera", {**place, "exposure_s": 0.008, "blur_instants": 2, "latency_s": 0.012, "noise_grey": 2.0}
    )
    for joint in draft.tree.outward():
        if joint.kind.states:
            hand = {} if servos else hand_limits(joint)
            yield Table("[simulation.joint]", {**_joint(joint, poses[joint.parent], body_of), **hand})
    for marker in draft.markers:
        T = poses[marker.part] @ marker.mount
        plate = {
            "id": marker.id,
            "body": body_of[marker.part],
            "position_mm": numbers(MM * T[:3, 3]),
            "normal": numbers(T[:3, 2], 6),
            "up": numbers(T[:3, 1], 6),
            "margin_mm": round(MM * margin_m(draft, marker.size_m), 2),
        }
        yield Table("[simulation.plate]", plate)
    for block in _room(draft, view):
        yield Table("[simulation.box]", _box(block, np.eye(4), body_of[block.part]))
    for part in draft.parts:
        for block in part_blocks(draft, part):
            yield Table("[simulation.box]", _box(block, poses[part], body_of[part]))


def _joint(joint: Joint, T_root_parent: FloatArray, body_of: dict[str, str]) -> dict[str, object]:
    R, p = T_root_parent[:3, :3], T_root_parent[:3, 3]
    axis = np.zeros(3) if joint.axis_parent is None else R @ joint.axis_parent
    found: dict[str, object] = {
        "name": joint.name,
        "type": joint.type,
        "parent": body_of[joint.parent],
        "child": body_of[joint.child],
        "axis": numbers(axis, 9),
    }
    if joint.point_parent_m is not None:
        found["point_mm"] = numbers(MM * (R @ joint.point_parent_m + p))
    return found


def _box(block: Block, T_root_part: FloatArray, body: str) -> dict[str, object]:
    T = T_root_part @ block.T_part_block
    rpy_deg = np.degrees([float(angle) for angle in roll_pitch_yaw(T[:3, :3])])
    found: dict[str, object] = {"body": body, "size_mm": numbers(MM * block.size_m)}
    found["position_mm"] = numbers(MM * T[:3, 3])
    if np.any(np.round(rpy_deg, 4)):
        found["rpy_deg"] = numbers(rpy_deg, 4)
    return {**found, "colour": block.colour}


def _room(draft: Draft, view: Viewpoint) -> tuple[Block, Block]:
    """A table under all that the object reaches, and a wall behind it as the camera sees it, on the root."""
    points = swept_points(draft, reached_states(draft))
    low, high = points.min(axis=0), points.max(axis=0)
    wide = min(ROOM_SHARE * float(np.linalg.norm(view.position_m - view.target_m)), 0.5 * FARTHEST_DRAWN_M)
    middle = 0.5 * (low + high)
    table = np.array([middle[0], middle[1], low[2] - 0.5 * THICK_M])
    away = view.target_m - view.position_m
    axis = int(np.argmax(np.abs(away[:2])))
    wall, size = middle.copy(), np.full(3, 2 * wide)
    wall[axis] = (high[axis] + BEHIND_M) if away[axis] > 0 else (low[axis] - BEHIND_M)
    size[axis] = THICK_M
    root = draft.tree.root
    return (
        Block(root, se3.translation(table), np.array([2 * wide, 2 * wide, THICK_M]), TABLE_COLOUR),
        Block(root, se3.translation(wall), size, WALL_COLOUR),
    )


def _remarks(draft: Draft, view: Viewpoint) -> tuple[str, ...]:
    """Parts that are seen seldom."""
    best: dict[str, float] = {part: 0.0 for part in draft.parts}
    for marker in draft.markers:
        best[marker.part] = max(best[marker.part], view.seen_share[marker.id])
    return tuple(
        f"'{part}' is seen in {100 * share:.0f} % of the poses; move its markers, or give it others"
        for part, share in best.items()
        if share < OFTEN
    )
