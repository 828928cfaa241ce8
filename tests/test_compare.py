"""Claims of station/compare.py and comparison_files.py, against synthetic truth."""

import csv
import io
import itertools
import json

import numpy as np
import pytest

from calibration.lag import Slope, combined_lag, estimate_slope, held, held_smooth, interpolated
from station.compare import Comparison, JointComparison, compare
from station.comparison_files import comparison_csv, comparison_json
from station.errors import InvalidData
from station.logs import FloatArray, JointLog
from station.session_lag import estimate_session_lag

DURATION_S = 24.0
FPS = 30.0
LAG_S = 0.037
GAIN = 0.98
NOISE_RAD = np.radians(0.3)
COMMANDS_RAD = np.radians([[0, 0], [60, 0], [-60, 0], [0, 0], [0, 40], [0, -30], [45, 30], [0, 0]])
COMMAND_TIMES_S = np.arange(8) * 3.0
SPEED_RAD_S = np.radians([70.0, 40.0])


def follow(targets: FloatArray, speed: float):
    """The shaft of a servo of limited speed: exact, piecewise linear between corners."""
    times, states = [0.0], [0.0]
    for start_s, target in zip(COMMAND_TIMES_S, targets, strict=True):
        travel_s = abs(target - states[-1]) / speed
        times += [start_s + 1e-9, start_s + 1e-6 + travel_s]
        states += [states[-1], target]
    return lambda t_s: np.interp(t_s, times, states)


TRUE = tuple(follow(COMMANDS_RAD[:, j], SPEED_RAD_S[j]) for j in range(2))


def commands(shift_s: float = 0.0) -> JointLog:
    return JointLog(COMMAND_TIMES_S + shift_s, ("pan", "lift"), COMMANDS_RAD, ("rad", "rad"))


def readback(shift_s: float = 0.0) -> JointLog:
    t_s = np.arange(0.0, DURATION_S, 0.02)
    return JointLog(t_s + shift_s, ("pan", "lift"), np.stack([q(t_s) for q in TRUE], -1), ("rad", "rad"))


def detection(rng: np.random.Generator, *, signs=(-1, 1), gains=(GAIN, 1.0), noise=NOISE_RAD, lag_s=LAG_S) -> JointLog:
    """`lift` first, signs and zeros of the fit's own, a tenth of the frames missing."""
    t_s = np.arange(0.2, DURATION_S, 1 / FPS)
    parts = zip(TRUE, signs, gains, (0.5, -2.0), strict=True)
    q = np.stack([sign * (gain * true(t_s - lag_s)) + zero for true, sign, gain, zero in parts], -1)
    q = q + noise * rng.normal(size=q.shape)
    q[rng.random(q.shape) < 0.1] = np.nan
    return JointLog(t_s, ("b__c", "a__b"), q[:, ::-1], ("rad", "rad"), np.full(q.shape, noise))


FITTED = ("a__b", "b__c")


def joint_named(comparison: Comparison, name: str) -> JointComparison:
    return next(joint for joint in comparison.joints if joint.joint == name)


def test_a_command_holds_until_the_next_and_is_unknown_before_the_first():
    sampler = held(np.array([1.0, 2.0, 3.0]), np.array([5.0, np.nan, 7.0]))
    np.testing.assert_array_equal(sampler(np.array([0.9, 1.0, 2.5, 3.0, 99.0])), [np.nan, 5.0, 5.0, 7.0, 7.0])


def test_the_smoothed_hold_is_its_mean_under_a_triangle():
    times, values = np.array([0.0, 1.0, 1.3, 4.0]), np.array([2.0, -1.0, 4.0, 0.5])
    width_s, fine_s = 0.4, 1e-4
    at_s = np.linspace(0.5, 5.0, 19)
    around_s = np.arange(-width_s, width_s, fine_s) + fine_s / 2
    weight = 1 - np.abs(around_s) / width_s
    mean = (held(times, values)(at_s[:, None] + around_s) * weight).sum(-1) / weight.sum()
    # The oracle's sum places each step to 1e-4 s, times the window's peak 1/width and a step of 5.
    np.testing.assert_allclose(held_smooth(times, values, width_s)(at_s), mean, atol=2e-3)


def test_readback_is_never_interpolated_across_a_gap():
    """A pause, a lost bus: more than three samples without one. A lost sample or two are bridged."""
    times = np.array([0.0, 1.0, 2.0, 3.0, 5.5, 6.5, 10.0, 11.0])
    sampler = interpolated(times, 10 * times)
    np.testing.assert_allclose(sampler(np.array([0.5, 2.9, 4.0, 6.5, 10.0, 10.5])), [5, 29, 40, 65, 100, 105])
    assert np.all(np.isnan(sampler(np.array([-0.1, 6.51, 8.0, 9.99, 11.1]))))


def test_frames_within_a_gap_of_the_read_back_are_not_compared():
    """The arm moves on during a pause of 4 s: a line across the gap would be off by degrees."""
    log, detected = readback(), detection(np.random.default_rng(21), lag_s=0.0)
    paused = (log.t_s > 3.2) & (log.t_s < 7.2)
    kept = JointLog(log.t_s[~paused], log.joints, log.q[~paused], log.units)
    whole, gapped = compare(detected, None, log), compare(detected, None, kept)
    for one, other in zip(whole.joints, gapped.joints, strict=True):
        inside = (one.t_s > 3.2) & (one.t_s < 7.2 - 0.02)
        assert np.all(np.isnan(other.measured[inside])) and np.all(np.isfinite(one.measured[inside]))
        assert other.against_measured is not None and one.against_measured is not None
        assert other.against_measured.max <= one.against_measured.max + np.radians(0.05)


def test_sign_zero_lag_and_gain_of_known_truth_are_recovered():
    comparison = compare(detection(np.random.default_rng(1)), commands(), readback())
    assert [(j.joint, j.fitted_joint, j.sign) for j in comparison.joints] == [("pan", "a__b", -1), ("lift", "b__c", 1)]
    pan = joint_named(comparison, "pan").against_measured
    assert pan is not None and pan.lag_std_s is not None and pan.gain_std is not None
    assert pan.lag_s == pytest.approx(LAG_S, abs=4 * pan.lag_std_s) and pan.lag_std_s < 0.002
    assert pan.gain == pytest.approx(GAIN, abs=4 * pan.gain_std) and pan.gain_std < 0.003
    # joint = sign * fitted + offset, fitted = sign * joint + 0.5; the lag adds at most some tenths of a degree.
    assert pan.offset == pytest.approx(0.5, abs=np.radians(0.5))


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_stated_standard_deviations_of_lag_and_gain_cover_the_truth(colour):
    rng = np.random.default_rng(7)
    t_s = np.arange(0.2, DURATION_S, 1 / FPS)
    log = readback()
    reference = interpolated(log.t_s, log.state("pan"))
    z = []
    for _ in range(120):
        noise = rng.normal(size=len(t_s))
        for row in range(1, len(t_s)):  # an AR(1) of unit variance
            noise[row] = colour * noise[row - 1] + np.sqrt(1 - colour**2) * noise[row]
        y = GAIN * TRUE[0](t_s - LAG_S) + NOISE_RAD * (1 + np.abs(TRUE[0](t_s))) * noise
        slope = estimate_slope(t_s, y, reference, span_s=0.2)
        assert slope.lag_std_s is not None and slope.gain_std is not None
        z.append(((slope.lag_s - LAG_S) / slope.lag_std_s, (slope.gain - GAIN) / slope.gain_std))
    # 95 % nominal; 120 trials scatter by 2 %, estimated variances of few ramps cost some more.
    covered = np.mean(np.abs(np.array(z)) < 1.96, axis=0)
    assert np.all(covered > 0.87)
    assert np.all(np.std(z, axis=0) > 0.7), "the standard deviations are far too wide"


def test_the_lag_behind_step_commands_is_found_between_frames():
    """Of equal steps of a speed-limited servo: half the time that a step takes, plus the camera's lag."""
    times = np.arange(10) * 2.0 + 0.013
    targets = np.tile([0.0, 0.6], 5)
    t_s = np.arange(0.2, 20.0, 1 / FPS)
    corners_s = np.stack([times, times + 0.5], -1).ravel()
    states = np.stack([np.roll(targets, 1), targets], -1).ravel()[1:]
    states = np.concatenate(([0.0], states))
    y = np.interp(t_s - LAG_S, corners_s, states)
    slope = estimate_slope(t_s, y, held_smooth(times, targets, 4 / FPS), span_s=2.0)
    assert slope.lag_s == pytest.approx(0.25 + LAG_S, abs=0.002)  # a sixteenth of a frame


def test_errors_are_those_of_the_columns_after_sign_and_offset_only():
    comparison = compare(detection(np.random.default_rng(2), gains=(0.9, 1.0)), commands(), readback())
    for joint in comparison.joints:
        for agreement, reference in (
            (joint.against_measured, joint.measured),
            (joint.against_commanded, joint.commanded),
        ):
            assert agreement is not None
            error = (joint.detected - reference)[np.isfinite(joint.detected - reference)]
            assert agreement.frames == len(error)
            assert agreement.rmse == pytest.approx(np.sqrt(np.mean(error**2)))
            assert agreement.mae == pytest.approx(np.mean(np.abs(error)))
            assert agreement.max == pytest.approx(np.max(np.abs(error)))
    pan = joint_named(comparison, "pan").against_measured
    assert pan is not None
    assert pan.rmse > 0.05 * np.std(TRUE[0](np.arange(0, DURATION_S, 0.1))), "a gain of 0.9 must show in the errors"


def test_the_offset_is_the_least_squares_one():
    comparison = compare(detection(np.random.default_rng(3)), None, readback())
    for joint in comparison.joints:
        assert np.nanmean(joint.detected - joint.measured) == pytest.approx(0.0, abs=1e-12)
        assert joint.against_commanded is None and np.all(np.isnan(joint.commanded))


def test_against_commands_alone_the_zero_is_where_the_servo_had_arrived():
    """A plain mean would be pulled off by the ramps, here all on one side: up slowly, and never back."""
    t_s = np.arange(0, 20, 1 / FPS)
    climb = np.interp(t_s, [0.0, 2.0, 6.0, 20.0], [0.0, 0.0, 1.0, 1.0])
    noise = NOISE_RAD * np.random.default_rng(19).normal(size=len(t_s))
    detected = JointLog(t_s, ("a__b",), (climb + 0.7 + noise)[:, None], ("rad",))
    steps = JointLog(np.array([0.0, 2.0]), ("pan",), np.array([[0.0], [1.0]]), ("rad",))
    joint = compare(detected, steps).joints[0]
    assert np.nanmean(joint.detected - climb) == pytest.approx(0.0, abs=np.radians(0.1))


@pytest.mark.parametrize("signs", list(itertools.product((1, -1), repeat=2)))
@pytest.mark.parametrize("with_readback", [True, False])
def test_matching_and_signs_do_not_depend_on_the_order_or_the_sign(signs, with_readback):
    detected = detection(np.random.default_rng(4), signs=signs)
    comparison = compare(detected, commands(), readback() if with_readback else None)
    assert {(j.joint, j.fitted_joint, j.sign) for j in comparison.joints} == {
        ("pan", "a__b", signs[0]),
        ("lift", "b__c", signs[1]),
    }


def test_joints_that_always_move_together_are_told_apart_by_how_far():
    """Their correlation is 1 with either, so correlation alone can't."""
    t_s = np.arange(0, 20, 1 / FPS)
    wave = np.sin(t_s / 2)
    rng = np.random.default_rng(5)
    q = np.stack([0.5 * wave, wave], -1)
    log = JointLog(t_s, ("small", "large"), q, ("rad", "rad"))
    noisy = q[:, ::-1] + rng.normal(size=q.shape) * np.radians([0.01, 2.0])
    detected = JointLog(t_s, ("a__b", "b__c"), noisy, ("rad", "rad"))
    comparison = compare(detected, None, log)
    assert {j.joint: j.fitted_joint for j in comparison.joints} == {"small": "b__c", "large": "a__b"}


def test_a_joint_that_is_left_alone_matches_nothing_and_is_listed_as_at_rest():
    log = readback()
    count = np.radians(0.29) * (np.arange(len(log.t_s)) % 4)  # an AX servo that holds still, give or take some counts
    still = JointLog(log.t_s, ("pan", "rest"), np.stack([log.state("pan"), count], -1), log.units)
    comparison = compare(detection(np.random.default_rng(6)), None, still)
    assert [j.joint for j in comparison.joints] == ["pan"]
    assert comparison.at_rest == ("rest",) and comparison.unmatched_commanded == ()
    assert comparison.unmatched_fitted == ("b__c",)


@pytest.mark.parametrize("which", ["commanded", "measured"])
def test_a_joint_that_was_told_to_move_or_was_moved_by_hand_is_not_at_rest(which: str):
    """Commanded, and the servo didn't follow; or turned by hand, and the camera didn't see it."""
    still, moved = np.zeros((len(COMMAND_TIMES_S), 1)), COMMANDS_RAD[:, :1]
    one, other = (JointLog(COMMAND_TIMES_S, ("gripper",), q, ("rad",)) for q in (moved, still))
    logs = {"commanded": (one, other), "measured": (other, one)}[which]
    t_s = np.arange(0.2, DURATION_S, 1 / FPS)
    unrelated = JointLog(t_s, ("a__b",), np.sin(5 * t_s)[:, None], ("rad",))
    comparison = compare(unrelated, *logs)
    assert comparison.unmatched_commanded == ("gripper",) and comparison.at_rest == ()


def test_a_slide_never_matches_a_hinge():
    t_s = np.arange(0, 20, 1 / FPS)
    wave = np.sin(t_s)
    detected = JointLog(t_s, ("a__b",), wave[:, None], ("m",))
    comparison = compare(detected, None, JointLog(t_s, ("pan",), wave[:, None], ("rad",)))
    assert comparison.joints == ()
    assert (comparison.unmatched_fitted, comparison.unmatched_commanded) == (("a__b",), ("pan",))


def test_the_states_of_a_ball_follow_no_command():
    log = detection(np.random.default_rng(7))
    names = ("ball_x", "ball_y", "b__c", "a__b")
    detected = JointLog(log.t_s, names, np.tile(log.q, (1, 2)), ("rad",) * 4)
    types = dict.fromkeys(names, "revolute") | {"ball_x": "spherical", "ball_y": "spherical"}
    for same_clock in (True, False):
        comparison = compare(detected, commands(), readback(), types=types, same_clock=same_clock)
        assert [joint.fitted_joint for joint in comparison.joints] == ["a__b", "b__c"]
        assert comparison.unmatched_fitted == ("ball_x", "ball_y")
    alone = JointLog(log.t_s, names[:2], log.q, ("rad", "rad"))
    assert compare(alone, commands(), types=types, same_clock=False).joints == ()


def test_wild_frames_do_not_change_who_matches_whom():
    detected = detection(np.random.default_rng(8))
    q = np.array(detected.q)
    q[::25] += 3.0
    wild = JointLog(detected.t_s, detected.joints, q, detected.units)
    comparison = compare(wild, commands(), readback())
    assert {(j.joint, j.fitted_joint, j.sign) for j in comparison.joints} == {("pan", "a__b", -1), ("lift", "b__c", 1)}


@pytest.mark.parametrize("shift_s", [-7.3, 0.0, 4.21, 1000.017])
def test_the_lag_between_two_clocks_is_found_and_applied(shift_s):
    detected = detection(np.random.default_rng(9), gains=(1.0, 1.0))
    comparison = compare(detected, commands(shift_s), readback(shift_s), same_clock=False)
    assert comparison.clock_lag_s is not None and comparison.clock_lag_std_s is not None
    assert comparison.clock_lag_s == pytest.approx(LAG_S - shift_s, abs=4 * comparison.clock_lag_std_s)
    assert comparison.clock_lag_std_s < 0.002
    for joint in comparison.joints:
        assert joint.against_measured is not None
        assert joint.against_measured.rmse == pytest.approx(NOISE_RAD, rel=0.1), "with the lag applied, noise is left"
        assert joint.against_measured.lag_s == pytest.approx(LAG_S - shift_s, abs=0.005)


def test_commands_of_another_clock_alone_are_enough_to_align():
    detected = detection(np.random.default_rng(10))
    comparison = compare(detected, commands(33.0), same_clock=False)
    assert {j.joint for j in comparison.joints} == {"pan", "lift"}
    assert comparison.clock_lag_s is not None
    assert -33.0 < comparison.clock_lag_s < -32.0  # half of the longest ramp (1.7 s) at most, plus the camera's lag


def test_unrelated_motion_on_two_clocks_matches_nothing():
    t_s = np.arange(0, 20, 1 / FPS)
    still = JointLog(t_s, ("a__b",), np.zeros((len(t_s), 1)), ("rad",))
    comparison = compare(still, commands(), same_clock=False)
    assert comparison.joints == () and comparison.clock_lag_s is None


def test_one_lag_from_all_joints_is_applied_and_both_errors_are_told():
    detected = detection(np.random.default_rng(22), gains=(1.0, 1.0))
    comparison = compare(detected, commands(), readback())
    lag = comparison.lag
    assert lag.std_s is not None and lag.std_s < 0.001 and lag.why_not == ""
    assert lag.applied_s == lag.lag_s == pytest.approx(LAG_S, abs=4 * lag.std_s)
    data = json.loads(comparison_json(comparison))
    assert data["lag"]["applied_s"] == lag.applied_s and data["lag"]["std_s"] == lag.std_s
    for joint, told in zip(comparison.joints, data["joints"], strict=True):
        measured = joint.against_measured
        assert measured is not None
        assert measured.rmse == pytest.approx(NOISE_RAD, rel=0.1), "with the lag applied, noise is left"
        at_stamps = interpolated(readback().t_s, readback().state(joint.joint))(joint.t_s)
        late = np.nanstd(joint.detected - at_stamps)
        assert measured.rmse_before_lag == pytest.approx(late, rel=1e-6) and late > 1.5 * NOISE_RAD
        assert told["measured"]["lag_s"] == measured.lag_s == pytest.approx(LAG_S, abs=0.002), (
            "as given, not what is left"
        )
        assert told["measured"]["rmse_deg"] == pytest.approx(np.degrees(measured.rmse))
        assert data["lag"]["rmse_before"][joint.joint]["measured"] == pytest.approx(np.degrees(late))


def test_with_the_lag_applied_the_references_are_those_of_when_the_light_fell():
    detected = detection(np.random.default_rng(23), gains=(1.0, 1.0))
    comparison = compare(detected, commands(), readback())
    pan, applied_s = joint_named(comparison, "pan"), comparison.lag.applied_s
    np.testing.assert_array_equal(pan.t_s, detected.t_s)
    np.testing.assert_allclose(pan.measured, TRUE[0](pan.t_s - applied_s), atol=1e-4)  # a corner between two samples
    first = held(COMMAND_TIMES_S, COMMANDS_RAD[:, 0])
    np.testing.assert_array_equal(pan.commanded, first(pan.t_s - applied_s))


@pytest.mark.parametrize("jitter_s", [0.0, 0.003])
def test_the_stated_deviation_of_the_sessions_lag_covers_the_truth(jitter_s):
    """Coarse counts of 0.29 deg, and stamps that jitter: which moves all joints of a frame together."""
    rng, z = np.random.default_rng(24), []
    count = np.radians(0.29)
    for _ in range(100):
        true_s, phase_s = rng.uniform(0.01, 0.06), rng.uniform(0.0, 0.02)
        read_s = np.arange(phase_s, DURATION_S, 0.02)
        t_s = np.arange(0.2 + rng.uniform(0.0, 0.03), DURATION_S, 1 / FPS)
        lit_s = t_s - true_s + jitter_s * rng.normal(size=len(t_s))
        together = [TRUE[0], lambda at_s: 0.7 * TRUE[0](at_s), lambda at_s: -0.5 * TRUE[0](at_s)]
        slopes = [
            estimate_slope(
                t_s,
                true(lit_s) + 0.3 * count * rng.normal(size=len(t_s)),
                interpolated(read_s, count * np.round(true(read_s) / count)),
                span_s=0.2,
            )
            for true in together
        ]
        lag = estimate_session_lag(slopes)
        assert lag.lag_s is not None and lag.std_s is not None
        z.append((lag.lag_s - true_s) / lag.std_s)
    # 95 % nominal; 100 trials scatter by 2 %.
    assert np.mean(np.abs(z) < 1.96) > 0.88
    assert np.std(z) > 0.6, "the standard deviation is far too wide"


@pytest.mark.parametrize(
    ("lag_s", "std_s", "why"),
    [(0.05, 0.006, "its std is over 5 ms"), (0.003, 0.002, "can't be told from none"), (0.03, 0.001, "")],
)
def test_a_lag_that_is_not_sure_is_told_and_not_applied(lag_s, std_s, why):
    lag = estimate_session_lag([Slope(lag_s, std_s, 1.0, None)])
    assert lag.lag_s == pytest.approx(lag_s) and lag.std_s == pytest.approx(std_s)
    assert why in lag.why_not and bool(lag.why_not) == bool(why)
    assert lag.applied_s == (0.0 if why else pytest.approx(lag_s))


def test_without_a_read_back_or_without_motion_no_lag_is_applied():
    alone = compare(detection(np.random.default_rng(25)), commands())
    assert alone.lag.lag_s is None and alone.lag.applied_s == 0.0 and "no read-back" in alone.lag.why_not
    undefined = estimate_session_lag([Slope(np.nan, None, np.nan, None)])
    assert undefined.applied_s == 0.0 and "no joint moved enough" in undefined.why_not
    data = json.loads(comparison_json(alone))
    assert data["lag"]["applied_s"] == 0.0 and data["lag"]["lag_s"] is None and data["lag"]["why_not_applied"]


def test_combined_lag_is_the_weighted_mean_and_wider_where_joints_disagree():
    def slopes(*lags_s: float):
        return [Slope(lag_s, std_s, 1.0, None) for lag_s, std_s in zip(lags_s, (0.001, 0.002, 0.002), strict=False)]

    agreeing, disagreeing = combined_lag(slopes(0.030, 0.031)), combined_lag(slopes(0.010, 0.055))
    assert agreeing == pytest.approx((0.0302, 0.001 / np.sqrt(1.25)))
    assert disagreeing == pytest.approx((0.019, 0.018))  # by hand: weights 4 and 1
    assert combined_lag([Slope(np.nan, None, np.nan, None)]) is None


def test_no_references_leave_every_fitted_joint_unmatched():
    comparison = compare(detection(np.random.default_rng(12)), None)
    assert comparison.joints == () and set(comparison.unmatched_fitted) == set(FITTED)


def test_a_fitted_joint_without_a_type_is_refused():
    with pytest.raises(InvalidData, match="b__c"):
        compare(detection(np.random.default_rng(13)), commands(), types={"a__b": "revolute"})


def test_a_joint_in_two_units_is_refused():
    metres = JointLog(np.arange(3.0), ("pan",), np.zeros((3, 1)), ("m",))
    with pytest.raises(InvalidData, match="pan"):
        compare(detection(np.random.default_rng(14)), commands(), metres)


def test_no_argument_is_changed_and_results_are_frozen():
    detected = detection(np.random.default_rng(15))
    before = detected.q.copy()
    joint = compare(detected, commands(), readback()).joints[0]
    np.testing.assert_array_equal(detected.q, before)
    with pytest.raises(ValueError, match="read-only"):
        joint.detected[0] = 1.0


def test_the_json_has_the_fields_of_the_design_in_degrees_and_no_nan():
    def refuse(constant: str):
        raise AssertionError(f"{constant} is no JSON")

    comparison = compare(detection(np.random.default_rng(16)), None, readback())
    data = json.loads(comparison_json(comparison), parse_constant=refuse)
    assert data["schema"] == "comparison/1" and set(data) == {"schema", "joints", "lag"}
    pan = data["joints"][0]
    assert list(pan) == ["joint", "fitted_joint", "type", "unit", "sign", "commanded", "measured"]
    assert pan["unit"] == "deg" and pan["sign"] == -1 and pan["commanded"] is None
    assert list(pan["measured"]) == ["lag_s", "gain", "offset_deg", "rmse_deg", "mae_deg", "max_deg", "frames"]
    measured = comparison.joints[0].against_measured
    assert measured is not None
    assert pan["measured"]["rmse_deg"] == pytest.approx(np.degrees(measured.rmse))
    assert pan["measured"]["lag_s"] == pytest.approx(measured.lag_s)


def test_undefined_lag_and_gain_are_null():
    """The command is constant (nobody moved the target), the read-back moves: lag and gain against it mean nothing."""
    held_still = JointLog(np.array([0.0]), ("pan",), np.zeros((1, 1)), ("rad",))
    log = readback()
    moved = JointLog(log.t_s, ("pan",), log.state("pan")[:, None], ("rad",))
    comparison = compare(detection(np.random.default_rng(17)), held_still, moved)
    commanded = json.loads(comparison_json(comparison))["joints"][0]["commanded"]
    assert commanded["lag_s"] is None and commanded["gain"] is None and commanded["rmse_deg"] > 10


def test_a_slide_is_written_in_millimetres():
    t_s = np.arange(0, 20, 1 / FPS)
    wave = 0.1 * np.sin(t_s)
    detected = JointLog(t_s, ("a__b",), wave[:, None] + 0.002 * np.sign(np.cos(9 * t_s))[:, None], ("m",))
    comparison = compare(detected, None, JointLog(t_s, ("rail",), wave[:, None], ("m",)))
    rail = json.loads(comparison_json(comparison))["joints"][0]
    assert rail["unit"] == "mm" and rail["type"] == "prismatic"
    assert rail["measured"]["rmse_mm"] == pytest.approx(2.0, abs=0.1)
    rows = list(csv.DictReader(io.StringIO(comparison_csv(comparison))))
    assert float(rows[50]["measured"]) == pytest.approx(1e3 * wave[50], abs=1e-6) and rows[50]["unit"] == "mm"


def test_the_csv_gives_back_the_arrays_with_blanks_for_what_was_not_seen():
    comparison = compare(detection(np.random.default_rng(18)), None, readback())
    text = comparison_csv(comparison)
    assert text.splitlines()[0] == "t_s,joint,unit,commanded,measured,detected,detected_std"
    rows = [row for row in csv.DictReader(io.StringIO(text)) if row["joint"] == "lift"]
    lift = joint_named(comparison, "lift")
    assert np.array_equal([float(row["t_s"]) for row in rows], lift.t_s)
    assert {row["commanded"] for row in rows} == {""}
    detected = np.array([float(row["detected"] or "nan") for row in rows])
    np.testing.assert_allclose(detected, np.degrees(lift.detected), atol=1e-6)
    assert [row["detected"] == "" for row in rows] == np.isnan(lift.detected).tolist()
