"""Claims of every model of noise: its distribution, where it is put, and what it says of its covariance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm, logm

from station.errors import InvalidData
from station.kinematics import se3
from station.logs import FloatArray
from station.simulate import NOISE_MODELS, CameraNoise, GaussianNoise, StudentNoise, UniformNoise, make_noise
from station.simulate.camera_noise import flipped_square

MANY = 20_000
EPS_M, EPS_RAD = 0.003, 0.02
SCALE = np.repeat([EPS_M, EPS_RAD], 3)
# Probability with which a test of a distribution may fail by chance; the seed is fixed.
CHANCE = 1e-3


def poses(seed: int = 1, count: int = MANY) -> FloatArray:
    """(N, 4, 4) about 1 m before a camera, in any orientation."""
    rng = np.random.default_rng(seed)
    w = rng.normal(size=(count, 3))
    return se3.pose(se3.exp_so3(w), rng.uniform(-0.3, 0.3, (count, 3)) + np.array([0, 0, 1]))


def errors(noise, seed: int = 3) -> FloatArray:
    """(N, 6) right perturbations."""
    T = poses()
    return se3.log(se3.inverse(T) @ noise.perturbed(T, np.random.default_rng(seed)))


def test_uniform_noise_fills_its_box_in_se3_and_no_more():
    xi = errors(UniformNoise(EPS_M, EPS_RAD)) / SCALE
    assert np.abs(xi).max() <= 1 + 1e-9
    for column in xi.T:
        assert stats.kstest(column, stats.uniform(-1, 2).cdf).pvalue > CHANCE
    independent = np.corrcoef(xi.T) - np.eye(6)
    assert np.abs(independent).max() < 4 / np.sqrt(MANY)


def test_gaussian_noise_has_a_chi_square_of_six():
    xi = errors(GaussianNoise(EPS_M, EPS_RAD)) / SCALE
    assert stats.kstest((xi**2).sum(axis=1), stats.chi2(6).cdf).pvalue > CHANCE
    for column in xi.T:
        assert stats.kstest(column, stats.norm.cdf).pvalue > CHANCE


@pytest.mark.parametrize("freedom", (1, 3, 8))
def test_student_noise_has_the_tail_of_its_degrees_of_freedom(freedom: int):
    noise = StudentNoise(1e-6, 1e-6, freedom=freedom)  # so small that a far one turns by less than pi
    xi = errors(noise) / 1e-6
    for column in xi.T:
        assert stats.kstest(column, stats.t(freedom).cdf).pvalue > CHANCE
    # One denominator serves all six: their mean square has Fisher's distribution.
    assert stats.kstest((xi**2).mean(axis=1), stats.f(6, freedom).cdf).pvalue > CHANCE
    far = np.abs(xi).ravel() > 4
    expected = 2 * stats.t(freedom).sf(4)
    assert abs(far.mean() - expected) < 5 * np.sqrt(expected / MANY)


@pytest.mark.parametrize("name", NOISE_MODELS)
def test_noise_is_put_on_the_right_as_scipys_exponential_has_it(name: str):
    noise = make_noise(name, 0.05, 0.4)
    T = poses(count=5)
    draws = noise.draws(np.random.default_rng(2), (5,))
    for one, pose, u in zip(noise.apply(T, draws), T, draws, strict=True):
        xi = se3.log(np.linalg.inv(pose) @ one)
        hat = np.zeros((4, 4))
        hat[:3, :3], hat[:3, 3] = se3.hat3(xi[3:]), xi[:3]
        np.testing.assert_allclose(pose @ expm(hat), one, atol=1e-12)
        if name == "uniform":
            np.testing.assert_allclose(xi, u * np.repeat([0.05, 0.4], 3), atol=1e-12)
            np.testing.assert_allclose(np.real(logm(np.linalg.inv(pose) @ one)), hat, atol=1e-8)


@pytest.mark.parametrize("name", NOISE_MODELS)
def test_the_covariance_that_a_model_tells_is_that_of_its_noise(name: str):
    more = {"freedom": 8} if name == "student" else {"flips": 0.0} if name == "camera" else {}
    noise = make_noise(name, 0.001, 0.004, more)  # small, so that what is of second order is no matter
    covariance = noise.covariance(poses())
    white = np.linalg.solve(np.linalg.cholesky(covariance), errors(noise)[..., None])[..., 0]
    # Student's fourth moments are 4.5 times the square of the second, at 8 degrees of freedom.
    assert np.abs(white.T @ white / MANY - np.eye(6)).max() < 5 * np.sqrt(4.5 / MANY)


@pytest.mark.parametrize("name", NOISE_MODELS)
def test_without_magnitude_there_is_no_noise(name: str):
    T = poses(count=50)
    noise = make_noise(name, 0.0, 0.0, {"flips": 0.0} if name == "camera" else {})
    np.testing.assert_array_equal(noise.perturbed(T, np.random.default_rng(0)), T)


@pytest.mark.parametrize("name", [name for name, model in NOISE_MODELS.items() if model.reference == "world"])
def test_planar_noise_leaves_the_plane_alone(name: str):
    T = se3.translation(np.random.default_rng(0).normal(size=(200, 3)))
    seen = make_noise(name, 0.01, 0.1).perturbed(T, np.random.default_rng(0), planar=True)
    assert np.all(seen[:, 2, 3] == T[:, 2, 3]) and np.all(seen[:, 2, :3] == [0, 0, 1])
    assert np.all(seen[:, :2, 3] != T[:, :2, 3]) and np.all(seen[:, 0, 1] != 0)


def test_a_camera_sees_depth_and_tilt_worst():
    noise = CameraNoise(0.001, 0.005, flips=0.0, depth_ratio=6.0, tilt_ratio=3.0)
    T = np.tile(se3.translation([0.0, 0.0, 2.0]), (MANY, 1, 1))  # twice as far
    xi = se3.log(se3.inverse(T) @ noise.perturbed(T, np.random.default_rng(0)))
    want = [0.002, 0.002, 4 * 0.006, 2 * 0.015, 2 * 0.015, 0.01]
    np.testing.assert_allclose(xi.std(axis=0), want, rtol=5 / np.sqrt(2 * MANY))


def test_a_flip_keeps_the_square_as_it_looks_from_far_away_and_is_its_own_opposite():
    T = poses(count=200)
    T[:, :3, 3] *= 1e4  # far away
    other = flipped_square(T)
    corners = np.array([[-1, -1, 0, 1], [1, -1, 0, 1], [1, 1, 0, 1], [-1, 1, 0, 1]]) * [0.05, 0.05, 0.05, 1]
    here, there = (np.einsum("nij,cj->nci", pose, corners)[..., :3] for pose in (T, other))
    sight = T[:, None, :3, 3] / np.linalg.norm(T[:, None, :3, 3], axis=-1, keepdims=True)
    off = (here - there) - np.sum((here - there) * sight, axis=-1, keepdims=True) * sight
    assert np.abs(off).max() < 1e-9  # metres across the line of sight
    np.testing.assert_allclose(flipped_square(other), T, atol=1e-9)
    tilt = [np.abs(np.sum(pose[:, :3, 2] * sight[:, 0], axis=-1)) for pose in (T, other)]
    np.testing.assert_allclose(*tilt, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(other[:, :3, :3]), 1.0, atol=1e-12)


def test_a_camera_flips_the_share_that_it_is_told():
    T = poses()
    seen = CameraNoise(0.0, 0.0, flips=0.1).perturbed(T, np.random.default_rng(5))
    flipped = se3.angle(np.swapaxes(T[:, :3, :3], -1, -2) @ seen[:, :3, :3]) > 1e-6
    assert abs(flipped.mean() - 0.1) < 4 * np.sqrt(0.09 / MANY)
    np.testing.assert_allclose(seen[flipped], flipped_square(T)[flipped], atol=1e-12)


@pytest.mark.parametrize("name", NOISE_MODELS)
@pytest.mark.parametrize("wrong", (-0.001, np.nan, np.inf, "much", None, True))
def test_magnitudes_that_are_none_are_refused(name: str, wrong: object):
    for magnitudes in ((wrong, 0.1), (0.1, wrong)):
        with pytest.raises(InvalidData, match=r"noise of (translation|rotation) is .*; want a .*0 or more"):
            make_noise(name, *magnitudes)  # type: ignore[arg-type]


def test_a_model_or_an_option_of_it_that_there_is_not_is_refused_with_those_that_there_are():
    with pytest.raises(InvalidData, match="noise 'pink' is unknown; choose one of uniform, gaussian, student, camera"):
        make_noise("pink", 0.1, 0.1)
    with pytest.raises(InvalidData, match="uniform noise has no flips; camera noise has one"):
        make_noise("uniform", 0.1, 0.1, {"flips": 0.1})
    for wrong in ({"freedom": 0}, {"freedom": 1.5}):
        with pytest.raises(InvalidData, match=r"degrees of freedom: have .*; want a whole number, 1 or more"):
            make_noise("student", 0.1, 0.1, wrong)
    for wrong in ({"flips": 1.0}, {"flips": np.nan}, {"distance_m": 0.0}, {"depth_ratio": -1.0}):
        with pytest.raises(InvalidData, match="; want "):
            make_noise("camera", 0.1, 0.1, wrong)
