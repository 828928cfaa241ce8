"""Places for markers on parts: pairs of plates before a part's boxes, turned to either side, which a camera sees.

One of two plates that are turned apart always faces the camera by less than 60 degrees, however the part turns within
35 degrees, and no plate is seen from straight ahead, where its orientation is ambiguous (docs/rig.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calibration.intrinsics import CameraModel
from station.builder.draft import Block, Draft
from station.builder.drawing import part_blocks
from station.builder.sights import MARGIN_CELLS, direction, framed, outlook, reached_states
from station.drawn import facing
from station.foresight.detector import SEEN
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.markers import Marker, cells_along

# From where the camera usually looks; z is up.
FRONT, UP = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
TURNED_RAD = np.radians(40.0)
# Of a marker's size: from the middle of a pair to each of it, and how far in front of a box they are, so that edges of
# turned plates neither meet nor touch it.
ASIDE_SHARE, CLEAR_SHARE = 0.7, 0.6
# From one single marker to the next, of its size; and how far from the face it is on.
BESIDE_SHARE, FLUSH_M = 1.5, 1e-3
# Of half of a box: places on its front that are tried, its middle first.
PLACES = tuple((x, z) for x in (0.0, -0.8, 0.8) for z in (0.0, 0.8, -0.8))
# Of the longest way through an object: the size of its markers [m], within bounds and in steps that can be printed.
SIZE_SHARE, LEAST_SIZE_M, MOST_SIZE_M, SIZE_STEP_M = 0.08, 0.02, 0.2, 0.005


def usual_size_m(draft: Draft) -> float:
    """A size for markers that can be seen from where all of the draft is in view [m]."""
    low, high = _extent(draft, draft.parts)
    steps = round(SIZE_SHARE * float(np.linalg.norm(high - low)) / SIZE_STEP_M)
    return float(np.clip(steps * SIZE_STEP_M, LEAST_SIZE_M, MOST_SIZE_M))


def front_mount(draft: Draft, part: str, size_m: float) -> FloatArray:
    """(4, 4) `T_part_marker` on the front of a part's largest box, beside the markers that the part has already."""
    low, high = _box_extent(draft, part, _boxes(draft, part)[0])
    there = sum(marker.part == part for marker in draft.markers)
    aside = BESIDE_SHARE * size_m * there
    place = np.array([0.5 * (low[0] + high[0]) + aside, low[1] - FLUSH_M, 0.5 * (low[2] + high[2])])
    return se3.inverse(_zero_pose(draft, part)) @ facing(place, FRONT, UP)


def with_plates(draft: Draft, parts: tuple[str, ...], size_m: float, camera: CameraModel) -> Draft:
    """The draft with a pair of markers on each of some parts, where a camera in front of it sees them best.

    Raises:
        InvalidData: where the dictionary has too few markers.
    """
    for part in parts:
        draft = _with_pair(draft, part, size_m, camera)
    return draft


def _with_pair(draft: Draft, part: str, size_m: float, camera: CameraModel) -> Draft:
    """The draft with the first pair that is always seen and hides no other marker, else the best one."""
    candidates = (_paired(draft, part, mounts, size_m) for mounts in _pairs(draft, part, size_m))
    if not any(joint.kind.states == 1 for joint in draft.joints):
        return next(candidates)
    q = reached_states(draft)
    best, best_share = None, -1.0
    for candidate in candidates:
        share = _seen_share(candidate, camera, q)
        if share > best_share:
            best, best_share = candidate, share
        if share == 1.0:
            break
    return best or draft


def _seen_share(draft: Draft, camera: CameraModel, q: FloatArray) -> float:
    """Of all markers at all states, how many are seen from in front."""
    low, high = _extent(draft, draft.parts)
    corners = np.stack([np.where(mask, low, high) for mask in np.ndindex(2, 2, 2)])
    position, target = framed(corners, camera, direction())
    reason, _ = outlook(draft, camera, position, target, q)
    return float(np.mean(reason == SEEN))


def _pairs(draft: Draft, part: str, size_m: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """`T_part_marker` (4, 4) of two plates: before the part's boxes, the largest first; then before all there is."""
    foremost = _extent(draft, draft.parts)[0][1]
    T_part_root = se3.inverse(_zero_pose(draft, part))
    for before_all in (False, True):
        for block in _boxes(draft, part):
            low, high = _box_extent(draft, part, block)
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            front = foremost if before_all else low[1]
            for x, z in PLACES:
                place = np.array([middle[0] + x * half[0], front - CLEAR_SHARE * size_m, middle[2] + z * half[2]])
                left, right = (T_part_root @ _turned(place, side, size_m) for side in (-1, 1))
                yield left, right


def _turned(place: FloatArray, side: int, size_m: float) -> FloatArray:
    """(4, 4) in the root's frame of the left (-1) or right (1) plate of a pair."""
    normal = np.array([side * np.sin(TURNED_RAD), -np.cos(TURNED_RAD), 0.0])
    return facing(place + np.array([side * ASIDE_SHARE * size_m, 0.0, 0.0]), normal, UP)


def _paired(draft: Draft, part: str, mounts: tuple[FloatArray, FloatArray], size_m: float) -> Draft:
    for mount in mounts:
        draft = replace(draft, markers=(*draft.markers, Marker(draft.free_id(), part, size_m, mount)))
    return draft


def margin_m(draft: Draft, size_m: float) -> float:
    """Width of the white border around a marker of a size: one cell."""
    return MARGIN_CELLS * size_m / cells_along(draft.dictionary)


def _boxes(draft: Draft, part: str) -> list[Block]:
    """The part's boxes, the largest first."""
    return sorted(part_blocks(draft, part), key=lambda block: -float(np.prod(block.size_m)))


def _zero_pose(draft: Draft, part: str) -> FloatArray:
    return draft.tree.forward(np.zeros(len(draft.tree.columns)))[part]


def _box_extent(draft: Draft, part: str, block: Block) -> tuple[FloatArray, FloatArray]:
    """(3,) least and greatest of a box along the root's axes, with all joints at 0."""
    T = _zero_pose(draft, part) @ block.T_part_block
    half = 0.5 * np.abs(T[:3, :3]) @ block.size_m
    return T[:3, 3] - half, T[:3, 3] + half


def _extent(draft: Draft, parts: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
    """(3,) least and greatest of all boxes along the root's axes, with all joints at 0."""
    ends = [_box_extent(draft, part, block) for part in parts for block in part_blocks(draft, part)]
    return np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)
