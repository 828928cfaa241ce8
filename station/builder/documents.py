"""A draft as text and back: kinematics.json (kinematics/1), URDF, and the table of its markers.

A draft's kinematics.json is a tree file like any other: readers of `kinematics/1` take it to the letter. What a tree
has no place for stands under its "method", which is free: how it came about, "drawn", its markers and boxes, in metres:

    "method": {"name": "drawn", "dictionary": "DICT_4X4_50",
               "markers": [{"id": 0, "part": "seat", "size_m": 0.05, "T_part_marker": [[...4x4...]]}],
               "boxes": [{"part": "seat", "T_part_box": [[...4x4...]], "size_m": [0.4, 0.4, 0.05],
                          "colour": "#8a8f98"}]}
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import PurePath
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from station.builder.draft import DICTIONARY, Block, Draft, drawn_tree
from station.errors import InvalidData, InvalidFile
from station.formats.markers import format_markers
from station.formats.urdf import from_urdf, to_urdf
from station.kinematics.tree import KinematicTree
from station.kinematics.tree_json import from_json, to_json
from station.logs import SLUG, FloatArray
from station.perception.markers import Marker, MarkerTable

DRAWN = "drawn"
UNNAMED = "draft"

Vector = Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
Row = Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[Row], Field(min_length=4, max_length=4)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class _Marker(_Strict):
    id: int
    part: str
    size_m: FiniteFloat
    T_part_marker: Matrix


class _Box(_Strict):
    part: str
    T_part_box: Matrix
    size_m: Vector
    colour: str


class _Drawing(_Strict):
    name: Literal["drawn"]
    dictionary: str = DICTIONARY
    markers: list[_Marker] = []
    boxes: list[_Box] = []


def to_tree(draft: Draft) -> KinematicTree:
    """The draft's tree, with its markers and boxes as its `method`."""
    markers = [
        {"id": m.id, "part": m.part, "size_m": m.size_m, "T_part_marker": m.mount.tolist()} for m in draft.markers
    ]
    boxes = [
        {"part": b.part, "T_part_box": b.T_part_block.tolist(), "size_m": b.size_m.tolist(), "colour": b.colour}
        for b in draft.blocks
    ]
    method = {"name": DRAWN, "dictionary": draft.dictionary, "markers": markers, "boxes": boxes}
    return replace(draft.tree, method=method)


def from_tree(tree: KinematicTree, name: str = UNNAMED) -> Draft:
    """The draft of a tree: of one that was drawn also its markers and boxes, of one that was fitted its joints alone.

    Args:
        tree: one tree, not several.
        name: of the draft, a slug.

    Raises:
        InvalidData: for several trees, markers and boxes that can't be, and whatever else makes no draft.
    """
    if tree.method.get("name") != DRAWN:
        return Draft(name, drawn_tree(tree))
    drawing = _drawing(tree.method)
    return Draft(
        name,
        drawn_tree(tree),
        tuple(Marker(m.id, m.part, m.size_m, np.array(m.T_part_marker)) for m in drawing.markers),
        tuple(Block(b.part, _pose(b.T_part_box), np.array(b.size_m), b.colour) for b in drawing.boxes),
        drawing.dictionary,
    )


def to_text(draft: Draft) -> str:
    """Text of a kinematics.json."""
    return to_json(to_tree(draft))


def to_urdf_text(draft: Draft) -> str:
    """Text of a URDF: the tree without markers and boxes; see `left_out_of_urdf`."""
    return to_urdf(draft.tree, draft.name)


def left_out_of_urdf(draft: Draft) -> tuple[str, ...]:
    """What a draft has that its URDF hasn't, in words."""
    trackers = [part for part in draft.tree.parts if part not in draft.parts]
    balls = [joint.name for joint in draft.joints if joint.type == "spherical"]
    have = {
        _counted(len(draft.markers), "marker", "markers"): draft.markers,
        _counted(len(draft.blocks), "box", "boxes"): draft.blocks,
        f"further trackers {', '.join(trackers)}": trackers,
        f"limits of the ball joints {', '.join(balls)}": balls,
    }
    return tuple(what for what, there in have.items() if there)


def _counted(count: int, one: str, many: str) -> str:
    return f"{count} {one if count == 1 else many}"


def markers_text(draft: Draft) -> str:
    """Text of a markers.toml with the draft's markers and their mounts; raises InvalidData if there are none."""
    return format_markers(MarkerTable(draft.dictionary, draft.markers))


def from_text(text: str, file_name: str) -> Draft:
    """The draft in the text of a kinematics.json or a URDF, told apart by their first letters.

    Args:
        text: the file's text.
        file_name: the file's name, for errors; the draft is named after it.

    Raises:
        InvalidFile: for a file that is neither, and one whose tree can't be drawn.
    """
    tree = from_urdf(text, file_name) if text.lstrip("\ufeff \t\r\n").startswith("<") else from_json(text, file_name)
    try:
        return from_tree(tree, name_of(file_name))
    except InvalidData as error:
        raise InvalidFile(f"{file_name}: {error}") from None


def name_of(file_name: str) -> str:
    """A slug after a file's name; UNNAMED where it has no letters."""
    stem = PurePath(file_name).name.split(".")[0].lower()
    slug = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in stem).strip("_")
    if not slug:
        return UNNAMED
    return slug if SLUG.fullmatch(slug) else f"{UNNAMED}_{slug}"


def _drawing(method: Mapping[str, object]) -> _Drawing:
    try:
        return _Drawing.model_validate(dict(method))
    except ValidationError as error:
        first = error.errors()[0]
        where = ", ".join(str(step) for step in ("method", *first["loc"]))
        raise InvalidData(f"{where}: {first['msg']}") from None


def _pose(matrix: Matrix) -> FloatArray:
    return np.array(matrix, dtype=np.float64)
