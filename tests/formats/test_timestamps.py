"""Time stamps of a video's frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.errors import InvalidFile
from station.formats.timestamps import parse_timestamps


def test_stamps_are_read_by_frame_in_ns() -> None:
    text = "t_s, frame\n0.1,0\n\n0.25, 3\n1e3,4\n"
    assert parse_timestamps(text, "stamps.csv") == {0: 100_000_000, 3: 250_000_000, 4: 10**12}


@given(st.lists(st.integers(-(10**12), 2 * 10**15), min_size=1, max_size=20, unique=True))
def test_decimals_of_a_microsecond_are_exact_also_since_1970(stamps_us: list[int]) -> None:
    stamps_us = sorted(stamps_us)
    rows = [f"{k},{'-' if t < 0 else ''}{abs(t) // 10**6}.{abs(t) % 10**6:06d}" for k, t in enumerate(stamps_us)]
    read = parse_timestamps("\n".join(["frame,t_s", *rows]), "stamps.csv")
    assert list(read.values()) == [1000 * t for t in stamps_us]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "stamps.csv is empty"),
        ("frame,t_s\n", "has no data below its header"),
        ("frame,time\n0,0\n", "columns frame,time; want frame,t_s"),
        ("frame,t_s,x\n0,0,0\n", "columns frame,t_s,x; want frame,t_s"),
        ("frame,t_s\n0,0\n1.5,1\n", "row 3: frame is 1.5; want a whole number, 0 for the first frame"),
        ("frame,t_s\n-1,0\n", "row 2: frame is -1; want a whole number"),
        ("frame,t_s\n0,0\n0,1\n", "row 3: frame 0 follows 0; want rows in which frames increase"),
        ("frame,t_s\n0,1\n1,1\n", "row 3: t_s 1 follows 1; want rows in which times increase"),
        ("frame,t_s\n0,0\n1,1e-12\n", "row 3: t_s is less than 1 ns after the row before"),
        ("frame,t_s\n0,1e300\n", "row 2: t_s is 1e\\+300; want seconds"),
        ("frame,t_s\n0,\n", "row 2: t_s is blank"),
        ("frame,t_s\n0,nan\n", "row 2: t_s is 'nan'; want a finite number"),
        ("frame,t_s\n0,soon\n", "row 2: t_s is 'soon'; want a number"),
    ],
)
def test_a_bad_row_is_refused_with_its_number(text: str, message: str) -> None:
    with pytest.raises(InvalidFile, match=f"stamps.csv.*{message}|{message}"):
        parse_timestamps(text, "stamps.csv")


@given(st.lists(st.floats(0, 1e4), min_size=2, max_size=10))
def test_seconds_of_a_float_come_back_to_the_nanosecond(t_s: list[float]) -> None:
    t_s = np.unique(np.round(t_s, 6)).tolist()
    text = "\n".join(["frame,t_s", *(f"{k},{t!r}" for k, t in enumerate(t_s))])
    np.testing.assert_allclose(np.array(list(parse_timestamps(text, "s").values())) / 1e9, t_s, atol=1e-9)
