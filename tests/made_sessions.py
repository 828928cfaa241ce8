"""Small sessions for the tests of recording and viewer: made of random numbers, so that each value is its own."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from station.perception.observations import FrameMarkers
from station.recording import RecordingWriter
from station.session import SessionDescription

JOINTS = ("base_pan", "shoulder", "elbow")
START_NS = 7_000_000_123
FRAME_NS = 33_333_333

CAMERA = """schema = "camera/1"
size_px = [64, 48]
matrix = [[60.0, 0.0, 31.5], [0.0, 60.0, 23.5], [0.0, 0.0, 1.0]]
distortion = [0.1, -0.2, 0.001, 0.002, 0.0]
"""
MARKERS = 'schema = "markers/1"\ndictionary = "DICT_4X4_50"\n' + "".join(
    f'\n[[marker]]\nid = {n}\npart = "{part}"\nsize_mm = 50.8\n' for n, part in enumerate(("base", "link1", "link2"))
)


def describe(**changes: object) -> SessionDescription:
    """A description with three joints, three markers and odd characters in its texts."""
    values: dict[str, object] = {
        "camera": CAMERA,
        "markers": MARKERS,
        "joints": JOINTS,
        "units": ("rad", "rad", "m"),
        "rig": 'schema = "rig/1"\nname = "Prüfstand \\"7\\""\n',
        "motion": 'schema = "motion/1"\n\n',
        "started": datetime(2024, 5, 6, 7, 8, 9, 123000, tzinfo=UTC),
        "seed": 11,
        "versions": {"station": "0.1.0", "numpy": np.__version__},
    }
    return SessionDescription(**{**values, **changes})  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True, eq=False)
class MadeFrame:
    """What is logged for one frame, with the command and the reading just before it."""

    index: int
    t_ns: int
    image: NDArray[np.uint8]
    markers: FrameMarkers
    command: NDArray[np.float64]
    reading: NDArray[np.float64]
    request_ns: int
    reply_ns: int


def make_frames(count: int, *, seed: int = 0) -> list[MadeFrame]:
    """Frames with 0 to 3 markers in front of the camera; every fourth has none, and some have one solution only."""
    rng = np.random.default_rng(seed)
    return [_make_frame(k, 0 if k % 4 == 3 else 1 + k % 3, rng) for k in range(count)]


def _make_frame(k: int, markers: int, rng: np.random.Generator) -> MadeFrame:
    t_ns = START_NS + (k + 1) * FRAME_NS + int(rng.integers(1000))
    T = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (markers, 2, 1, 1))
    T[:, :, :3, 3] = rng.normal(size=(markers, 2, 3)) * 0.1 + (0, 0, 0.6)
    rms = rng.random((markers, 2))
    if k % 2:
        T[:, 1], rms[:, 1] = np.nan, np.nan
    request_ns = t_ns - 5_000_001
    return MadeFrame(
        index=2 * k,  # each second frame was dropped
        t_ns=t_ns,
        image=rng.integers(0, 255, (48, 64, 3), dtype=np.uint8),
        markers=FrameMarkers(
            marker_id=rng.permutation(3)[:markers].astype(np.int64),
            corners_px=rng.normal(size=(markers, 4, 2)) * 10 + 30,
            corner_covariance_px2=rng.random((markers, 4, 2, 2)),
            T_cam_marker=T,
            rms_px=rms,
        ),
        command=rng.normal(size=len(JOINTS)),
        reading=rng.normal(size=len(JOINTS)),
        request_ns=request_ns,
        reply_ns=request_ns + int(rng.integers(1, 10**6)),
    )


def log_frame(writer: RecordingWriter, frame: MadeFrame) -> None:
    """Log a frame with its command, its reading and an event."""
    writer.log_command(frame.request_ns - 1, frame.command)
    writer.log_reading(frame.request_ns, frame.reply_ns, frame.reading)
    log_image(writer, frame)
    writer.log_event(frame.t_ns, "INFO", f"frame {frame.index}")


def log_image(writer: RecordingWriter, frame: MadeFrame) -> None:
    """Log a frame alone."""
    writer.log_frame(frame.index, frame.t_ns, frame.image, frame.markers)


def make_session(folder: Path, frames: list[MadeFrame]) -> Path:
    """A complete session of these frames."""
    with RecordingWriter(folder, describe(), start_ns=START_NS) as writer:
        for frame in frames:
            log_frame(writer, frame)
        writer.close("complete", {"dropped_frames": len(frames)})
    return folder
