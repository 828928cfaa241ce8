"""A tab of the tree builder, and how a person finds things in it: by what is written beside them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

# viser's page sends one message in 50 ms, and of several meanwhile the last alone: nobody clicks faster.
PAUSE = "() => new Promise(done => setTimeout(done, 120))"
# The scene is drawn coarsely: by the processor, at that.
COARSE = "/?fixedDpr=0.25"
# A loaded machine draws the scene with its processor.
PATIENCE_MS = 60_000


class Tab:
    """A tab on the builder.

    Attributes:
        asked: addresses of all that the page has asked for.
        said: what went wrong, as its console says.
    """

    def __init__(self, browser: Any, url: str, *, query: str = COARSE) -> None:
        self.context = browser.new_context(viewport={"width": 1200, "height": 800}, accept_downloads=True)
        self.page = self.context.new_page()
        self.page.set_default_timeout(PATIENCE_MS)
        self.asked: list[str] = []
        self.said: list[str] = []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("websocket", lambda socket: self.asked.append(socket.url))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.goto(url + query)
        self.sees("in no file yet", "saved", "unsaved changes")

    def __enter__(self) -> Tab:
        return self

    def __exit__(self, *_: object) -> None:
        self.context.close()

    def sees(self, *texts: str) -> None:
        """Wait until one of these is written anywhere."""
        found = self.page.get_by_text(texts[0])
        for text in texts[1:]:
            found = found.or_(self.page.get_by_text(text))
        found.locator("visible=true").first.wait_for()

    def click(self, name: str) -> None:
        """Click a button."""
        self.page.get_by_role("button", name=name, exact=True).first.click()
        self._pause()

    def opens(self, tab: str) -> None:
        """Open one of the tabs of the panel."""
        self.page.get_by_role("tab", name=tab, exact=True).click()

    def type(self, label: str, *values: object) -> None:
        """Type into the fields beside a label."""
        fields = self._fields(label)
        for k, value in enumerate(values):
            fields.nth(k).fill(str(value))
            self._pause()

    def presses_enter(self, label: str) -> None:
        """Press Enter in the first field beside a label."""
        self._fields(label).first.press("Enter")
        self._pause()

    def choose(self, label: str, option: str) -> None:
        """Choose from a menu."""
        self._fields(label).first.click()
        self.page.get_by_role("option", name=option, exact=True).click()
        self._pause()

    def shows(self, label: str, *values: object) -> None:
        """Wait until the fields beside a label hold this."""
        fields = self._fields(label)
        for k, value in enumerate(values):
            self.until(lambda k=k, value=value: fields.nth(k).input_value() == str(value), f"{label}: {value}")

    def until(self, holds: Callable[[], bool], what: str = "") -> None:
        """Wait until it holds, while the page goes on."""
        for _ in range(PATIENCE_MS // 50):
            if holds():
                return
            self.page.wait_for_timeout(50)
        raise AssertionError(f"it never came about: {what}")

    def _fields(self, label: str) -> Any:
        return self.page.locator(f"xpath=//label[normalize-space(.)='{label}']/../../..//input").locator("visible=true")

    def _pause(self) -> None:
        self.page.evaluate(PAUSE)

    def drags(self, start: tuple[float, float], end: tuple[float, float], steps: int = 4) -> None:
        """Drag with the mouse, from one point of the page to another [px]."""
        mouse = self.page.mouse
        mouse.move(*start)
        self._pause()
        mouse.down()
        for k in range(1, steps + 1):
            mouse.move(*(a + k / steps * (b - a) for a, b in zip(start, end, strict=True)))
            self._pause()
        mouse.up()
        self._pause()

    def pixel(self, camera: Any, point_m: Any) -> tuple[float, float]:
        """Where a point of the scene is on the page [px], for a camera of viser's with z up."""
        box = self.page.locator("canvas").first.bounding_box()
        eye, forward = np.asarray(camera.position), np.asarray(camera.look_at) - np.asarray(camera.position)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right = right / np.linalg.norm(right)
        ray = np.asarray(point_m) - eye
        per_m = box["height"] / 2 / np.tan(camera.fov / 2) / (ray @ forward)
        x, y = ray @ right * per_m, ray @ np.cross(right, forward) * per_m
        return box["x"] + box["width"] / 2 + x, box["y"] + box["height"] / 2 - y
