"""markers.toml: which marker is on which part, read strictly; its model serves rig.toml's `[markers]` as well."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from station.errors import InvalidData, InvalidFile
from station.formats.toml_models import StrictModel, parse
from station.perception.markers import Marker, MarkerTable

MARKERS_SCHEMA = "markers/1"
M_PER_MM = 1e-3

Row4 = Annotated[list[float], Field(min_length=4, max_length=4)]
Matrix4 = Annotated[list[Row4], Field(min_length=4, max_length=4)]


class MarkerModel(StrictModel):
    """One `[[marker]]`: its id, the part's slug, the side of the black square, optionally its mount (m)."""

    id: int
    part: str
    size_mm: float
    T_part_marker: Matrix4 | None = None

    def to_marker(self) -> Marker:
        """The checked marker; raises InvalidData."""
        mount = None if self.T_part_marker is None else np.array(self.T_part_marker)
        return Marker(self.id, self.part, self.size_mm * M_PER_MM, mount)


class MarkersModel(StrictModel):
    """The table of markers: the dictionary's name and the markers."""

    dictionary: str
    marker: list[MarkerModel]

    def to_table(self) -> MarkerTable:
        """The checked table; raises InvalidData."""
        return MarkerTable(self.dictionary, tuple(marker.to_marker() for marker in self.marker))


def parse_markers(text: str, name: str) -> MarkerTable:
    """The table in a markers.toml text; raises InvalidFile, with the file's `name`, for anything else."""
    model = parse(MarkersModel, text, name, MARKERS_SCHEMA)
    try:
        return model.to_table()
    except InvalidData as error:
        raise InvalidFile(f"{name}: {error}") from error


def format_markers(table: MarkerTable) -> str:
    """markers.toml's text of a table."""
    lines = [f'schema = "{MARKERS_SCHEMA}"', f'dictionary = "{table.dictionary}"']
    for marker in table.markers:
        size_mm = float(f"{marker.size_m / M_PER_MM:.15g}")  # 50.8, not 50.80000000000001
        lines += ["", "[[marker]]", f"id = {marker.id}", f'part = "{marker.part}"', f"size_mm = {size_mm!r}"]
        if marker.T_part_marker is not None:
            lines.append("T_part_marker = [")
            lines += [f"    {row}," for row in marker.T_part_marker.tolist()]
            lines.append("]")
    return "\n".join(lines) + "\n"
