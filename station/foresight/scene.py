"""What a forecast knows: the mechanism, where its markers are, where the camera stands, what may be in the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel
from station.errors import InvalidData
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray, frozen_floats


@dataclass(frozen=True, eq=False, slots=True)
class Mount:
    """A marker where it is mounted.

    Attributes:
        marker_id: its id.
        part: the tracked part that it belongs to.
        body: named part of the body that carries it.
        T_body_marker: (4, 4) marker frame in the body: origin in its middle, x right, y up, z out of the marker.
        size_m: side of the black square.
        margin_m: width of the white rim around it.
        cells: how many cells a side of the square has, its border included.
    """

    marker_id: int
    part: str
    body: str
    T_body_marker: FloatArray
    size_m: float
    margin_m: float
    cells: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_body_marker", frozen_floats(self.T_body_marker))


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """A box on a body, in the way of what is behind it.

    Attributes:
        body: named part of the body.
        T_body_block: (4, 4) the box's frame in the body, origin in its middle.
        size_m: (3,) full lengths of its edges.
        colour_bgr: 0 to 255 each, for people to see.
    """

    body: str
    T_body_block: FloatArray
    size_m: FloatArray
    colour_bgr: tuple[int, int, int]

    def __post_init__(self) -> None:
        for name in ("T_body_block", "size_m"):
            object.__setattr__(self, name, frozen_floats(getattr(self, name)))


@dataclass(frozen=True, slots=True)
class Link:
    """How a joint of the mechanism follows a joint of the arm: `state = sign * joint + offset`, rad or m."""

    sign: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """A mechanism before a camera that stands still.

    Attributes:
        tree: of the bodies; joints have the names of the arm's where they follow them.
        links: how each joint of the tree that is driven follows the arm's joint of its name.
        resting: states of the joints that nothing drives.
        T_camera_root: (4, 4) by root of each of the tree's `trees`; what has none has no place.
        camera: its model.
        exposure_s: how long the shutter is open.
        mounts: the markers that have a place.
        blocks: what may hide them; None where nobody told.
        notes: what all of that rests on, in words.
    """

    tree: KinematicTree
    links: Mapping[str, Link]
    resting: Mapping[str, FloatArray]
    T_camera_root: Mapping[str, FloatArray]
    camera: CameraModel
    exposure_s: float
    mounts: tuple[Mount, ...]
    blocks: tuple[Block, ...] | None
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        placed = self.bodies
        for item in (*self.mounts, *(self.blocks or ())):
            if item.body not in placed:
                raise InvalidData(f"what is mounted on '{item.body}' has no place; places have {', '.join(placed)}")

    @property
    def bodies(self) -> tuple[str, ...]:
        """The bodies that have a place."""
        return tuple(
            body for root in self.T_camera_root for body in (root, *(joint.child for joint in self.tree.outward(root)))
        )

    def rows_of(self, body: str) -> NDArray[np.intp]:
        """Rows of the mounts on a body."""
        return np.flatnonzero([mount.body == body for mount in self.mounts])

    def T_camera_bodies(self, states: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """`T_camera_body` (..., 4, 4) by body, for states (...,) of the arm's joints by name, rad or m."""
        driven = {name: link.sign * states[name] + link.offset for name, link in self.links.items()}
        shape = np.broadcast_shapes(*(np.shape(state) for state in states.values()))
        poses: dict[str, FloatArray] = {}
        for root, T_camera_root in self.T_camera_root.items():
            below = {joint.name for joint in self.tree.outward(root)}
            q = {name: state for name, state in {**self.resting, **driven}.items() if name in below}
            for body, T_root_body in self.tree.forward(q, start=root).items():
                poses[body] = np.broadcast_to(T_camera_root @ T_root_body, (*shape, 4, 4))
        return poses
