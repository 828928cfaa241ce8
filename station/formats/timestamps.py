"""Time stamps of a video's frames, `frame,t_s`: for videos whose own stamps are made up, or are of another clock."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal

import numpy as np

from station.errors import InvalidFile
from station.formats.table import parse_csv

COLUMNS = ("frame", "t_s")
# Seconds. A stamp in ns must fit 64 bits; seconds since 1970 do for a long time to come.
LATEST_S = 9e9
NS_PER_S = 1_000_000_000


def parse_timestamps(text: str, name: str) -> Mapping[int, int]:
    """Read the text of a file of stamps; returns each listed frame's stamp in ns, rounded from its decimals.

    Frames count from 0, in the order in which the video is read. They may be left out, of the file but not of a row.

    Args:
        text: the file's text, comma-separated under the header `frame,t_s`, in either order.
        name: the file's name, for errors.

    Raises:
        InvalidFile: for other columns and, with the row, for frames that are no whole numbers from 0, frames or times
            that don't increase, times beyond 9e9 s.
    """
    table = parse_csv(text, name)
    if set(table.columns) != set(COLUMNS):
        raise InvalidFile(f"{name}: columns {','.join(table.columns)}; want {','.join(COLUMNS)}")
    frames, t_s = table.filled_floats("frame"), table.times("t_s", repeats=False)
    wrong = np.flatnonzero((frames < 0) | (frames != np.round(frames)))
    if wrong.size:
        i = int(wrong[0])
        raise table.refusal(i, f"frame is {table.columns['frame'][i]}; want a whole number, 0 for the first frame")
    falls = np.flatnonzero(frames[1:] <= frames[:-1])
    if falls.size:
        i = int(falls[0]) + 1
        raise table.refusal(i, f"frame {frames[i]:g} follows {frames[i - 1]:g}; want rows in which frames increase")
    far = np.flatnonzero(np.abs(t_s) > LATEST_S)
    if far.size:
        raise table.refusal(int(far[0]), f"t_s is {t_s[far[0]]:g}; want seconds, {LATEST_S:g} at most")
    stamps_ns = [int((Decimal(cell) * NS_PER_S).to_integral_value()) for cell in table.columns["t_s"]]
    same = np.flatnonzero(np.diff(stamps_ns) <= 0)
    if same.size:
        raise table.refusal(int(same[0]) + 1, "t_s is less than 1 ns after the row before; want times that increase")
    return dict(zip(frames.astype(int).tolist(), stamps_ns, strict=True))
