"""The metric (15, 16) and its gradient (17) against finite differences, and what the paper says of them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import logm

from station.kinematics import metric, se3

examples = settings(max_examples=40, deadline=None)  # a loaded machine is no failure
WEIGHTS = {"c": 0.7, "d": 3.0}
seeds = st.integers(0, 2**32 - 1)


def poses(seed: int, count: int, reach: float = 1.0) -> np.ndarray:
    """Poses `exp(xi)` with twists well below half a turn, so that two of them are less than half a turn apart."""
    return se3.exp(np.random.default_rng(seed).uniform(-reach, reach, (count, 6)) * [1, 1, 1, 0.8, 0.8, 0.8])


def finite_difference(T_u: np.ndarray, T_v: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Derivative of the squared distance along the six right perturbations of u."""

    def along(e: np.ndarray) -> float:
        plus, minus = (metric.squared_distance(T_u @ se3.exp(s * e), T_v, **WEIGHTS) for s in (step, -step))
        return float(plus - minus) / (2 * step)

    return np.array([along(e) for e in np.eye(6)])


def paper_rotation_gradient(T_u: np.ndarray, T_v: np.ndarray) -> np.ndarray:
    """The rotation term of (17) as printed: 2c log(U^T V) V^T U V."""
    U, V = T_u[:3, :3], T_v[:3, :3]
    return 2 * WEIGHTS["c"] * se3.hat3(se3.log_so3(U.T @ V)) @ V.T @ U @ V


def along_rotations(G: np.ndarray, T_u: np.ndarray) -> np.ndarray:
    """tr(G^T U hat(e)) for the three rotations e: the derivative that a gradient in matrix entries stands for."""
    return np.array([np.sum(G * (T_u[:3, :3] @ se3.hat3(e))) for e in np.eye(3)])


def test_the_squared_distance_of_a_turn_and_a_shift_is_known():
    """||log R||_F^2 is twice the squared angle."""
    T = se3.pose(se3.exp_so3([0, 0, 0.3]), [0, 0.4, 0])
    assert metric.squared_distance(se3.identity(), T, **WEIGHTS) == pytest.approx(0.7 * 2 * 0.3**2 + 3.0 * 0.4**2)


def test_the_frobenius_norm_of_the_matrix_logarithm_is_meant():
    T_u, T_v = poses(3, 2)
    log = logm(T_u[:3, :3].T @ T_v[:3, :3])
    expected = np.sum(np.abs(log) ** 2)
    assert metric.squared_distance(T_u, T_v, c=1.0, d=0.0) == pytest.approx(expected, rel=1e-9)


@given(seeds)
@examples
def test_the_distance_is_a_metric(seed: int):
    T = poses(seed, 3)
    ab, ba, bc, ac = (metric.distance(T[i], T[j], **WEIGHTS) for i, j in ((0, 1), (1, 0), (1, 2), (0, 2)))
    assert ab == pytest.approx(ba, rel=1e-12)
    assert ab > 0
    assert metric.distance(T[0], T[0], **WEIGHTS) == pytest.approx(0, abs=1e-12)
    assert ac <= ab + bc + 1e-12


@given(seeds)
@examples
def test_the_metric_is_left_invariant_in_full(seed: int):
    T_u, T_v, g = poses(seed, 3)
    moved = metric.distance(g @ T_u, g @ T_v, **WEIGHTS)
    assert moved == pytest.approx(metric.distance(T_u, T_v, **WEIGHTS), rel=1e-9)


@given(seeds)
@examples
def test_the_metric_is_right_invariant_under_rotations(seed: int):
    T_u, T_v, g = poses(seed, 3)
    g = se3.pose(g[:3, :3], np.zeros(3))
    moved = metric.distance(T_u @ g, T_v @ g, **WEIGHTS)
    assert moved == pytest.approx(metric.distance(T_u, T_v, **WEIGHTS), rel=1e-9)


def test_the_metric_is_not_right_invariant_under_translations():
    """The paper calls (15) right-invariant: half a turn apart, a metre on the right puts two between the poses."""
    T_u, T_v = se3.identity(), se3.rotation_z(3.0)
    g = se3.translation([1.0, 0, 0])
    apart = 2 * np.sin(1.5)  # m, chord of 3 rad on a circle of 1 m
    before = metric.squared_distance(T_u, T_v, **WEIGHTS)
    after = metric.squared_distance(T_u @ g, T_v @ g, **WEIGHTS)
    assert after - before == pytest.approx(3.0 * apart**2)


@given(seeds)
@examples
def test_the_twist_gradient_is_the_finite_difference(seed: int):
    T_u, T_v = poses(seed, 2)
    numeric = finite_difference(T_u, T_v)
    np.testing.assert_allclose(metric.twist_gradient(T_u, T_v, **WEIGHTS), numeric, atol=1e-7)


@pytest.mark.parametrize("turn", (0.0, 1e-9, 1e-4, 1.0, 3.0))
@pytest.mark.parametrize("shift", (0.0, 1e-9, 1e-4, 1.0))
def test_the_twist_gradient_holds_near_coincidence(turn: float, shift: float):
    T_u = poses(5, 1)[0]
    T_v = T_u @ se3.exp([shift, 0, 0, 0, turn * 0.6, turn * 0.8])
    numeric = finite_difference(T_u, T_v)
    np.testing.assert_allclose(metric.twist_gradient(T_u, T_v, **WEIGHTS), numeric, atol=1e-8)


@given(seeds)
@examples
def test_the_corrected_gradient_is_the_finite_difference(seed: int):
    T_u, T_v = poses(seed, 2)
    G = metric.gradient(T_u, T_v, **WEIGHTS)
    numeric = finite_difference(T_u, T_v)
    np.testing.assert_allclose(along_rotations(G[:, :3], T_u), numeric[3:], atol=1e-7)
    np.testing.assert_allclose(T_u[:3, :3].T @ G[:, 3], numeric[:3], atol=1e-7)


def test_the_printed_rotation_gradient_is_not_the_finite_difference():
    """Neither as printed in (17) nor with its sign turned."""
    T_u, T_v = poses(11, 2)
    numeric = finite_difference(T_u, T_v)[3:]
    printed = along_rotations(paper_rotation_gradient(T_u, T_v), T_u)
    assert np.abs(printed - numeric).max() > 0.1
    assert np.abs(-printed - numeric).max() > 0.1


def test_where_rotations_commute_only_the_sign_of_the_printed_gradient_is_wrong():
    T_u, T_v = se3.rotation_z(0.3), se3.rotation_z(1.1)
    printed = along_rotations(paper_rotation_gradient(T_u, T_v), T_u)
    np.testing.assert_allclose(-printed, finite_difference(T_u, T_v)[3:], atol=1e-8)


def test_a_step_against_the_gradient_comes_closer():
    T_u, T_v = poses(8, 2)
    step = -1e-3 * metric.twist_gradient(T_u, T_v, **WEIGHTS)
    assert metric.distance(T_u @ se3.exp(step), T_v, **WEIGHTS) < metric.distance(T_u, T_v, **WEIGHTS)


def test_batches_agree_with_single_poses_and_nan_passes_through():
    T_u, T_v = poses(1, 6).reshape(3, 2, 4, 4), poses(2, 2)
    T_u[1, 0] = np.nan
    distances = metric.distance(T_u, T_v, **WEIGHTS)
    G, twists = metric.gradient(T_u, T_v, **WEIGHTS), metric.twist_gradient(T_u, T_v, **WEIGHTS)
    assert (distances.shape, G.shape, twists.shape) == ((3, 2), (3, 2, 3, 4), (3, 2, 6))
    assert np.isnan(distances[1, 0])
    assert np.isnan(G[1, 0]).all()
    assert np.isnan(twists[1, 0]).all()
    assert distances[2, 1] == metric.distance(T_u[2, 1], T_v[1], **WEIGHTS)
    np.testing.assert_array_equal(G[2, 1], metric.gradient(T_u[2, 1], T_v[1], **WEIGHTS))
    assert np.isfinite(np.delete(distances.ravel(), 2)).all()
