"""PartSplitter: every way in which cameras write their streams, split anywhere, and what is no stream."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.multipart import BadStream, Part, PartSplitter, read_boundary

NAME = b"frame"
# A picture's bytes may hold anything but a delimiter; dashes, names and line ends among them.
BODIES = st.lists(
    st.one_of(st.binary(max_size=30), st.sampled_from([b"--", b"\r\n", b"\n", b"fram", b"--fram", b"frame", b"\r\n-"])),
    max_size=8,
).map(lambda pieces: b"".join(pieces).replace(b"frame", b"from"))


def cut(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = sorted({0, len(data), *(c % (len(data) + 1) for c in cuts)})
    return [data[a:b] for a, b in pairwise(edges)]


def taken(pieces: list[bytes], splitter: PartSplitter | None = None) -> list[Part]:
    splitter = splitter or PartSplitter(NAME)
    return [part for t_ns, piece in enumerate(pieces) for part in splitter.feed(piece, t_ns)]


def stream(
    bodies: list[bytes], *, dashes: bytes = b"--", end: bytes = b"\r\n", length: bool = True, last: bool = True
) -> bytes:
    """Parts one after another; `last` adds a delimiter, without which the end of the last part isn't known."""
    written = b""
    for body in bodies:
        written += dashes + NAME + end + b"Content-Type: image/jpeg" + end
        written += b"content-length:  %d" % len(body) + end if length else b""
        written += end + body + end
    return written + (dashes + NAME + end if last else b"")


@given(
    bodies=st.lists(BODIES, max_size=5),
    cuts=st.lists(st.integers(0, 10**6), max_size=20),
    dashes=st.sampled_from([b"", b"--", b"----"]),
    end=st.sampled_from([b"\r\n", b"\n"]),
    length=st.booleans(),
)
def test_parts_come_whole_however_the_stream_is_split_and_written(
    bodies: list[bytes], cuts: list[int], dashes: bytes, end: bytes, length: bool
) -> None:
    if not length:  # a body that ends as the line does can't be told from the line's end
        bodies = [body.strip(b"\r\n-") + b"!" for body in bodies]
    parts = taken(cut(stream(bodies, dashes=dashes, end=end, length=length), cuts))
    assert [part.body for part in parts] == bodies
    assert all(part.headers["content-type"] == "image/jpeg" for part in parts)


@given(body=BODIES.map(lambda body: body + b"frame" + body), cuts=st.lists(st.integers(0, 10**6), max_size=9))
def test_with_a_length_a_body_may_hold_its_own_delimiter(body: bytes, cuts: list[int]) -> None:
    body += b"\r\n--frame\r\n"
    assert [part.body for part in taken(cut(stream([body, body]), cuts))] == [body, body]


@given(pieces=st.lists(st.binary(max_size=200), max_size=10))
def test_junk_is_passed_over(pieces: list[bytes]) -> None:
    junk = [piece.replace(NAME, b"") for piece in pieces]
    splitter = PartSplitter(NAME)
    before = taken(junk, splitter)
    assert before == []
    parts = splitter.feed(b"\r\n" + stream([b"one", b"two"]), 7)
    assert [part.body for part in parts] == [b"one", b"two"]


PIECES = st.sampled_from(
    [b"frame", b"--", b"-", b"\r\n", b"\n", b"\r", b" ", b"x", b"Content-Length: 3\r\n\r\n", b"\xff\xd9", b"\0" * 60]
)


@given(pieces=st.lists(PIECES, max_size=40), cuts=st.lists(st.integers(0, 10**6), max_size=40))
def test_bytes_of_any_kind_give_the_same_parts_however_they_are_split(pieces: list[bytes], cuts: list[int]) -> None:
    data = b"".join(pieces)
    whole, split = taken([data]), taken(cut(data, cuts))
    assert [(part.headers, part.body) for part in split] == [(part.headers, part.body) for part in whole]
    assert sum(len(part.body) for part in whole) <= len(data)


@given(data=st.binary(max_size=3000), cuts=st.lists(st.integers(0, 10**6), max_size=20))
def test_noise_is_junk_or_a_bad_stream(data: bytes, cuts: list[int]) -> None:
    splitter = PartSplitter(b"\n", max_part_bytes=500)
    try:
        parts = taken(cut(data, cuts), splitter)
    except BadStream:
        return
    assert sum(len(part.body) for part in parts) + splitter.skipped_bytes <= len(data)


def test_a_parts_stamp_is_that_of_the_first_bytes_of_its_body() -> None:
    head, tail = b"--frame\r\n", b"Content-Length: 6\r\n\r\n"
    # The delimiter comes right after the picture before it, as some servers send it; the headers before the body.
    pieces = [head, tail, b"abc", b"def\r\n" + head, tail + b"g", b"hijkl\r\n" + head]
    assert [(part.t_ns, part.body) for part in taken(pieces)] == [(2, b"abcdef"), (4, b"ghijkl")]
    open_end = [head + b"\r\n", b"abc", b"def\r\n", head]
    assert [(part.t_ns, part.body) for part in taken(open_end)] == [(1, b"abcdef")]


def test_a_picture_may_run_into_the_delimiter() -> None:
    picture = b"\xff\xd8...\xff\xd9"
    data = b"--frame\r\n\r\n" + picture + b"--frame\r\n\r\n" + picture + b"--frame\r\n"
    assert [part.body for part in taken([data])] == [picture, picture]


def test_nothing_comes_after_the_closing_delimiter() -> None:
    splitter = PartSplitter(NAME)
    parts = taken([stream([b"one"], last=False) + b"--frame--\r\n" + stream([b"two"])], splitter)
    assert [part.body for part in parts] == [b"one"] and splitter.ended
    assert splitter.feed(stream([b"three"]), 0) == []


def test_what_stands_between_parts_is_counted() -> None:
    splitter = PartSplitter(NAME)
    data = b"Hello\r\n" + stream([b"one"], last=False) + b"noise\r\n" + stream([b"two"])
    assert [part.body for part in taken([data], splitter)] == [b"one", b"two"]
    assert splitter.skipped_bytes == len(b"Hello") + len(b"\r\nnoise")


@pytest.mark.parametrize("length", ["", "x", "-5", "1e9", "12.5"])
def test_a_length_that_is_no_number_is_none(length: str) -> None:
    data = b"--frame\r\nContent-Length: " + length.encode() + b"\r\n\r\nbody\r\n--frame\r\n"
    assert [part.body for part in taken([data])] == [b"body"]


@pytest.mark.parametrize(
    "data",
    [
        b"--frame\r\nContent-Length: 501\r\n\r\n",
        b"--frame\r\n\r\n" + b"x" * 20_000,
        b"--frame\r\n" + b"x" * 20_000,
    ],
)
def test_parts_and_headers_that_are_too_long_are_a_bad_stream(data: bytes) -> None:
    with pytest.raises(BadStream, match=r"want at most 500|longer than 16384"):
        taken(cut(data, list(range(0, 20_000, 1000))), PartSplitter(NAME, max_part_bytes=500))


def test_endless_junk_is_not_kept() -> None:
    splitter = PartSplitter(NAME)
    for _ in range(1000):
        splitter.feed(b"-" * 1000, 0)
    assert splitter.skipped_bytes > 990_000


@pytest.mark.parametrize(
    ("content_type", "boundary"),
    [
        ("multipart/x-mixed-replace; boundary=frame", b"frame"),
        ("multipart/x-mixed-replace;boundary=--frame", b"frame"),
        ('Multipart/X-Mixed-Replace; charset=x; BOUNDARY="--my frame"', b"my frame"),
        ("multipart/mixed; boundary = frame;x=y", b"frame"),
    ],
)
def test_boundaries_are_read_as_cameras_write_them(content_type: str, boundary: bytes) -> None:
    assert read_boundary(content_type) == boundary


@pytest.mark.parametrize(
    ("content_type", "says"),
    [
        ("image/jpeg", "it gives image/jpeg; want multipart"),
        ("", "it gives no Content-Type"),
        ("multipart/x-mixed-replace", "names no boundary"),
        ("multipart/x-mixed-replace; boundary=--", "names no boundary"),
    ],
)
def test_what_has_no_boundary_is_a_bad_stream(content_type: str, says: str) -> None:
    with pytest.raises(BadStream, match=says):
        read_boundary(content_type)
