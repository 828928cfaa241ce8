"""What is on the parts: markers, and the boxes that they are drawn as."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from station.builder import marking
from station.builder.draft import Draft
from station.builder.drawing import part_blocks
from station.builder.page.controls import MM_PER_M, NumberField
from station.builder.page.page import Page
from station.builder.page.scene import rgb
from station.errors import StationError

if TYPE_CHECKING:
    from viser import GuiDropdownHandle

NO_MARKER = "none"
ADD, DELETE, MARK_ALL = "Add", "Delete", "Mark all parts"
USUAL = "As usual"


class Markers:
    """The markers on all parts; a new one comes onto the selected part."""

    def __init__(self, page: Page) -> None:
        self._page = page
        gui = page.server.gui
        with gui.add_folder("Markers", expand_by_default=False):
            self._marker: GuiDropdownHandle[str] = gui.add_dropdown("Marker", tuple[str, ...]((NO_MARKER,)))
            self._marker.on_update(page.acting(lambda _: None))
            self._change = gui.add_button_group("", (ADD, DELETE, MARK_ALL), hint="Added to the selected part.")
            self._change.on_click(page.acting(self._changed))
            self._part = gui.add_dropdown("On part", (page.selected,), hint="The marker stays where it is.")
            self._part.on_update(page.acting(self._set_part))
            self._form = gui.add_form(None)
            with self._form:
                self._id = NumberField(gui, "Id")
                self._size = NumberField(gui, "Size [mm]", hint="Side of the black square.")
                apply = gui.add_button("Apply")
        apply.on_click(page.acting(self._apply))
        self._form.on_submit(page.acting(self._apply))
        self._of: int | None = None

    @property
    def selected(self) -> int | None:
        """The id of the marker that the controls are about."""
        return None if self._marker.value == NO_MARKER else int(self._marker.value.split(" ")[0])

    def refresh(self) -> None:
        """Show the markers that there are."""
        draft, selected = self._page.draft, self.selected
        options = tuple(f"{marker.id} on {marker.part}" for marker in draft.markers) or (NO_MARKER,)
        if self._marker.options != options:
            ids = [marker.id for marker in draft.markers]
            self._marker.options = options
            self._marker.value = options[ids.index(selected)] if selected in ids else options[-1]
        self._show()

    def _show(self, *, again: bool = False) -> None:
        draft = self._page.draft
        marker = None if self.selected is None else draft.marker(self.selected)
        again = again or self._of != self.selected
        self._of = self.selected
        self._id.show(None if marker is None else (marker.id,), again=again)
        self._size.show(None if marker is None else (MM_PER_M * marker.size_m,), again=again)
        self._form.visible = self._part.visible = marker is not None
        if self._part.options != draft.parts:
            self._part.options = draft.parts
        if marker is not None:
            self._part.value = marker.part

    def _select(self, marker_id: int) -> None:
        part = self._page.draft.marker(marker_id).part
        self.refresh()
        self._marker.value = f"{marker_id} on {part}"

    def _changed(self, event: Any) -> None:
        page = self._page
        if event.target.value == ADD:
            draft = marking.add_marker(page.draft, page.selected)
            page.edit(draft, f"add marker {draft.markers[-1].id}")
            self._select(draft.markers[-1].id)
        elif event.target.value == MARK_ALL:
            self._mark_all(event, page.draft)
        elif self.selected is not None:
            page.edit(marking.delete_marker(page.draft, self.selected), f"delete marker {self.selected}")

    def _mark_all(self, event: Any, draft: Draft) -> None:
        def marked(found: Draft) -> None:
            if self._page.draft is not draft:
                raise StationError("the object was changed while places for markers were sought; mark all parts again")
            self._page.edit(found, "mark all parts")

        what = "places are sought in which a camera sees the markers"
        self._page.slowly(event, what, lambda: marking.mark_all(draft), marked)

    def _set_part(self, event: Any) -> None:
        if self.selected is not None:
            part, marker = event.target.value, self.selected
            self._page.edit(
                marking.change_marker(self._page.draft, marker, part=part), f"put marker {marker} on {part}"
            )
            self._select(marker)

    def _apply(self, event: Any) -> None:
        if (marker := self.selected) is None:
            return
        new_id = int(self._id.typed[0]) if self._id.typed else marker
        size_m = self._size.typed[0] / MM_PER_M if self._size.typed else None
        draft = marking.change_marker(self._page.draft, marker, new_id=new_id, size_m=size_m)
        self._page.edit(draft, f"change marker {marker}")
        self._select(new_id)
        self._show(again=True)
        self._form.submit()


class Shape:
    """The box that the selected part is drawn as."""

    def __init__(self, page: Page) -> None:
        self._page = page
        gui = page.server.gui
        with gui.add_folder("Shape", expand_by_default=False):
            self._form = gui.add_form(None)
            with self._form:
                self._size = NumberField(gui, "Size [mm]", count=3, step=10.0, hint="Along the part's x, y, z.")
                self._middle = NumberField(gui, "Middle [mm]", count=3, step=10.0, hint="In the part's frame.")
                self._colour = gui.add_rgb("Colour", (138, 143, 152))
                apply = gui.add_button("Apply")
            usual = gui.add_button(USUAL, hint="Draw it as parts are drawn that have no shape of their own.")
        apply.on_click(page.acting(self._apply))
        self._form.on_submit(page.acting(self._apply))
        usual.on_click(page.acting(self._clear))
        self._of: object = None

    def refresh(self) -> None:
        """Show the largest box of the selected part."""
        block = max(part_blocks(self._page.draft, self._page.selected), key=lambda each: float(np.prod(each.size_m)))
        again = self._of != self._page.selected
        self._size.show((MM_PER_M * block.size_m).tolist(), again=again)
        self._middle.show((MM_PER_M * block.T_part_block[:3, 3]).tolist(), again=again)
        shown = (self._page.selected, block.colour)
        if self._of != shown:
            self._colour.value = rgb(block.colour)
        self._of = self._page.selected

    def _apply(self, event: Any) -> None:
        page = self._page
        size_m, middle_m = (np.divide(field.values, MM_PER_M) for field in (self._size, self._middle))
        colour = "#{:02x}{:02x}{:02x}".format(*self._colour.value)
        page.edit(marking.set_block(page.draft, page.selected, size_m, middle_m, colour), f"shape {page.selected}")
        self._of = None
        self._form.submit()

    def _clear(self, event: Any) -> None:
        page = self._page
        page.edit(marking.clear_blocks(page.draft, page.selected), f"draw {page.selected} as usual")
        self._of = None
