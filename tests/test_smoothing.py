import numpy as np
import pytest

from station.errors import InvalidData
from station.kinematics import se3
from station.logs import FloatArray, PoseLog
from station.smoothing import smooth

FPS = 30.0
CUTOFF_HZ = 3.0


def motion(t_s: FloatArray) -> FloatArray:
    """(T, 4, 4) a slow turn with a slow sway."""
    turn, zero = 1.5 * np.sin(2 * np.pi * 0.2 * t_s), np.zeros_like(t_s)
    return se3.pose(
        se3.exp_so3(np.stack([zero, 0.3 * turn, turn], axis=-1)), np.stack([0.1 * turn, zero, zero + 0.6], axis=-1)
    )


def log_of(T: FloatArray) -> PoseLog:
    return PoseLog(np.arange(len(T)) / FPS, "camera", ("a",), T[:, None])


def test_noise_falls_and_motion_stays_without_delay() -> None:
    truth = motion(np.arange(300) / FPS)
    noise = np.random.default_rng(0).normal(size=(300, 6)) * 0.01  # m, rad
    smoothed = smooth(log_of(truth @ se3.exp(noise)), CUTOFF_HZ).T_ref_part[:, 0]
    error = se3.log(se3.inverse(truth) @ smoothed)
    # Of the noise's 15 Hz of bandwidth 3 Hz stay: sqrt(3 / 15) = 0.45 of it; a delay of a frame would cost 0.06 rad.
    assert np.sqrt(np.mean(error**2)) < 0.5 * 0.01
    clean = smooth(log_of(truth), CUTOFF_HZ).T_ref_part[:, 0]
    assert np.abs(se3.log(se3.inverse(truth) @ clean))[20:-20].max() < 2e-3  # m, rad


def test_gaps_stay_gaps_and_do_not_mix() -> None:
    T = motion(np.arange(120) / FPS)
    T[50:55] = np.nan
    T[60:] = T[60] @ se3.translation(np.array([5.0, 0, 0]))
    T[57:60] = np.nan
    smoothed = smooth(log_of(T), CUTOFF_HZ)
    np.testing.assert_array_equal(smoothed.seen, log_of(T).seen)
    np.testing.assert_array_equal(smoothed.T_ref_part[55:57, 0], T[55:57])  # too short a run to filter
    np.testing.assert_allclose(smoothed.T_ref_part[60:, 0], T[60:], atol=1e-9)


@pytest.mark.parametrize("cutoff_hz", [0.0, 16.0, np.nan])
def test_a_cutoff_that_the_frame_rate_cannot_have_is_refused(cutoff_hz: float) -> None:
    with pytest.raises(InvalidData, match="half the frame rate, 15 Hz"):
        smooth(log_of(motion(np.arange(60) / FPS)), cutoff_hz)
