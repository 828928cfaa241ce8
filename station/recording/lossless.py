"""A session's frames without loss: FFV1 in Matroska, and their stamps to the nanosecond in a table beside it.

Matroska's own stamps are milliseconds here; `frames.csv` (`frame,t_s`) has them whole, as `station track --timestamps`
takes them. A kill leaves both readable up to the frame before the last one written. A session that was gone on with
has further pairs, `frames_1.mkv` and `frames_1.csv`.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidFile, StationError
from station.formats.timestamps import parse_timestamps
from station.recording.rrd_stream import written

KINDS = ("jpeg", "none", "ffv1")
NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
# As it keeps all of a BGR image (the fourth byte stays empty); checked by tests.
PIXELS, IMAGE = "bgr0", "bgr24"
# Of FFV1: version 3, which has check sums and slices; each frame by itself, so that any can be read alone.
OPTIONS = {"level": "3", "slicecrc": "1", "slices": "4"}
# Each packet is handed to the operating system as it comes.
CONTAINER_OPTIONS = {"flush_packets": "1", "cluster_time_limit": "100"}


def check_kind(frames: str) -> None:
    """Raise StationError unless frames can be kept so: "jpeg", "none", or "ffv1", which needs the extra `lossless`."""
    if frames not in KINDS:
        raise StationError(f"frames = '{frames}'; want one of {', '.join(KINDS)}")
    if frames == "ffv1" and importlib.util.find_spec("av") is None:
        raise StationError(
            "frames without loss need PyAV, which isn't installed\npip install 'capture-fit-station[lossless]'"
        )


class LosslessFrames:
    """Writes the frames of one piece of a session.

    Args:
        video: where to; the stamps go beside it, as .csv.

    Raises:
        StationError: a file can't be written.
    """

    def __init__(self, video: Path) -> None:
        self._path = video
        self._container: Any = None
        self._stream: Any = None
        self._frames, self._first_ms, self._last_ms = 0, 0, -1
        with written(video):
            self._stamps = video.with_suffix(".csv").open("w", encoding="ascii")
            self._stamps.write("frame,t_s\n")

    def write(self, elapsed_ns: int, image: NDArray[np.uint8]) -> None:
        """Write a frame (H, W, 3) BGR or (H, W) grey, at nanoseconds since the session's start."""
        import av

        if image.ndim == 2:
            image = np.repeat(image[..., None], 3, axis=2)
        with written(self._path):
            if self._stream is None:
                self._begin(image.shape[1], image.shape[0])
                self._first_ms = elapsed_ns // NS_PER_MS
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=IMAGE).reformat(format=PIXELS)
            self._last_ms = max(self._last_ms + 1, elapsed_ns // NS_PER_MS - self._first_ms)
            frame.pts, frame.time_base = self._last_ms, Fraction(1, 1000)
            self._put(frame)
            self._stamps.write(f"{self._frames},{Decimal(elapsed_ns) / NS_PER_S:.9f}\n")
            self._stamps.flush()
        self._frames += 1

    def close(self) -> None:
        """Finish the files."""
        with written(self._path):
            if self._stream is not None:
                self._put(None)
                self._container.close()
            self._stamps.close()

    def _begin(self, width: int, height: int) -> None:
        import av

        self._container = av.open(str(self._path), "w", format="matroska", options=CONTAINER_OPTIONS)
        stream: Any = self._container.add_stream("ffv1", options=OPTIONS)
        stream.width, stream.height, stream.pix_fmt = width, height, PIXELS
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        stream.codec_context.gop_size = 1
        self._stream = stream

    def _put(self, frame: Any) -> None:
        for packet in self._stream.encode(frame):
            self._container.mux(packet)


def lossless_images(videos: Sequence[Path]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Each frame of these files that is whole, in order: nanoseconds since the session's start, and (H, W, 3) BGR."""
    import av
    from av.error import FFmpegError

    for video in videos:
        stamps = _stamps(video.with_suffix(".csv"))
        try:
            with av.open(str(video)) as container:
                for k, frame in enumerate(container.decode(video=0)):
                    if k in stamps:
                        yield stamps[k], np.asarray(frame.to_ndarray(format=IMAGE), np.uint8)
        except FFmpegError:
            continue  # its torn end; or nothing but its beginning


def find_lossless(videos: Sequence[Path], elapsed_ns: int) -> NDArray[np.uint8] | None:
    """The frame at this time since the session's start; None where there is none."""
    return next((image for t_ns, image in lossless_images(videos) if t_ns == elapsed_ns), None)


def _stamps(path: Path) -> Mapping[int, int]:
    """Each frame's stamp in ns, without the row that a kill cut."""
    try:
        text = path.read_text(encoding="ascii")
    except (OSError, ValueError) as error:
        raise InvalidFile(f"{path} can't be read: {error}") from error
    rows = text[: text.rfind("\n") + 1]
    return parse_timestamps(rows, path.name) if rows.count("\n") > 1 else {}
