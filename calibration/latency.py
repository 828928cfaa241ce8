"""A camera's latency against the servos' read-back: found in the images, between frames, with its standard deviation.

While one joint moves alone, each coordinate of each marker corner is a smooth function of its state, whatever the
mechanism and the lens: `u_k(t) = f_k(q(t - latency))`. The functions are polynomials; the latency is what makes them
fit best, to and fro: no function of q can take one way for the other. No pose and no calibration is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.optimize import minimize_scalar

from calibration.errors import CalibrationError
from calibration.lag import (
    MIN_FRAMES,
    FloatArray,
    Sampler,
    ar1,
    best_peak,
    between_samples,
    combined_lag,
    grid,
    known_rows,
    score_covariance,
)

Mask = NDArray[np.bool_]

# Latencies are looked for from minus to plus this: webcams have 30 to 150 ms, network cameras some hundreds.
SPAN_S = 0.5
# Of the polynomials in a joint's state: over 40 deg an image coordinate differs from it by some hundredths of a pixel.
DEGREE = 4
# A coordinate that is off its polynomial by more robust standard deviations than this is another marker's, or a wrong
# corner's. Generous: where joints move, the read-back's rounding and the stamps' jitter count, at rest they don't.
OUTLIER_SIGMAS = 30.0
ROUNDS = 2
# px. Signals are never taken as better than this, so that a still marker's hundredths don't make outliers.
LEAST_SIGMA_PX = 0.02
# s. Between the knots beyond either end of the read-back: next to nothing, so that the spline ends where it does.
END_KNOTS_S = 1e-9
# Of the squared speeds of a sweep's coordinates: what functions of the joint's state must leave, or it tells nothing.
LEAST_SHARE = 0.1
# A latency of which less is known than this is no result.
WORST_STD_S = 0.01
# Joints that disagree by more than this many standard deviations, and by this much, are worth a word.
DISAGREEING_SIGMAS, DISAGREEING_S = 4.0, 0.003


@dataclass(frozen=True, eq=False)
class Sweep:
    """One joint moves, all others stand still, and a camera looks on.

    Attributes:
        joint: its name.
        t_s: (F, S) stamps of S image coordinates in F frames; rows of a rolling shutter have their own [s].
        px: (F, S) the coordinates; NaN where not seen.
        readback_t_s, readback: (N,) stamps and states of the joint, while only it moved; rad or m.

    Raises:
        CalibrationError: for shapes that don't agree.
    """

    joint: str
    t_s: FloatArray
    px: FloatArray
    readback_t_s: FloatArray
    readback: FloatArray

    def __post_init__(self) -> None:
        if self.t_s.ndim != 2 or self.t_s.shape != self.px.shape or self.readback_t_s.shape != self.readback.shape:
            have = f"{self.t_s.shape} and {self.px.shape}, {self.readback_t_s.shape} and {self.readback.shape}"
            raise CalibrationError(f"sweep of {self.joint}: shapes {have}; want each pair alike, the first (frames, S)")


@dataclass(frozen=True)
class JointLatency:
    """What one joint's sweeps say; of the standard deviation None where they say nothing."""

    joint: str
    lag_s: float
    lag_std_s: float | None
    frames: int


@dataclass(frozen=True)
class Latency:
    """How much later than it was exposed a frame is stamped.

    Attributes:
        latency_s: from the middle of the exposure (of the middle row) to the stamp [s].
        std_s: its standard deviation, widened where joints disagree.
        joints: what each joint alone says.
        warnings: what is doubtful, in words.
    """

    latency_s: float
    std_s: float
    joints: tuple[JointLatency, ...]
    warnings: tuple[str, ...] = ()


def estimate_latency(sweeps: Sequence[Sweep], *, reply_s: float = 0.0, span_s: float = SPAN_S) -> Latency:
    """Least squares over the latency and the polynomials of all image coordinates; one latency for all joints.

    Coarsely by the share of the variance that the polynomials explain, over all sweeps; finely joint by joint. The
    standard deviations hold for noise that is shared by all coordinates of a frame (jitter of its stamp, rounding of
    the read-back) and for noise that is correlated over time.

    Args:
        reply_s: from request to reply of one joint. Its state is stamped midway, and may be of any time in between:
            that is in the standard deviation, as a uniform distribution.
        span_s: latencies are looked for from minus to plus this.

    Raises:
        CalibrationError: nothing moved enough before the camera, or no latency within `span_s` stands out.
    """
    signals = [signal for sweep in sweeps if (signal := _Signals.of(sweep)) is not None]
    if not signals:
        raise CalibrationError(
            "no joint moved alone before the camera, to and fro and with markers in view\n"
            "move one joint at a time by 10 deg or more: station calibrate latency RIG --out DIR does that"
        )
    frame_s = float(np.median([signal.period_s for signal in signals]))
    lags_s = grid(span_s, frame_s / 2)
    coarse_s = best_peak(lags_s, np.array([_explained(signals, lag_s) for lag_s in lags_s]))
    if coarse_s is None:
        raise CalibrationError(
            f"no latency within {span_s:g} s makes the markers' motion that of the joints\n"
            "look whether the markers on what moves are in view, and whether the read-back is that of this arm"
        )
    signals = [signal for signal in signals if _to_and_fro(signal, coarse_s)]
    joints = [
        _joint_latency(name, [signal for signal in signals if signal.joint == name], coarse_s, frame_s)
        for name in dict.fromkeys(signal.joint for signal in signals)
    ]
    return _combined(joints, reply_s)


def _combined(joints: Sequence[JointLatency], reply_s: float) -> Latency:
    together = combined_lag(joints)
    usual_s = float(np.median([joint.lag_s for joint in joints])) if joints else np.nan
    if together is None or together[1] > WORST_STD_S:
        said = "" if together is None else f" to better than {together[1] * 1e3:.0f} ms"
        raise CalibrationError(
            f"the latency can't be told{said}: the joints moved too little, too slowly or one way only\n"
            "move a joint to and fro by 10 deg or more: station calibrate latency RIG --out DIR does that"
        )
    latency_s, std_s = together[0], float(np.hypot(together[1], reply_s / np.sqrt(12)))
    warnings = tuple(
        f"{joint.joint} alone says {joint.lag_s * 1e3:.1f} ms: its read-back or its link lags otherwise than the rest"
        for joint in joints
        if joint.lag_std_s is not None
        and abs(joint.lag_s - usual_s) > max(DISAGREEING_SIGMAS * joint.lag_std_s, DISAGREEING_S)
    )
    return Latency(latency_s, std_s, tuple(joints), warnings)


@dataclass(frozen=True, eq=False)
class _Signals:
    """A sweep's image coordinates that can be used, and its joint's state at any time, scaled to -1 to 1.

    Attributes:
        state, rate: at any time.
        count: the smallest step of the read-back, scaled likewise.
    """

    joint: str
    t_s: FloatArray
    px: FloatArray
    state: Sampler
    rate: Sampler
    readback_t_s: FloatArray
    count: float

    @property
    def period_s(self) -> float:
        """Between frames."""
        return float(np.median(np.diff(self.t_s[:, 0])))

    @staticmethod
    def of(sweep: Sweep) -> _Signals | None:
        """None where too few frames or readings are there."""
        enough = np.count_nonzero(np.isfinite(sweep.px), axis=0) >= MIN_FRAMES + DEGREE
        rows, states = known_rows(sweep.readback_t_s, sweep.readback)
        if not np.any(enough) or len(rows) < MIN_FRAMES or np.ptp(states) <= 0:
            return None
        scaled: FloatArray = 2 * (states - states.min()) / np.ptp(states) - 1
        steps: FloatArray = np.diff(np.sort(np.round(scaled, 9)))
        return _Signals(
            sweep.joint,
            sweep.t_s[:, enough],
            sweep.px[:, enough],
            *smoothed(rows, scaled),
            rows,
            float(steps[steps > 0].min()),
        )

    def without(self, outliers: Mask) -> _Signals:
        """The same less some coordinates."""
        return replace(self, px=np.where(outliers, np.nan, self.px))


def smoothed(t_s: FloatArray, values: FloatArray) -> tuple[Sampler, Sampler]:
    """Values and their rate at any time by a cubic spline that has the samples as its coefficients; NaN outside.

    It passes near the samples, not through them: their noise and rounding weigh alike at each time, where linear
    interpolation has half the variance midway between samples, which would draw a lag there. Symmetric: moves no lag.
    """
    beyond = END_KNOTS_S * np.arange(1, 4)
    knots = np.concatenate([t_s[0] - beyond[::-1], t_s, t_s[-1] + beyond])
    centres = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3
    spline = BSpline(knots, np.interp(centres, t_s, values), 3)
    slope = spline.derivative()
    known = between_samples(t_s)

    def sampler(function: Callable[[FloatArray], Any]) -> Sampler:
        return lambda at_s: np.where(known(at_s), function(np.clip(at_s, t_s[0], t_s[-1])), np.nan)

    return sampler(spline), sampler(slope)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Polynomials (S, D) at one latency, and what they leave.

    Attributes:
        basis: (F, S, D) powers of the state, zero where unused.
        residual: (F, S) zero where unused.
        used: (F, S).
    """

    basis: FloatArray
    coefficients: FloatArray
    residual: FloatArray
    used: Mask
    q: FloatArray

    def projected(self, column: FloatArray) -> FloatArray:
        """What of a column (F, S) the polynomials can't take up."""
        return np.where(self.used, column - _solved(self.basis, column)[1], 0.0)


def _solved(basis: FloatArray, column: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares of each signal: coefficients (S, D) and what they give (F, S)."""
    normal = np.einsum("fsd,fse->sde", basis, basis)
    right = np.einsum("fsd,fs->sd", basis, column)
    inverse = np.asarray(np.linalg.pinv(normal, hermitian=True), dtype=np.float64)
    coefficients = np.einsum("sde,se->sd", inverse, right)
    return coefficients, np.einsum("fsd,sd->fs", basis, coefficients)


def _fit(signals: _Signals, lag_s: float, used: Mask | None = None) -> _Fit:
    q = signals.state(signals.t_s - lag_s)
    known = np.isfinite(signals.px) & np.isfinite(q)
    known = known if used is None else known & used
    q = np.where(known, q, 0.0)
    basis = np.asarray(chebyshev.chebvander(q, DEGREE) * known[..., None], dtype=np.float64)
    px = np.where(known, signals.px, 0.0)
    coefficients, fitted = _solved(basis, px)
    return _Fit(basis, coefficients, np.where(known, px - fitted, 0.0), known, q)


def _explained(signals: Sequence[_Signals], lag_s: float) -> float:
    """The share of the coordinates' variance that polynomials of the joints' states explain at a latency."""
    left = total = 0.0
    for each in signals:  # sweeps differ in their frames
        fit = _fit(each, lag_s)
        count = np.maximum(fit.used.sum(axis=0), 1)
        px = np.where(fit.used, each.px, 0.0)
        about = np.where(fit.used, px - px.sum(axis=0) / count, 0.0)
        left += float(np.sum(fit.residual**2))
        total += float(np.sum(about**2))
    return 1.0 - left / total if total > 0 else np.nan


def _joint_latency(joint: str, signals: Sequence[_Signals], coarse_s: float, frame_s: float) -> JointLatency:
    lag_s, around = coarse_s, frame_s
    for _ in range(ROUNDS):  # outliers are told from the fit without those before
        lag_s = _finest(signals, lag_s, around)
        signals = [each.without(_outliers(_fit(each, lag_s))) for each in signals]
    lag_s = _finest(signals, lag_s, around)
    frames = sum(int(np.count_nonzero(_fit(each, lag_s).used.any(axis=1))) for each in signals)
    variance = _variance(signals, lag_s) if abs(lag_s - coarse_s) < around else None
    return JointLatency(joint, lag_s, None if variance is None else float(np.sqrt(variance)), frames)


def _finest(signals: Sequence[_Signals], lag_s: float, around_s: float) -> float:
    """The latency of least squares within `around_s`, over the coordinates that count at all latencies there."""
    ends = [lag_s - 2 * around_s, lag_s + 2 * around_s]
    used = [np.logical_and(*(np.isfinite(each.state(each.t_s - end)) for end in ends)) for each in signals]

    def misfit(at_s: float) -> float:
        fits = (_fit(each, at_s, kept) for each, kept in zip(signals, used, strict=True))
        return sum(float(np.sum(fit.residual**2)) for fit in fits)

    bounds = (lag_s - around_s, lag_s + around_s)
    best: Any = minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": 1e-6})
    return float(best.x)


def _outliers(fit: _Fit) -> Mask:
    """Coordinates (F, S) far from their polynomial, by the median of the frames' residuals."""
    residual = np.where(fit.used, np.abs(fit.residual), np.nan)
    seen = fit.used.any(axis=0)
    sigma_px = np.full(residual.shape[1], np.inf)
    sigma_px[seen] = np.maximum(1.4826 * np.nanmedian(residual[:, seen], axis=0), LEAST_SIGMA_PX)
    return fit.used & (np.abs(fit.residual) > OUTLIER_SIGMAS * sigma_px)


def _variance(signals: Sequence[_Signals], lag_s: float) -> float | None:
    """Variance of the latency, the polynomials being as unknown as it; None where the frames say nothing of it.

    A sandwich as in `calibration.lag`, with the scores of all coordinates of a frame added up before they are squared:
    jitter of its stamp and rounding of the read-back move them together. No less than what rounding alone does:
    at a steady speed its errors may repeat from one way to the next, which no residual shows.
    """
    information, scores, weights = 0.0, list[FloatArray](), list[FloatArray]()
    for each in signals:  # sweeps differ in their frames
        fit = _fit(each, lag_s)
        alone = fit.projected(_moved(each, fit, lag_s))
        information += float(np.sum(alone**2))
        weights.append(np.sum(alone**2, axis=1))
        scores.append(np.sum(alone * fit.residual, axis=1)[fit.used.any(axis=1)])
    series = np.concatenate(scores)
    if information <= 0 or len(series) < MIN_FRAMES:
        return None
    correlated = float(score_covariance(series[:, None], ar1(series))[0, 0])
    frames = information**2 / float(np.sum(np.concatenate(weights) ** 2))  # as many as tell something
    spread = max(correlated, float(np.sum(series**2))) * frames / max(frames - DEGREE - 2, 1.0)
    return max(spread / information**2, _rounding_variance(signals))


def _moved(signals: _Signals, fit: _Fit, lag_s: float) -> FloatArray:
    """(F, S) speed of each coordinate, per second; zero where unused."""
    slope = chebyshev.chebval(fit.q, chebyshev.chebder(fit.coefficients.T)[:, None], tensor=False)
    return np.where(fit.used, np.nan_to_num(signals.rate(signals.t_s - lag_s)) * np.asarray(slope), 0.0)


def _to_and_fro(signals: _Signals, lag_s: float) -> bool:
    """Whether a sweep tells a latency: at a steady speed one way, functions of the state can take up any."""
    fit = _fit(signals, lag_s)
    moved = _moved(signals, fit, lag_s)
    return bool(np.sum(fit.projected(moved) ** 2) > LEAST_SHARE * np.sum(moved**2) > 0)


def _rounding_variance(signals: Sequence[_Signals]) -> float:
    """Variance of the latency if each reading were off by a count's rounding, and nothing else were."""
    information = noise = 0.0
    for each in signals:  # sweeps differ in their readings
        speed = np.sum(np.nan_to_num(each.rate(each.readback_t_s)) ** 2)
        information += float(speed)
        noise += float(speed) * each.count**2 / 12
    return noise / information**2 if information > 0 else np.inf
