"""What can be exported, and into which format: the one place to add an exporter is `EXPORTERS`, at the end.

An exporter writes some of what an input has, each kind (`WHAT`) into files of its own or all of it into one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import BinaryIO, TypeVar

from calibration.intrinsics import CameraModel
from station.errors import InvalidData
from station.formats import parquet
from station.formats.camera import format_camera
from station.formats.camera_files import format_camera_opencv, format_camera_ros
from station.formats.joint_csv import format_joint_states
from station.formats.mcap_log import Images, McapLog
from station.formats.observations_csv import format_observations_csv
from station.formats.poses_csv import format_poses_csv
from station.formats.tum import format_tum
from station.formats.urdf import to_urdf
from station.kinematics.tree import KinematicTree
from station.kinematics.tree_json import to_json
from station.logs import JointLog, PoseLog
from station.perception.observations import ObservationLog

# In this order, what an input has is looked for where nobody says what is wanted.
WHAT = ("poses", "states", "commands", "readings", "tree", "observations", "camera", "images")

Write = Callable[[BinaryIO], object]
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Exportable:
    """What an input has, by the names in `WHAT`; None where it hasn't.

    Attributes:
        poses: of the parts.
        states: what a fit detected of the joints.
        commands, readings: of a session with an arm.
        tree: a fit's.
        observations: a session's corners.
        camera: its calibration.
        images: gives a session's frames, one after another.
    """

    poses: PoseLog | None = None
    states: JointLog | None = None
    commands: JointLog | None = None
    readings: JointLog | None = None
    tree: KinematicTree | None = None
    observations: ObservationLog | None = None
    camera: CameraModel | None = None
    images: Callable[[], Images] | None = None

    @property
    def there(self) -> tuple[str, ...]:
        """What it has."""
        return tuple(what for what in WHAT if getattr(self, what) is not None)


@dataclass(frozen=True)
class Exporter:
    """One format.

    Attributes:
        format: its name, for `--format`.
        endings: of file names that mean it; the first is the usual one.
        what: the kinds that it can write, of `WHAT`.
        files: by name, what writes each file of the kinds that are asked for, which the input has.
    """

    format: str
    endings: tuple[str, ...]
    what: tuple[str, ...]
    files: Callable[[Exportable, Sequence[str]], Mapping[str, Write]]


def exporter_named(name: str) -> Exporter:
    """The exporter of a format; raises InvalidData, with the names that there are."""
    for exporter in EXPORTERS:
        if exporter.format == name:
            return exporter
    raise InvalidData(f"no format '{name}'; choose one of {', '.join(exporter.format for exporter in EXPORTERS)}")


def exporter_of_file(name: str) -> Exporter:
    """The exporter that a file's ending means; raises InvalidData where none does, or several do."""
    ending = PurePath(name).suffix.lower()
    fitting = [exporter for exporter in EXPORTERS if ending in exporter.endings]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        choices = " or ".join(f"--format {exporter.format}" for exporter in fitting)
        raise InvalidData(f"'{name}' may be one of several formats: say which with {choices}")
    known = ", ".join(ending for exporter in EXPORTERS for ending in exporter.endings[:1])
    raise InvalidData(f"'{name}' ends in no known format's way ({known})\nsay which is wanted with --format")


def files_of(source: Exportable, exporter: Exporter, what: Sequence[str], *, several: bool) -> Mapping[str, Write]:
    """What writes each of the files, by name.

    Args:
        source: what there is.
        exporter: the format.
        what: kinds that are asked for; if none, all that the format can write and the source has, or where only one
            file is wanted and the format can't put all of it into one, the first of them.
        several: whether more than one file is wanted.

    Raises:
        InvalidData: the source hasn't what is asked for, or the format can't write it.
    """
    for name in what:
        if name not in WHAT:
            raise InvalidData(f"nothing is called '{name}'; choose of {', '.join(WHAT)}")
        if name not in exporter.what:
            raise InvalidData(f"{exporter.format} can't hold {name}; it holds {', '.join(exporter.what)}")
        if name not in source.there:
            raise InvalidData(f"the input has no {name}; it has {', '.join(source.there) or 'nothing'}")
    possible = tuple(name for name in source.there if name in exporter.what)
    if not possible:
        have = ", ".join(source.there) or "nothing"
        raise InvalidData(f"{exporter.format} holds {', '.join(exporter.what)}; the input has {have}")
    files = exporter.files(source, what or possible)
    if what or several or len(files) == 1:
        return files
    return exporter.files(source, possible[:1])


def _texts(
    name: str, endings: tuple[str, ...], texts: Mapping[str, tuple[str, Callable[[Exportable], str]]]
) -> Exporter:
    """A format with one text file for each kind: by kind, the file's name and what makes its text."""

    def files(source: Exportable, what: Sequence[str]) -> Mapping[str, Write]:
        return {texts[kind][0]: _text(texts[kind][1](source)) for kind in what}

    return Exporter(name, endings, tuple(texts), files)


def _text(text: str) -> Write:
    return lambda file: file.write(text.encode())


def _tum_files(source: Exportable, what: Sequence[str]) -> Mapping[str, Write]:
    poses = _there(source.poses)
    return {f"{part}.tum": _text(format_tum(poses, part)) for part in poses.parts}


def _parquet_files(source: Exportable, what: Sequence[str]) -> Mapping[str, Write]:
    writers: dict[str, Write] = {
        "poses": lambda file: parquet.write_poses(_there(source.poses), file),
        "states": lambda file: parquet.write_states(_there(source.states), file),
        "commands": lambda file: parquet.write_states(_there(source.commands), file),
        "readings": lambda file: parquet.write_states(_there(source.readings), file),
        "observations": lambda file: parquet.write_observations(_there(source.observations), file),
    }
    names = {"states": "joint_states"}
    return {f"{names.get(kind, kind)}.parquet": writers[kind] for kind in what}


def _mcap_files(source: Exportable, what: Sequence[str]) -> Mapping[str, Write]:
    def write(file: BinaryIO) -> None:
        with McapLog(file) as log:
            if "poses" in what:
                log.add_poses(_there(source.poses))
            for kind, topic in (("states", "detected"), ("commands", "commanded"), ("readings", "measured")):
                if kind in what:
                    log.add_states(_there(getattr(source, kind)), f"/joints/{topic}")
            if "camera" in what:
                log.add_camera(_there(source.camera), _first_s(source))
            if "tree" in what:
                log.attach_tree(_there(source.tree))
            if "images" in what:
                log.add_images(_there(source.images)())

    return {"session.mcap": write}


def _first_s(source: Exportable) -> float:
    """When the first of the poses or frames was; 0 where there are none."""
    logs = [log for log in (source.poses, source.observations) if log is not None and len(log.t_s)]
    return float(logs[0].t_s[0]) if logs else 0.0


def _there(value: T | None) -> T:
    if value is None:
        raise InvalidData("the input hasn't what is to be written")
    return value


CSV = _texts(
    "csv",
    (".csv",),
    {
        "poses": ("poses.csv", lambda source: format_poses_csv(_there(source.poses))),
        "states": ("joint_states.csv", lambda source: format_joint_states(_there(source.states))),
        "commands": ("commands.csv", lambda source: format_joint_states(_there(source.commands))),
        "readings": ("readings.csv", lambda source: format_joint_states(_there(source.readings))),
        "observations": ("observations.csv", lambda source: format_observations_csv(_there(source.observations))),
    },
)
EXPORTERS: tuple[Exporter, ...] = (
    CSV,
    Exporter("tum", (".tum", ".txt"), ("poses",), _tum_files),
    Exporter("parquet", (".parquet",), ("poses", "states", "commands", "readings", "observations"), _parquet_files),
    _texts("urdf", (".urdf",), {"tree": ("kinematics.urdf", lambda source: to_urdf(_there(source.tree), "fitted"))}),
    _texts("json", (".json",), {"tree": ("kinematics.json", lambda source: to_json(_there(source.tree)))}),
    Exporter("mcap", (".mcap",), ("poses", "states", "commands", "readings", "tree", "camera", "images"), _mcap_files),
    _texts("toml", (".toml",), {"camera": ("camera.toml", lambda source: format_camera(_there(source.camera)))}),
    _texts(
        "opencv",
        (".yaml", ".yml"),
        {"camera": ("camera.yaml", lambda source: format_camera_opencv(_there(source.camera)))},
    ),
    _texts(
        "ros",
        (".yaml", ".yml"),
        {"camera": ("camera_info.yaml", lambda source: format_camera_ros(_there(source.camera)))},
    ),
)
