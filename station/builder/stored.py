"""Drafts in files: opened, saved, and put aside beside their file while they are not saved yet."""

from __future__ import annotations

from pathlib import Path

from station.builder.documents import from_text, from_tree, name_of, to_text, to_urdf_text
from station.builder.draft import Draft
from station.comparison_files import write_files
from station.errors import InvalidData, InvalidFile, StationError
from station.formats.text import read_text
from station.formats.trees import load_tree

# What is put aside of `chair.json` is `.chair.json.unsaved`.
ASIDE = ".unsaved"
ENDINGS = (".json", ".urdf")


def load_draft(name_or_path: str | Path) -> Draft:
    """The draft in a kinematics.json, a URDF or a fit's folder, or a packaged example by its name.

    Raises:
        InvalidFile: for what is missing, torn, no tree, or one that can't be drawn.
    """
    tree = load_tree(name_or_path)
    try:
        return from_tree(tree, name_of(str(name_or_path)))
    except InvalidData as error:
        raise InvalidFile(f"{name_or_path}: {error}") from None


def save_draft(draft: Draft, path: Path) -> None:
    """Write a draft as its file's ending says; an error leaves what was there before.

    Raises:
        InvalidData: for another ending than .json and .urdf.
        StationError: for a file that can't be written.
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise InvalidData(f"'{path.name}' ends in '{ending}'; want {' or '.join(ENDINGS)}")
    write_text(path, to_text(draft) if ending == ".json" else to_urdf_text(draft))


def keep_aside(draft: Draft, path: Path) -> None:
    """Write a draft that isn't saved yet beside its file, from where `recovered` has it after a crash.

    Raises:
        StationError: for a file that can't be written.
    """
    write_text(aside(path), to_text(draft))


def recovered(path: Path) -> Draft | None:
    """What was put aside of a file and not saved since; None if there is nothing, or nothing that can be read."""
    kept = aside(path)
    if not kept.exists():
        return None
    try:
        return from_text(read_text(kept, "draft"), path.name)
    except InvalidFile:
        return None


def forget_aside(path: Path) -> None:
    """Delete what was put aside of a file, if there is anything: it was saved, or nobody wants it."""
    aside(path).unlink(missing_ok=True)


def aside(path: Path) -> Path:
    """Where a file's draft is put aside."""
    return path.with_name(f".{path.name}{ASIDE}")


def write_text(path: Path, text: str) -> None:
    """Write a file; an error, a StationError, leaves what was there before."""
    try:
        write_files(path.parent, {path.name: text.encode()})
    except OSError as error:
        raise StationError(f"can't write {path}: {error.strerror}; name another file") from error
