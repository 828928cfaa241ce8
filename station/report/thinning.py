"""Series with no more points than can be told apart in a drawing, and with a break where nothing was recorded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray

# Of a panel's width: what follows within one can't be told apart. Series of up to two points each stay as they are.
COLUMNS = 800
SHORT = 2 * COLUMNS
# In median steps: a longer one is a pause, and no line crosses it.
PAUSE_STEPS = 10.0


def line(t_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A line (T,) with a break at each pause; of a long one each column's first, last, lowest and highest point.

    A column in which nothing is known breaks the line; single unknown values in others don't.
    """
    if len(t_s) > SHORT:
        t_s, values = _extremes(t_s, values)
    if len(t_s) < 3:
        return t_s, values
    pauses = np.flatnonzero(np.diff(t_s) > PAUSE_STEPS * max(float(np.median(np.diff(t_s))), 0.0)) + 1
    return np.insert(t_s, pauses, t_s[pauses - 1]), np.insert(values, pauses, np.nan)


def band(t_s: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Both edges (T,) of a band; of a long one the lowest and the highest of each column."""
    if len(t_s) <= SHORT:
        return t_s, low, high
    first, count = _columns(t_s)
    known = np.isfinite(low) & np.isfinite(high)
    some = np.logical_or.reduceat(known, first)
    lowest = np.minimum.reduceat(np.where(known, low, np.inf), first)
    highest = np.maximum.reduceat(np.where(known, high, -np.inf), first)
    lowest, highest = (np.repeat(np.where(some, edge, np.nan), 2) for edge in (lowest, highest))
    ends = np.stack([t_s[first], t_s[np.append(first[1:], count) - 1]], axis=-1).ravel()
    return ends, lowest, highest


def flags(t_s: FloatArray, raised: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Flags (T,); of a long series one a column, raised where most of it are."""
    if len(t_s) <= SHORT:
        return t_s, raised
    first, count = _columns(t_s)
    share = np.add.reduceat(raised.astype(float), first) / np.diff(np.append(first, count))
    return t_s[first], share > 0.5


def _columns(t_s: FloatArray) -> tuple[NDArray[np.int64], int]:
    """The first row of each column that has any, and how many rows there are."""
    column = np.floor((t_s - t_s[0]) / max(float(t_s[-1] - t_s[0]), 1e-9) * COLUMNS)
    return np.flatnonzero(np.diff(column, prepend=-1)), len(t_s)


def _extremes(t_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """As M4 has it (Jugel et al. 2014), with a NaN for each column that has no value."""
    first, count = _columns(t_s)
    run = np.repeat(np.arange(len(first)), np.diff(np.append(first, count)))
    known = np.flatnonzero(np.isfinite(values))
    by_height = known[np.lexsort((values[known], run[known]))]
    kept = [first[~np.isin(np.arange(len(first)), run[known])]]
    for rows in (known, by_height):
        starts = np.flatnonzero(np.diff(run[rows], prepend=-1))
        kept += [rows[starts], rows[np.append(starts[1:], len(rows))[: len(starts)] - 1]]
    rows = np.unique(np.concatenate(kept))
    return t_s[rows], values[rows]
