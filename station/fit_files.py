"""A fit's folder: kinematics.json, joint_states.csv, kinematics.urdf, residuals.parquet and a drawing."""

from __future__ import annotations

import io
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from station.comparison_files import write_files
from station.errors import InvalidFile, StationError
from station.fit.result import Fit
from station.formats.joint_csv import format_joint_states, parse_joint_states
from station.formats.text import read_text
from station.formats.urdf import to_urdf
from station.kinematics.tree import KinematicTree
from station.kinematics.tree_json import from_json, to_json
from station.session import FIT_FOLDER, RECORDING_FILE, check_output_folder

if TYPE_CHECKING:
    from station.fit.image_checks import Residuals

TREE_FILE = "kinematics.json"
STATES_FILE = "joint_states.csv"
URDF_FILE = "kinematics.urdf"
RESIDUALS_FILE = "residuals.parquet"
TREE_NAME = "fitted"
TREE_FIGURE = "tree"


def write_fit(
    fit: Fit, folder: str | PathLike[str], *, residuals: Residuals | None = None, force: bool = False
) -> None:
    """Write kinematics.json, joint_states.csv, kinematics.urdf, tree.png, tree.svg and, if given, residuals.parquet.

    Args:
        fit: what `station.fit` returned.
        folder: new or empty; made if it isn't there.
        residuals: of a fit on corners; without, those of an earlier fit are taken away.
        force: overwrite what is in the folder.

    Raises:
        StationError: an occupied folder, one that can't be written.
    """
    from station.report import save_figure, tree_figure

    folder = Path(folder)
    check_output_folder(folder, force=force)
    texts = {
        URDF_FILE: to_urdf(fit.tree, TREE_NAME),
        STATES_FILE: format_joint_states(fit.states),
        TREE_FILE: to_json(fit.tree),
    }
    files = {name: text.encode() for name, text in texts.items()} | _residual_files(residuals)
    figure = tree_figure(fit.tree, fit.states)
    try:
        save_figure(figure, folder / TREE_FIGURE)
        write_files(folder, files)
        if residuals is None:
            (folder / RESIDUALS_FILE).unlink(missing_ok=True)
    except OSError as error:
        raise StationError(f"can't write the fit into '{folder}': {error.strerror}; name another folder") from error


def _residual_files(residuals: Residuals | None) -> dict[str, bytes]:
    if residuals is None:
        return {}
    from station.formats.residuals import write_residuals

    content = io.BytesIO()
    write_residuals(residuals, content)
    return {RESIDUALS_FILE: content.getvalue()}


def read_fit_residuals(folder: str | PathLike[str]) -> Residuals | None:
    """The residuals of a fit on corners; None where the fit was on poses.

    Raises:
        InvalidFile: a StationError: a file that is torn or of another schema.
    """
    path = Path(folder) / RESIDUALS_FILE
    if not path.exists():
        return None
    from station.formats.residuals import read_residuals

    return read_residuals(path)


def read_fit(folder: str | PathLike[str]) -> Fit:
    """Read a fit's tree and joint states back from the folder that they were written to.

    Raises:
        InvalidFile: a StationError: files that are missing, torn, of another schema, or don't belong together.
    """
    folder = Path(folder)
    if not (folder / TREE_FILE).exists():
        raise InvalidFile(
            f"{folder} has no {TREE_FILE}: nothing was fitted there yet\nrun: station fit {_input_of(folder)}"
        )
    tree = read_tree(folder / TREE_FILE)
    path = folder / STATES_FILE
    states = parse_joint_states(read_text(path, "joint states"), str(path), tree.units)
    missing = [column for column in tree.columns if column not in states.joints]
    if missing:
        have = ", ".join(states.joints) or "none"
        raise InvalidFile(f"{path} has no column {missing[0]}, a joint's of the {TREE_FILE} beside it; have {have}")
    return Fit(tree, states)


def _input_of(folder: Path) -> str:
    """What is to be fitted for this folder to have a fit: the session that it is in, if it is in one."""
    session = folder.parent
    if folder.name == FIT_FOLDER and (session / RECORDING_FILE).exists():
        return str(session)
    return f"INPUT --out {folder}"


def read_tree(path: str | PathLike[str]) -> KinematicTree:
    """Read a kinematics.json; raises InvalidFile, a StationError, for what is missing, torn, or no tree."""
    path = Path(path)
    return from_json(read_text(path, "tree"), str(path))
