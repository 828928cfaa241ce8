"""The tab in which a draft is tried: Algorithm 2 played live, and simulated and fitted."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from station.builder.draft import Draft
from station.builder.page.controls import MM_PER_M
from station.builder.page.fit_apart import FitApart
from station.builder.page.found import found_html
from station.builder.page.page import Page
from station.builder.page.scene import Picture
from station.builder.playing import Play, start_play
from station.builder.trial import Trial, TrialSettings
from station.errors import StationError
from station.simulate import MOTIONS, NOISE_MODELS

PLAY, PAUSE, STEP, STOP = "Play", "Pause", "Step", "Stop"
# Between two frames that are played, s.
FRAME_S = 0.1
# Ends of the sliders, in mm, degrees and virtual trackers a part.
MOST_NOISE_MM, MOST_NOISE_DEG, MOST_INFLATION = 50.0, 10.0, 4
MOST_FRAMES = 2000


class Settings:
    """How a draft is simulated, and by which method it is fitted."""

    def __init__(self, page: Page) -> None:
        gui, usual = page.server.gui, TrialSettings()
        self._place = gui.add_slider("Noise [mm]", 0.0, MOST_NOISE_MM, 0.1, MM_PER_M * usual.noise_translation_m)
        turn = round(float(np.degrees(usual.noise_rotation_rad)), 2)
        self._turn = gui.add_slider("Noise [deg]", 0.0, MOST_NOISE_DEG, 0.01, turn)
        hint = "Virtual trackers, rigid on each part, beside its own."
        self._inflation = gui.add_slider("Inflation", 0, MOST_INFLATION, 1, usual.inflation, hint=hint)
        self._noise = gui.add_dropdown("Noise model", tuple(NOISE_MODELS), initial_value=usual.noise)
        self._motion = gui.add_dropdown("Motion", tuple(MOTIONS), initial_value=usual.motion)
        self._frames = gui.add_number("Frames", usual.frames, min=2, max=MOST_FRAMES, step=1)
        self._seed = gui.add_number("Seed", usual.seed, min=0, step=1, hint="The same seed gives the same motion.")
        self._method = gui.add_dropdown("Method", ("station", "paper"), initial_value=usual.method, hint="Of the fit.")

    @property
    def now(self) -> TrialSettings:
        """What the controls say."""
        return TrialSettings(
            frames=int(self._frames.value),
            noise_translation_m=self._place.value / MM_PER_M,
            noise_rotation_rad=float(np.radians(self._turn.value)),
            inflation=int(self._inflation.value),
            method=self._method.value,
            seed=int(self._seed.value),
            motion=self._motion.value,
            noise=self._noise.value,
        )


class Player:
    """Algorithm 2, frame by frame: the draft moves, and what a tracker would report of it stands beside."""

    def __init__(self, page: Page, settings: Settings) -> None:
        self._page, self._settings = page, settings
        gui = page.server.gui
        self._buttons = gui.add_button_group("Algorithm 2", (PLAY, PAUSE, STEP, STOP))
        self._buttons.on_click(page.acting(self._order))
        self._text = gui.add_markdown("")
        self._play: Play | None = None
        self._timer: asyncio.TimerHandle | None = None

    def close(self) -> None:
        """Stop, before the event loop does; from another thread."""

        async def pause() -> None:
            self._pause()

        asyncio.run_coroutine_threadsafe(pause(), self._page.server.get_event_loop()).result()

    @property
    def running(self) -> bool:
        """Whether frames follow by themselves."""
        return self._timer is not None

    def refresh(self) -> None:
        """Say which frame is shown; another draft or other settings begin again."""
        draft, settings = self._page.draft, self._settings.now
        if self._play is not None and self._play.settings != settings:
            same = self._play.settings.seed == settings.seed
            self._play = self._play.with_settings(settings) if same else start_play(draft, settings)
        if self._play is not None and self._play.draft is not draft:
            self._play = start_play(draft, settings)
        self._page.playing = self._play is not None
        text = "Not playing." if self._play is None else f"Frame {self._play.frame}, seed {settings.seed}."
        if text != self._text.content:
            self._text.content = text

    def seen(self, picture: Picture) -> Picture:
        """The picture of what is played, if anything is."""
        if self._play is None:
            return picture
        root = self._play.truth[self._page.draft.tree.root]
        return replace(picture, states=self._play.states, T_world_root=root, measured=self._play.measured)

    def _order(self, event: Any) -> None:
        what = event.target.value
        if what == STOP:
            self._pause()
            self._play = None
        elif what == PAUSE:
            self._pause()
        elif what == STEP:
            self._pause()
            self._step()
        elif not self.running:
            self._tick()

    def _step(self) -> None:
        """The first frame, or the next."""
        if self._play is None:
            self._play = start_play(self._page.draft, self._settings.now)
        else:
            self._play = self._play.stepped()

    def _pause(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = None

    def _tick(self) -> None:
        """Show the next frame, and have the one after follow; in the event loop."""
        self._timer = asyncio.get_running_loop().call_later(FRAME_S, self._tick)
        try:
            self._step()
        except StationError as error:
            self._pause()
            self._page.tell(None, "The play has stopped", str(error), bad=True)
        with self._page.server.atomic():
            self.refresh()
            self._page.draw()


class Fitter:
    """Simulates the draft and fits it, apart, while the page goes on; shows what was found beside what is true."""

    def __init__(self, page: Page, settings: Settings) -> None:
        self._page, self._settings = page, settings
        gui = page.server.gui
        self._go = gui.add_button("Simulate and fit", hint="Lays what the fit finds over the draft.")
        self._go.on_click(page.acting(self._start))
        self._cancel = gui.add_button("Cancel the fit", visible=False)
        self._cancel.on_click(page.acting(lambda _: self._stop()))
        self._busy = gui.add_progress_bar(100.0, animated=True, visible=False)
        self._overlay = gui.add_checkbox("Show found", True, hint="Axes that were found, over the draft's own.")
        self._overlay.on_update(page.acting(lambda _: None))
        self._text = gui.add_html("")
        self._trial: Trial | None = None
        self._of: Draft | None = None
        self._under_way: FitApart | None = None
        self._waits = ThreadPoolExecutor(1, "wait for the fit")

    def refresh(self) -> None:
        """Show the last trial, and whether one is under way."""
        busy = self._under_way is not None
        self._go.disabled, self._cancel.visible, self._busy.visible = busy, busy, busy
        self._overlay.visible = self._trial is not None
        if (text := self._told()) != self._text.content:
            self._text.content = text

    def seen(self, picture: Picture) -> Picture:
        """The picture with what was found of this very draft."""
        if self._trial is None or self._of is not picture.draft or not self._overlay.value:
            return picture
        return replace(picture, found=self._trial.found_lines(picture.states))

    def close(self) -> None:
        """End the fit that is under way, if any."""
        self._stop()
        self._waits.shutdown()

    def _told(self) -> str:
        if self._trial is None:
            return ""
        return found_html(self._trial, is_older=self._of is not self._page.draft)

    def _start(self, event: Any) -> None:
        if self._under_way is not None:
            raise StationError("a fit is under way; wait for it, or cancel it")
        draft, fit = self._page.draft, FitApart(self._page.draft, self._settings.now)
        self._under_way = fit
        loop, client = asyncio.get_running_loop(), event.client

        def done(future: Future[Trial]) -> None:
            with suppress(RuntimeError):  # the page has been closed meanwhile
                loop.call_soon_threadsafe(self._done, fit, draft, future, client)

        self._waits.submit(fit.wait).add_done_callback(done)

    def _stop(self) -> None:
        if self._under_way is not None:
            self._under_way.stop()

    def _done(self, fit: FitApart, draft: Draft, future: Future[Trial], client: Any) -> None:
        self._under_way = None
        error = future.exception()
        if error is None:
            self._trial, self._of = future.result(), draft
        elif fit.stopped:
            self._page.tell(client, "Cancelled", "the fit was ended before it was done")
        else:
            self._page.tell(client, "No fit", str(error), bad=True)
        self._page.refresh()
