"""multipart/x-mixed-replace taken apart as its bytes come, however they are split (RFC 2046, 5.1).

Lenient where cameras are: delimiters with any number of leading dashes, whether or not the header has them too; lines
that end in LF alone; parts with or without Content-Length; anything before and between the parts.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.errors import CameraError

MAX_PART_BYTES = 32 * 1024 * 1024
MAX_HEADER_BYTES = 16 * 1024
MAX_DASHES = 64
DASH, LF, CR = b"-\n\r"
END_OF_JPEG = b"\xff\xd9"
# After a delimiter's name: two dashes at the very end of all, blanks, the end of the line; and the beginning of that.
_REST = re.compile(rb"(--)?[ \t]{0,64}\r?\n")
_REST_BEGUN = re.compile(rb"-{0,2}[ \t]{0,64}\r?")
_HEADERS_END = re.compile(rb"\A\r?\n|\r?\n\r?\n")
_BOUNDARY = re.compile(r"""boundary\s*=\s*(?:"([^"]*)"|([^;\s]+))""", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Part:
    """One part.

    Attributes:
        t_ns: the time that was given with the first bytes of its body.
        headers: its own, names in lower case.
        body: its bytes.
    """

    t_ns: int
    headers: Mapping[str, str]
    body: bytes


class BadStream(CameraError):
    """A stream that is no multipart stream, or has parts that nobody could want."""


def read_boundary(content_type: str) -> bytes:
    """The delimiter's name in a Content-Type, without leading dashes; raises BadStream where there is none."""
    kind, _, parameters = content_type.partition(";")
    if not kind.strip().lower().startswith("multipart/"):
        raise BadStream(f"it gives {kind.strip() or 'no Content-Type'}; want multipart/x-mixed-replace")
    found = _BOUNDARY.search(parameters)
    name = (found[1] or found[2] or "").lstrip("-") if found else ""
    if not name:
        raise BadStream(f"its Content-Type names no boundary: {content_type!r}")
    return name.encode("latin-1", "replace")


@dataclass(frozen=True, slots=True)
class _Delimiter:
    start: int
    end: int
    closing: bool


class PartSplitter:
    """Takes the bytes of a stream, gives its parts.

    Args:
        boundary: the delimiter's name without leading dashes.
        max_part_bytes: a longer part is an error.

    Attributes:
        skipped_bytes: what stood before and between the parts and was no part of any.
        ended: whether the closing delimiter came; nothing after it is a part.
    """

    def __init__(self, boundary: bytes, *, max_part_bytes: int = MAX_PART_BYTES) -> None:
        self._name = boundary
        self._max_bytes = max_part_bytes
        self._buffer = bytearray()
        self._searched = 0
        self._in_part = False
        self._headers: dict[str, str] | None = None
        self._length: int | None = None
        self._body_ns: int | None = None
        self.skipped_bytes = 0
        self.ended = False

    def feed(self, data: bytes, t_ns: int) -> list[Part]:
        """The parts that are whole with these bytes, which came at `t_ns`.

        Raises:
            BadStream: a part or its headers are longer than they may be.
        """
        self._buffer += data
        parts: list[Part] = []
        while not self.ended and self._step(t_ns, parts):
            pass
        return parts

    def _step(self, t_ns: int, parts: list[Part]) -> bool:
        """Take one thing off the buffer; False if it takes more bytes to do so."""
        if not self._in_part:
            return self._skip_to_part()
        if self._headers is None:
            return self._read_headers()
        if self._body_ns is None and (self._buffer or self._length == 0):
            self._body_ns = t_ns
        return self._read_body(parts)

    def _skip_to_part(self) -> bool:
        found = self._next_delimiter()
        # What may still become a delimiter stays.
        junk = len(self._buffer) - len(self._name) - MAX_DASHES - len(b"\r\n") if found is None else found.start
        if found is not None:
            self.skipped_bytes += junk
            self._begin(found)
        elif junk > 0 and self._searched >= junk:
            self.skipped_bytes += junk
            del self._buffer[:junk]
            self._searched -= junk
        return found is not None

    def _begin(self, found: _Delimiter) -> None:
        """A part begins after the delimiter, or nothing any more."""
        self.ended = found.closing
        del self._buffer[: found.end]
        self._searched = 0
        self._in_part, self._headers, self._length, self._body_ns = True, None, None, None

    def _read_headers(self) -> bool:
        end = _HEADERS_END.search(self._buffer, 0, MAX_HEADER_BYTES)
        if end is None:
            if len(self._buffer) >= MAX_HEADER_BYTES:
                raise BadStream(f"a part's headers are longer than {MAX_HEADER_BYTES} bytes")
            return False
        lines = self._buffer[: end.start()].decode("latin-1").split("\n")
        pairs = (line.partition(":") for line in lines)
        self._headers = {name.strip().lower(): value.strip() for name, colon, value in pairs if colon}
        text = self._headers.get("content-length", "")
        self._length = int(text) if re.fullmatch(r"[0-9]{1,18}", text) else None
        del self._buffer[: end.end()]
        return True

    def _read_body(self, parts: list[Part]) -> bool:
        """The body: as long as it says, else up to the next delimiter."""
        if (self._length or 0) > self._max_bytes or len(self._buffer) > self._max_bytes + MAX_HEADER_BYTES:
            raise BadStream(f"a part of {self._length or len(self._buffer)} bytes; want at most {self._max_bytes}")
        found = self._next_delimiter() if self._length is None else None
        end = self._length if found is None else found.start
        if end is None or len(self._buffer) < end:
            return False
        parts.append(Part(self._body_ns or 0, self._headers or {}, bytes(self._buffer[:end])))
        if found is None:
            del self._buffer[:end]
            self._searched, self._in_part = 0, False
        else:
            self._begin(found)
        return True

    def _next_delimiter(self) -> _Delimiter | None:
        """The next delimiter that is whole, with its line end; the search goes on where it ended before."""
        while (at := self._buffer.find(self._name, self._searched)) >= 0:
            start, after = self._line_start(at), at + len(self._name)
            if start is not None:
                rest = _REST.match(self._buffer, after)
                if rest is not None:
                    return _Delimiter(start, rest.end(), rest[1] is not None)
                if _REST_BEGUN.fullmatch(self._buffer, after):
                    self._searched = at
                    return None
            self._searched = at + 1
        self._searched = max(self._searched, len(self._buffer) - len(self._name) + 1)
        return None

    def _line_start(self, at: int) -> int | None:
        """Where the line end before a name and its dashes begins; None if the name is not at a line's start."""
        buffer, start = self._buffer, at
        while start > 0 and at - start < MAX_DASHES and buffer[start - 1] == DASH:
            start -= 1
        if start == 0:
            return 0
        if buffer[start - 1] == LF:
            return start - 2 if start >= 2 and buffer[start - 2] == CR else start - 1
        # Some cameras leave the line end out after a picture.
        return start if start < at and buffer[:start].endswith(END_OF_JPEG) else None
