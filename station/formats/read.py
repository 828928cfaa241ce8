"""Reads logs from a path. The one place to add an importer of pose logs is `IMPORTERS`, below."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from station.errors import InvalidFile
from station.formats.joint_csv import parse_commands
from station.formats.legacy_aruco import COLUMNS as LEGACY_COLUMNS
from station.formats.legacy_aruco import parse_legacy_aruco
from station.formats.poses_csv import COLUMNS as POSES_COLUMNS
from station.formats.poses_csv import parse_poses_csv
from station.formats.table import count_words, read_header
from station.formats.text import read_text
from station.formats.tracks import parse_track
from station.formats.tum import COLUMNS as TUM_COLUMNS
from station.formats.tum import parse_tum, parse_tum_files
from station.logs import JointLog, PoseLog

WORDS_ENDINGS = (".log", ".txt", ".tum")


@dataclass(frozen=True)
class Importer:
    """One form of pose log in a text file.

    Attributes:
        name: for people.
        endings: of the files that may have this form.
        fits: whether a text with such an ending is of this form, as its first line says.
        parse: the log in a text, given also the file's name; raises InvalidFile with the row that is wrong.
    """

    name: str
    endings: tuple[str, ...]
    fits: Callable[[str], bool]
    parse: Callable[[str, str], PoseLog]


IMPORTERS: tuple[Importer, ...] = (
    Importer("poses.csv", (".csv",), lambda text: "part" in read_header(text), parse_poses_csv),
    Importer("legacy ArUco", (".csv",), lambda text: "id" in read_header(text), parse_legacy_aruco),
    Importer("TUM", WORDS_ENDINGS, lambda text: count_words(text) == len(TUM_COLUMNS), parse_tum),
    Importer("track", WORDS_ENDINGS, lambda text: count_words(text) in (3, 7), parse_track),
)
READABLE = (
    f"can read .csv with {','.join(POSES_COLUMNS)}",
    f"or with {','.join(LEGACY_COLUMNS)} (legacy ArUco);",
    f".log or .txt with x y z [qx qy qz qw] (track) or {' '.join(TUM_COLUMNS)} (TUM);",
    "several TUM files, or a folder of them (a part a file)",
)


def read_pose_log(path: str | PathLike[str], *others: str | PathLike[str]) -> PoseLog:
    """Read the poses in a file, in a folder of TUM files, or in several TUM files.

    Args:
        path: a .csv of poses or of legacy ArUco rows, told apart by the header; a .log, .txt or .tum with a track
            (three or seven numbers a row) or a TUM trajectory (eight); a folder of TUM trajectories.
        others: more TUM trajectories of the same recording.

    Raises:
        InvalidFile: with the file's name, for what is missing, no text, of another form, or wrong in some row.
    """
    path = Path(path)
    if others:
        return _read_tum_files([path, *map(Path, others)], f"{1 + len(others)} files")
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in WORDS_ENDINGS)
        if not files:
            raise _unreadable(path.name, f"is a folder without {', '.join(WORDS_ENDINGS)} files")
        return _read_tum_files(files, path.name)
    return _importer_of(text := read_text(path, "pose log"), path).parse(text, path.name)


def read_commands(path: str | PathLike[str], units: Mapping[str, str] | None = None) -> JointLog:
    """Read a commands.csv: `t_s`, then a column a joint.

    Args:
        path: of the file.
        units: "rad" or "m" by joint, which the file doesn't tell; joints that aren't in it are in rad.

    Raises:
        InvalidFile: with the file's name, for what is missing, no text, or wrong in some row.
    """
    path = Path(path)
    return parse_commands(read_text(path, "commands"), path.name, units)


def _importer_of(text: str, path: Path) -> Importer:
    """The one importer that a file's ending and first line ask for; raises InvalidFile where none or several do."""
    ending = path.suffix.lower()
    possible = [importer for importer in IMPORTERS if ending in importer.endings]
    if not possible:
        raise _unreadable(path.name, f"ends in '{ending}'" if ending else "has no ending")
    fitting = [importer for importer in possible if importer.fits(text)]
    if not fitting:
        raise _unreadable(path.name, _first_line(text, ending))
    if len(fitting) > 1:
        names = " or ".join(importer.name for importer in fitting)
        raise _unreadable(path.name, f"may be {names}: it {_first_line(text, ending)}; leave the columns of one")
    return fitting[0]


def _first_line(text: str, ending: str) -> str:
    if ending in WORDS_ENDINGS:
        words = count_words(text)
        return f"has {words} numbers in its first row" if words else "is empty"
    header = read_header(text)
    return f"has the columns {','.join(header)[:80]}" if header else "is empty"


def _read_tum_files(paths: list[Path], name: str) -> PoseLog:
    texts: dict[str, str] = {}
    for path in paths:
        text = read_text(path, "pose log")
        if path.name in texts:
            raise InvalidFile(f"two files are named {path.name}; a file's name is its part's, rename one")
        if count_words(text) != len(TUM_COLUMNS):
            raise _unreadable(
                path.name, f"is no TUM trajectory ({' '.join(TUM_COLUMNS)}), as every file of several must be"
            )
        texts[path.name] = text
    return parse_tum_files(texts, name)


def _unreadable(name: str, why: str) -> InvalidFile:
    return InvalidFile("\n".join([f"{name} {why}", *READABLE]))
