"""The page: one desk that all tabs show, the choices beside it, and how an action comes to be seen."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from station.builder.desk import Desk
from station.builder.draft import Draft
from station.builder.page.scene import Picture, Scene
from station.builder.stored import forget_aside, keep_aside
from station.errors import StationError

if TYPE_CHECKING:
    from viser import ClientHandle, ViserServer

T = TypeVar("T")
Action = Callable[[Any], None]
Callback = Callable[[Any], Coroutine[Any, Any, None]]
# How long notifications stay, s.
TOLD_S, REFUSED_S = 6.0, 20.0
GREEN, RED = (47, 158, 68), (224, 49, 49)


class Shows(Protocol):
    """Something that shows the desk: a group of controls."""

    def refresh(self) -> None:
        """Bring it up to date."""
        ...


class Page:
    """What is open, what is selected, and what everybody sees of it.

    Args:
        server: that shows it.
        desk: with the draft.
        path: of its file.
        in_file: whether the draft was read from there; otherwise the file needn't exist, and isn't overwritten unasked.

    Attributes:
        desk: with the draft; actions put another in its place.
        path: where the draft is saved, and beside which it is put aside until then.
        in_file: whether the file there is this draft's.
        selected: the part that the controls are about.
        playing: whether something else than the draft at its sliders' states is seen.
        picture: of what is played or tried beside the draft; None of the draft alone.
    """

    def __init__(self, server: ViserServer, desk: Desk, path: Path, *, in_file: bool) -> None:
        self.server, self.desk, self.path, self.in_file = server, desk, path, in_file
        self.selected = desk.draft.tree.root
        self.picture: Callable[[Picture], Picture] = lambda picture: picture
        self.scene = Scene(server, self._clicked)
        self.playing = False
        self._shown: list[Shows] = []
        self.trouble_aside: str | None = None
        self._slow = ThreadPoolExecutor(1, "the builder's slow work")

    @property
    def draft(self) -> Draft:
        """As it is now."""
        return self.desk.draft

    def add(self, *shown: Shows) -> None:
        """Have groups of controls brought up to date after each action."""
        self._shown += shown

    def acting(self, action: Action) -> Callback:
        """A callback for viser that does this, tells what refuses it in a notification, and shows what has come of it.

        What the page itself writes into a control is no action.
        """

        async def act(event: Any) -> None:
            if event.client is not None:
                self.act(event, action)

        return act

    def act(self, event: Any, action: Action, *, goes_on: bool = False) -> None:
        """Do it now; see `acting`.

        Args:
            event: of viser.
            action: to be done.
            goes_on: whether more of the same follows at once, as in a drag: then nothing is put aside yet.
        """
        before = self.desk
        try:
            action(event)
        except StationError as error:
            self.tell(event.client, "Not done: nothing has changed", str(error), bad=True)
        except Exception as error:  # a defect: what was drawn must outlive it
            self.desk = before
            logging.getLogger(__name__).exception("the tree builder's page")
            self.tell(event.client, "A defect of the builder: nothing has changed", repr(error), bad=True)
        if self.desk.draft is not before.draft and not goes_on:
            self.put_aside()
        self.refresh()

    def slowly(self, event: Any, what: str, work: Callable[[], T], then: Callable[[T], None]) -> None:
        """Do what takes seconds beside the page, which goes on meanwhile and says what is awaited.

        Args:
            event: of viser.
            what: is done, in words.
            work: to be done in a thread of its own; it must change nothing.
            then: what is done with its result, as by `act`.
        """
        wait = event.client.add_notification("Please wait", what, loading=True, with_close_button=False)

        def done(future: asyncio.Future[T]) -> None:
            wait.remove()
            self.act(event, lambda _: then(future.result()))

        asyncio.wrap_future(self._slow.submit(work)).add_done_callback(done)

    def close(self) -> None:
        """Wait for the end of slow work; from another thread than the event loop's."""
        self._slow.shutdown(cancel_futures=True)

    def edit(self, draft: Draft, what: str, gesture: str | None = None) -> None:
        """Put the result of an edit on the desk, and keep the selection on something that is there."""
        self.desk = self.desk.edited(draft, what, gesture=gesture)

    def select(self, part: str) -> None:
        """Have the controls be about a part."""
        self.draft.check_part(part)
        self.selected = part

    def open(self, draft: Draft, path: Path, *, in_file: bool) -> None:
        """Show another draft, and turn the cameras to it; what was put aside of the last one goes."""
        self.desk = Desk.of(self.draft)
        self.put_aside()
        self.desk, self.path, self.in_file = Desk.of(draft), path, in_file
        self.selected = draft.tree.root
        self.look()

    def saved_to(self, path: Path) -> None:
        """The draft is in a file now, which is its own from now on."""
        self.desk = self.desk.kept()
        self.put_aside()
        self.path, self.in_file = path, True

    def look(self) -> None:
        """Turn the cameras to all of the draft."""
        self.scene.look_at(self.draft, self.desk.states)

    def put_aside(self) -> None:
        """Keep what isn't saved beside its file; where that can't be written, `trouble_aside` says why."""
        try:
            if self.desk.unsaved:
                keep_aside(self.draft, self.path)
            else:
                forget_aside(self.path)
            self.trouble_aside = None
        except (StationError, OSError) as error:
            self.trouble_aside = str(error)

    def refresh(self) -> None:
        """Bring all that is seen up to date."""
        if self.selected not in self.draft.parts:
            self.selected = self.draft.tree.root
        with self.server.atomic():
            for shown in self._shown:
                shown.refresh()
            self.draw()

    def draw(self) -> None:
        """Bring the scene up to date."""
        self.scene.show(self.picture(Picture(self.draft, self.desk.states, self.selected)))

    def tell(self, client: ClientHandle | None, title: str, body: str, *, bad: bool = False) -> None:
        """Notify the tab that asked; all of them if None."""
        clients = self.server.get_clients().values() if client is None else (client,)
        for each in clients:
            each.add_notification(
                title, body, color=RED if bad else GREEN, auto_close_seconds=REFUSED_S if bad else TOLD_S
            )

    async def _clicked(self, event: Any, part: str) -> None:
        self.act(event, lambda _: self.select(part))
