"""Corners of a rolling shutter straightened and moved to the time of their frame: each row is exposed at its own time.

A frame's time is that of its middle row; a corner at row v was seen (v / height - 1/2) times the readout later. Where
it was at the frame's own time is interpolated along its own track in the image, through its places in the frames before
and after, each at its own time. That needs no pose, so that wrong solutions can't spoil it, and keeps what speeds and
accelerations do to a corner.

A marker that turns while its rows are read has bent edges, and the lines that were fitted to them don't meet where its
corners were: 0.03 px off for a marker of 60 px that turns at 1 rad/s under a readout of 25 ms, as much as all noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray
from station.perception.observations import COORDINATES, IntArray, ObservationLog
from station.perception.profiles import profile_span
from station.quadrilaterals import edges_of, following, intersect_edges

BoolArray = NDArray[np.bool_]

# A corner isn't interpolated over a longer time: a marker can turn back within it.
LONGEST_GAP_S = 0.15


def row_delay_s(v_px: FloatArray, height_px: int, readout_s: float) -> FloatArray:
    """How much later than the middle row an image's rows (...) are seen."""
    return (v_px / height_px - 0.5) * readout_s


def straightened(observations: ObservationLog, height_px: int, readout_s: float) -> ObservationLog:
    """Observations with their corners where these were at their rows' own times, not where lines fitted to edges meet.

    The point of an edge at a share s from one corner to the next is seen at the time t + s dt, and moves at the speed
    v + s dv: it is seen s (1 - s) dv dt behind the straight line between the corners, and the line that fits best to
    the share L of the edge about its middle lies (1 - L^2 / 3) / 4 dv dt behind them all along. The speeds are those of
    the corners from the frame before to the one after (within LONGEST_GAP_S); those that were seen in neither stay.

    Args:
        observations: corners as seen: where lines fitted to the edges meet.
        height_px: rows of the image.
        readout_s: from the first row to the last.
    """
    if not len(observations):
        return observations
    px = observations.corners_px
    delay_s = row_delay_s(px[..., 1], height_px, readout_s)
    change_px_s, edges = following(speed := _corner_speeds(observations, delay_s)) - speed, edges_of(px)
    share = profile_span(edges.length_px) / edges.length_px
    behind = ((1.0 - share**2 / 3.0) / 4.0 * (following(delay_s) - delay_s))[..., None] * change_px_s
    at = np.sum(edges.normal * (px + behind), axis=-1)
    return replace(observations, corners_px=intersect_edges(edges.normal, at))


def _corner_speeds(observations: ObservationLog, delay_s: FloatArray) -> FloatArray:
    """(N, 4, 2) px/s of the corners, which are seen so much (N, 4) later than their frames."""
    px, seen_s = observations.corners_px, observations.t_s[observations.frame][:, None] + delay_s
    ends = [np.where(np.abs(seen_s[rows] - seen_s).max(axis=1) <= LONGEST_GAP_S, rows, np.arange(len(px)))
            for rows in _neighbours(observations)]  # fmt: skip
    step_s = (seen_s[ends[1]] - seen_s[ends[0]])[..., None]
    moved = ends[0] != ends[1]
    return np.where(moved[:, None, None], (px[ends[1]] - px[ends[0]]) / np.where(step_s == 0, 1.0, step_s), 0.0)


def at_frame_time(
    observations: ObservationLog, covariance_px2: FloatArray, height_px: int, readout_s: float
) -> tuple[ObservationLog, FloatArray]:
    """Observations with their corners where they were at their frames' times, and the covariances that they then have.

    A corner seen in the frames before and after (within LONGEST_GAP_S) is interpolated by a parabola; one that was seen
    in one of them, by a line. One that was seen in neither stays where it is, with the variance of where it may have
    moved to at the typical speed of all others. The poses in the result are those that came.

    Args:
        observations: corners as seen.
        covariance_px2: (N, 8, 8) of them.
        height_px: rows of the image.
        readout_s: from the first row to the last.
    """
    if not len(observations):
        return observations, covariance_px2
    px = observations.corners_px
    seen_s = observations.t_s[observations.frame][:, None] + row_delay_s(px[..., 1], height_px, readout_s)
    before, after = _neighbours(observations)
    here = np.arange(len(px))
    steps = [(before, seen_s[before] - seen_s), (after, seen_s[after] - seen_s)]
    there = [(rows != here)[:, None] & (np.abs(step) <= LONGEST_GAP_S) for rows, step in steps]
    delay = seen_s - observations.t_s[observations.frame][:, None]
    weights = _weights(-delay, steps[0][1], steps[1][1], there[0], there[1])
    places = (here, before, after)
    moved = sum(w[..., None] * px[rows] for w, rows in zip(weights, places, strict=True))
    of_coordinate = [np.repeat(w, 2, axis=1) for w in weights]
    grown = sum(
        w[:, :, None] * w[:, None, :] * covariance_px2[rows] for w, rows in zip(of_coordinate, places, strict=True)
    )
    alone = ~(there[0] | there[1])
    astray_px2 = np.where(alone, (_speed_px_s(px, steps, there) * delay) ** 2, 0.0)
    grown = grown + np.repeat(astray_px2, 2, axis=1)[:, :, None] * np.eye(COORDINATES)
    return replace(observations, corners_px=np.asarray(moved)), np.asarray(grown)


def _neighbours(observations: ObservationLog) -> tuple[IntArray, IntArray]:
    """(N,) rows of the same marker's sightings before and after; a row's own number where there is none."""
    order = np.lexsort((observations.frame, observations.marker_id))
    same = np.diff(observations.marker_id[order]) == 0
    here = np.arange(len(order))
    before, after = np.array(here), np.array(here)
    after[order[:-1][same]] = order[1:][same]
    before[order[1:][same]] = order[:-1][same]
    return before, after


def _weights(
    at_s: FloatArray, before_s: FloatArray, after_s: FloatArray, has_before: BoolArray, has_after: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lagrange's weights (N, 4) of the places seen at times 0, before and after, for the place at `at_s`."""
    b, a = np.where(has_before, before_s, -1.0), np.where(has_after, after_s, 1.0)  # any time but 0
    both = has_before & has_after
    parabola_b, parabola_a = at_s * (at_s - a) / (b * (b - a)), at_s * (at_s - b) / (a * (a - b))
    w_b = np.where(both, parabola_b, np.where(has_before, at_s / b, 0.0))
    w_a = np.where(both, parabola_a, np.where(has_after, at_s / a, 0.0))
    return 1.0 - w_b - w_a, w_b, w_a


def _speed_px_s(px: FloatArray, steps: list[tuple[IntArray, FloatArray]], there: list[BoolArray]) -> float:
    """RMS speed of a coordinate over all steps that are short enough; 0 where there is none."""
    speeds = [
        ((px[rows] - px) / np.where(known, step, 1.0)[..., None])[known]
        for (rows, step), known in zip(steps, there, strict=True)
    ]
    each = np.concatenate([speed.ravel() for speed in speeds])
    return float(np.sqrt(np.mean(each**2))) if each.size else 0.0
