"""Edits of what is on the parts: markers, by numbers or a gizmo, and boxes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from station.builder.draft import FARTHEST_DRAWN_M, Block, Draft
from station.builder.drawing import part_colour
from station.builder.placing import Numbers, from_gizmo, to_gizmo
from station.builder.plates import front_mount, usual_size_m, with_plates
from station.builder.sights import usual_camera
from station.errors import InvalidData
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.markers import DICTIONARY_SIZES, Marker

MARKER_SIZE_M = 0.05


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
    marker_id = draft.free_id() if id is None else id
    _check_id(draft, marker_id)
    if T_part_marker is None:
        _check_size(size_m)
        mount = front_mount(draft, part, size_m)
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


def mark_all(draft: Draft, size_m: float | None = None) -> Draft:
    """The draft with two markers on each part that has none, where a camera in front of it sees them; see `plates`.

    Args:
        draft: any.
        size_m: side of the black squares; one that suits the draft if None.

    Raises:
        InvalidData: for a size that isn't positive, and where the dictionary has too few.
    """
    camera = usual_camera()
    size = usual_size_m(draft, camera) if size_m is None else size_m
    _check_size(size)
    marked = {marker.part for marker in draft.markers}
    bare = tuple(part for part in draft.parts if part not in marked)
    return with_plates(draft, bare, size, camera)


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
        raise InvalidData(f"marker {marker_id} is on '{taken.part}' already; the least free id is {draft.free_id()}")
