"""Places for markers on parts: pairs of plates before a part's boxes, turned to either side, which a camera sees.

One of two plates that are turned apart always faces the camera by less than 60 degrees, however the part turns within
35 degrees, and no plate is seen from straight ahead, where its orientation is ambiguous (docs/rig.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.intrinsics import CameraModel
from station.builder.draft import Draft
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
# Of the sizes of two markers: how far their middles are apart at least.
APART_SHARE = 0.75
# From one single marker to the next, of its size; and how far from the face it is on.
BESIDE_SHARE, FLUSH_M = 1.5, 1e-3
# Of the object's size: what the camera sees of the room. And how often all places are gone through.
ROOM, ROUNDS = 1.3, 2
# How large markers are in the picture of a whole object, as on the packaged rigs; smaller ones of one body may be taken
# for two. Their sizes are in steps that can be printed [m].
SIZE_PX, SIZE_STEP_M = 48.0, 0.005


@dataclass(frozen=True, eq=False)
class _Place:
    """A draft with all joints at 0, and a camera in front of it.

    Attributes:
        camera: a model.
        q: (T, C) states that are looked at.
        poses: `T_root_part` (4, 4).
        boxes: of each part, least and greatest (3,) of each box along the root's axes, the largest box first.
        position_m, target_m: (3,) of the camera, which has all boxes in its image, and some room.
    """

    camera: CameraModel
    q: FloatArray
    poses: dict[str, FloatArray]
    boxes: dict[str, list[tuple[FloatArray, FloatArray]]]
    position_m: FloatArray
    target_m: FloatArray

    @staticmethod
    def of(draft: Draft, camera: CameraModel) -> _Place:
        poses = draft.tree.forward(np.zeros(len(draft.tree.columns)))
        boxes = {part: _boxes(draft, part, poses[part]) for part in draft.parts}
        ends = [end for each in boxes.values() for end in each]
        low, high = np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)
        middle, half = 0.5 * (low + high), ROOM * 0.5 * (high - low)
        corners = np.stack([middle + (2 * np.array(end) - 1) * half for end in np.ndindex(2, 2, 2)])
        return _Place(camera, reached_states(draft), poses, boxes, *framed(corners, camera, direction()))

    @property
    def foremost(self) -> float:
        """Of all boxes, the front."""
        return min(float(low[1]) for boxes in self.boxes.values() for low, _ in boxes)

    def seen_share(self, draft: Draft) -> float:
        """Of all markers at all states, how many are seen."""
        reason, _ = outlook(draft, self.camera, self.position_m, self.target_m, self.q)
        return float(np.mean(reason == SEEN))

    def crowding(self, markers: Sequence[Marker], new: Sequence[Marker]) -> float:
        """How many of the markers' plates new ones are in the way of.

        A forecast takes plates that lie in one plane for side by side.
        """
        near = [
            np.linalg.norm((self.poses[a.part] @ a.mount - self.poses[b.part] @ b.mount)[:3, 3])
            < APART_SHARE * (a.size_m + b.size_m)
            for a in new
            for b in markers
        ]
        return float(np.sum(near))


def usual_size_m(draft: Draft, camera: CameraModel) -> float:
    """A size for markers that can be seen from where all of the draft is in view [m]."""
    place = _Place.of(draft, camera)
    distance_m = float(np.linalg.norm(place.position_m - place.target_m))
    return max(1, round(SIZE_PX * distance_m / float(camera.matrix[0, 0]) / SIZE_STEP_M)) * SIZE_STEP_M


def front_mount(draft: Draft, part: str, size_m: float) -> FloatArray:
    """(4, 4) `T_part_marker` on the front of a part's largest box, beside the markers that the part has already."""
    T_root_part = draft.tree.forward(np.zeros(len(draft.tree.columns)))[part]
    low, high = _boxes(draft, part, T_root_part)[0]
    there = sum(marker.part == part for marker in draft.markers)
    aside = BESIDE_SHARE * size_m * there
    place = np.array([0.5 * (low[0] + high[0]) + aside, low[1] - FLUSH_M, 0.5 * (low[2] + high[2])])
    return se3.inverse(T_root_part) @ facing(place, FRONT, UP)


def with_plates(draft: Draft, parts: tuple[str, ...], size_m: float, camera: CameraModel) -> Draft:
    """The draft with a pair of markers on each of some parts, where a camera in front of it sees them best.

    Raises:
        InvalidData: where the dictionary has too few markers.
    """
    place = _Place.of(draft, camera)
    for _ in range(ROUNDS):  # what was placed first may be in the way of what came last
        least = 1.0
        for part in parts:
            others = tuple(marker for marker in draft.markers if marker.part != part)
            draft, share = _with_pair(replace(draft, markers=others), part, size_m, place)
            least = min(least, share)
        if least == 1.0:
            break
    return replace(draft, markers=tuple(sorted(draft.markers, key=lambda marker: draft.parts.index(marker.part))))


def margin_m(draft: Draft, size_m: float) -> float:
    """Width of the white border around a marker of a size: one cell."""
    return MARGIN_CELLS * size_m / cells_along(draft.dictionary)


def _with_pair(draft: Draft, part: str, size_m: float, place: _Place) -> tuple[Draft, float]:
    """The draft with the first pair that is always seen and hides no other marker, else the best one; and how good."""
    candidates = (_paired(draft, part, mounts, size_m) for mounts in _pairs(part, size_m, place))
    if not any(joint.kind.states == 1 for joint in draft.joints):
        return next(candidates), 1.0
    best, best_share = draft, -np.inf
    for candidate in candidates:
        crowding = place.crowding(draft.markers, candidate.markers[len(draft.markers) :])
        if 1.0 - crowding <= best_share:
            continue
        share = place.seen_share(candidate) - crowding
        if share > best_share:
            best, best_share = candidate, share
        if share == 1.0:
            break
    return best, best_share


def _pairs(part: str, size_m: float, place: _Place) -> Iterator[tuple[FloatArray, FloatArray]]:
    """`T_part_marker` (4, 4) of two plates: before and above the part's boxes, then beside them; then before all."""
    T_part_root = se3.inverse(place.poses[part])
    for before_all in (False, True):
        for low, high in place.boxes[part]:
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            front = (place.foremost if before_all else low[1]) - CLEAR_SHARE * size_m
            beside = half[0] + size_m
            heights = (0.0, 0.8 * half[2], -0.8 * half[2])
            before = [(x, z) for x in (0.0, -0.8 * half[0], 0.8 * half[0]) for z in heights]
            aside = [(x, z) for x in (-beside, beside) for z in heights]
            for x, z in (*before, (0.0, half[2] + ASIDE_SHARE * size_m), *aside):
                spot = np.array([middle[0] + x, front, middle[2] + z])
                left, right = (T_part_root @ _turned(spot, side, size_m) for side in (-1, 1))
                yield left, right


def _turned(spot: FloatArray, side: int, size_m: float) -> FloatArray:
    """(4, 4) in the root's frame of the left (-1) or right (1) plate of a pair about a spot (3,)."""
    normal = np.array([side * np.sin(TURNED_RAD), -np.cos(TURNED_RAD), 0.0])
    return facing(spot + np.array([side * ASIDE_SHARE * size_m, 0.0, 0.0]), normal, UP)


def _paired(draft: Draft, part: str, mounts: tuple[FloatArray, FloatArray], size_m: float) -> Draft:
    for mount in mounts:
        draft = replace(draft, markers=(*draft.markers, Marker(draft.free_id(), part, size_m, mount)))
    return draft


def _boxes(draft: Draft, part: str, T_root_part: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Least and greatest (3,) of a part's boxes along the root's axes, the largest first."""
    found: list[tuple[FloatArray, FloatArray]] = []
    for block in sorted(part_blocks(draft, part), key=lambda block: -float(np.prod(block.size_m))):
        T = T_root_part @ block.T_part_block
        half = 0.5 * np.abs(T[:3, :3]) @ block.size_m
        found.append((T[:3, 3] - half, T[:3, 3] + half))
    return found
