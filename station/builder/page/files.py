"""The tab of files: examples, opening and saving where the station runs, and to and from the browser's machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from station.builder.documents import (
    DRAWN,
    from_text,
    left_out_of_urdf,
    markers_text,
    name_of,
    to_text,
    to_urdf_text,
)
from station.builder.draft import Draft, blank
from station.builder.page.page import Page
from station.builder.rigs import to_rig
from station.builder.stored import load_draft, save_draft
from station.errors import InvalidFile
from station.formats.trees import example_names, load_tree


def rig_text(draft: Draft) -> str:
    """Text of a rig with a servo for each joint; seconds of work."""
    return to_rig(draft).text


NEW = "new: one part"
OPEN, SAVE = "Open", "Save"
DOWNLOADS: Mapping[str, tuple[str, Callable[[Draft], str]]] = {
    "kinematics.json": (".json", to_text),
    "URDF": (".urdf", to_urdf_text),
    "markers.toml": ("_markers.toml", markers_text),
    "rig.toml": ("_rig.toml", rig_text),
}
# No drawn tree's file is nearly as large, B.
MOST_BYTES = 10_000_000


class Files:
    """Where drafts come from and go to."""

    def __init__(self, page: Page) -> None:
        self._page = page
        gui = page.server.gui
        with gui.add_folder("Examples"):
            self._example = gui.add_dropdown("Example", (NEW, *example_names()))
            gui.add_button("Open example").on_click(page.acting(self._open_example))
        with gui.add_folder("On the station's machine"):
            form = gui.add_form(None)
            with form:
                self._path = gui.add_text(
                    "File", str(page.path), hint=".json or .urdf; relative to where it was started."
                )
            form.on_submit(page.acting(self._save))
            there = gui.add_button_group("", (OPEN, SAVE), hint="Enter in the field saves, too.")
            there.on_click(page.acting(self._there))
        with gui.add_folder("On this browser's machine"):
            self._upload = gui.add_upload_button("Upload kinematics.json or URDF")
            self._upload.on_upload(page.acting(self._open_upload))
            here = gui.add_button_group("Download", tuple(DOWNLOADS))
            here.on_click(page.acting(self._download))
        self._shown = page.path

    def refresh(self) -> None:
        """Show the path of what is open."""
        if self._shown != self._page.path:
            self._shown = self._page.path
            self._path.value = str(self._page.path)

    def _open_example(self, event: Any) -> None:
        name = self._example.value
        draft = blank() if name == NEW else load_draft(name)
        self._open(event, draft, Path.cwd() / f"{draft.name}.json", in_file=False)

    def _there(self, event: Any) -> None:
        if event.target.value == SAVE:
            self._save(event)
        else:
            path = self._typed()
            self._open(event, load_draft(path), path, in_file=is_drawn(path))

    def _open_upload(self, event: Any) -> None:
        file = event.target.value
        if len(file.content) > MOST_BYTES:
            raise InvalidFile(f"{file.name} has {len(file.content)} bytes; no drawn tree is larger than {MOST_BYTES}")
        try:
            text = file.content.decode("utf-8")
        except UnicodeDecodeError:
            raise InvalidFile(f"{file.name} is no text; want a kinematics.json or a URDF") from None
        draft = from_text(text, file.name)
        self._open(event, draft, Path.cwd() / f"{draft.name}.json", in_file=False)

    def _open(self, event: Any, draft: Draft, path: Path, *, in_file: bool) -> None:
        """Open it, after a question where that would lose what isn't saved."""

        def open_now() -> None:
            self._page.open(draft, path, in_file=in_file)
            self._page.tell(event.client, "Opened", f"{draft.name}: {len(draft.parts)} parts")

        if not self._page.desk.unsaved:
            open_now()
            return
        self._ask(
            event,
            f"{self._page.path.name} has unsaved changes, which opening another loses.",
            "Open all the same",
            open_now,
        )

    def _typed(self) -> Path:
        text = self._path.value.strip()
        if not text:
            raise InvalidFile("no file is named; type a path that ends in .json or .urdf")
        return Path.cwd() / Path(text).expanduser()

    def _save(self, event: Any) -> None:
        path = self._typed()
        known = path == self._page.path and self._page.in_file

        def save_now() -> None:
            self._save_to(path, event.client)

        if path.exists() and not known:
            self._ask(event, f"{path} is there already.", "Overwrite", save_now)
        else:
            save_now()

    def _save_to(self, path: Path, client: Any) -> None:
        page = self._page
        save_draft(replace(page.draft, name=name_of(path.name)), path)
        lost = left_out_of_urdf(page.draft) if path.suffix.lower() == ".urdf" else ()
        if lost:
            page.tell(
                client, "Saved, but not all of it", f"a URDF has no {', no '.join(lost)}; save a .json to keep them"
            )
            return
        page.saved_to(path)
        page.tell(client, "Saved", str(path))

    def _download(self, event: Any) -> None:
        draft = replace(self._page.draft, name=name_of(self._page.path.name))
        ending, make = DOWNLOADS[event.target.value]

        def send(text: str) -> None:
            event.client.send_file_download(draft.name + ending, text.encode("utf-8"), save_immediately=True)

        if make is not rig_text:
            send(make(draft))
            return
        self._page.slowly(event, "markers and a camera are put in place", lambda: make(draft), send)

    def _ask(self, event: Any, question: str, yes: str, do: Callable[[], None]) -> None:
        """Do it if the person who asked for it says yes, in a window of that tab."""
        gui = event.client.gui
        modal = gui.add_modal("Sure?")
        with modal:
            gui.add_markdown(question)
            answers = gui.add_button_group("", (yes, "Cancel"))

        def answer(answered: Any) -> None:
            modal.close()
            if answered.target.value == yes:
                do()

        answers.on_click(self._page.acting(answer))


def is_drawn(path: Path) -> bool:
    """Whether a tree's file was written by the builder: there saving loses nothing, such as the scores of a fit."""
    return load_tree(path).method.get("name") == DRAWN
