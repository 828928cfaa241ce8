"""The builder as a whole: a page with all its controls, on a server."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from station.builder.desk import Desk
from station.builder.documents import name_of
from station.builder.draft import Draft, blank
from station.builder.page.files import Files, is_drawn
from station.builder.page.gizmo import Gizmo
from station.builder.page.head import Head
from station.builder.page.marks import Markers, Shape
from station.builder.page.moving import Moving
from station.builder.page.page import Page
from station.builder.page.parts import JointForm, Parts
from station.builder.page.scene import Picture
from station.builder.page.server import address, serving
from station.builder.page.trying import Fitter, Player, Settings
from station.builder.stored import aside, load_draft, recovered
from station.formats.trees import example_names

UNTITLED = "draft.json"


class Builder:
    """The tree builder while it is open.

    Attributes:
        page: with all that is shown; its event loop is another thread's.
        address: where a browser finds it.
        was_recovered: whether what is open are changes that an earlier run left unsaved.
    """

    def __init__(self, page: Page, url: str, *, was_recovered: bool) -> None:
        self.page, self.address, self.was_recovered = page, url, was_recovered

    @property
    def path(self) -> Path:
        """Of the file that is open."""
        return self.page.path

    @property
    def draft(self) -> Draft:
        """What is open, as it is now."""
        return self.page.draft

    def left(self) -> str | None:
        """What has become of changes that aren't saved, in a sentence; None if there are none."""
        if not self.page.desk.unsaved:
            return None
        if self.page.trouble_aside is not None:
            return f"unsaved changes of {self.path.name} are lost: {self.page.trouble_aside}"
        return (
            f"unsaved changes of {self.path.name} are kept in {aside(self.path)}; "
            "the builder takes them up when it is started here with that file again"
        )


@contextmanager
def building(tree: str | None, host: str, port: int) -> Iterator[Builder]:
    """The builder while the block runs.

    Args:
        tree: a file, a packaged example's name, or None for a draft of one part.
        host: address of this machine.
        port: a free one.

    Raises:
        InvalidFile: the tree is missing, or no tree.
        StationError: viser isn't there, the port is taken.
    """
    draft, path, in_file = opened(tree)
    found = recovered(path)
    desk = Desk.of(draft)
    if found is not None:
        desk = desk.edited(found, "take up unsaved changes of an earlier run")
    with serving(host, port) as server:
        page = Page(server, desk, path, in_file=in_file)
        under_way = _furnished(page)
        try:
            yield Builder(page, address(host, port), was_recovered=desk.unsaved)
        finally:
            for each in under_way:
                each.close()


def opened(tree: str | None) -> tuple[Draft, Path, bool]:
    """What is opened, the path of its file, and whether it comes from there.

    Raises:
        InvalidFile: it is missing, or no tree.
    """
    if tree is None:
        path = Path.cwd() / UNTITLED
        return blank(name_of(path.name)), path, False
    draft, path = load_draft(tree), Path.cwd() / tree
    if tree in example_names() or path.is_dir():
        return draft, Path.cwd() / f"{path.name}.json", False
    return draft, path, is_drawn(path)


def _furnished(page: Page) -> tuple[Page, Player, Fitter]:
    """Add the controls to a page, and show it; what is to be closed at the end."""
    gui = page.server.gui
    head = Head(page)
    tabs = gui.add_tab_group()
    with tabs.add_tab("Build"):
        parts = Parts(page)
        gizmo = Gizmo(page, lambda: markers.selected)
        form, markers, shape = JointForm(page), Markers(page), Shape(page)
    with tabs.add_tab("Move"):
        moving = Moving(page)
    with tabs.add_tab("Try"):
        settings = Settings(page)
        player, fitter = Player(page, settings), Fitter(page, settings)
    with tabs.add_tab("Files"):
        files = Files(page)
    page.add(head, parts, form, markers, shape, moving, player, gizmo, fitter, files)

    def seen(picture: Picture) -> Picture:
        return fitter.seen(player.seen(picture))

    page.picture = seen
    page.look()
    page.refresh()
    return page, player, fitter
