"""`station export` as a function: what a session, a recording, a fit, a log of poses or a camera has, in other formats.

Takes paths and options, returns what was written, and raises StationError; printing is left to the caller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from station.commands.fitting import is_session, load_session
from station.errors import InvalidData, InvalidFile, OutputExists, StationError
from station.fit_files import TREE_FILE, read_fit, read_tree
from station.formats.camera import parse_camera
from station.formats.camera_files import read_camera
from station.formats.exporters import Exportable, Write, exporter_named, exporter_of_file, files_of
from station.formats.read import read_pose_log
from station.formats.text import read_text
from station.formats.urdf import from_urdf
from station.session import FIT_FOLDER, check_output_folder

if TYPE_CHECKING:
    from station.recording import Recording

CAMERA_ENDINGS = (".toml", ".yaml", ".yml", ".xml")


def export(
    source: str | PathLike[str],
    out: str | PathLike[str],
    *,
    what: Sequence[str] = (),
    format: str | None = None,
    force: bool = False,
) -> tuple[Path, ...]:
    """Write what `source` has in another format; returns the files.

    Args:
        source: a session folder or recording.rrd (with its fit, if there is one), a fit's folder or kinematics.json, a
            URDF, a log of poses in any format that is read, a calibration.
        out: a file, whose ending tells the format; or, without an ending, a folder, new or empty.
        what: of poses, states, commands, readings, tree, observations, camera, images; if none, all that there is and
            that the format can hold; where that is one file alone, the first of these.
        format: csv, tum, parquet, urdf, json, mcap, toml, opencv, ros; for a file its ending tells, if none.
        force: overwrite what is there.

    Raises:
        StationError: an input that can't be read or hasn't what is asked for, a format that can't hold it or needs a
            package that isn't there, a place that is occupied.
    """
    source, out = Path(source), Path(out)
    into_folder = out.is_dir() or not out.suffix
    if format is None and into_folder:
        raise InvalidData(f"'{out}' is a folder: say with --format what to write there, or name a file with its ending")
    exporter = exporter_of_file(out.name) if format is None else exporter_named(format)
    if into_folder:
        check_output_folder(out, force=force)
    elif out.exists() and not force:
        raise OutputExists(f"{out} exists\nname another file with --out, or overwrite with --force")
    found = files_of(read_exportable(source), exporter, what, several=into_folder)
    if into_folder:
        return _write_all(out, found)
    if len(found) > 1:
        raise InvalidData(
            f"{source} makes {len(found)} files of this kind: {', '.join(found):.200}\n"
            f"name a folder: --out {out.with_suffix('')} --format {exporter.format}"
        )
    (write,) = found.values()
    return _write_all(out.parent, {out.name: write})


def read_exportable(path: str | PathLike[str]) -> Exportable:
    """All that an input has to export; raises StationError for what can't be read."""
    path = Path(path)
    if not path.exists():
        raise InvalidFile(f"no input '{path}'; want a session, a recording, a fit, a log of poses or a calibration")
    if is_session(path):
        return _of_session(path)
    if path.is_dir() and (path / TREE_FILE).is_file():
        return _of_fit(path)
    ending = path.suffix.lower()
    if ending == ".json":
        return Exportable(tree=read_tree(path))
    if ending == ".urdf":
        return Exportable(tree=from_urdf(read_text(path, "URDF"), str(path)))
    if ending in CAMERA_ENDINGS and path.is_file():
        return Exportable(camera=read_camera(path))
    return Exportable(poses=read_pose_log(path))


def _of_fit(folder: Path) -> Exportable:
    fit = read_fit(folder)
    return Exportable(tree=fit.tree, states=fit.states)


def _of_session(path: Path) -> Exportable:
    session = load_session(path, most_markers=None)
    recording = session.recording
    fit = path / FIT_FOLDER if path.is_dir() else path.parent / FIT_FOLDER
    fitted = _of_fit(fit) if (fit / TREE_FILE).is_file() else Exportable()
    has_commands = bool(recording.description.joints)
    return replace(
        fitted,
        poses=session.poses,
        observations=recording.observations,
        camera=parse_camera(recording.description.camera, f"{path}: camera"),
        commands=recording.commanded if has_commands else None,
        readings=recording.measured if has_commands else None,
        images=recording.frame_jpegs if _has_images(recording) else None,
    )


def _has_images(recording: Recording) -> bool:
    return next(recording.frame_jpegs(), None) is not None


def _write_all(folder: Path, files: Mapping[str, Write]) -> tuple[Path, ...]:
    """Write files by name, all of them first under temporary names; a failure leaves what was there before."""
    made: dict[str, Path] = {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, write in files.items():
            made[name] = folder / f".{name}.part"
            with made[name].open("wb") as file:
                write(file)
        for name, part in made.items():
            part.replace(folder / name)
    except OSError as error:
        raise StationError(f"can't write into '{folder}': {error.strerror or error}") from error
    finally:
        for part in made.values():
            part.unlink(missing_ok=True)
    return tuple(folder / name for name in files)
