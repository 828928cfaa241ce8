"""Lag and gain of one signal behind another, between samples, with standard deviations that hold for coloured noise."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import find_peaks

FloatArray = NDArray[np.float64]
Sampler = Callable[[FloatArray], FloatArray]
"""States at any times (s); NaN where there is none."""

# In median sample periods. Between samples farther apart than this (a pause, a lost bus) nothing is known.
GAP_SAMPLES = 3.0
# Common frames below which nothing is estimated.
MIN_FRAMES = 10
# As parts of the range that the correlation has over the lags tried: what makes a peak more than noise, and how close
# to the best one a peak is as good (periodic motion). Of peaks as good, the one nearest zero lag is meant.
PEAK_PROMINENCE = 0.2
PEAK_TOLERANCE = 0.05
# Dimensionless. Correlation of neighbouring residuals above which whitening them would divide by next to nothing.
MAX_CORRELATION = 0.97
# Bound on the frames or grid points that a coarse search for a lag looks at.
MAX_COARSE_POINTS = 20_000


@dataclass(frozen=True)
class Slope:
    """`y(t) = gain x(t - lag) + a`: least squares with standard deviations; NaN and None where undefined.

    Attributes:
        influence_s: (T,) by how much each frame's residual moves the lag, zero where it isn't used; the lag's error is
            their sum. None where the standard deviation is.
    """

    lag_s: float
    lag_std_s: float | None
    gain: float
    gain_std: float | None
    influence_s: FloatArray | None = field(default=None, compare=False, repr=False)


# --- References at any time ------------------------------------------------------------------------------------------


def held(t_s: FloatArray, values: FloatArray) -> Sampler:
    """Zero-order hold of commands: each holds until the next; NaN before the first. NaN cells are no commands."""
    rows, kept = known_rows(t_s, values)

    def sample(at_s: FloatArray) -> FloatArray:
        return np.concatenate(([np.nan], kept))[np.searchsorted(rows, at_s, side="right")]

    return sample


def held_smooth(t_s: FloatArray, values: FloatArray, width_s: float) -> Sampler:
    """The zero-order hold under a triangular window of +- `width_s`; NaN before the first command.

    Symmetric, so it moves no lag. Several frames wide, its sums over frames are smooth in a shift: a lag can be found
    between frames, where the bare hold's sums change only as a step passes a frame.
    """
    rows, kept = known_rows(t_s, values)
    if not len(rows):
        return held(t_s, values)
    step_s = np.diff(rows)
    area = np.concatenate(([0.0], np.cumsum(kept[:-1] * step_s)))
    twice = np.concatenate(([0.0], np.cumsum(area[:-1] * step_s + kept[:-1] * step_s**2 / 2)))

    def integrated_twice(at_s: FloatArray) -> FloatArray:
        row = np.searchsorted(rows, at_s, side="right") - 1
        since_s = at_s - rows[row]
        return np.where(row < 0, np.nan, twice[row] + area[row] * since_s + kept[row] * since_s**2 / 2)

    def sample(at_s: FloatArray) -> FloatArray:
        sides = integrated_twice(at_s + width_s) + integrated_twice(at_s - width_s)
        return (sides - 2 * integrated_twice(at_s)) / width_s**2

    return sample


def interpolated(t_s: FloatArray, values: FloatArray) -> Sampler:
    """Linear interpolation between samples; NaN outside them and within gaps (`between_samples`)."""
    rows, kept = known_rows(t_s, values)
    if len(rows) < 2:
        return lambda at_s: np.full(np.shape(at_s), np.nan)
    known = between_samples(rows)
    return lambda at_s: np.where(known(at_s), np.interp(at_s, rows, kept), np.nan)


def between_samples(t_s: FloatArray) -> Callable[[FloatArray], NDArray[np.bool_]]:
    """Whether times lie on a sample (T,) or between two that are at most 3 median periods apart, so not in a gap."""
    longest_s = GAP_SAMPLES * float(np.median(np.diff(t_s)))

    def known(at_s: FloatArray) -> NDArray[np.bool_]:
        after = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
        on_sample = (at_s == t_s[after - 1]) | (at_s == t_s[after])
        inside = (at_s >= t_s[0]) & (at_s <= t_s[-1]) & (t_s[after] - t_s[after - 1] <= longest_s)
        return on_sample | inside

    return known


def known_rows(t_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times and values of the rows that have one."""
    known = np.isfinite(values)
    return t_s[known], values[known]


# --- Lag and gain ----------------------------------------------------------------------------------------------------


def estimate_slope(t_s: FloatArray, y: FloatArray, reference: Sampler, *, span_s: float) -> Slope:
    """Lag and gain of `y` behind a reference, by least squares of `y(t) = b x(t - lag) + a` over lag, b and a.

    The lag of greatest correlation on a grid of one frame starts it (of peaks as good, the one nearest zero), a bounded
    minimisation between frames finishes it. The standard deviations are of the sandwich `B S B`, B the inverse of
    J^T J, S the scores' covariance over time (whitened as an AR(1), Bartlett kernel, recoloured: Andrews and Monahan
    1992), so noise that is coloured or grows at oblique views is accounted for. What is not: errors of the reference.
    Its noise attenuates the gain, its quantisation at the stops biases it.

    Args:
        t_s: (T,) times of y [s].
        y: (T,) states with the sign of the reference; NaN where unknown.
        reference: states x at any time, same unit.
        span_s: the lag is looked for in +- this [s].

    Returns:
        NaN and None where one doesn't move, too few frames have both, or the best lag is at the end of the span.
    """
    period_s = period(t_s)
    some = slice(None, None, 1 + len(t_s) // MAX_COARSE_POINTS)
    lag_s = _coarse_lag(t_s[some], y[some], reference, grid(span_s, period_s))
    if lag_s is None:
        return Slope(np.nan, None, _gain(y, reference(t_s)), None)
    around = (lag_s - period_s, lag_s + period_s)
    used = np.isfinite(y) & np.isfinite(reference(t_s - around[0])) & np.isfinite(reference(t_s - around[1]))
    used &= np.isfinite(reference(t_s - lag_s))
    if np.count_nonzero(used) < MIN_FRAMES:
        return Slope(np.nan, None, _gain(y, reference(t_s - lag_s)), None)
    slope = _refined_slope(t_s[used], y[used], reference, around, period_s)
    if slope.influence_s is None:
        return slope
    influence_s = np.zeros(len(t_s))
    influence_s[used] = slope.influence_s
    return replace(slope, influence_s=influence_s)


def _refined_slope(
    t_s: FloatArray, y: FloatArray, reference: Sampler, around_s: tuple[float, float], period_s: float
) -> Slope:
    def misfit(lag_s: float) -> float:
        return 1.0 - correlation(y, _filled(reference(t_s - lag_s)))

    best: Any = minimize_scalar(misfit, bounds=around_s, method="bounded", options={"xatol": 1e-7})
    lag_s = float(best.x)
    x = _filled(reference(t_s - lag_s))
    gain = _gain(y, x)
    rate = (reference(t_s - lag_s + period_s / 2) - reference(t_s - lag_s - period_s / 2)) / period_s
    jacobian = np.stack([-gain * _filled(rate), x - x.mean(), np.ones_like(x)], axis=-1)
    residual = y - y.mean() - gain * (x - x.mean())
    influence = _influence(jacobian, residual)
    if influence is None:
        return Slope(lag_s, None, gain, None)
    variance = score_covariance(influence, ar1(residual))
    return Slope(lag_s, float(np.sqrt(variance[0, 0])), gain, float(np.sqrt(variance[1, 1])), influence[:, 0])


def _coarse_lag(t_s: FloatArray, y: FloatArray, reference: Sampler, lags_s: FloatArray) -> float | None:
    # A loop over lags: all of them at once would need lags x frames of memory, too much for hours of frames.
    return best_peak(lags_s, np.array([correlation(y, reference(t_s - lag_s)) for lag_s in lags_s]))


def best_peak(lags_s: FloatArray, agreement: FloatArray) -> float | None:
    """The lag of greatest agreement (L,), of peaks as good the one nearest zero; None where none stands out."""
    if not np.any(agreement > 0):
        return None
    r = np.where(np.isfinite(agreement), agreement, np.nanmin(agreement))
    height = float(np.ptp(r))
    peaks = find_peaks(r, prominence=PEAK_PROMINENCE * height)[0]
    if not len(peaks):
        return None
    as_good = lags_s[peaks[r[peaks] >= r[peaks].max() - PEAK_TOLERANCE * height]]
    return float(as_good[np.argmin(np.abs(as_good))])


def _influence(jacobian: FloatArray, residual: FloatArray) -> FloatArray | None:
    """(N, P) what each residual (N,) adds to the error of least squares; None where J (N, P) lacks rank.

    The covariance of their sum is the sandwich `B S B`, small samples allowed for by n / (n - p).
    """
    n, p = jacobian.shape
    scale = np.linalg.norm(jacobian, axis=0)
    if n <= p or np.any(scale <= 0) or np.linalg.cond(jacobian / scale) > 1e8:
        return None
    scores = (jacobian / scale) * residual[:, None]
    bread = np.asarray(np.linalg.inv((jacobian / scale).T @ (jacobian / scale)), dtype=np.float64)
    return scores @ bread / scale * np.sqrt(n / (n - p))


def ar1(values: FloatArray) -> float:
    """Correlation of neighbours in a series (N,), 0 to MAX_CORRELATION."""
    if not np.any(values):
        return 0.0
    rho = correlation(values[1:], values[:-1])
    return float(np.clip(rho, 0.0, MAX_CORRELATION)) if np.isfinite(rho) else 0.0


def score_covariance(scores: FloatArray, rho: float) -> FloatArray:
    """Covariance (P, P) of the sum of scores (N, P) that are correlated over time, by about `rho` with the next one.

    Whitened as an AR(1), Bartlett kernel, recoloured: Andrews and Monahan 1992.
    """
    return _long_run(scores[1:] - rho * scores[:-1]) / (1.0 - rho) ** 2


def _long_run(scores: FloatArray) -> FloatArray:
    """Covariance (P, P) of the sum of scores (N, P): Bartlett kernel, the customary bandwidth `4 (N / 100)^(2/9)`."""
    bandwidth = int(4.0 * (len(scores) / 100.0) ** (2 / 9))
    total = scores.T @ scores
    for shift in range(1, bandwidth + 1):
        at_shift = scores[shift:].T @ scores[:-shift]
        total += (1.0 - shift / (bandwidth + 1.0)) * (at_shift + at_shift.T)
    return total


def correlation(a: FloatArray, b: FloatArray) -> float:
    """Pearson's over frames with both; NaN for too few frames or one that doesn't vary."""
    both = np.isfinite(a) & np.isfinite(b)
    if np.count_nonzero(both) < MIN_FRAMES:
        return np.nan
    da, db = a[both] - a[both].mean(), b[both] - b[both].mean()
    # Sums, not BLAS dot products: those wake a pool of threads for each of hundreds of lags.
    norm = float(np.sqrt(np.sum(da * da) * np.sum(db * db)))
    return float(np.sum(da * db)) / norm if norm > 0 else np.nan


def _gain(y: FloatArray, x: FloatArray) -> float:
    both = np.isfinite(y) & np.isfinite(x)
    dx = x[both] - x[both].mean() if np.any(both) else np.zeros(1)
    return float(dx @ y[both] / (dx @ dx)) if dx @ dx > 0 else np.nan


def _filled(x: FloatArray) -> FloatArray:
    """The few frames that a lag moved off the reference take their neighbours' values."""
    known, row = np.isfinite(x), np.arange(len(x), dtype=np.float64)
    return np.asarray(np.interp(row, row[known], x[known]), dtype=np.float64)


def period(t_s: FloatArray) -> float:
    """Median time between rows, s; 1 where there is but one row."""
    return float(np.median(np.diff(t_s))) if len(t_s) > 1 else 1.0


def grid(span_s: float, step_s: float) -> FloatArray:
    """Lags from -span_s to span_s and a little over, zero among them."""
    steps = int(np.ceil(span_s / step_s))
    return np.arange(-steps, steps + 1, dtype=np.float64) * step_s


class Lagged(Protocol):
    """Anything with a lag and its standard deviation, s."""

    @property
    def lag_s(self) -> float: ...

    @property
    def lag_std_s(self) -> float | None: ...


def combined_lag(slopes: Iterable[Lagged]) -> tuple[float, float] | None:
    """Weighted mean of several joints' lags and its standard deviation [s], widened where they disagree."""
    known = [(one.lag_s, one.lag_std_s) for one in slopes if one.lag_std_s is not None and one.lag_std_s > 0]
    if not known:
        return None
    lags_s, std_s = np.array(known).T
    weight = std_s**-2
    mean_s = float(np.sum(weight * lags_s) / np.sum(weight))
    birge = float(np.sum(weight * (lags_s - mean_s) ** 2)) / max(len(known) - 1, 1)
    return mean_s, float(np.sqrt(max(birge, 1.0) / np.sum(weight)))


def shared_lag(slopes: Sequence[Slope]) -> tuple[float, float] | None:
    """The one lag of several joints seen in the same frames and its standard deviation [s]; None where none tells it.

    As `combined_lag`, and no surer than the frames allow: jitter of a frame's stamp moves all joints together, so that
    what a frame does to the mean is added up over the joints before its variance is taken.
    """
    combined = combined_lag(slopes)
    told = [(slope.lag_std_s**-2, slope.influence_s) for slope in slopes if slope.lag_std_s and slope.lag_std_s > 0]
    pooled = [weight * influence for weight, influence in told if influence is not None]
    if combined is None or not pooled:
        return combined
    series: FloatArray = np.sum(pooled, axis=0) / sum(weight for weight, _ in told)
    together = float(score_covariance(series[:, None], ar1(series))[0, 0])
    return combined[0], max(combined[1], float(np.sqrt(together)))
