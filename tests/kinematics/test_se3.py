"""SE(3) against scipy's matrix exponential, finite differences and itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from station.errors import InvalidData
from station.kinematics import se3

TINY = (0.0, 1e-300, 1e-160, 1e-20, 1e-9, 1e-6, 1e-3)
# Around the switch of the series (1 rad), small, middle and near pi.
ANGLES = (*TINY, 0.1, 0.999999, 1.0, 1.000001, 2.0, 3.0, np.pi - 1e-3, np.pi - 1e-7)
LENGTHS = (0.0, 1e-12, 1e-6, 1e-3, 1.0, 100.0)


def twist(angle: float, length: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    axis, direction = (x / np.linalg.norm(x) for x in rng.normal(size=(2, 3)))
    return np.concatenate([length * direction, angle * axis])


def hat(xi: np.ndarray) -> np.ndarray:
    v, w = xi[:3], xi[3:]
    return np.array([[0, -w[2], w[1], v[0]], [w[2], 0, -w[0], v[1]], [-w[1], w[0], 0, v[2]], [0, 0, 0, 0]])


CASES = [twist(a, d, i * 100 + j) for i, a in enumerate(ANGLES) for j, d in enumerate(LENGTHS)]


def test_exp_is_the_matrix_exponential():
    for xi in CASES:
        expected = expm(hat(xi))
        np.testing.assert_allclose(se3.exp(xi), expected, atol=1e-13 * max(1, np.abs(xi[:3]).max()))


def test_log_undoes_exp_also_at_the_identity_and_near_pi():
    for xi in CASES:
        np.testing.assert_allclose(se3.log(se3.exp(xi)), xi, rtol=1e-8, atol=1e-13 * max(1, np.abs(xi[:3]).max()))


def test_log_at_pi_gives_a_half_turn():
    for axis in np.eye(3):
        w = se3.log_so3(2 * np.outer(axis, axis) - np.eye(3))
        np.testing.assert_allclose(np.abs(w), np.pi * axis, atol=1e-14)


def numeric_jacobian(f, xi: np.ndarray, step: float) -> np.ndarray:
    return np.stack([(f(xi + step * e) - f(xi - step * e)) / (2 * step) for e in np.eye(6)], axis=-1)


@pytest.mark.parametrize("length", (0.0, 1e-9, 1e-3, 1.0, 3.0))
@pytest.mark.parametrize("angle", (0.0, 1e-12, 1e-9, 1e-4, 1e-2, 0.5, 0.9999, 1.0, 1.0001, 2.5, np.pi - 1e-3))
def test_jacobians_agree_with_finite_differences(angle: float, length: float):
    """Translation and rotation shrink independently: an error of half order shows when only one is small."""
    xi = twist(angle, length, 7)
    T = se3.exp(xi)
    left = numeric_jacobian(lambda x: se3.log(se3.exp(x) @ se3.inverse(T)), xi, 1e-5)
    right = numeric_jacobian(lambda x: se3.log(se3.inverse(T) @ se3.exp(x)), xi, 1e-5)
    np.testing.assert_allclose(se3.left_jacobian(xi), left, atol=2e-9 * max(1, length))
    np.testing.assert_allclose(se3.right_jacobian(xi), right, atol=2e-9 * max(1, length))


@pytest.mark.parametrize("angle", ANGLES)
def test_inverse_jacobians_are_inverses(angle: float):
    for length in LENGTHS:
        xi = twist(angle, length, 11)
        tolerance = 1e-12 * max(1, length) ** 2
        np.testing.assert_allclose(se3.inverse_left_jacobian(xi) @ se3.left_jacobian(xi), np.eye(6), atol=tolerance)
        np.testing.assert_allclose(se3.inverse_right_jacobian(xi) @ se3.right_jacobian(xi), np.eye(6), atol=tolerance)


def test_coefficients_have_no_step_where_the_series_ends():
    below, above = twist(1 - 1e-12, 1.0, 3), twist(1 + 1e-12, 1.0, 3)
    np.testing.assert_allclose(se3.left_jacobian(below), se3.left_jacobian(above), atol=1e-11)
    np.testing.assert_allclose(se3.inverse_left_jacobian(below), se3.inverse_left_jacobian(above), atol=1e-11)


@given(st.integers(0, 2**32 - 1))
def test_adjoint_moves_a_twist_across_a_pose(seed: int):
    rng = np.random.default_rng(seed)
    T, xi = se3.exp(rng.normal(size=6)), 0.3 * rng.normal(size=6)
    np.testing.assert_allclose(T @ se3.exp(xi), se3.exp(se3.adjoint(T) @ xi) @ T, atol=1e-12)


def test_batches_equal_single_calls():
    xi = np.stack(CASES).reshape(len(ANGLES), len(LENGTHS), 6)
    for f in (se3.exp, se3.left_jacobian, se3.inverse_right_jacobian):
        single = np.stack([[f(x) for x in row] for row in xi])
        np.testing.assert_array_equal(f(xi), single)


def test_inverse_and_mean():
    rng = np.random.default_rng(5)
    centre = se3.exp(rng.normal(size=6))
    steps = 0.2 * rng.normal(size=(7, 40, 6))
    steps -= steps.mean(axis=1, keepdims=True)
    T = centre @ se3.exp(steps)
    np.testing.assert_allclose(se3.inverse(T) @ T, np.broadcast_to(np.eye(4), T.shape), atol=1e-14)
    np.testing.assert_allclose(se3.mean(T), np.broadcast_to(centre, (7, 4, 4)), atol=1e-10)


def test_mean_weighs_and_refuses_opposite_poses():
    T = se3.exp(np.array([[0, 0, 0, 0, 0, 0], [1.0, 0, 0, 0, 0, 1.0]]))
    one_third = se3.exp(np.array([1.0, 0, 0, 0, 0, 1.0]) / 3)
    np.testing.assert_allclose(se3.mean(T, [2.0, 1.0]), one_third, atol=1e-12)
    with pytest.raises(InvalidData, match="half turn"):
        se3.mean(se3.rotation_z(np.arange(3) * 2 * np.pi / 3), iterations=0)


def test_quaternions_round_trip():
    T = se3.exp(np.stack(CASES))
    xyz, wxyz = se3.to_xyz_wxyz(T)
    np.testing.assert_allclose(se3.from_xyz_wxyz(xyz, wxyz), T, atol=1e-14 * 200)
    assert np.all(wxyz[:, 0] >= 0)


def test_rotation_between_takes_a_to_b_and_handles_opposites():
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 50, 3))
    a, b = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (a, b))
    b[:10] = -a[:10]
    b[10:20] = a[10:20]
    R = se3.rotation_between(a, b)
    np.testing.assert_allclose((R @ a[..., None])[..., 0], b, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-12)


def test_projection_is_the_nearest_rotation():
    rng = np.random.default_rng(4)
    R = se3.exp_so3(rng.normal(size=(20, 3)))
    np.testing.assert_allclose(se3.project_to_so3(3.0 * R), R, atol=1e-13)
    assert np.allclose(np.linalg.det(se3.project_to_so3(rng.normal(size=(20, 3, 3)))), 1)


def test_nan_in_gives_nan_out_and_shapes_are_checked():
    T = se3.identity(2)
    T[1] = np.nan
    assert np.all(np.isnan(se3.log(T)[1])) and not np.any(np.isnan(se3.log(T)[0]))
    assert np.all(np.isnan(se3.inverse(T)[1])) and not np.any(np.isnan(se3.inverse(T)[0]))
    with pytest.raises(InvalidData, match=r"\(\.\.\., 6\)"):
        se3.exp(np.zeros(5))
