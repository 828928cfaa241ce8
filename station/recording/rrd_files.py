"""An .rrd below rerun: where its last whole message ends.

An .rrd (version 2) is a header of 12 bytes, "RRF2", version, options, then messages: kind (u64), length (u64), payload.
A message of kind 0 ends it, with the index of the whole file as its payload; a trailer of 32 bytes follows. A writer
that was killed leaves neither, and its last message may be cut anywhere.
"""

from __future__ import annotations

import shutil
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from station.errors import InvalidFile

MAGIC = b"RRF2"
HEADER_BYTES = 12
TRAILER_MAGIC = b"RRF2FOOT"
TRAILER_BYTES = 32
MESSAGE = struct.Struct("<QQ")
END_KIND = 0
STORE_KIND = 1
# No message is longer: twice as much as the writer gathers before it writes one.
LONGEST_BYTES = 128 << 20
# Kinds of message: end, store info, chunk, command to activate a blueprint.
KINDS = frozenset({END_KIND, STORE_KIND, 2, 3})


@dataclass(frozen=True)
class Framing:
    """How far a file consists of whole messages.

    Attributes:
        size: bytes in the file.
        whole: bytes up to the end of the last whole message.
        messages: how many there are, the end included.
        body: bytes up to the end of the last one that isn't the end with its index.
        complete: whether the file was closed: it has its end, and with it the index.
        last: where the last message that isn't the end begins.
        stores: where the messages begin and end that tell which recording what follows is of.
        cut: whether what follows the last whole message is what a kill or a power cut leaves: the beginning of a
            message, or zeros. Anything else is damage, and whole messages may follow it.
    """

    size: int
    whole: int
    messages: int
    body: int
    complete: bool
    last: int
    stores: tuple[tuple[int, int], ...]
    cut: bool

    @property
    def torn(self) -> bool:
        """Whether something follows the last whole message that isn't the trailer of a complete file."""
        return not self.complete and self.whole < self.size

    def without_index(self) -> Framing:
        """The same file as if it had never been closed."""
        return replace(self, whole=self.body, complete=False)

    def without_last(self) -> Framing:
        """The same file as if its last message were torn."""
        return replace(self, whole=self.last, body=self.last, messages=self.messages - 1)


def scan_framing(path: Path) -> Framing:
    """Walk the messages of the file without reading what is in them.

    Raises:
        InvalidFile: the file can't be read, is empty or is no .rrd of this version.
    """
    try:
        with path.open("rb") as file:
            return _scan(file, path)
    except OSError as error:
        raise InvalidFile(f"{path} can't be read: {error.strerror}") from error


def _scan(file: BinaryIO, path: Path) -> Framing:
    size = file.seek(0, 2)
    file.seek(0)
    header = file.read(HEADER_BYTES)
    if not header:
        raise InvalidFile(f"{path} is empty; nothing was recorded in it")
    if len(header) < HEADER_BYTES or not header.startswith(MAGIC):
        raise InvalidFile(f"{path} is no recording: it starts with {header[:4]!r}, an .rrd with {MAGIC!r}")
    whole, body, messages, last = HEADER_BYTES, HEADER_BYTES, 0, HEADER_BYTES
    stores: list[tuple[int, int]] = []
    while len(head := file.read(MESSAGE.size)) == MESSAGE.size:
        kind, length = MESSAGE.unpack(head)
        end = whole + MESSAGE.size + length
        if kind not in KINDS or end > size or (kind == END_KIND and not _ends_with_trailer(file, end, size)):
            break
        start, whole, messages = whole, end, messages + 1
        if kind == END_KIND:
            return Framing(size, whole, messages, body, True, last, tuple(stores), False)
        body, last = end, start
        if kind == STORE_KIND:
            stores.append((start, end))
        file.seek(end)
    return Framing(size, whole, messages, body, False, last, tuple(stores), _is_cut(file, whole, size))


def _is_cut(file: BinaryIO, whole: int, size: int) -> bool:
    """Whether the file's rest is the beginning of one message, the end with its trailer included, or zeros."""
    file.seek(whole)
    rest = file.read(LONGEST_BYTES)
    if len(rest) < MESSAGE.size or not rest.strip(b"\0"):
        return True
    kind, length = MESSAGE.unpack(rest[: MESSAGE.size])
    trailer = TRAILER_BYTES if kind == END_KIND else 0
    return kind in KINDS and length <= LONGEST_BYTES and whole + MESSAGE.size + length + trailer > size


def _ends_with_trailer(file: BinaryIO, end: int, size: int) -> bool:
    """Whether only the trailer follows: zeros, as a power cut leaves them, read as an end without anything in it."""
    file.seek(end)
    trailer = file.read(TRAILER_BYTES + 1)
    return end < size and len(trailer) == TRAILER_BYTES and TRAILER_MAGIC in trailer


def copy_last(path: Path, framing: Framing, target: Path) -> None:
    """Copy the file's last message to `target`, as a file of its own."""
    with path.open("rb") as file, target.open("wb") as copy:
        for start, end in ((0, HEADER_BYTES), *framing.stores, (framing.last, framing.body)):
            file.seek(start)
            copy.write(file.read(end - start))


def copy_whole(path: Path, whole: int, target: Path) -> None:
    """Copy the first `whole` bytes of the file to `target`."""
    shutil.copyfile(path, target)
    with target.open("r+b") as file:
        file.truncate(whole)
