"""What the command line does with files of others, as functions: track a video; export what was recorded or fitted.

Each takes paths and options, returns values, and raises StationError; printing is left to the caller.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from calibration.intrinsics import CameraModel
from station.commands.capturing import versions
from station.errors import InvalidFile
from station.formats.camera import format_camera
from station.formats.camera_files import read_camera
from station.formats.markers import format_markers, parse_markers
from station.formats.rig import RIG_SCHEMA, load_calibration
from station.formats.text import read_text
from station.perception.markers import MarkerTable
from station.rig_reading import packaged, read_rig
from station.session import SessionDescription, check_output_folder

if TYPE_CHECKING:
    from station.recording import RecordingWriter
    from station.videos.frames import Video
    from station.videos.tally import MarkerRow
    from station.videos.tracker import Progress


@dataclass(frozen=True)
class Tracked:
    """What a video showed.

    Attributes:
        folder: the session's.
        counts: of frames and of frames without a stamp, as in session.json.
        markers: a row a marker of the table.
        warnings: sentences.
    """

    folder: Path
    counts: Mapping[str, int]
    markers: tuple[MarkerRow, ...]
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        """The result as JSON."""
        return {
            "session": str(self.folder),
            **self.counts,
            "markers": [row.as_dict() for row in self.markers],
            "warnings": list(self.warnings),
        }


def track(
    video: str | PathLike[str],
    *,
    camera: str | PathLike[str],
    markers: str | PathLike[str],
    out: str | PathLike[str],
    timestamps: str | PathLike[str] | None = None,
    fps: float | None = None,
    scale_camera: bool = False,
    keep_frames: bool = True,
    force: bool = False,
    progress: Progress | None = None,
) -> Tracked:
    """Find the markers in a video and make a session of it, which fit, view, report and compare take.

    Args:
        video: a video file, or a folder of images.
        camera: camera.toml, a calibration of OpenCV or ROS, or a rig, whose calibration is taken.
        markers: markers.toml, or a rig, whose table is taken.
        out: folder of the session, new or empty.
        timestamps: a file `frame,t_s` (frames count from 0) in place of the video's own stamps, kept as given. Frames
            that it doesn't list are left out.
        fps: frames a second of images, which have no stamps.
        scale_camera: scale a calibration of the same shape to the video's size.
        keep_frames: keep the images in the recording, as JPEG.
        force: overwrite an earlier session in `out`.
        progress: called with frames done and in all.

    Raises:
        StationError: files that can't be read, another size than the calibration's, no marker of the table in any
            frame (then there is no session); a video that is damaged at some frame (those before it are in the
            session, which is then "interrupted").
    """
    from station.videos.frames import camera_for, open_video
    from station.videos.tracker import check_first_sight

    out = Path(out)
    table, model = read_marker_table(markers), read_camera_of(camera)
    check_output_folder(out, force=force)
    opened = open_video(str(video), timestamps=None if timestamps is None else Path(timestamps), fps=fps)
    model = camera_for(opened, model, scale=scale_camera)
    check_first_sight(opened, table)
    return _record(opened, table, model, out, keep_frames=keep_frames, force=force, progress=progress)


def _record(
    video: Video,
    table: MarkerTable,
    camera: CameraModel,
    out: Path,
    *,
    keep_frames: bool,
    force: bool,
    progress: Progress | None,
) -> Tracked:
    from station.recording import RecordingWriter
    from station.videos.tracker import track_video
    from station.view import session_blueprint

    description = SessionDescription(
        camera=format_camera(camera),
        markers=format_markers(table),
        joints=(),
        units=(),
        rig=None,
        motion=None,
        started=datetime.now(UTC),
        versions=versions(),
    )
    # The session's clock is that of the stamps, from zero: so they are kept as given.
    with RecordingWriter(out, description, start_ns=0, blueprint=session_blueprint(()), force=force) as writer:
        try:
            tally = track_video(video, table, camera, writer, keep_frames=keep_frames, progress=progress)
        except InvalidFile as error:
            writer.log_event(0, "ERROR", str(error))
            raise InvalidFile(f"{error}\nthe frames before that are in {out}: station fit {out}") from error
        warnings = (*_warnings_of_stamps(video), *tally.warnings())
        _log_warnings(writer, tally.last_ns, warnings)
        counts = {"frames": video.frames_seen - video.left_out, "dropped_frames": video.left_out}
        writer.close("complete", counts)
    return Tracked(out, counts, tally.rows(), warnings)


def _log_warnings(writer: RecordingWriter, t_ns: int, warnings: tuple[str, ...]) -> None:
    for warning in warnings:
        writer.log_event(t_ns, "WARN", warning)


def _warnings_of_stamps(video: Video) -> tuple[str, ...]:
    said: list[str] = []
    if video.left_out:
        said.append(f"{video.left_out} of {video.frames_seen} frames have no time stamp and were left out")
    if beyond := video.stamps_without_frame():
        said.append(
            f"{beyond} time stamps are of frames that the video doesn't have: it has {video.frames_seen}, "
            "counted from 0; is it cut short, or do the stamps count from 1?"
        )
    return tuple(said)


def read_marker_table(path: str | PathLike[str]) -> MarkerTable:
    """The table in a markers.toml, or that of a rig (a file, or a packaged one's name); raises InvalidFile."""
    file = packaged("rigs", str(path))
    text = read_text(file, "table of markers")
    return read_rig(str(path))[0].marker_table() if _is_rig(text) else parse_markers(text, str(path))


def read_camera_of(path: str | PathLike[str]) -> CameraModel:
    """The camera in a calibration file of any kind, or that of a rig (a file, or a packaged one's name).

    Raises:
        InvalidFile: as `read_camera`; a rig without a calibration.
    """
    file = packaged("rigs", str(path))
    if file.suffix.lower() != ".toml" or not _is_rig(read_text(file, "calibration")):
        return read_camera(file)
    rig, _, file = read_rig(str(path))
    return load_calibration(rig, file.parent, str(file))


def _is_rig(text: str) -> bool:
    """Whether TOML text says that it is a rig; what is no TOML is none, and another reader says why."""
    try:
        return tomllib.loads(text).get("schema") == RIG_SCHEMA
    except tomllib.TOMLDecodeError:
        return False
