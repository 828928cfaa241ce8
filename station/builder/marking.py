"""Edits of what is on the parts: markers, by numbers or a gizmo, and boxes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from station.builder.draft import FARTHEST_DRAWN_M, Block, Draft
from station.builder.drawing import part_blocks, part_colour
from station.builder.placing import Numbers, from_gizmo, to_gizmo
from station.drawn import facing
from station.errors import InvalidData
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.markers import DICTIONARY_SIZES, Marker

MARKER_SIZE_M = 0.05
# Plates are turned to either side of the way to the camera, as on the packaged rigs: one of them always faces it.
TURNED_RAD = np.radians(40.0)
# From the front of a draft, which is seen along its root's y, z up, as the packaged rigs are.
FRONT = np.array([0.0, -1.0, 0.0])
UP = np.array([0.0, 0.0, 1.0])
# Of the size of a marker: how far in front of a box its middle is, so that a turned plate's edge clears the box.
CLEAR_SHARE = 0.6


def add_marker(
    draft: Draft,
    part: str,
    size_m: float = MARKER_SIZE_M,
    id: int | None = None,
    T_part_marker: ArrayLike | None = None,
) -> Draft:
    """The draft with a new marker on a part.

    Args:
        draft: of the part.
        part: its name.
        size_m: side of the black square.
        id: in the draft's dictionary; the least that is free if None.
        T_part_marker: (4, 4) mount; before the part's front if None.

    Raises:
        InvalidData: for a part that isn't there, an id that is taken or isn't in the dictionary, a size that isn't
            positive, a mount that is no rigid motion.
    """
    draft.check_part(part)
    marker_id = free_id(draft) if id is None else id
    _check_id(draft, marker_id)
    if T_part_marker is None:
        _check_size(size_m)
        mount = front_mounts(draft, part, size_m, 1)[0]
    else:
        mount = np.asarray(T_part_marker, dtype=np.float64)
    return replace(draft, markers=(*draft.markers, _marker(marker_id, part, size_m, mount)))


def delete_marker(draft: Draft, id: int) -> Draft:
    """The draft without a marker; raises InvalidData if it isn't there."""
    gone = draft.marker(id)
    return replace(draft, markers=tuple(marker for marker in draft.markers if marker is not gone))


def change_marker(
    draft: Draft, id: int, *, new_id: int | None = None, part: str | None = None, size_m: float | None = None
) -> Draft:
    """The draft with another id, part or size of a marker; on another part it stays where it is with all joints at 0.

    Raises:
        InvalidData: for a marker or part that isn't there, an id that is taken or not in the dictionary, a size that
            isn't positive.
    """
    old = draft.marker(id)
    if new_id is not None and new_id != id:
        _check_id(draft, new_id)
    mount = old.mount
    if part is not None and part != old.part:
        draft.check_part(part)
        T_root = draft.tree.forward(np.zeros(len(draft.tree.columns)))
        mount = se3.inverse(T_root[part]) @ T_root[old.part] @ mount
    new = _marker(
        id if new_id is None else new_id,
        old.part if part is None else part,
        old.size_m if size_m is None else size_m,
        mount,
    )
    return replace(draft, markers=tuple(new if marker is old else marker for marker in draft.markers))


def marker_gizmo(draft: Draft, id: int, states: Mapping[str, float]) -> tuple[Numbers, Numbers]:
    """Quaternion (w, x, y, z) and place [m] of a marker in the root's frame; raises InvalidData if it isn't there."""
    marker = draft.marker(id)
    return to_gizmo(draft.poses(states)[marker.part] @ marker.mount)


def place_marker(draft: Draft, id: int, wxyz: ArrayLike, xyz: ArrayLike, states: Mapping[str, float]) -> Draft:
    """The draft with a marker where a gizmo in the root's frame is; its z is out of the marker, its y up.

    Raises:
        InvalidData: for a marker that isn't there, a place that is none.
    """
    old = draft.marker(id)
    mount = se3.inverse(draft.poses(states)[old.part]) @ from_gizmo(wxyz, xyz)
    new = _marker(id, old.part, old.size_m, mount)
    return replace(draft, markers=tuple(new if marker is old else marker for marker in draft.markers))


def mark_all(draft: Draft, size_m: float = MARKER_SIZE_M) -> Draft:
    """The draft with two markers, turned to either side, before the front of each part that has none.

    Raises:
        InvalidData: for a size that isn't positive, and where the dictionary has too few.
    """
    _check_size(size_m)
    marked = {marker.part for marker in draft.markers}
    for part in draft.parts:
        if part not in marked:
            for mount in front_mounts(draft, part, size_m, 2):
                draft = add_marker(draft, part, size_m, None, mount)
    return draft


def set_block(
    draft: Draft, part: str, size_m: ArrayLike, centre_m: ArrayLike = (0.0, 0.0, 0.0), colour: str | None = None
) -> Draft:
    """The draft with one box on a part in the place of what it had.

    Args:
        draft: of the part.
        part: its name.
        size_m: (3,) lengths along the part's x, y, z.
        centre_m: (3,) in the part's frame.
        colour: "#rrggbb"; the part's usual one if None.

    Raises:
        InvalidData: for a part that isn't there, lengths that aren't positive, another colour.
    """
    draft.check_part(part)
    place = np.asarray(centre_m, dtype=np.float64)
    if place.shape != (3,) or not np.all(np.abs(place) <= FARTHEST_DRAWN_M):
        raise InvalidData(f"the box on '{part}' is at {place.tolist()} m; want three, {FARTHEST_DRAWN_M:g} at most")
    block = Block(
        part, se3.translation(place), np.asarray(size_m), part_colour(draft, part) if colour is None else colour
    )
    return replace(clear_blocks(draft, part), blocks=(*clear_blocks(draft, part).blocks, block))


def clear_blocks(draft: Draft, part: str) -> Draft:
    """The draft without own boxes on a part, which is then drawn as usual; raises InvalidData if it isn't there."""
    draft.check_part(part)
    return replace(draft, blocks=tuple(block for block in draft.blocks if block.part != part))


def free_id(draft: Draft) -> int:
    """The least id that no marker has; raises InvalidData where the dictionary has no more."""
    taken = {marker.id for marker in draft.markers}
    size = DICTIONARY_SIZES[draft.dictionary]
    for candidate in range(size):
        if candidate not in taken:
            return candidate
    raise InvalidData(f"all {size} markers of {draft.dictionary} are in use; choose a larger dictionary")


def front_mounts(draft: Draft, part: str, size_m: float, count: int) -> list[FloatArray]:
    """`T_part_marker` (4, 4) of one marker before a part's front, or of two beside each other, turned outward.

    The front is that of its largest box, as it is seen along the root's y with all joints at 0.
    """
    T_root_part = draft.tree.forward(np.zeros(len(draft.tree.columns)))[part]
    block = max(part_blocks(draft, part), key=lambda each: float(np.prod(each.size_m)))
    T_root_block = T_root_part @ block.T_part_block
    half = 0.5 * np.abs(T_root_block[:3, :3]) @ block.size_m
    middle = T_root_block[:3, 3] + (half @ np.abs(FRONT)) * FRONT
    turns = [0.0] if count == 1 else [-TURNED_RAD, TURNED_RAD]
    found: list[FloatArray] = []
    for turn in turns:
        normal = np.array([np.sin(turn), -np.cos(turn), 0.0])
        clear = CLEAR_SHARE * size_m if count > 1 else 1e-3
        aside = np.sign(turn) * 0.75 * size_m * np.array([1.0, 0.0, 0.0])
        found.append(se3.inverse(T_root_part) @ facing(middle + aside + clear * FRONT, normal, UP))
    return found


def _marker(marker_id: int, part: str, size_m: float, mount: FloatArray) -> Marker:
    _check_size(size_m)
    return Marker(int(marker_id), part, float(size_m), mount)


def _check_size(size_m: float) -> None:
    if not 0 < size_m <= FARTHEST_DRAWN_M:
        raise InvalidData(f"a marker of {1e3 * size_m:g} mm; want the side of its black square, above 0")


def _check_id(draft: Draft, marker_id: int) -> None:
    size = DICTIONARY_SIZES[draft.dictionary]
    if isinstance(marker_id, bool) or not isinstance(marker_id, int) or not 0 <= marker_id < size:
        raise InvalidData(f"there is no marker {marker_id} in {draft.dictionary}; its ids are 0 to {size - 1}")
    taken = next((marker for marker in draft.markers if marker.id == marker_id), None)
    if taken is not None:
        raise InvalidData(f"marker {marker_id} is on '{taken.part}' already; the least free id is {free_id(draft)}")
