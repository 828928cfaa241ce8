"""Opens an .rrd to read it, whole or torn, with its index or without; what is wrong becomes a notice or InvalidFile."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from rerun.chunk import LazyChunkStream, RrdReader
from rerun.error_utils import RerunWarning

from station.errors import InvalidData, InvalidFile, StationError
from station.recording.rrd_files import Framing, copy_last, copy_whole, scan_framing

T = TypeVar("T")


def read_piece(path: Path, read: Callable[[LazyChunkStream], T]) -> tuple[T, tuple[str, ...]]:
    """What `read` makes of the file's chunks, and notices of what was wrong; without the index if that is damaged.

    Raises:
        InvalidFile: empty, damaged, or no .rrd.
    """
    framing = sound_framing(path)
    try:
        return _read_framed(path, framing, read), notices_on(path, framing)
    except InvalidFile:
        if not framing.complete:
            raise
    notice = f"{path.name} was read without its index, which is damaged"
    return _read_framed(path, framing.without_index(), read), (notice,)


def sound_framing(path: Path) -> Framing:
    """How far an .rrd can be read; of a torn one, whose last message may have been filled up with zeros, less of it.

    Raises:
        InvalidFile: the file can't be read, is empty or is no .rrd of this version.
    """
    framing = scan_framing(path)
    if framing.complete or not framing.messages:
        return framing
    with tempfile.TemporaryDirectory(prefix="station-") as folder:
        copy_last(path, framing, last := Path(folder) / path.name)
        try:
            with errors_of(path), warnings.catch_warnings():
                warnings.simplefilter("ignore", RerunWarning)
                reader = RrdReader(last)
                for store in reader.recordings():
                    reader.stream(store=store).to_chunks()
        except InvalidFile:
            return framing.without_last()
    return framing


def has_rows(path: Path) -> bool:
    """Whether anything can be read: a program that was killed as it began leaves an empty file."""
    try:
        return scan_framing(path).messages > 0
    except InvalidFile:
        return False


@contextmanager
def open_piece(path: Path) -> Iterator[LazyChunkStream]:
    """The file's chunks, for as long as they are read."""
    framing = sound_framing(path)
    with errors_of(path), _readable(path, framing) as source:
        yield _stream(source, framing)


def _read_framed(path: Path, framing: Framing, read: Callable[[LazyChunkStream], T]) -> T:
    with errors_of(path), _readable(path, framing) as source:
        return read(_stream(source, framing))


@contextmanager
def errors_of(path: Path) -> Iterator[None]:
    """Whatever rerun or Arrow raise on a damaged file, a panic included, becomes InvalidFile."""
    try:
        yield
    except InvalidFile as error:
        raise error if str(path) in str(error) else InvalidFile(f"{path}: {error}") from error
    except InvalidData as error:
        raise InvalidFile(f"{path} is damaged: {error}") from error
    except StationError:
        raise  # of what is done with the content
    except BaseException as error:
        # rerun's panics derive from BaseException, like an interrupt, which must pass.
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InvalidFile(f"{path} is damaged and can't be read: {reason:.200}\nrestore it or record again") from error


@contextmanager
def _readable(path: Path, framing: Framing) -> Iterator[Path]:
    """The file itself, or for as long as it is read a copy without its torn end."""
    if not framing.messages:
        raise InvalidFile(f"{path} was cut before anything was recorded in it; nothing can be read")
    if not framing.torn:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="station-") as folder:
        target = Path(folder) / path.name
        copy_whole(path, framing.whole, target)
        yield target


def _stream(source: Path, framing: Framing) -> LazyChunkStream:
    """All chunks; of a complete file, only those that are asked for are read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RerunWarning)  # that there is no index; the framing has told us
        reader = RrdReader(source)
    return reader.store().stream() if framing.complete else reader.stream()


def notices_on(path: Path, framing: Framing) -> tuple[str, ...]:
    """What is wrong with the file, in words; nothing if it was closed."""
    if framing.complete:
        return ()
    if not framing.torn:
        return (f"{path.name} was not closed: what was logged after its last flush is lost",)
    what = "was cut" if framing.cut else "is damaged"
    return (f"{path.name} {what}: read up to its last whole message, {framing.size - framing.whole} bytes left out",)
