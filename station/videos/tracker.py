"""A video into a session's recording, frame by frame: markers, both poses of each, the image; and a tally of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel
from drivers.camera import Frame
from drivers.errors import CameraError
from station.errors import InvalidFile
from station.perception.corners import MarkerDetector
from station.perception.dictionary_search import find_dictionary
from station.perception.jpeg import encode_jpeg
from station.perception.marker_tracker import MarkerTracker
from station.perception.markers import MarkerTable, load_dictionary
from station.perception.sharpness import edge_widths_px
from station.tracking import observe
from station.videos.frames import Video
from station.videos.tally import MarkerTally

if TYPE_CHECKING:
    from station.recording import RecordingWriter

Image = NDArray[np.uint8]
# Done and all frames; 0 for all where nobody knows.
Progress = Callable[[float, float], None]

NS_PER_S = 1e9
BORDER_CELLS = 1
# Frames, spread over a video, in which another dictionary is looked for.
TRIED_FRAMES = 8
# JPEGs that are made while the next frames are looked at.
PENDING = 4
SHOWN_IDS = 12


def check_first_sight(video: Video, table: MarkerTable) -> None:
    """Return at the first frame that shows a marker of the table.

    Raises:
        InvalidFile: no frame does; says what the frames show instead: other markers of the dictionary, or of another.
    """
    detector, sample = MarkerDetector(table.dictionary), _Sample()
    others: set[int] = set()
    damage = ""
    try:
        for frame in video:
            ids = detector.detect(frame.image).ids
            if np.any(table.rows(ids) >= 0):
                return
            others.update(ids.tolist())
            sample.add(frame.image)
    except CameraError as error:
        damage = f"\n{error}"
    raise InvalidFile(f"{video.name}: {_what_is_there(video, table, others, sample.images)}{damage}")


def track_video(
    video: Video,
    table: MarkerTable,
    camera: CameraModel,
    writer: RecordingWriter,
    *,
    keep_frames: bool = True,
    progress: Progress | None = None,
) -> MarkerTally:
    """Record all frames and the markers in them; the writer is left open.

    Raises:
        InvalidFile: the video is damaged or changes its size at some frame; those before it are recorded.
        StationError: the recording can't be written.
    """
    tally, total = MarkerTally(table), float(video.count or 0)
    cells = int(load_dictionary(table.dictionary).markerSize) + 2 * BORDER_CELLS
    detector = MarkerTracker(table.dictionary, camera, [marker.id for marker in table.markers])
    try:
        with closing(_with_jpeg(video, keep_frames)) as frames:
            for frame, jpeg in frames:
                found = detector.detect(frame.image)
                markers = observe(found, table, camera)
                strangers = found.ids[table.rows(found.ids) < 0].tolist()
                width_px = edge_widths_px(frame.image, found.corners_px, cells)
                tally.add(frame.t_ns / NS_PER_S, markers, strangers, width_px)
                writer.log_frame(frame.index, frame.t_ns, jpeg() if jpeg else None, markers)
                if progress is not None:
                    progress(float(frame.index + 1), max(total, float(frame.index + 1)))
    except CameraError as error:
        raise InvalidFile(str(error)) from error
    return tally


def _with_jpeg(video: Video, wanted: bool) -> Generator[tuple[Frame, Callable[[], bytes] | None]]:
    """Each frame and its JPEG, which another thread makes some frames ahead: that is a third of all the work."""
    if not wanted:
        for frame in video:
            yield frame, None
        return
    pending: deque[tuple[Frame, Future[bytes]]] = deque()
    damage: CameraError | None = None
    frames = iter(video)
    with ThreadPoolExecutor(1, thread_name_prefix="jpeg") as pool:
        while True:
            while damage is None and len(pending) < PENDING:
                try:
                    frame = next(frames)
                except StopIteration:
                    break
                except CameraError as error:  # told when the frames before it are through
                    damage = error
                    break
                pending.append((frame, pool.submit(encode_jpeg, frame.image)))
            if not pending:
                break
            frame, made = pending.popleft()
            yield frame, made.result
    if damage is not None:
        raise damage


class _Sample:
    """Some of the images that are added, evenly spread however many there are."""

    def __init__(self) -> None:
        self.images: list[Image] = []
        self._every = 1
        self._added = 0

    def add(self, image: Image) -> None:
        """Keep the image if its turn has come."""
        if self._added % self._every == 0:
            self.images.append(image)
            if len(self.images) == 2 * TRIED_FRAMES:
                self.images = self.images[::2]
                self._every *= 2
        self._added += 1


def _what_is_there(video: Video, table: MarkerTable, others: set[int], sample: list[Image]) -> str:
    if not sample:
        return (
            f"none of its {video.frames_seen} frames has a time stamp\n"
            "give their rate with --fps, or the time of each with --timestamps (frame,t_s; frames count from 0)"
        )
    wanted = _ids(sorted(marker.id for marker in table.markers))
    if others:
        return (
            f"no frame shows a marker of the table\nit has {wanted} of {table.dictionary}; "
            f"the video shows {_ids(sorted(others))} of it: correct the table"
        )
    found = find_dictionary(sample)
    if found is None:
        return (
            f"no markers in {video.frames_seen} frames, neither of {table.dictionary} nor of any other dictionary\n"
            "are they sharp, whole, with a white margin around the black square, and 20 px or more wide?"
        )
    if found.mirrored:
        return (
            f"no markers of {table.dictionary}, but the mirrored picture shows {_ids(list(found.ids))} of {found.name}"
            "\nturn the video left to right, as the camera saw it"
        )
    return (
        f"no markers of {table.dictionary}, but {_ids(list(found.ids))} of {found.name} "
        f'(in {found.images} of {len(sample)} frames tried)\nwrite dictionary = "{found.name}" into the table'
    )


def _ids(ids: list[int]) -> str:
    """Marker ids in words, a few of them."""
    shown = ", ".join(map(str, ids[:SHOWN_IDS]))
    return f"{'marker' if len(ids) == 1 else 'markers'} {shown}{', ...' if len(ids) > SHOWN_IDS else ''}"
