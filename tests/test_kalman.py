"""The Kalman smoother on SE(3): what it promises of its covariances holds, and gaps and outliers do no harm."""

import numpy as np
import pytest

from station.errors import InvalidData
from station.kalman import estimate_noise, kalman_smooth
from station.kinematics import se3
from station.logs import FloatArray, PoseLog
from station.smoothing import SMOOTHERS, smoother

FPS = 30.0
NOISE = np.array([[0.02, 0.5]])  # m^2/s^3, rad^2/s^3
SIGMA = np.array([0.001, 0.001, 0.003, 0.03, 0.03, 0.005])  # m, rad: the tilt is the least certain


def walk(rng: np.random.Generator, frames: int, noise: FloatArray) -> FloatArray:
    """(F, 4, 4) a part whose twist changes by white noise of densities (2,)."""
    sub, dt = 10, 1 / FPS / 10
    T, v = np.broadcast_to(np.eye(4), (frames, 4, 4)).copy(), rng.normal(size=6) * 0.05
    T[0, 2, 3] = 0.6
    for n in range(1, frames):
        here = T[n - 1]
        for _ in range(sub):
            v = v + rng.normal(size=6) * np.sqrt(np.repeat(noise, 3) * dt)
            here = here @ se3.exp(v * dt)
        T[n] = here
    return T


def measured(truth: FloatArray, rng: np.random.Generator, sigma: FloatArray = SIGMA) -> PoseLog:
    T = truth @ se3.exp(rng.normal(size=(len(truth), 6)) * sigma)
    covariance = np.broadcast_to(np.diag(sigma**2), (len(truth), 1, 6, 6))
    return PoseLog(np.arange(len(truth)) / FPS, "camera", ("lid",), T[:, None], covariance)


def normalised(log: PoseLog, truth: FloatArray) -> FloatArray:
    """(F,) squared errors in units of the stated covariance, over 6."""
    assert log.covariance is not None
    error = se3.log(se3.inverse(truth) @ log.T_ref_part[:, 0])
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(log.covariance[:, 0]), error) / 6


def rms(log: PoseLog, truth: FloatArray) -> FloatArray:
    error = se3.log(se3.inverse(truth) @ log.T_ref_part[:, 0])
    return np.sqrt(np.nanmean(error**2, axis=0))


def with_poses(log: PoseLog, T: FloatArray, covariance: FloatArray | None) -> PoseLog:
    return PoseLog(log.t_s, log.reference, log.parts, T, covariance)


@pytest.mark.parametrize("given", [True, False])
def test_errors_fall_and_stated_covariances_are_honest(given: bool) -> None:
    found = []
    for seed in range(4 if given else 1):
        rng = np.random.default_rng(seed)
        truth = walk(rng, 250, NOISE[0])
        log = measured(truth, rng)
        smoothed = kalman_smooth(log, noise=NOISE if given else None)
        assert np.all(rms(smoothed, truth)[3:5] < 0.5 * rms(log, truth)[3:5])  # the tilts
        found.append(normalised(smoothed, truth).mean())
    # Up to 1000 frames whose errors hold together over about ten each: 100 chi-squared of 6 over 6, 1 +- 0.06.
    assert 0.8 < np.mean(found) < 1.25


def test_the_noise_of_the_motion_is_found_to_a_factor_of_four() -> None:
    rng = np.random.default_rng(5)
    log = measured(walk(rng, 300, NOISE[0]), rng)
    assert np.all(np.abs(np.log10(estimate_noise(log) / NOISE)) < np.log10(4.0))


def test_unseen_stays_unseen_and_only_short_gaps_are_filled_when_asked() -> None:
    rng = np.random.default_rng(1)
    truth = walk(rng, 200, NOISE[0])
    log = measured(truth, rng)
    T, covariance = np.array(log.T_ref_part), np.array(log.covariance)
    for gap in (slice(0, 3), slice(50, 54), slice(100, 130), slice(195, 200)):
        T[gap], covariance[gap] = np.nan, np.nan
    gappy = with_poses(log, T, covariance)
    np.testing.assert_array_equal(kalman_smooth(gappy, noise=NOISE).seen, gappy.seen)
    filled = kalman_smooth(gappy, noise=NOISE, fill_s=0.2)
    want = gappy.seen.copy()
    want[50:54] = True
    np.testing.assert_array_equal(filled.seen, want)
    inside = normalised(filled, truth)[50:54]
    assert np.all(inside < 4)
    assert filled.covariance is not None
    assert np.trace(filled.covariance[52, 0]) > np.trace(filled.covariance[40, 0])


def test_what_was_not_observed_is_not_made_up() -> None:
    rng = np.random.default_rng(2)
    truth = walk(rng, 150, NOISE[0])
    log = measured(truth, rng)
    covariance = np.array(log.covariance)
    covariance[..., 3:, :] = covariance[..., :, 3:] = 0.0
    covariance[..., [3, 4, 5], [3, 4, 5]] = np.inf
    T = np.array(log.T_ref_part)
    T[..., :3, :3] = np.eye(3)
    smoothed = kalman_smooth(with_poses(log, T, covariance), noise=NOISE)
    assert smoothed.covariance is not None
    variance = np.diagonal(smoothed.covariance[:, 0], axis1=-2, axis2=-1)
    assert np.all(np.isinf(variance[:, 3:])) and np.all(variance[:, :3] < SIGMA[2] ** 2)


def test_an_outlier_does_not_drag_its_neighbours_along() -> None:
    rng = np.random.default_rng(3)
    truth = walk(rng, 150, NOISE[0])
    log = measured(truth, rng)
    T = np.array(log.T_ref_part)
    T[70, 0] = T[70, 0] @ se3.exp(np.array([0.05, 0, 0, 0, 0.8, 0]))
    smoothed = kalman_smooth(with_poses(log, T, log.covariance), noise=NOISE)
    clean = kalman_smooth(log, noise=NOISE)
    apart = se3.log(se3.inverse(clean.T_ref_part[:, 0]) @ smoothed.T_ref_part[:, 0])
    assert np.abs(apart[:, 4]).max() < 2 * SIGMA[4]


def test_a_log_without_covariances_is_refused() -> None:
    rng = np.random.default_rng(4)
    log = measured(walk(rng, 20, NOISE[0]), rng)
    with pytest.raises(InvalidData, match="unknown covariance"):
        kalman_smooth(with_poses(log, log.T_ref_part, None))


def test_parts_that_were_never_seen_stay_so() -> None:
    nothing = PoseLog(
        np.arange(5) / FPS, "camera", ("lid",), np.full((5, 1, 4, 4), np.nan), np.full((5, 1, 6, 6), np.nan)
    )
    assert not kalman_smooth(nothing).seen.any()


@pytest.mark.parametrize("name", SMOOTHERS)
def test_every_smoother_keeps_what_was_seen_and_lowers_noise(name: str) -> None:
    rng = np.random.default_rng(6)
    truth = walk(rng, 200, NOISE[0])
    log = measured(truth, rng)
    smoothed = smoother(f"{name}:{5 if name == 'lowpass' else 0}")(log)
    np.testing.assert_array_equal(smoothed.seen, log.seen)
    assert np.all(rms(smoothed, truth)[3:5] < rms(log, truth)[3:5])


@pytest.mark.parametrize("text", ["median", "lowpass", "lowpass:fast", "kalman:-1", "lowpass:nan", ""])
def test_a_smoother_that_there_is_not_is_refused_with_the_choices(text: str) -> None:
    with pytest.raises(InvalidData, match=r"lowpass|kalman"):
        smoother(text)
