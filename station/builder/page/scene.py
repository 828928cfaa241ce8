"""What is seen of a draft: its parts, joints and markers, what was found of it, what a tracker reports."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.boards import marker_cells
from station.builder.draft import Block, Draft
from station.builder.drawing import Line, bounds, joint_glyph, part_blocks, part_poses
from station.builder.page.nodes import Nodes, Wanted
from station.kinematics import se3
from station.logs import FloatArray
from station.perception.markers import Marker

if TYPE_CHECKING:
    from viser import SceneApi, SceneNodeHandle, ViserServer

TREE, MEASURED, FLOOR = "/tree", "/measured", "/floor"
# Pixels of a cell of a marker's picture: the viewer blurs between pixels.
CELL_PX = 16
# Of its side: how far a marker's picture is drawn before the place of the marker.
LIFT = 0.02
UP = np.array([0.0, 0.0, 1.0])
# The camera looks from this direction, with this opening, from so many radii of what is seen.
VIEW_FROM = np.array([1.0, -1.6, 0.9]) / np.linalg.norm([1.0, -1.6, 0.9])
OPENING_RAD = np.radians(40.0)
DISTANCE_RADII = 3.2
# So far from the middle of what the cameras were turned to, in its radii, there still is room in the picture.
VIEWED_RADII = 1.3
# Nothing is taken for smaller than this: a draft of one small part.
LEAST_RADIUS_M = 0.25
# Of the radius: the axes of the selected part and of measured poses, and how far above a part its name stands.
AXES_RADII, MEASURED_RADII, NAME_RADII = 0.25, 0.2, 0.04


@dataclass(frozen=True)
class Picture:
    """What shall be seen.

    Attributes:
        draft: of which.
        states: of its joints, by column.
        selected: part that is marked.
        found: lines of what a fit found, in the root's frame.
        measured: poses that a tracker reports, by name, in the frame in which the root began.
        T_world_root: (4, 4) where the root is, seen from where it began.
        names: whether the parts' names stand beside them.
    """

    draft: Draft
    states: Mapping[str, float]
    selected: str
    found: tuple[Line, ...] = ()
    measured: Mapping[str, FloatArray] = field(default_factory=dict[str, FloatArray])
    T_world_root: FloatArray = field(default_factory=se3.identity)
    names: bool = True


class Scene:
    """The scene of all tabs.

    Args:
        server: that shows it.
        on_part: what a click on a part does, given viser's event and the part's name.
    """

    def __init__(self, server: ViserServer, on_part: Callable[[Any, str], Coroutine[Any, Any, None]]) -> None:
        self._server, self._on_part = server, on_part
        self._nodes = Nodes()
        self.radius_m, self._middle_m = LEAST_RADIUS_M, np.zeros(3)
        # Without a graphics card shadows take most of the time that a picture takes.
        self._scene.configure_default_lights(cast_shadow=False)
        self._tree = self._scene.add_frame(TREE, show_axes=False)

    @property
    def _scene(self) -> SceneApi:
        return self._server.scene

    def show(self, picture: Picture) -> None:
        """Bring the scene up to date, in one step for those who look."""
        with self._server.atomic():
            self._nodes.show(dict(self._wanted(picture)))
            _place(self._tree, picture.T_world_root)
            for part, (wxyz, xyz) in part_poses(picture.draft, picture.states).items():
                node = self._nodes[_frame(part)]
                node.wxyz, node.position = np.array(wxyz), np.array(xyz)

    def look_at(self, draft: Draft, states: Mapping[str, float]) -> None:
        """Turn the cameras of all tabs, and of those that will open, to all of a draft."""
        low, high = bounds(draft, states)
        middle = self._middle_m = (low + high) / 2
        self.radius_m = max(float(np.linalg.norm(high - low)) / 2, LEAST_RADIUS_M)
        eye = middle + DISTANCE_RADII * self.radius_m * VIEW_FROM
        cameras = [self._server.initial_camera, *(c.camera for c in self._server.get_clients().values())]
        for camera in cameras:
            camera.position, camera.look_at, camera.fov = eye, middle, float(OPENING_RAD)
        self._add_floor(middle, float(low[2]))

    def has_in_view(self, draft: Draft, states: Mapping[str, float]) -> bool:
        """Whether a draft is within what the cameras were last turned to, or not far beyond."""
        far = np.abs(np.stack(bounds(draft, states)) - self._middle_m).max(axis=0)
        return bool(np.linalg.norm(far) <= VIEWED_RADII * self.radius_m)

    def _add_floor(self, middle: FloatArray, height_m: float) -> None:
        size_m = 10 ** np.floor(np.log10(self.radius_m))
        self._scene.add_grid(
            FLOOR,
            width=float(10 * size_m * np.ceil(self.radius_m / size_m)),
            height=float(10 * size_m * np.ceil(self.radius_m / size_m)),
            cell_size=float(size_m),
            section_size=float(5 * size_m),
            cell_color=(222, 226, 230),
            section_color=(190, 196, 202),
            position=(float(middle[0]), float(middle[1]), height_m),
        )

    def _wanted(self, picture: Picture) -> Sequence[tuple[str, Wanted]]:
        draft = picture.draft
        nodes: list[tuple[str, Wanted]] = []
        for part in draft.parts:
            nodes += self._part(draft, part, picture)
        nodes += [self._marker(draft, marker) for marker in draft.markers]
        poses = draft.poses(picture.states)
        for joint in draft.joints:
            lines = joint_glyph(draft, joint.name, picture.states, poses).lines
            nodes += [self._line(f"{TREE}/joints/{joint.name}/{k}", line) for k, line in enumerate(lines)]
        nodes += [self._line(f"{TREE}/found/{k}", line) for k, line in enumerate(picture.found)]
        if picture.measured:
            nodes.append(self._measured(picture.measured))
        return nodes

    def _part(self, draft: Draft, part: str, picture: Picture) -> list[tuple[str, Wanted]]:
        selected = part == picture.selected
        blocks = part_blocks(draft, part)
        nodes = [(_frame(part), Wanted("frame", lambda name: self._scene.add_frame(name, show_axes=False)))]
        nodes += [self._block(f"{_frame(part)}/{k}", block) for k, block in enumerate(blocks)]
        if picture.names:
            nodes.append(self._name(part, blocks))
        if selected:
            length = AXES_RADII * self.radius_m
            look = ("axes", length)
            nodes.append(
                (
                    f"{_frame(part)}/axes",
                    Wanted(
                        look,
                        lambda name: self._scene.add_frame(name, axes_length=length, axes_radius=length / 25),
                    ),
                )
            )
        return nodes

    def _block(self, name: str, block: Block) -> tuple[str, Wanted]:
        xyz, wxyz = se3.to_xyz_wxyz(block.T_part_block)

        def make(name: str) -> SceneNodeHandle:
            box = self._scene.add_box(
                name,
                color=rgb(block.colour),
                dimensions=tuple(block.size_m.tolist()),
                wxyz=wxyz,
                position=xyz,
            )

            @box.on_click
            async def _(event: Any) -> None:
                await self._on_part(event, block.part)

            return box

        look = (block.part, block.colour, block.size_m.tobytes(), block.T_part_block.tobytes())
        return name, Wanted(look, make)

    def _name(self, part: str, blocks: Sequence[Block]) -> tuple[str, Wanted]:
        top = blocks[0].T_part_block[:3, 3] + (blocks[0].size_m[2] / 2 + NAME_RADII * self.radius_m) * UP
        look = ("name", part, top.tobytes())
        return f"{_frame(part)}/name", Wanted(
            look, lambda name: self._scene.add_label(name, part, position=top, anchor="bottom-center")
        )

    def _marker(self, draft: Draft, marker: Marker) -> tuple[str, Wanted]:
        # viser's pictures have y down and are looked at from below; and this one mustn't lie in the face of a box.
        lifted = se3.translation([0.0, 0.0, LIFT * marker.size_m]) @ se3.pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
        xyz, wxyz = se3.to_xyz_wxyz(marker.mount @ lifted)

        def make(name: str) -> SceneNodeHandle:
            cells = np.pad(marker_cells(draft.dictionary, marker.id), 1)  # with the white around it
            side_m = marker.size_m * len(cells) / (len(cells) - 2)
            grey = np.where(cells, 0, 255).astype(np.uint8).repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)
            image = np.repeat(grey[..., None], 3, axis=2)
            return self._scene.add_image(name, image, side_m, side_m, format="png", wxyz=wxyz, position=xyz)

        look = (draft.dictionary, marker.id, marker.size_m, marker.mount.tobytes())
        return f"{_frame(marker.part)}/marker_{marker.id}", Wanted(look, make)

    def _line(self, name: str, line: Line) -> tuple[str, Wanted]:
        points = np.stack([line.points_m[:-1], line.points_m[1:]], axis=1)
        look = (line.points_m.tobytes(), line.colour, line.width)
        return name, Wanted(
            look,
            lambda name: self._scene.add_line_segments(
                name, points, rgb(line.colour), thickness=line.width, thickness_units="screen"
            ),
        )

    def _measured(self, poses: Mapping[str, FloatArray]) -> tuple[str, Wanted]:
        T = np.stack(list(poses.values()))
        xyz, wxyz = se3.to_xyz_wxyz(T)
        length = MEASURED_RADII * self.radius_m
        return MEASURED, Wanted(
            T.tobytes(),
            lambda name: self._scene.add_batched_axes(name, wxyz, xyz, axes_length=length, axes_radius=length / 40),
        )


def _frame(part: str) -> str:
    return f"{TREE}/parts/{part}"


def _place(node: SceneNodeHandle, T: FloatArray) -> None:
    xyz, wxyz = se3.to_xyz_wxyz(T)
    node.wxyz, node.position = wxyz, xyz


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green, blue of "#rrggbb", 0 to 255."""
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue
