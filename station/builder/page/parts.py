"""The tab in which a tree is built: its parts, and the joint that each hangs from."""

from __future__ import annotations

from typing import Any

import numpy as np

from station.builder import edits, placing
from station.builder.draft import Draft, limits_of
from station.builder.drawing import shown_unit
from station.builder.page.controls import MM_PER_M, NumberField, TextField
from station.builder.page.page import Page
from station.kinematics.joint import Joint
from station.kinematics.joints import JOINT_TYPES

ADD, ROOT, DELETE, PRUNE = "Add", "Make root", "Delete", "Delete branch"


class Parts:
    """The list of parts, and what is done to the selected one as a whole."""

    def __init__(self, page: Page) -> None:
        self._page = page
        gui = page.server.gui
        self._tree = gui.add_markdown("")
        self._part = gui.add_dropdown("Part", (page.selected,), hint="Or click a part in the scene.")
        self._part.on_update(page.acting(lambda event: page.select(event.target.value)))
        for names in ((ADD, ROOT), (DELETE, PRUNE)):
            gui.add_button_group("", names).on_click(page.acting(self._change))

    def refresh(self) -> None:
        """Show the tree as a list."""
        draft = self._page.draft
        text = "\n".join(_branch(draft, draft.tree.root, 0))
        if text != self._tree.content:
            self._tree.content = text
        if self._part.options != draft.parts:
            self._part.options = draft.parts
        self._part.value = self._page.selected

    def _change(self, event: Any) -> None:
        page, part = self._page, self._page.selected
        what = event.target.value
        if what == ADD:
            name = edits.unused_name(page.draft)
            page.edit(edits.add_part(page.draft, name, part), f"add {name}")
            page.select(name)
            if not page.scene.has_in_view(page.draft, page.desk.states):
                page.look()
        elif what == ROOT:
            page.edit(edits.set_root(page.draft, part), f"make {part} the root")
        else:
            above = page.draft.joint_above(part)
            delete = edits.delete_part if what == DELETE else edits.delete_branch
            page.edit(delete(page.draft, part), f"delete {part}")
            page.selected = page.draft.tree.root if above is None else above.parent


class JointForm:
    """Name, joint and place of the selected part: types and parents at once, what is typed when it is applied."""

    def __init__(self, page: Page) -> None:
        self._page = page
        gui = page.server.gui
        self._type = gui.add_dropdown("Joint type", tuple(JOINT_TYPES), hint="How the part moves against its parent.")
        self._type.on_update(page.acting(self._set_type))
        self._parent = gui.add_dropdown("Parent", (page.selected,), hint="The part stays where it is.")
        self._parent.on_update(page.acting(self._set_parent))
        self._form = gui.add_form("Name and numbers")
        with self._form:
            self._name = TextField(gui, "Name", hint="Lower case letters, digits and _.")
            self._joint = TextField(gui, "Joint name")
            self._low = NumberField(gui, "Lower", hint="Limit of the joint's state.")
            self._high = NumberField(gui, "Upper", hint="Limit of the joint's state.")
            self._axis = NumberField(gui, "Axis", count=3, step=0.1, hint="Direction in the parent's frame.")
            self._point = NumberField(gui, "Axis at [mm]", count=3, hint="A point of it in the parent's frame.")
            self._pitch = NumberField(gui, "Pitch [mm/rad]", hint="Advance of a screw.")
            self._place = NumberField(gui, "Place [mm]", count=3, hint="In the parent's frame, with the joint at 0.")
            self._turn = NumberField(gui, "Turn [deg]", count=3, hint="Roll, pitch, yaw there, as URDF has them.")
            apply = gui.add_button("Apply", hint="Or press Enter in a field.")
        apply.on_click(page.acting(self._apply))
        self._form.on_submit(page.acting(self._apply))
        self._of: str | None = None

    def refresh(self) -> None:
        """Show the selected part's numbers."""
        self._show(again=self._of != self._page.selected)

    def _show(self, *, again: bool) -> None:
        draft, part = self._page.draft, self._page.selected
        joint = draft.joint_above(part)
        self._of = part
        self._name.show(part, again=again)
        self._joint.show(None if joint is None else joint.name, again=again)
        self._type.visible = self._parent.visible = joint is not None
        if joint is not None:
            self._type.value = joint.type
            parents = tuple(each for each in draft.parts if each != part)
            if self._parent.options != parents:
                self._parent.options = parents
            self._parent.value = joint.parent
        self._show_joint(joint, again)
        place, turn = None, None
        if joint is not None:
            xyz_m, rpy_rad = placing.zero_numbers(draft, part)
            place, turn = np.multiply(xyz_m, MM_PER_M).tolist(), np.degrees(rpy_rad).tolist()
        self._place.show(place, again=again)
        self._turn.show(turn, again=again)

    def _show_joint(self, joint: Joint | None, again: bool) -> None:
        moves = joint is not None and joint.kind.states > 0
        unit, per_unit = ("", 1.0) if joint is None else shown_unit(joint)
        limits = limits_of(joint) if moves and joint is not None else None
        for field, name, k in ((self._low, "Lower", 0), (self._high, "Upper", 1)):
            value = None if limits is None else (limits[k] / per_unit,)
            field.show(value, label=f"{name} [{unit}]", again=again)
        axis = None if joint is None else joint.axis_parent
        point = None if joint is None else joint.point_parent_m
        pitch = None if joint is None else joint.pitch_m_per_rad
        self._axis.show(None if axis is None else axis.tolist(), again=again)
        label = "Centre [mm]" if axis is None else "Axis at [mm]"
        self._point.show(None if point is None else (MM_PER_M * point).tolist(), label=label, again=again)
        self._pitch.show(None if pitch is None else (MM_PER_M * pitch,), again=again)

    def _set_type(self, event: Any) -> None:
        joint = self._selected_joint()
        self._page.edit(
            edits.set_type(self._page.draft, joint.name, event.target.value), f"make {joint.name} {event.target.value}"
        )

    def _set_parent(self, event: Any) -> None:
        page, part = self._page, self._page.selected
        page.edit(edits.set_parent(page.draft, part, event.target.value), f"hang {part} from {event.target.value}")

    def _apply(self, event: Any) -> None:
        page, part = self._page, self._page.selected
        draft = self._numbers_applied(page.draft, part)
        joint = draft.joint_above(part)
        if joint is not None and (name := self._joint.typed) is not None:
            draft = edits.rename_joint(draft, joint.name, name)
        if (name := self._name.typed) is not None:
            draft = edits.rename_part(draft, part, name)
        page.edit(draft, f"change {part}")
        page.selected = self._name.typed or part
        self._show(again=True)
        self._form.submit()  # for the star that marks what isn't applied

    def _numbers_applied(self, draft: Draft, part: str) -> Draft:
        """The draft with what was typed; the place first, for the joint goes along with it."""
        joint = draft.joint_above(part)
        if joint is None:
            return draft
        if self._place.typed or self._turn.typed:
            xyz_m, rpy_rad = placing.zero_numbers(draft, part)
            xyz_m = np.divide(self._place.typed, MM_PER_M) if self._place.typed else xyz_m
            rpy_rad = np.radians(self._turn.typed) if self._turn.typed else rpy_rad
            draft = placing.set_zero(draft, part, xyz_m, rpy_rad)
        if self._axis.typed or self._point.typed:
            point = None if self._point.typed is None else np.divide(self._point.typed, MM_PER_M)
            axis = self._axis.typed or draft.joint(joint.name).axis_parent
            draft = placing.set_axis(draft, joint.name, axis if axis is not None else (0.0, 0.0, 1.0), point)
        if self._low.typed or self._high.typed:
            _, per_unit = shown_unit(joint)
            low, high = limits_of(joint)
            low = self._low.typed[0] * per_unit if self._low.typed else low
            high = self._high.typed[0] * per_unit if self._high.typed else high
            draft = edits.set_limits(draft, joint.name, low, high)
        if self._pitch.typed:
            draft = edits.set_pitch(draft, joint.name, self._pitch.typed[0] / MM_PER_M)
        return draft

    def _selected_joint(self) -> Joint:
        joint = self._page.draft.joint_above(self._page.selected)
        assert joint is not None  # the controls are away for the root
        return joint


def _branch(draft: Draft, part: str, depth: int) -> list[str]:
    """Lines of a list of a part and of all below it."""
    joint = draft.joint_above(part)
    how = "root" if joint is None else f"{joint.name}, {joint.type}"
    lines = [f"{'  ' * depth}- **{part}** · {how}"]
    for below in draft.joints:
        if below.parent == part:
            lines += _branch(draft, below.child, depth + 1)
    return lines
