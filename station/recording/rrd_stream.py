"""An .rrd while it is written: rows at their times, in the file within a second; what failed is told from then on."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
from rerun_bindings import flush_and_cleanup_orphaned_recordings

from station.errors import StationError
from station.recording.layout import APPLICATION, ELAPSED, FRAME

if TYPE_CHECKING:
    from rerun.blueprint import Blueprint

# Between two flushes, s of the wall clock.
FLUSH_PERIOD_S = 0.5
# A flush that takes longer means that the disk takes nothing any more, s.
FLUSH_TIMEOUT_S = 5.0
# Waiting for the end of a file that could not be written, s.
END_TIMEOUT_S = 2.0
# rerun's batcher writes an entity when it has this much, and all of them when they are flushed. Were images alone to
# reach the limit before each flush, nothing else would ever be written; hence far more than a flush's worth of images.
BATCH_BYTES = 64 << 20
# Its own tick is left out, or there would be twice as many chunks to read.
BATCH_TICK_S = 3600.0


@contextmanager
def written(path: Path) -> Iterator[None]:
    """rerun's errors on writing, whose type goes by their cause, become StationError with the file's name."""
    try:
        yield
    except StationError:
        raise
    except Exception as error:
        raise StationError(f"{path} can't be written: {error}\n{_free_text(path.parent)}") from error


def _free_text(folder: Path) -> str:
    try:
        return f"{shutil.disk_usage(folder).free / 1e6:.1f} MB are free on its disk"
    except OSError:
        return f"{folder} is gone, or can't be looked into"


def check_rerun() -> None:
    """Raise StationError where the environment disables rerun."""
    if os.environ.get("RERUN", "on").lower() in ("off", "0", "false"):
        raise StationError("RERUN=off is set in the environment, so nothing would be recorded; unset RERUN")


def open_stream(recording_id: str, tick_s: float = BATCH_TICK_S, *, send_properties: bool = True) -> rr.RecordingStream:
    """A stream of this recording in rerun's strict mode, which batches for `tick_s`.

    With `send_properties` it notes when it began itself. Raises StationError where the environment disables rerun.
    """
    check_rerun()
    rr.set_strict_mode(True)  # otherwise bad data is dropped with a warning
    batching = rr.ChunkBatcherConfig(flush_tick=tick_s, flush_num_bytes=BATCH_BYTES)
    stream = rr.RecordingStream(
        APPLICATION, recording_id=recording_id, batcher_config=batching, send_properties=send_properties
    )
    if not rr.is_enabled(stream):
        raise StationError("rerun is disabled, so nothing would be recorded; look for RERUN in the environment")
    return stream


def forget_ended_streams() -> None:
    """End the threads of streams that nothing refers to any more: rerun keeps two for each until it is told to."""
    flush_and_cleanup_orphaned_recordings()


class RrdStream:
    """Writes one .rrd. May be called from several threads.

    A thread of its own hands what was logged to the operating system twice a second, so that a kill loses less than a
    second also when nothing more is logged. What fails is fatal, since rerun doesn't recover: it is raised by each call
    from then on.

    Args:
        start_ns: time 0 of the file, on the clock of the stamps that are logged.
        blueprint: the viewer's layout, kept in the file.
        send_properties: note in the file when it was begun.

    Raises:
        StationError: the file can't be written.
    """

    def __init__(
        self,
        path: Path,
        recording_id: str,
        start_ns: int,
        *,
        blueprint: Blueprint | None = None,
        send_properties: bool = True,
    ) -> None:
        self._path, self._start_ns = path, start_ns
        self._failure: StationError | None = None
        self._ending = threading.Event()
        self._flushing = threading.Lock()
        self._stream = open_stream(recording_id, send_properties=send_properties)
        self._timer = threading.Thread(target=self._flush_by_the_clock, name="recording flush", daemon=True)
        try:
            with written(path):
                self._stream.set_sinks(rr.FileSink(path), default_blueprint=blueprint)
        except BaseException:
            self.end()
            raise

    @property
    def raw(self) -> rr.RecordingStream:
        """rerun's stream, for what has no time."""
        return self._stream

    def start_timer(self) -> None:
        """Flush by the clock from now on."""
        self._timer.start()

    def log(self, t_ns: int, entity: str, *values: rr.AsComponents, frame: int | None = None) -> None:
        """Log a row at its stamp; raises StationError once something failed."""
        self.check()
        self._stream.reset_time()  # times are kept for each thread; `frame` must not stick to what follows
        self._stream.set_time(ELAPSED, duration=np.timedelta64(int(t_ns) - self._start_ns, "ns"))
        if frame is not None:
            self._stream.set_time(FRAME, sequence=int(frame))
        self._stream.log(entity, *values)

    def check(self) -> None:
        """Raise what failed, if anything did."""
        if self._failure is not None:
            raise self._failure

    def flush(self, timeout_s: float = FLUSH_TIMEOUT_S) -> None:
        """Hand all that was logged to the operating system; raises StationError if it can't be written (disk full)."""
        with self._flushing:
            self.check()
            try:
                with written(self._path):
                    self._stream.flush(timeout_sec=timeout_s)
            except StationError as error:
                self._failure = error
                raise

    def end(self) -> None:
        """Finish the file; once.

        For a file that failed rerun may wait here for ever, and once more when the program ends: then a thread waits in
        our place, which keeps the stream, and rerun is not asked to finish anything at the end.
        """
        if self._ending.is_set():
            return
        self._ending.set()
        if self._timer.ident is not None:
            self._timer.join()
        ending = threading.Thread(target=self._stream.disconnect, name="rerun disconnect", daemon=True)
        ending.start()
        ending.join(END_TIMEOUT_S if self._failure is not None else None)
        del self._stream
        if ending.is_alive():
            rr.unregister_shutdown()
        else:
            forget_ended_streams()

    def _flush_by_the_clock(self) -> None:
        while not self._ending.wait(FLUSH_PERIOD_S):
            try:
                self.flush()
            except StationError:
                return  # kept; whoever logs next is told
