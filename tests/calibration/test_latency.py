"""The camera's latency, found in made images of one joint that swings to and fro."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibration.errors import CalibrationError
from calibration.latency import Sweep, estimate_latency, smoothed

FPS, READINGS_HZ = 30.0, 50.0
AX_COUNT_DEG = 300 / 1023
LEGS = ((15, 45.0), (-15, 37.0), (15, 41.0), (-15, 34.0), (0, 43.0))


def swings(legs=LEGS) -> tuple[np.ndarray, np.ndarray]:
    """Joint angle (deg) over time, each ms: legs at their speeds with rests, its corners rounded as servos do."""
    t_s, q_deg = [0.0, 0.4], [0.0, 0.0]
    for target, speed in legs:
        t_s += [t_s[-1] + abs(target - q_deg[-1]) / speed]
        q_deg += [target, target]
        t_s += [t_s[-1] + 0.25]
    fine_s = np.arange(0, t_s[-1] + 0.4, 1e-3)
    window = np.hanning(81) / np.sum(np.hanning(81))
    return fine_s, np.convolve(np.pad(np.interp(fine_s, t_s, q_deg), 40, mode="edge"), window, "valid")


def made_sweep(
    seed: int,
    latency_s: float,
    *,
    count_deg: float = AX_COUNT_DEG,
    jitter_s: float = 1e-3,
    noise_px: float = 0.1,
    readout_s: float = 0.0,
    late_readback_s: float = 0.0,
    legs=LEGS,
    joint: str = "elbow",
) -> Sweep:
    """24 coordinates that move by up to 40 px, 8 that don't; all are seen in the lower part of the frame."""
    rng = np.random.default_rng(seed)
    fine_s, fine_deg = swings(legs)
    end_s = fine_s[-1]
    read_s = np.arange(rng.uniform(0, 1 / READINGS_HZ), end_s, 1 / READINGS_HZ)
    states = np.radians(np.round(np.interp(read_s - late_readback_s, fine_s, fine_deg) / count_deg) * count_deg)
    middle_s = np.arange(rng.uniform(0, 1 / FPS), end_s, 1 / FPS)
    radius, angle = rng.uniform(50, 150, 32), rng.uniform(0, 2 * np.pi, 32)
    radius[24:] = 0.0
    later_s = np.linspace(0.2, 0.5, 32) * readout_s
    q = np.radians(np.interp(middle_s[:, None] + later_s, fine_s, fine_deg))
    px = 240 + radius * np.cos(angle + q) / (1 + 0.2 * np.sin(angle + q))
    stamp_s = middle_s + latency_s + rng.normal(0, jitter_s, len(middle_s))
    t_s = np.broadcast_to(stamp_s[:, None], px.shape) + later_s
    return Sweep(joint, t_s, px + rng.normal(0, noise_px, px.shape), read_s, states)


@pytest.mark.parametrize("latency_s", [0.0, 0.005, 0.010, 0.020, 0.033, 0.050, 0.080, 0.120, 0.3, -0.02])
def test_a_latency_is_found_to_a_part_of_a_frame(latency_s: float):
    found = estimate_latency([made_sweep(1, latency_s)])
    # Half a count of rounding on about 90 readings in motion at 40 deg/s, and 1 ms of jitter: 0.2 ms.
    assert found.latency_s == pytest.approx(latency_s, abs=0.8e-3)
    assert 0.05e-3 < found.std_s < 0.5e-3


@pytest.mark.parametrize(
    "noise",
    [
        {},
        {"jitter_s": 3e-3},
        {"count_deg": 360 / 4096, "jitter_s": 1e-5, "noise_px": 0.5},
        {"count_deg": AX_COUNT_DEG, "jitter_s": 1e-5, "noise_px": 0.02},
    ],
    ids=["all", "jitter", "corners", "rounding"],
)
def test_the_standard_deviation_covers_the_error_whatever_makes_it(noise: dict[str, float]):
    found = [estimate_latency([made_sweep(seed, 0.033, **noise)]) for seed in range(30)]
    normalised = np.array([(each.latency_s - 0.033) / each.std_s for each in found])
    # Of 30 draws the root of the mean square is 1 within 0.26 (two sigma). Rounding is stated as if each reading had
    # its own; at steady speeds much of it averages out, or repeats.
    assert 0.25 < np.sqrt(np.mean(normalised**2)) < 1.3


def test_rows_of_a_rolling_shutter_count_at_their_own_times():
    sweep = made_sweep(2, 0.033, readout_s=0.03)
    assert estimate_latency([sweep]).latency_s == pytest.approx(0.033, abs=0.8e-3)
    at_once = replace(sweep, t_s=np.broadcast_to(sweep.t_s[:, :1], sweep.t_s.shape))
    assert estimate_latency([at_once]).latency_s == pytest.approx(0.033 - 0.15 * 0.03, abs=1e-3)


def test_wrong_corners_and_gaps_do_not_sway_it():
    sweep = made_sweep(3, 0.05)
    px = np.array(sweep.px)
    px[20:40, :8] = np.nan
    px[60:64, 8:16] += 80.0
    assert estimate_latency([replace(sweep, px=px)]).latency_s == pytest.approx(0.05, abs=0.8e-3)


def test_several_joints_give_one_latency_and_the_one_that_disagrees_is_named():
    sweeps = [
        made_sweep(4, 0.05, joint="pan"),
        made_sweep(5, 0.05, joint="lift"),
        made_sweep(6, 0.05, joint="wrist", late_readback_s=0.02),
    ]
    agreeing = estimate_latency(sweeps[:2])
    assert agreeing.latency_s == pytest.approx(0.05, abs=0.6e-3) and not agreeing.warnings
    odd = estimate_latency(sweeps)
    assert odd.std_s > 4e-3  # as they disagree
    (warning,) = odd.warnings
    assert warning.startswith(("wrist alone says 30.", "wrist alone says 29."))


def test_what_request_and_reply_leave_open_is_in_the_standard_deviation():
    sweep = made_sweep(7, 0.05)
    alone, open_s = estimate_latency([sweep]), 6e-3
    assert estimate_latency([sweep], reply_s=open_s).std_s == pytest.approx(np.hypot(alone.std_s, open_s / np.sqrt(12)))


def test_one_way_at_a_steady_speed_tells_no_latency():
    there = made_sweep(8, 0.05, legs=((60, 40.0),))
    moving = (there.readback > np.radians(6)) & (there.readback < np.radians(54))
    with pytest.raises(CalibrationError, match="latency"):
        estimate_latency([replace(there, readback_t_s=there.readback_t_s[moving], readback=there.readback[moving])])


def test_markers_that_move_otherwise_than_the_joint_show_no_latency():
    sweep = made_sweep(9, 0.05)
    rng = np.random.default_rng(0)
    with pytest.raises(CalibrationError, match=r"latency"):
        estimate_latency([replace(sweep, px=np.cumsum(rng.normal(0, 1, sweep.px.shape), axis=0))])


def test_without_motion_there_is_nothing_to_tell():
    sweep = made_sweep(10, 0.05)
    with pytest.raises(CalibrationError, match="no joint moved alone"):
        estimate_latency([])
    with pytest.raises(CalibrationError, match="no joint moved alone"):
        estimate_latency([replace(sweep, readback=np.zeros(len(sweep.readback)))])
    with pytest.raises(CalibrationError, match="shapes"):
        replace(sweep, px=sweep.px[:, :3])


def test_the_spline_of_a_read_back_moves_nothing_and_ends_where_it_does():
    t_s = np.sort(np.random.default_rng(1).uniform(0, 4, 200))
    state, rate = smoothed(t_s, 3 * t_s)
    inside = np.linspace(t_s[3], t_s[-4], 999)
    inside = inside[np.isfinite(state(inside))]
    assert np.allclose(state(inside), 3 * inside) and np.allclose(rate(inside), 3)
    assert np.isnan(state(np.array([t_s[0] - 1e-6, t_s[-1] + 1e-6]))).all()
    gap_s = np.concatenate([np.arange(0, 1, 0.02), np.arange(2, 3, 0.02)])
    assert np.isnan(smoothed(gap_s, gap_s)[0](np.array([1.5]))).all()
