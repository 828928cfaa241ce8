"""A session folder on disk: session.json, the names of its files, and what may be written where."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from station.errors import InvalidFile, OutputExists

SESSION_SCHEMA = "session/1"
STATES = ("recording", "complete", "interrupted")

RECORDING_FILE = "recording.rrd"
# A session that was gone on with has further pieces until they are joined; this one, while it is there, is all of them.
JOINED_FILE = "recording.joined.rrd"
# While it is made.
JOINING_FILE = "recording.joined.rrd.part"
STATUS_FILE = "session.json"
# The next session.json is written here before it takes the place of the last one.
RESERVE_FILE = "session.json.part"
# Far more than a session.json has.
RESERVE_BYTES = 8192
RIG_FILE = "rig.toml"
MOTION_FILE = "motion.toml"
# A motion that was lengthened, until session.json tells of its first further leg; then it is motion.toml.
NEXT_MOTION_FILE = "motion.toml.next"
# Frames without loss, with their stamps beside them (.csv).
FRAMES_FILE = "frames.mkv"
FRAMES = re.compile(r"frames(?:_(\d+))?\.mkv")
LATER_PIECE = re.compile(r"recording_(\d+)\.rrd")
FIT_FOLDER = "fit"
FIT_FILE = "fit.rrd"
REPORT_FOLDER = "report"


@dataclass(frozen=True)
class SessionDescription:
    """What a session is of: written once at its start, into the recording and beside it.

    Attributes:
        camera: camera.toml's text.
        markers: markers.toml's text.
        joints: J names, in the order of the recorded states; none where nothing is commanded.
        units: J units, "rad" or "m".
        rig, motion: the texts of rig.toml and motion.toml; None where there was none, as with a video.
        started: wall-clock time of the start; the only one that a session has.
        seed: seed of everything random in a simulated session; None on real hardware.
        versions: of the programs that make it.
    """

    camera: str
    markers: str
    joints: tuple[str, ...]
    units: tuple[str, ...]
    rig: str | None
    motion: str | None
    started: datetime
    seed: int | None = None
    versions: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Checkpoint:
    """How far a plan has come: leg number `leg`, counted from 0, of `legs` begins."""

    leg: int
    legs: int


@dataclass(frozen=True)
class SessionStart:
    """A program began to record: the session's first one, or one that went on with it.

    Attributes:
        when: wall-clock time.
        elapsed_s: what the session's clock said then, seconds since the session's start.
    """

    when: datetime
    elapsed_s: float


@dataclass(frozen=True)
class SessionStatus:
    """What session.json says.

    Attributes:
        state: "recording" while it is written (and after a kill), then "complete" or "interrupted".
        recording_id: the same as in the recording and in the fit's sidecar.
        started: wall-clock time of the start.
        ended: wall-clock time of the end; None while it is written.
        seed: seed of everything random in a simulated session; None on real hardware.
        counts: frames, dropped frames, bus errors and what else was counted.
        versions: of the programs that made it.
        progress: the last checkpoint that was reached; None before the first, and where there is no plan.
        starts: of the programs that recorded, the first one included; none in sessions made before 0.2.0.
        motion_sha256: of motion.toml, where the motion was lengthened; else it is as in the recording.
        images: how they are kept: "jpeg", "none" or "ffv1"; None in sessions that don't say.

    Raises:
        InvalidFile: for another state.
    """

    state: str
    recording_id: str
    started: datetime
    ended: datetime | None = None
    seed: int | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    progress: Checkpoint | None = None
    starts: tuple[SessionStart, ...] = ()
    motion_sha256: str | None = None
    images: str | None = None

    def __post_init__(self) -> None:
        if self.state not in STATES:
            raise InvalidFile(f"no session state '{self.state}'; want one of {', '.join(STATES)}")


def check_output_folder(path: Path, *, force: bool = False) -> None:
    """Raise OutputExists unless `path` is new or an empty folder; with `force` a folder may hold anything."""
    if path.exists() and not path.is_dir():
        raise OutputExists(f"{path} is a file; want a folder that is new or empty")
    if path.is_dir() and not force and any(path.iterdir()):
        raise OutputExists(f"{path} exists and isn't empty\nname another folder with --out, or overwrite with --force")


def piece_file(number: int) -> str:
    """Name of the recording's piece; 0 is the first one, which is all of it in most sessions."""
    return f"recording_{number}.rrd" if number else RECORDING_FILE


def recording_pieces(folder: Path) -> list[Path]:
    """The files that together are the session's recording, in order; none where nothing was recorded.

    A long one has several, and one that was gone on with, until they are joined.
    """
    if (joined := folder / JOINED_FILE).exists():
        return [joined]
    first = folder / RECORDING_FILE
    return [path for path in (first, *later_pieces(folder)) if path.exists()]


def frames_file(number: int) -> str:
    """Name of the piece's frames without loss, where they are kept so."""
    return f"frames_{number}.mkv" if number else FRAMES_FILE


def lossless_files(folder: Path) -> list[Path]:
    """The session's frames without loss, in order; none where they are kept otherwise."""
    return [folder / frames_file(number) for number in _frames_numbers(folder)]


def _frames_numbers(folder: Path) -> list[int]:
    matches = (FRAMES.fullmatch(path.name) for path in folder.glob("frames*.mkv"))
    return sorted(int(match[1] or 0) for match in matches if match)


def next_piece(folder: Path) -> int:
    """Number of the piece to go on in: one more than the last one that is there."""
    numbers = _piece_numbers(folder) + _frames_numbers(folder)
    return max(numbers, default=0) + 1


def later_pieces(folder: Path) -> list[Path]:
    """The files after the first one, in order."""
    return [folder / piece_file(number) for number in _piece_numbers(folder)]


def _piece_numbers(folder: Path) -> list[int]:
    """Of the pieces after the first one, in order."""
    matches = (LATER_PIECE.fullmatch(path.name) for path in folder.glob("recording_*.rrd"))
    return sorted(int(match[1]) for match in matches if match)


def clear_session(folder: Path) -> None:
    """Remove an earlier session's files, fit and report, so that nothing of it passes for the next one's."""
    names = (
        RECORDING_FILE,
        JOINED_FILE,
        JOINING_FILE,
        STATUS_FILE,
        RESERVE_FILE,
        RIG_FILE,
        MOTION_FILE,
        NEXT_MOTION_FILE,
    )
    videos = lossless_files(folder)
    stamps = [video.with_suffix(".csv") for video in videos]
    for path in (*(folder / name for name in names), *later_pieces(folder), *videos, *stamps):
        path.unlink(missing_ok=True)
    for name in (FIT_FOLDER, REPORT_FOLDER):
        shutil.rmtree(folder / name, ignore_errors=True)


def write_status(folder: Path, status: SessionStatus) -> None:
    """Write session.json in one step: a reader finds the old one or the new one, never half of it."""
    document = {"schema": SESSION_SCHEMA, **asdict(status)}
    document["started"] = _text(status.started)
    document["ended"] = None if status.ended is None else _text(status.ended)
    document["starts"] = [{"when": _text(start.when), "elapsed_s": start.elapsed_s} for start in status.starts]
    content = (json.dumps(document, indent=2, allow_nan=False) + "\n").encode()
    part = folder / RESERVE_FILE
    # Over what was reserved, if it was: a full disk has no room for anything new.
    with part.open("r+b" if part.exists() else "wb") as file:
        file.write(content)
        file.truncate()
        file.flush()
        os.fsync(file.fileno())
    part.replace(folder / STATUS_FILE)


def motion_sha256(text: str) -> str:
    """By which session.json knows its motion.toml."""
    return hashlib.sha256(text.encode()).hexdigest()


def stage_motion(folder: Path, text: str) -> None:
    """Have the next motion.toml on the disk, beside the one that holds still."""
    with (folder / NEXT_MOTION_FILE).open("w", encoding="utf-8", newline="\n") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def take_staged_motion(folder: Path) -> None:
    """Have the next motion.toml take the place of the last one, if there is one."""
    with suppress(FileNotFoundError):
        (folder / NEXT_MOTION_FILE).replace(folder / MOTION_FILE)


def reserve_status(folder: Path) -> None:
    """Reserve room for the next session.json, so that it can be written on a full disk too; where there is room."""
    part = folder / RESERVE_FILE
    with suppress(OSError), part.open("wb") as file:
        file.write(b" " * RESERVE_BYTES)
        file.flush()
        os.fsync(file.fileno())


def drop_reserve(folder: Path) -> None:
    """Give the room back."""
    with suppress(OSError):
        (folder / RESERVE_FILE).unlink(missing_ok=True)


def read_status(folder: Path) -> SessionStatus:
    """What the folder's session.json says; raises InvalidFile where it is missing, torn or of another schema."""
    path = folder / STATUS_FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InvalidFile(f"{path} is missing; a session folder has one") from error
    except (OSError, ValueError) as error:
        raise InvalidFile(f"{path} is no JSON: {error}") from error
    have = document.pop("schema", None) if isinstance(document, dict) else None
    if have != SESSION_SCHEMA:
        raise InvalidFile(f"{path} has schema {have!r}; this station reads '{SESSION_SCHEMA}'")
    try:
        return _to_status(document)
    except (TypeError, ValueError, KeyError) as error:
        raise InvalidFile(f"{path}: {error}") from error


def _text(when: datetime) -> str:
    return when.astimezone(UTC).isoformat(timespec="milliseconds")


def _to_status(document: dict[str, Any]) -> SessionStatus:
    started, ended = document.pop("started"), document.pop("ended")
    progress, starts = document.pop("progress", None), document.pop("starts", ())
    return SessionStatus(
        started=datetime.fromisoformat(started),
        ended=None if ended is None else datetime.fromisoformat(ended),
        progress=None if progress is None else Checkpoint(**progress),
        starts=tuple(SessionStart(datetime.fromisoformat(s["when"]), s["elapsed_s"]) for s in starts),
        **document,
    )
