"""The tab whose sliders move the joints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from station.builder.drawing import Slider, sliders
from station.builder.page.page import Page

if TYPE_CHECKING:
    from viser import GuiSliderHandle

# That the field beside a slider shows, of degrees or mm.
DECIMALS = 1
REST, ENDS = "All at rest", ("Lower ends", "Upper ends")


class Moving:
    """A slider for each state, within the joint's limits; moving them changes nothing of the draft."""

    def __init__(self, page: Page) -> None:
        self._page = page
        gui = page.server.gui
        self._nothing = gui.add_markdown("No joint moves: add a part, or give a joint another type.")
        self._all = gui.add_button_group("Joints", (REST, *ENDS))
        self._all.on_click(page.acting(self._move_all))
        self._folder = gui.add_folder(None)
        self._shown: tuple[Slider, ...] = ()
        self._handles: dict[str, GuiSliderHandle[float]] = {}

    def refresh(self) -> None:
        """Have the sliders that the joints need, where their states are."""
        wanted = sliders(self._page.draft)
        if wanted != self._shown:
            self._make(wanted)
        self._nothing.visible, self._all.visible = not wanted, bool(wanted)
        for slider in wanted:
            shown = self._page.desk.states[slider.column] / slider.per_unit
            self._handles[slider.column].value = min(max(shown, slider.low), slider.high)

    def _make(self, wanted: tuple[Slider, ...]) -> None:
        for handle in self._handles.values():
            handle.remove()
        self._shown, self._handles = wanted, {}
        with self._folder:
            for slider in wanted:
                state = self._page.desk.states[slider.column] / slider.per_unit
                handle = self._page.server.gui.add_slider(
                    slider.label,
                    float(slider.low),
                    float(slider.high),
                    float(slider.step),
                    float(min(max(state, slider.low), slider.high)),
                    marks=tuple((float(end), f"{end:.4g}") for end in (slider.low, slider.high)),
                )
                handle.precision = DECIMALS
                handle.on_update(self._page.acting(self._mover(slider)))
                self._handles[slider.column] = handle

    def _mover(self, slider: Slider) -> Any:
        def move(event: Any) -> None:
            self._page.desk = self._page.desk.moved(slider.column, event.target.value * slider.per_unit)

        return move

    def _move_all(self, event: Any) -> None:
        page = self._page
        if event.target.value == REST:
            page.desk = page.desk.rested()
            return
        for slider in self._shown:
            end = slider.low if event.target.value == ENDS[0] else slider.high
            page.desk = page.desk.moved(slider.column, end * slider.per_unit)
