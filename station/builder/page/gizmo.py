"""The gizmo: an axis, a part or a marker is put where it is dragged to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from station.builder import marking, placing
from station.builder.draft import Draft
from station.builder.page.page import Page
from station.builder.page.scene import TREE
from station.errors import StationError

if TYPE_CHECKING:
    from viser import TransformControlsHandle

NOTHING, AXIS, PART, MARKER = "nothing", "joint's axis", "part", "marker"
# Of the radius of what is seen.
SIZE_RADII = 0.35


class Gizmo:
    """A choice of what is dragged, and the gizmo on it. One drag is one step that can be undone.

    Args:
        page: of which.
        marker: which marker is selected, if any.
    """

    def __init__(self, page: Page, marker: Any) -> None:
        self._page, self._marker = page, marker
        choices = (NOTHING, AXIS, PART, MARKER)
        self._choice = page.server.gui.add_dropdown("Drag", choices, hint="Its blue arrow is the axis' direction.")
        self._choice.on_update(page.acting(lambda _: None))
        self._gizmo: TransformControlsHandle | None = None
        self._size_m = 0.0
        self._drags, self._dragging = 0, False

    def refresh(self) -> None:
        """Put the gizmo on what is selected, unless it is being dragged."""
        if self._dragging:
            return
        pose = self._pose()
        size_m = SIZE_RADII * self._page.scene.radius_m
        if self._gizmo is not None and (pose is None or size_m != self._size_m):
            self._gizmo.remove()
            self._gizmo = None
        if pose is None:
            return
        if self._gizmo is None:
            self._size_m = size_m
            self._gizmo = self._page.server.scene.add_transform_controls(
                f"{TREE}/gizmo", scale=size_m, depth_test=False
            )
            self._gizmo.on_update(self._drag)
        self._gizmo.wxyz, self._gizmo.position = np.array(pose[0]), np.array(pose[1])

    def _pose(self) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        page, draft, what = self._page, self._page.draft, self._choice.value
        if page.playing:
            return None
        joint = draft.joint_above(page.selected)
        if what == AXIS and joint is not None and joint.kind.states:
            return placing.axis_gizmo(draft, joint.name, page.desk.states)
        if what == PART and joint is not None:
            return placing.part_gizmo(draft, page.selected, page.desk.states)
        marker = self._marker()
        if what == MARKER and marker is not None:
            return marking.marker_gizmo(draft, marker, page.desk.states)
        return None

    async def _drag(self, event: Any) -> None:
        if event.phase == "start":
            self._drags, self._dragging = self._drags + 1, True
        elif event.phase == "end":
            self._dragging = False
        self._page.act(event, self._moved, goes_on=self._dragging)

    def _moved(self, event: Any) -> None:
        try:
            draft, what = self._placed(event.target.wxyz, event.target.position)
        except StationError:
            if self._dragging:  # it may be dragged on to where it can be; at the end it is told
                return
            raise
        self._page.edit(draft, f"drag {what}", gesture=f"drag {self._drags}")

    def _placed(self, wxyz: Any, xyz: Any) -> tuple[Draft, str]:
        page, draft, states = self._page, self._page.draft, self._page.desk.states
        joint = draft.joint_above(page.selected)
        marker = self._marker()
        if self._choice.value == AXIS and joint is not None:
            return placing.place_axis(draft, joint.name, wxyz, xyz, states), f"the axis of {joint.name}"
        if self._choice.value == PART and joint is not None:
            return placing.place_part(draft, page.selected, wxyz, xyz, states), page.selected
        if self._choice.value == MARKER and marker is not None:
            return marking.place_marker(draft, marker, wxyz, xyz, states), f"marker {marker}"
        return draft, ""
