"""The table of markers: which marker of which dictionary is on which part, how large, and where it is mounted."""

from __future__ import annotations

import numbers
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from station.errors import InvalidData
from station.logs import ROTATION_TOLERANCE, FloatArray, check_slugs, frozen_floats

if TYPE_CHECKING:
    import cv2

# How many markers each of OpenCV's predefined dictionaries has. Here so that tables are checked without loading OpenCV.
DICTIONARY_SIZES = {
    **{f"DICT_{n}X{n}_{count}": count for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
    "DICT_ARUCO_MIP_36h12": 250,
}

# Bits along a side of the dictionaries that don't say it in their names as DICT_4X4_50 does.
NAMED_OTHERWISE = {
    "DICT_ARUCO_ORIGINAL": 5,
    "DICT_APRILTAG_16h5": 4,
    "DICT_APRILTAG_25h9": 5,
    "DICT_APRILTAG_36h10": 6,
    "DICT_APRILTAG_36h11": 6,
    "DICT_ARUCO_MIP_36h12": 6,
}


def cells_along(dictionary: str) -> int:
    """Cells along a side of a dictionary's markers, the black border included; raises InvalidData for no dictionary."""
    check_dictionary(dictionary)
    bits = NAMED_OTHERWISE.get(dictionary) or int(dictionary.removeprefix("DICT_")[0])
    return bits + 2


def check_dictionary(name: str) -> None:
    """Raise InvalidData unless `name` is one of OpenCV's predefined ArUco dictionaries; lists them if not."""
    if name not in DICTIONARY_SIZES:
        raise InvalidData(f"no marker dictionary '{name}'; want one of\n{', '.join(DICTIONARY_SIZES)}")


def load_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's predefined dictionary of that name, such as "DICT_4X4_50"; raises InvalidData for another name."""
    import cv2

    check_dictionary(name)
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _check_mount(T_part_marker: FloatArray, where: str) -> None:
    if T_part_marker.shape != (4, 4) or not np.all(np.isfinite(T_part_marker)):
        raise InvalidData(f"{where}: T_part_marker must be 4x4 finite numbers; have shape {T_part_marker.shape}")
    R = T_part_marker[:3, :3]
    rigid = np.abs(R.T @ R - np.eye(3)).max() < ROTATION_TOLERANCE and np.linalg.det(R) > 0
    if not rigid or not np.array_equal(T_part_marker[3], (0, 0, 0, 1)):
        raise InvalidData(f"{where}: T_part_marker is no rigid motion (a rotation, metres, last row 0 0 0 1)")


@dataclass(frozen=True, eq=False)
class Marker:
    """One marker, checked. Its frame: origin at the centre, x right, y up, z out of the marker.

    Attributes:
        id: its number in the table's dictionary.
        part: slug of the part that it is on.
        size_m: side of the black square.
        T_part_marker: (4, 4) mount on the part, m; None = the part's frame is the marker's.

    Raises:
        InvalidData: for a size that isn't positive, a part that is no slug, a mount that is no rigid motion.
    """

    id: int
    part: str
    size_m: float
    T_part_marker: FloatArray | None = None

    def __post_init__(self) -> None:
        where = f"marker {self.id}"
        if isinstance(self.id, bool) or not isinstance(self.id, numbers.Integral) or self.id < 0:
            raise InvalidData(f"{where}: id must be a whole number of at least 0")
        check_slugs([self.part], f"{where}: part")
        if not (np.isfinite(self.size_m) and self.size_m > 0):
            raise InvalidData(f"{where}: size is {self.size_m:g} m; want the side of the black square, above 0")
        if self.T_part_marker is not None:
            object.__setattr__(self, "T_part_marker", frozen_floats(self.T_part_marker))
            _check_mount(self.T_part_marker, where)

    @property
    def mount(self) -> FloatArray:
        """(4, 4) T_part_marker; the identity where none is given."""
        return np.eye(4) if self.T_part_marker is None else self.T_part_marker


@dataclass(frozen=True, eq=False)
class MarkerTable:
    """The markers of a rig or a video, checked: ids distinct and in the dictionary; parts with several have mounts.

    Raises:
        InvalidData: for a dictionary that OpenCV doesn't have, an id twice or beyond the dictionary, a table without
            markers, a part with several markers of which one has no mount.
    """

    dictionary: str
    markers: tuple[Marker, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "markers", tuple(self.markers))
        check_dictionary(self.dictionary)
        if not self.markers:
            raise InvalidData("the marker table is empty; want at least one marker")
        self._check_ids()
        self._check_mounts()

    def _check_ids(self) -> None:
        twice = sorted(n for n, count in Counter(m.id for m in self.markers).items() if count > 1)
        if twice:
            raise InvalidData(f"marker ids twice in the table: {', '.join(map(str, twice))}; each may be on one part")
        size = DICTIONARY_SIZES[self.dictionary]
        beyond = sorted(m.id for m in self.markers if m.id >= size)
        if beyond:
            raise InvalidData(f"marker {beyond[0]} is not in {self.dictionary}; its ids are 0 to {size - 1}")

    def _check_mounts(self) -> None:
        counts = Counter(m.part for m in self.markers)
        for m in self.markers:
            if counts[m.part] > 1 and m.T_part_marker is None:
                raise InvalidData(
                    f"part '{m.part}' has {counts[m.part]} markers, but marker {m.id} has no mount;\n"
                    "give each its T_part_marker, or give each marker a part of its own (a rigid pair is found)"
                )

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts, in the order of their first appearance."""
        return tuple(dict.fromkeys(m.part for m in self.markers))

    def rows(self, ids: ArrayLike) -> NDArray[np.int64]:
        """Row of each id (...) in `markers`; -1 for an id that isn't in the table."""
        ids = np.asarray(ids, dtype=np.int64)
        lookup = np.full(DICTIONARY_SIZES[self.dictionary], -1, dtype=np.int64)
        lookup[[m.id for m in self.markers]] = np.arange(len(self.markers))
        inside = (ids >= 0) & (ids < len(lookup))
        return np.where(inside, lookup[np.where(inside, ids, 0)], -1)

    def sizes_m(self, ids: ArrayLike) -> FloatArray:
        """Sizes (...) of the black squares of the markers with these ids, m; NaN for an id that isn't in the table."""
        return np.append([m.size_m for m in self.markers], np.nan)[self.rows(ids)]
