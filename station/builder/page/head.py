"""The head of the page: what is open, whether it is saved, undo and redo."""

from __future__ import annotations

from typing import Any

from station.builder.page.page import Page

UNDO, REDO, LOOK = "Undo", "Redo", "Look at all"


class Head:
    """Stands above the tabs."""

    def __init__(self, page: Page) -> None:
        self._page = page
        gui = page.server.gui
        self._text = gui.add_markdown("")
        self._steps = gui.add_button_group(
            "Edit", (UNDO, REDO, LOOK), hint="Ctrl-Z undoes, Ctrl-Shift-Z does it again."
        )
        self._steps.on_click(page.acting(self._step))
        gui.add_command(UNDO, hotkey="Z", modifier="cmd/ctrl").on_trigger(page.acting(self._undo))
        gui.add_command(REDO, hotkey="Z", modifier="cmd/ctrl+shift").on_trigger(page.acting(self._redo))

    def refresh(self) -> None:
        """Say what is there now."""
        desk, draft = self._page.desk, self._page.draft
        state = "**unsaved changes**" if desk.unsaved else "saved" if self._page.in_file else "in no file yet"
        counts = (_count(len(draft.parts), "part"), _count(len(draft.joints), "joint"))
        last = f"  \nLast: {desk.undo_what}." if desk.undo_what else ""
        text = f"**{self._page.path.name}** · {state}  \n{', '.join(counts)}{last}"
        if text != self._text.content:
            self._text.content = text
            self._page.server.gui.set_panel_label(("● " if desk.unsaved else "") + self._page.path.name)

    def _step(self, event: Any) -> None:
        {UNDO: self._undo, REDO: self._redo, LOOK: lambda _: self._page.look()}[event.target.value](event)

    def _undo(self, event: Any) -> None:
        self._page.desk = self._page.desk.undone()

    def _redo(self, event: Any) -> None:
        self._page.desk = self._page.desk.redone()


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
