"""Whatever poses the learner is given: a clear error, or a result that is right or warns; never anything else.

Warnings of numpy are errors here, as in all tests.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated import poses

import station
from station.errors import InvalidData, StationError
from station.logs import FloatArray

FRAMES = 60
SIGMA = np.repeat([1e-3, 0.01], 3)  # m, rad
# Of a state: three times the noise of the two poses at either end of the range.
TRAVEL_WITHIN_RAD = 0.06
ZERO = np.zeros(3)


def hinge(frames: int = FRAMES, *, travel_rad: float = 1.0, sigma: FloatArray = SIGMA) -> FloatArray:
    """(T, 2, 4, 4): a base that stands still and an arm that turns about its z axis, each with noise of its own."""
    rng = np.random.default_rng(70)
    q = np.linspace(0.0, travel_rad, frames)
    base = np.broadcast_to(poses(np.array([0.2, 0.1, 0.0]), np.array([0.5, 0.0, 1.0])), (frames, 4, 4))
    arm = base @ poses(q[:, None] * np.array([0.0, 0.0, 1.0]), ZERO) @ poses(ZERO, np.array([0.3, 0.05, 0.1]))
    noise = sigma * rng.normal(size=(frames, 2, 6))
    return np.stack([base, arm], axis=1) @ poses(noise[..., 3:], noise[..., :3])


def covariances(frames: int = FRAMES) -> FloatArray:
    return np.tile(np.diag(SIGMA**2), (frames, 2, 1, 1))


def log_of(T: FloatArray, covariance: FloatArray | None = None, *, t_s: FloatArray | None = None) -> station.PoseLog:
    t_s = np.arange(len(T)) / 30 if t_s is None else t_s
    return station.PoseLog(t_s, "world", ("base", "arm", "copy")[: T.shape[1]], T, covariance)


def is_hinge(fit: station.Fit, *, travel_rad: float = 1.0) -> bool:
    """The arm turns by the right angle about the right axis of the base, and says how sure it is."""
    if [(joint.type, joint.parent, joint.child) for joint in fit.tree.joints] != [("revolute", "base", "arm")]:
        return False
    (joint,) = fit.tree.joints
    seen = np.isfinite(fit.states.q[:, 0])
    assert joint.axis_parent is not None and fit.states.std is not None
    q, std = fit.states.q[seen, 0], fit.states.std[seen, 0]
    right = q.size > 0 and abs(np.ptp(q) - travel_rad) < TRAVEL_WITHIN_RAD and abs(joint.axis_parent[2]) > np.cos(0.05)
    return bool(right and np.all(np.isfinite(std)) and np.all(std > 0))


def warned(fit: station.Fit, *words: str) -> bool:
    return any(all(word in warning for word in words) for warning in fit.tree.warnings)


# --- What is refused, with the place and the numbers ---------------------------------------------------------------


def changed(change: Callable[[FloatArray], None]) -> Callable[[], station.PoseLog]:
    """A log in which something was done to the poses, where row 7 and the arm are the ones to look at."""

    def make() -> station.PoseLog:
        T = hinge()
        change(T)
        return log_of(T)

    return make


def with_covariance(change: Callable[[FloatArray], None]) -> Callable[[], station.PoseLog]:
    def make() -> station.PoseLog:
        covariance = covariances()
        change(covariance)
        return log_of(hinge(), covariance)

    return make


def with_times(change: Callable[[FloatArray], None], start_s: float = 0.0) -> Callable[[], station.PoseLog]:
    def make() -> station.PoseLog:
        t_s = start_s + np.arange(FRAMES) / 8
        change(t_s)
        return log_of(hinge(), t_s=t_s)

    return make


def named(*parts: object, reference: str = "world") -> Callable[[], station.PoseLog]:
    return lambda: station.PoseLog(np.arange(FRAMES), reference, parts, hinge())  # type: ignore[arg-type]


def put(index: object, value: object) -> Callable[[FloatArray], None]:
    return lambda array: array.__setitem__(index, value)


def scale(index: object, factor: object) -> Callable[[FloatArray], None]:
    return lambda array: array.__setitem__(index, array[index] * factor)


ARM = "the pose of 'arm' in row 7 is no rigid motion: "
COVARIANCE = "the covariance of 'arm' in row 7 "
T_S = np.arange(FRAMES) / 30
REFUSED: dict[str, tuple[Callable[[], station.PoseLog], str]] = {
    "one NaN in a pose": (changed(put((7, 1, 0, 3), np.nan)), ARM + "1 of 16 numbers are NaN or inf"),
    "a rotation of NaN": (changed(put((7, 1, slice(3), slice(3)), np.nan)), ARM + "9 of 16 numbers are NaN or inf"),
    "an infinite position": (changed(put((7, 1, 2, 3), np.inf)), ARM + "1 of 16 numbers are NaN or inf"),
    "an infinite rotation": (changed(put((7, 1, 2, 2), -np.inf)), ARM + "1 of 16 numbers are NaN or inf"),
    "a rotation beyond floats": (
        changed(put((7, 1, 2, 2), 1e200)),
        ARM + "R^T R of its rotation R is off the identity",
    ),
    "a reflection": (changed(scale((7, 1, slice(3), 2), -1.0)), ARM + "its determinant is -1, a reflection"),
    "a scaled rotation": (
        changed(scale((7, 1, slice(3), slice(3)), 1.01)),
        ARM + "R^T R of its rotation R is off the identity by 0.02; want less than 1e-06",
    ),
    "a rotation off unit by a bit": (
        changed(scale((7, 1, slice(3), 0), 1.00001)),
        ARM + "R^T R of its rotation R is off the identity by 2e-05",
    ),
    "a sheared rotation": (changed(put((7, 1, 0, 1), 0.5)), ARM + "R^T R of its rotation R is off the identity"),
    "no pose at all": (changed(put((7, 1), 0.0)), ARM + "its last row is 0 0 0 0; want 0 0 0 1"),
    "homogeneous by 2": (changed(put((7, 1, 3, 3), 2.0)), ARM + "its last row is 0 0 0 2"),
    "transposed poses": (lambda: log_of(np.swapaxes(hinge(), -1, -2)), "'base' in row 0 .*its last row is 0.5"),
    "farther than any thing": (changed(scale((7, 1, slice(3), 3), 1e200)), "'arm' in row 7 is .* m away; want metres"),
    "times that fall": (with_times(put(4, 0.1)), "t = 0.1 s in row 4 follows 0.375 s; sort the rows"),
    "a time twice": (with_times(put(4, 0.375)), "t = 0.375 s in row 4 follows 0.375 s"),
    "a time twice, far from zero": (
        with_times(put(4, 1e6 + 0.375), 1e6),
        "t = 1000000.375 s in row 4 follows 1000000.375 s",
    ),
    "times beyond floats": (with_times(put([0, 1], (1e308, -1e308))), "row 1 follows 1e.308 s"),
    "a time that is NaN": (with_times(put(4, np.nan)), "finite seconds; have nan in row 4"),
    "a time that is infinite": (with_times(put(59, np.inf)), "finite seconds; have inf in row 59"),
    "times in a table": (lambda: log_of(hinge(), t_s=np.zeros((FRAMES, 1))), "have shape .60, 1."),
    "a variance below zero": (
        with_covariance(put((7, 1, 0, 0), -1e-6)),
        COVARIANCE + "has a variance of -1e-06 for x; want 1e-24 to 1e+24",
    ),
    "a variance of -inf": (with_covariance(put((7, 1, 4, 4), -np.inf)), COVARIANCE + "has a variance of -inf for ry"),
    "a variance beyond floats": (with_covariance(put((7, 1, 0, 0), 1e200)), COVARIANCE + "has a variance of 1e+200"),
    "a variance below rounding": (
        with_covariance(put((7, 1, 3, 3), 5e-324)),
        COVARIANCE + "has a variance of 4.94066e-324 for rx",
    ),
    "a variance that is NaN": (with_covariance(put((7, 1, 0, 0), np.nan)), COVARIANCE + "is NaN for 1 of three"),
    "a covariance that is NaN": (with_covariance(put((7, 1, 0, 1), np.nan)), COVARIANCE + "has nan for x with y"),
    "a covariance that is infinite": (with_covariance(put((7, 1, 1, 0), np.inf)), COVARIANCE + "has inf for y with x"),
    "one that is not symmetric": (
        with_covariance(put((7, 1, 0, 1), 1e-7)),
        COVARIANCE + "is not symmetric: 1e-07 for x with y, 0 the other way round",
    ),
    "one that is not definite": (
        with_covariance(put((7, 1, (0, 1), (1, 0)), 2e-6)),
        COVARIANCE + "is not .*positive definite; give one that is, or none",
    ),
    "one that is zero": (with_covariance(put(..., 0.0)), "covariance of 'base' in row 0 is not .*positive definite"),
    "one for all": (lambda: log_of(hinge(), np.diag(SIGMA**2)), "covariance has shape .6, 6.; want .60, 2, 6, 6."),
    "positions that were not observed": (with_covariance(put((..., (0, 1, 2), (0, 1, 2)), np.inf)), "position"),
    "one position that was not observed": (with_covariance(put((7, 1, 0, 0), np.inf)), "'arm'.*position"),
    "poses without a last row": (lambda: log_of(hinge()[:, :, :3]), "shape .60, 2, 3, 4.; want .60, 2, 4, 4."),
    "one time too few": (lambda: log_of(hinge(), t_s=T_S[1:]), "shape .60, 2, 4, 4.; want .59, 2, 4, 4."),
    "parts before times": (
        lambda: station.PoseLog(T_S, "world", ("base", "arm"), np.swapaxes(hinge(), 0, 1)),
        "shape .2, 60, 4, 4.; want .60, 2, 4, 4.",
    ),
    "no axis of parts": (
        lambda: station.PoseLog(T_S, "world", ("arm",), hinge()[:, 1]),
        "shape .60, 4, 4.; want .60, 1, 4, 4.",
    ),
    "a name twice": (named("arm", "arm"), "part named twice: arm"),
    "a name that is none": (named("The Base", "arm"), "part 'The Base' is no name"),
    "numbers for names": (named(1, 2), "part '1' is no name"),
    "one text for names": (lambda: replace(log_of(hinge()), parts="ab"), "parts: have 'ab'; want a name for each"),
    "no names": (lambda: replace(log_of(hinge()), parts=None), "parts: have None; want a name for each"),
    "a frame that is no name": (named("base", "arm", reference="The World"), "reference frame 'The World' is no name"),
    "texts for times": (lambda: log_of(hinge(), t_s=np.array(["0"] * FRAMES)), "times: have an array of <U1"),
    "dates for times": (
        lambda: log_of(hinge(), t_s=np.arange(FRAMES).astype("datetime64[ms]")),
        "times: have an array of datetime64.ms.; want real numbers",
    ),
    "complex poses": (lambda: log_of(hinge() + 0j), "poses: have an array of complex128; want real numbers"),
    "poses of many lengths": (
        lambda: station.PoseLog([0.0, 1.0], "world", ("arm",), [[1.0, 2.0], [3.0]]),
        "poses: want an array of real numbers",
    ),
    "no parts": (lambda: log_of(hinge()[:, :0]), "no parts; want at least one"),
    "no frames": (lambda: log_of(hinge()[:0]), "seen: base 0, arm 0 of 0 frames"),
    "two frames": (lambda: log_of(hinge(2)), "10 frames or more; seen: base 2, arm 2 of 2 frames"),
    "nothing seen": (lambda: log_of(np.full((FRAMES, 2, 4, 4), np.nan)), "seen: base 0, arm 0 of 60 frames"),
}


@pytest.mark.parametrize(("make", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_it_is_refused_with_the_place_and_the_numbers(make: Callable[[], station.PoseLog], message: str):
    with pytest.raises(StationError) as refused:
        station.fit(make())
    said = str(refused.value)
    assert re.search(message.replace("^", r"\^").replace("1e+", r"1e\+"), said), said
    assert "\n" not in said and len(said) < 250


# --- What is unusual and right ---------------------------------------------------------------------------------------


def test_frames_in_which_a_part_was_not_seen_are_left_out():
    T = hinge()
    T[10:20, 1] = np.nan
    fit = station.fit(log_of(T))
    assert is_hinge(fit)
    assert np.flatnonzero(np.isnan(fit.states.q[:, 0])).tolist() == list(range(10, 20))


def test_ten_frames_are_enough_for_a_hinge():
    assert is_hinge(station.fit(log_of(hinge(10))))


def test_exact_poses_give_the_exact_hinge():
    """Without any noise, states and axis are those of the definition, to rounding."""
    fit = station.fit(log_of(hinge(sigma=np.zeros(6))))
    assert is_hinge(fit)
    np.testing.assert_allclose(fit.states.q[:, 0], np.linspace(0, 1, FRAMES), atol=1e-9)  # rad
    np.testing.assert_allclose(fit.tree.joints[0].axis_parent, [0, 0, 1], atol=1e-9)


def test_exact_poses_give_the_exact_drawer_and_integers_are_numbers():
    T = np.tile(np.eye(4, dtype=int), (FRAMES, 2, 1, 1))
    T[:, 1, 0, 3] = np.arange(FRAMES)  # a metre a frame
    fit = station.fit(log_of(T, t_s=np.arange(FRAMES)))
    assert [joint.type for joint in fit.tree.joints] == ["prismatic"]
    np.testing.assert_allclose(fit.states.q[:, 0], np.arange(FRAMES), atol=1e-6)  # m, of 59


def test_states_are_the_same_however_the_array_lies_in_memory():
    T, t_s = hinge(), np.arange(FRAMES) / 30
    wanted = station.fit(log_of(T)).states.q
    wide = np.zeros((2 * FRAMES, 2, 4, 8))
    wide[::2, :, :, ::2] = T
    hidden = np.ma.masked_array(T, mask=False)
    for same in (np.asfortranarray(T), wide[::2, :, :, ::2], T.astype(object), T.tolist(), hidden):
        np.testing.assert_array_equal(station.fit(log_of(np.asanyarray(same), t_s=t_s)).states.q, wanted)
    narrow = station.fit(log_of(T.astype(np.float32), t_s=t_s.astype(np.float32))).states.q
    np.testing.assert_allclose(narrow, wanted, atol=1e-5)  # rad: float32 holds a rotation to 1e-7


def test_masked_poses_are_poses_that_were_not_seen():
    mask = np.zeros((FRAMES, 2, 4, 4), dtype=bool)
    mask[10:20, 1] = True
    fit = station.fit(log_of(np.ma.masked_array(np.where(mask, 0.0, hinge()), mask=mask)))
    assert is_hinge(fit) and np.isnan(fit.states.q[10:20, 0]).all()


def test_the_zero_of_the_clock_changes_nothing():
    T, t_s = hinge(), np.arange(FRAMES) / 8
    here, there = station.fit(log_of(T, t_s=t_s)), station.fit(log_of(T, t_s=1e6 + t_s))
    np.testing.assert_array_equal(there.states.q, here.states.q)
    np.testing.assert_array_equal(there.states.t_s, 1e6 + t_s)


@pytest.mark.parametrize("size", [10.0, 1e-9])
def test_very_large_and_very_small_things_are_hinges_too(size: float):
    """A hinge is one by its rotation alone; lengths, and the noise of lengths, are scaled."""
    T = hinge()
    T[..., :3, 3] *= size
    fit = station.fit(log_of(T))
    assert is_hinge(fit)
    if size > 1:
        point, point_std = fit.tree.joints[0].point_parent_m, fit.tree.joints[0].point_std_m
        assert point is not None and point_std is not None
        assert np.linalg.norm(point[:2]) < 4 * point_std < 0.1 * size


def test_a_thing_far_from_the_origin_is_where_it_is():
    T = hinge()
    T[..., :3, 3] += 1e9  # m; float64 holds that to 0.1 um
    fit = station.fit(log_of(T))
    assert is_hinge(fit)
    assert np.linalg.norm(fit.tree.joints[0].point_parent_m[:2]) < 0.01  # m, in the base's frame


def test_the_one_part_of_a_log_is_joined_to_its_frame():
    fit = station.fit(station.PoseLog(T_S, "camera", ("arm",), hinge()[:, 1:]))
    assert [(joint.name, joint.type) for joint in fit.tree.joints] == [("camera__arm", "revolute")]


def test_a_part_named_like_the_frame_can_be_the_root():
    log = station.PoseLog(T_S, "world", ("world", "arm"), hinge())
    fit = station.fit(log, root="world")
    assert [(joint.parent, joint.child, joint.type) for joint in fit.tree.joints] == [("world", "arm", "revolute")]
    with pytest.raises(InvalidData, match="reference frame's name 'world'; rename one"):
        station.fit(log, include_reference=True)


def test_the_log_is_left_as_it_was():
    log = log_of(hinge(), covariances())
    before = copy.deepcopy((log.t_s, log.T_ref_part, log.covariance))
    station.fit(log)
    for was, is_now in zip(before, (log.t_s, log.T_ref_part, log.covariance), strict=True):
        np.testing.assert_array_equal(was, is_now)


# --- What can't be told, and is said ---------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [SIGMA, np.zeros(6)], ids=["noisy", "exact"])
def test_parts_that_stand_still_are_one_body_with_a_warning(sigma: FloatArray):
    fit = station.fit(log_of(hinge(travel_rad=0.0, sigma=sigma)))
    assert fit.tree.rigid_groups == (("base", "arm"),) and fit.tree.joints == ()
    assert warned(fit, "no part moved")


def test_a_part_seen_in_one_frame_is_named_and_harms_no_other():
    T = np.concatenate([hinge(), hinge()[:, 1:]], axis=1)
    T[1:, 2] = np.nan
    fit = station.fit(log_of(T))
    assert is_hinge(fit) and ("copy",) in fit.tree.trees
    assert warned(fit, "copy was seen in 1 of 60 frames")


def test_moving_parts_that_were_never_seen_together_are_not_joined_and_that_is_said():
    t = np.linspace(0, 1, FRAMES)[:, None]
    T = poses(t * np.array([0.3, 1.0, 0.2]), t * np.array([0.3, 1.0, 0.2]))[:, None] @ hinge()
    T[30:, 0], T[:30, 1] = np.nan, np.nan
    fit = station.fit(log_of(T))
    assert fit.tree.joints == () and fit.tree.trees == (("base",), ("arm",))
    assert warned(fit, "together")


@pytest.mark.parametrize("sigma", [SIGMA, np.zeros(6)], ids=["noisy", "exact"])
def test_three_frames_of_motion_are_no_joint_or_a_warning(sigma: FloatArray):
    T = hinge(sigma=sigma)
    T[3:] = T[3]
    fit = station.fit(log_of(T))
    assert fit.tree.warnings or is_hinge(fit, travel_rad=3 / (FRAMES - 1))


def test_parts_that_move_anyhow_are_not_one_body():
    rng = np.random.default_rng(71)
    free = station.fit(log_of(poses(rng.normal(size=(FRAMES, 2, 3)), rng.normal(size=(FRAMES, 2, 3)))))
    assert free.tree.rigid_groups == () and free.tree.joints == ()
    assert free.tree.trees == (("base",), ("arm",)) and free.tree.warnings


def test_covariances_that_are_known_in_part_are_used_or_said_to_be_ignored():
    covariance = covariances()
    covariance[7, 1] = np.nan
    fit = station.fit(log_of(hinge(), covariance))
    assert is_hinge(fit) and warned(fit, "covariance")


@pytest.mark.parametrize("factor", [1e-16, 1e4, 1e6])
def test_covariances_that_are_far_off_are_no_silent_error(factor: float):
    """What is said of the poses is absurdly sharp (10 pm for 1 mm), or a hundred, a thousand times too coarse."""
    fit = station.fit(log_of(hinge(), factor * covariances()))
    assert is_hinge(fit)
    for joint in fit.tree.joints:
        assert joint.frames is not None and joint.outliers is not None and joint.outliers < joint.frames
        assert joint.axis_std_rad is not None and joint.axis_std_rad > 0


def test_an_axis_of_a_rotation_that_was_not_observed_is_no_harm():
    covariance = covariances()
    covariance[7, 1, 4, 4] = np.inf
    assert is_hinge(station.fit(log_of(hinge(), covariance)))


# --- Anything --------------------------------------------------------------------------------------------------------

WILD = (np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 1e300, -1e300, 5e-324, 1e9, 1e-9)


@pytest.mark.parametrize("seed", range(40))
def test_numbers_put_anywhere_are_an_error_of_the_station_or_a_result(seed: int):
    """Two wild numbers in poses or covariances: of one entry, one row, one frame or one part."""
    rng = np.random.default_rng([72, seed])
    T, covariance = hinge(12), covariances(12)
    for _ in range(2):
        array = (T, covariance)[rng.integers(2)]
        index = tuple(
            rng.choice([int(rng.integers(n)), -1]) if rng.random() < 0.7 else slice(None) for n in array.shape
        )
        array[index] = rng.choice(WILD)
    try:
        fit = station.fit(log_of(T, covariance))
    except StationError as error:
        assert str(error)
    else:
        assert all(np.all(np.isfinite(joint.T_parent_child_zero)) for joint in fit.tree.joints)
