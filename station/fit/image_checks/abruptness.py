"""Whether a change is sudden, or a drift that looks like one: told by the pictures just before and just after it.

A detector's own errors go as a marker's pose does: over a session they may look like a step, but about any time they
pass as a line does. What slipped or was touched is somewhere else from one picture to the next.
"""

from __future__ import annotations

import numpy as np

from station.fit.image_checks.sums import Sums
from station.logs import FloatArray

# Ticks on either side of a change, at least.
LEAST_TICKS = 3
# Pictures on either side that are looked at, those that repeat others counted for less than one.
PICTURES = 8.0
# A change's time is known to about so many ticks.
NEAR = 2
# What is likelier to be a drift than a step by this much, in twice the log likelihood, is none: noise alone makes two
# deviations of a true step as much, so that no more than 2 % of these are lost.
AGAINST = -4.0
# Directions with less than this share of the information of the best known one say nothing.
NOTHING = 1e-6


def is_abrupt(sums: Sums, what: str, at: int, size: FloatArray) -> bool:
    """Whether a change by a size (d,) that is likeliest at the beginning of a tick may be one.

    Few or noisy pictures can't tell it from a drift; then it may.
    """
    c = sums.columns[what]
    kind, _, number = what.partition(" ")
    seen: FloatArray = np.cumsum(sums.pictures[:, int(number)] if kind == "marker" else sums.pictures.max(axis=1))
    times = range(max(at - NEAR, LEAST_TICKS), min(at + NEAR, len(seen) - LEAST_TICKS) + 1)
    return any(_for_a_step(sums, c, _around(seen, time), time, size) > AGAINST for time in times)


def _around(seen: FloatArray, time: int) -> tuple[int, int]:
    """Ticks, the first and one behind the last, with enough pictures on either side of a time.

    Args:
        seen: (n,) pictures until each tick's end.
        time: the beginning of this tick.
    """
    before = seen[time - 1] if time else 0.0
    first = min(int(np.searchsorted(seen, before - PICTURES, side="right")), time - LEAST_TICKS)
    last = max(int(np.searchsorted(seen, before + PICTURES)) + 1, time + LEAST_TICKS)
    return max(first, 0), min(last, len(seen))


def _for_a_step(sums: Sums, c: slice, ticks: tuple[int, int], time: int, size: FloatArray) -> float:
    """By how much twice the log likelihood is greater with a step beside a line than without, the rest as it is."""
    t: FloatArray = np.arange(*ticks, dtype=np.float64) - (time - 0.5)
    profiles, window = np.stack([np.heaviside(t, 0.0), np.ones(len(t)), t / len(t)]), slice(*ticks)
    d = c.stop - c.start
    products: FloatArray = np.einsum("it,jt,tkl->ikjl", profiles, profiles, sums.DD[window, c, c])
    information = products.reshape(3 * d, 3 * d)
    score = (profiles @ sums.Dr[window, c]).ravel()
    unit = np.sqrt(np.maximum(np.diag(information), 1e-300))
    by_line = information[:d, d:] @ _inverse(information[d:, d:], unit[d:])
    left = information[:d, :d] - by_line @ information[d:, :d]
    return float(2.0 * size @ (score[:d] - by_line @ score[d:]) - size @ left @ size)


def _inverse(information: FloatArray, unit: FloatArray) -> FloatArray:
    """Of what is known, judged in units (n,); nothing along what isn't."""
    scaled = information / unit[:, None] / unit
    return np.asarray(np.linalg.pinv(scaled, rcond=NOTHING, hermitian=True), dtype=np.float64) / unit[:, None] / unit
