"""Fields for numbers and names that are typed, and applied together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viser import GuiApi, GuiNumberHandle, GuiTextHandle, GuiVector3Handle

# Decimals that fields show: of millimetres, degrees and directions.
DECIMALS = 4
MM_PER_M = 1e3


class NumberField:
    """Numbers that are typed, in the unit shown; a draft's numbers have more digits than what is shown of them.

    What was typed and not applied stays until the draft's own numbers change.

    Args:
        gui: to add it to.
        label: of the field, with the unit.
        count: one number or three.
        step: of its arrows.
        hint: what it means.
    """

    def __init__(self, gui: GuiApi, label: str, *, count: int = 1, step: float = 1.0, hint: str | None = None) -> None:
        self._field: GuiNumberHandle[float] | GuiVector3Handle
        if count == 1:
            self._field = gui.add_number(label, 0.0, step=step, hint=hint)
        else:
            self._field = gui.add_vector3(label, (0.0, 0.0, 0.0), step=step, hint=hint)
        self._field.precision = DECIMALS
        self._shown: tuple[float, ...] | None = None

    def show(self, values: Sequence[float] | None, *, label: str | None = None, again: bool = False) -> None:
        """Show a draft's numbers, or nothing for None.

        Args:
            values: in the unit shown.
            label: another label.
            again: whether what was typed goes, though the numbers are the same.
        """
        self._field.visible = values is not None
        if values is None:
            self._shown = None
            return
        if label is not None:
            self._field.label = label
        shown = tuple(round(float(value), DECIMALS) + 0.0 for value in values)  # + 0.0: no -0
        if shown != self._shown or again:
            self._shown = shown
            self._write(shown)

    @property
    def typed(self) -> tuple[float, ...] | None:
        """What has been typed, in the unit shown; None if it is what was shown."""
        if self._shown is None or self.values == self._shown:
            return None
        return self.values

    @property
    def values(self) -> tuple[float, ...]:
        """What the field holds now, in the unit shown."""
        value = self._field.value
        return tuple(value) if isinstance(value, tuple) else (value,)

    def _write(self, shown: tuple[float, ...]) -> None:
        self._field.value = shown if isinstance(self._field.value, tuple) else shown[0]  # pyright: ignore


class TextField:
    """A name that is typed; as NumberField."""

    def __init__(self, gui: GuiApi, label: str, *, hint: str | None = None) -> None:
        self._field: GuiTextHandle = gui.add_text(label, "", hint=hint)
        self._shown: str | None = None

    def show(self, text: str | None, *, again: bool = False) -> None:
        """Show a draft's name, or nothing for None; `again`, though it is the same."""
        self._field.visible = text is not None
        if text is not None and (text != self._shown or again):
            self._field.value = text
        self._shown = text

    @property
    def typed(self) -> str | None:
        """What has been typed, without spaces around it; None if it is what was shown."""
        text = self._field.value.strip()
        return None if self._shown is None or text == self._shown else text
