"""An .rrd while it is written: rows at their times, in the file within a second; what failed is told from then on."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable, Iterator
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
# Between two times that the disk is told to keep what the file has (fsync), s: a power cut may lose as much.
SYNC_PERIOD_S = 5.0
# A flush that takes longer means that the disk takes nothing any more, s.
FLUSH_TIMEOUT_S = 5.0
# Waiting for the end of a file, which has its index to write; and of one that could not be written, s.
END_TIMEOUT_S, FAILED_END_TIMEOUT_S = 60.0, 2.0
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
    except BaseException as error:
        # rerun's panics derive from BaseException, like an interrupt, which must pass.
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
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


# Set once a file can't be finished: rerun would wait for it for ever, whatever it is told to end.
_stuck = threading.Event()


def forget_ended_streams() -> None:
    """End the threads of streams that nothing refers to any more: rerun keeps two for each until it is told to."""
    if not _stuck.is_set():
        flush_and_cleanup_orphaned_recordings()


class RrdStream:
    """Writes one .rrd, or several one after another. May be called from several threads.

    Threads of its own hand what was logged to the operating system twice a second, so that a kill loses less than a
    second also when nothing more is logged, and have the disk keep it every five. What fails is fatal, since rerun
    doesn't recover: it is raised by each call from then on.

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
        self._timers = [
            threading.Thread(target=self._by_the_clock, args=what, name=f"recording {name}", daemon=True)
            for name, *what in (("flush", FLUSH_PERIOD_S, self.flush), ("sync", SYNC_PERIOD_S, self.sync))
        ]
        try:
            with written(path):
                self._stream.set_sinks(rr.FileSink(path), default_blueprint=blueprint)
                self._identity = _identity(path)
        except BaseException:
            self.end()
            raise

    @property
    def raw(self) -> rr.RecordingStream:
        """rerun's stream, for what has no time."""
        return self._stream

    def start_timers(self) -> None:
        """Flush and sync by the clock from now on."""
        for timer in self._timers:
            timer.start()

    def log(self, t_ns: int, entity: str, *values: rr.AsComponents, frame: int | None = None) -> None:
        """Log a row at its stamp; raises StationError once something failed."""
        self.check()
        self._stream.reset_time()  # times are kept for each thread; `frame` must not stick to what follows
        self._stream.set_time(ELAPSED, duration=np.timedelta64(int(t_ns) - self._start_ns, "ns"))
        if frame is not None:
            self._stream.set_time(FRAME, sequence=int(frame))
        self._stream.log(entity, *values)

    def go_on_in(self, path: Path, blueprint: Blueprint | None = None) -> None:
        """Finish the file, with its index, and write what is logged from now on into another one.

        rerun keeps a file's index in memory until the file is finished: some 3 MB a minute of a capture.
        """
        self.flush()
        with self._flushing:
            before = self._path
            try:
                with written(path):
                    self._stream.set_sinks(rr.FileSink(path), default_blueprint=blueprint)
                    self._path, self._identity = path, _identity(path)
                    _sync(before)
            except StationError as error:
                self._failure = error
                raise

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
                    if _identity(self._path) != self._identity:  # rerun goes on writing into what nobody can open
                        raise StationError(f"{self._path} was removed, moved or replaced while it was recorded")
            except StationError as error:
                self._failure = error
                raise

    def sync(self) -> None:
        """Have the disk keep what the file has; raises StationError if it can't."""
        self.check()
        try:
            with written(self._path):
                _sync(self._path)
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
        for timer in self._timers:
            if timer.ident is not None:
                timer.join()
        ending = threading.Thread(target=self._stream.disconnect, name="rerun disconnect", daemon=True)
        ending.start()
        ending.join(END_TIMEOUT_S if self._failure is None else FAILED_END_TIMEOUT_S)
        del self._stream
        if not ending.is_alive():
            forget_ended_streams()
            return
        _stuck.set()
        rr.unregister_shutdown()
        if self._failure is None:
            self._failure = StationError(f"{self._path} can't be finished: its disk takes nothing any more")

    def _by_the_clock(self, period_s: float, act: Callable[[], None]) -> None:
        while not self._ending.wait(period_s):
            try:
                act()
            except StationError:
                return  # kept; whoever logs next is told


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())


def _identity(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_dev, status.st_ino
