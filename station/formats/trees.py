"""Trees from files: kinematics.json, URDF, or an example that comes with the package."""

from __future__ import annotations

from importlib import resources
from os import PathLike
from pathlib import Path

from station.errors import InvalidFile
from station.formats.text import read_text
from station.formats.urdf import from_urdf
from station.kinematics.tree import KinematicTree
from station.kinematics.tree_json import from_json

TREE_FILE = "kinematics.json"
URDF_ENDINGS = (".urdf", ".xml")


def example_names() -> tuple[str, ...]:
    """Names of the trees that come with the package."""
    return tuple(sorted(path.stem for path in _examples().glob("*.json")))


def load_tree(name_or_path: str | PathLike[str]) -> KinematicTree:
    """Read a kinematics.json, a URDF (by its ending), the kinematics.json in a fit's folder, or a packaged example.

    Args:
        name_or_path: a packaged tree's name, such as "swivel_chair", or a path; a name goes before a file so named.

    Raises:
        InvalidFile: a StationError: what is missing, torn, of another form, or no tree.
    """
    inside = _examples() / f"{name_or_path}.json"
    if str(name_or_path) in example_names():
        return from_json(read_text(inside, "tree"), inside.name)
    path = Path(name_or_path)
    if path.is_dir():
        path = path / TREE_FILE
    if not path.suffix and not path.exists():
        raise InvalidFile(f"no tree '{path}'; {_choices()}\nor name a file: {path}.json")
    text = read_text(path, "tree", _choices())
    if path.suffix.lower() in URDF_ENDINGS:
        return from_urdf(text, str(path))
    return from_json(text, str(path))


def _choices() -> str:
    return f"packaged ones are {', '.join(example_names())}"


def _examples() -> Path:
    return Path(str(resources.files("station") / "trees"))
